# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Entry points: compiled functions that Python calls."""

from collections.abc import Callable, Sequence
import ctypes
from functools import partial
from operator import is_
from typing import Any

import numpy as np

from timo_sim.compiled import machine
from timo_sim.compiled.constants import Packed
from timo_sim.compiled.functions import Constants, Function, Thread, WARP, WIDTH


class EntryPoint(Function):
    """
    A function that Python calls.

    `arguments` says what its arguments are, by name: `Constants` first, then `Array`, int or
    float, or `Thread` at last. It returns an int or nothing. `name` is that in its module, by
    default the function's; for `fast` see `Function`.
    """

    def __init__(self, function: Callable, arguments: dict[str, Any], name: str = '',
                 fast: bool = True) -> None:
        super().__init__(function, fast)
        self.arguments = arguments
        module = function.__module__.removeprefix('timo_sim.')
        self.name = f'{module}.{name or function.__name__}'
        self.threads = Thread in arguments.values()
        self._arrays = [given for given in arguments.values() if not isinstance(given, Constants)]
        self._known: dict[Any, Any] = {}

    def of(self, *constants: Packed, any_size: bool = False) -> 'Call':
        """
        Return the function for some constants, with machine code for their sizes.

        `any_size` is slower code that serves all sizes, and differs in round-off.
        """
        return Call(self, any_size, constants, *self._code_for(constants, any_size))

    def _code_for(self, constants, any_size):
        """Return the code, what passes its arguments, see `_wanted`, and what passes sizes."""
        key = any_size, *[each.key for each in constants]
        if key not in self._known:
            code, sizes = machine.load(self, constants, any_size), []
            if any_size:
                sizes = [size for _, size in sorted(machine.symbols_of(constants).items())]
            self._known[key] = ((_CodeForAnySize if any_size else _Code)(code),
                                self._wanted(constants),
                                [(ctypes.c_int64 * len(sizes))(*sizes)] * any_size)
        return self._known[key]

    def _wanted(self, constants):
        """Return for each argument the function that returns what passes it; whether once."""
        sizes = {name: size for each in constants for name, size in each.sizes.items()}
        lanes = WARP if self.threads else WIDTH
        return [(_NUMBERS[given], True) if given in _NUMBERS else (partial(
            _place, tuple(sizes.get(dim, dim) for dim in given.dims) + given.lanes * (lanes,),
            np.dtype(np.int64 if given.whole else float)), given.own) for given in self._arrays]

    def __reduce__(self):
        return self.name.rpartition('.')[2]  # its module has it

    def __call__(self, *args: Any) -> Any:
        """Call the machine code; `of` is faster where constants stay the same."""
        count = len(self.arguments) - len(self._arrays)
        code, wanted, _ = self._code_for(args[:count], False)
        return code(*[each.place for each in args[:count]], *[
            place(value) for (place, _), value in zip(wanted, args[count:], strict=True)])


def entry_point(fast: bool = True, **arguments: Any) -> Callable[[Callable], EntryPoint]:
    """Return a decorator for a module-level function that Python calls, see `EntryPoint`."""
    return lambda function: EntryPoint(function, arguments, fast=fast)


_Place = ctypes.c_char * 0
_Code = ctypes.CFUNCTYPE(ctypes.c_int64)  # arguments are ctypes objects, so that none is converted
# It has sizes in global variables: it keeps the lock of Python, so that threads take turns.
_CodeForAnySize = ctypes.PYFUNCTYPE(ctypes.c_int64)
_NUMBERS: dict[Any, Any] = {
    int: ctypes.c_int64, float: ctypes.c_double, Thread: ctypes.c_int64}
_SHORT = 2**16  # longest array that a Call keeps in memory [B]
_NONE = object()  # is no argument


class Call:
    """A function of machine code with its constants; called with the other arguments."""

    def __init__(self, entry: EntryPoint, any_size: bool, constants: tuple[Packed, ...],
                 code: Any, wanted: list[Any], sizes: list[Any]) -> None:
        self._entry, self._code, self._wanted, self._constants = entry, code, wanted, constants
        self._any_size = any_size
        self._places = sizes + [each.place for each in constants]
        # Cache: arguments of the last call, and what passed them. The same object needs no check.
        self._last: tuple[Sequence[Any], list[Any]] = [_NONE] * len(wanted), [None] * len(wanted)

    def __reduce__(self):
        return partial(self._entry.of, any_size=self._any_size), self._constants

    def __call__(self, *args: Any) -> int:
        """Call the machine code; ValueError if an array is not of the shape or type it reads."""
        values, places = self._last
        if len(args) != len(values) or not all(map(is_, args, values)):
            places = self._check(args)
        return self._code(*self._places, *places)

    def _check(self, args):
        """Return what passes the arguments."""
        values, kept = self._last
        places, lent = [*kept], []
        for k, (value, last) in enumerate(zip(args, values, strict=True)):
            if value is not last:
                place, once = self._wanted[k]
                places[k] = place(value)
                if not once or getattr(value, 'nbytes', 0) > _SHORT:
                    lent.append(k)
        values, kept = ([*args], [*places]) if lent else (args, places)
        for k in lent:  # of these nothing is kept
            values[k], kept[k] = _NONE, None
        self._last = values, kept
        return places


def _place(shape, dtype, value):
    """Return what passes an array; machine code itself checks nothing."""
    given = value.shape
    if given != shape and (shape[0] is not None or given[1:] != shape[1:]) or (
            value.dtype != dtype):
        raise ValueError(f'compiled code needs {dtype} of shape {shape}, '
                         f'got {value.dtype} of shape {given}')
    try:
        return _Place.from_buffer(value)
    except (TypeError, ValueError, BufferError):  # read-only, or not in C order
        if not value.flags.c_contiguous:
            raise ValueError('compiled code needs arrays in C order') from None
        return ctypes.c_void_p(value.ctypes.data)
