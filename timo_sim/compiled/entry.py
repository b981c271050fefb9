# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Entry points: compiled functions that Python calls."""

from collections.abc import Callable
import ctypes
from typing import Any

import numpy as np

from timo_sim.compiled import machine
from timo_sim.compiled.constants import Packed
from timo_sim.compiled.functions import Constants, Function, WIDTH


class EntryPoint(Function):
    """
    A function that Python calls.

    Parameters
    ----------
    function : function
    arguments : dict
        What its arguments are, by name: `Constants` first, then `Array`, int or float. It returns
        an int or nothing.
    name : str
        Name in its module, by default that of the function.
    fast : bool
        See `Function`.

    """

    def __init__(self, function: Callable, arguments: dict[str, Any], name: str = '',
                 fast: bool = True) -> None:
        super().__init__(function, fast)
        self.arguments = arguments
        module = function.__module__.removeprefix('timo_sim.')
        self.name = f'{module}.{name or function.__name__}'
        self._arrays = [given for given in arguments.values() if not isinstance(given, Constants)]
        kinds: dict[Any, Any] = {int: ctypes.c_int64, float: ctypes.c_double}
        self._prototype = ctypes.CFUNCTYPE(ctypes.c_int64, *(
            kinds.get(given, ctypes.c_void_p) for given in arguments.values()))
        self._known: dict[Any, Any] = {}

    def of(self, *constants: Packed) -> 'Call':
        """Return the function for some constants, with machine code for their sizes."""
        key = tuple([each.key for each in constants])
        if key not in self._known:
            self._known[key] = (self._prototype(machine.load(self, constants)),
                                self._wanted(constants))
        code, wanted = self._known[key]
        return Call(code, wanted, constants)

    def _wanted(self, constants):
        """Return shape and type of each array, None for a number."""
        sizes = {name: size for each in constants for name, size in each.sizes.items()}
        return [None if given in (int, float) else
                (tuple(sizes.get(dim, dim) for dim in given.dims) + given.lanes * (WIDTH,),
                 np.dtype(np.int64 if given.whole else float)) for given in self._arrays]

    def __call__(self, *args: Any) -> Any:
        """Call the machine code; `of` is faster where constants stay the same."""
        count = len(self.arguments) - len(self._arrays)
        return self.of(*args[:count])(*args[count:])


def entry_point(fast: bool = True, **arguments: Any) -> Callable[[Callable], EntryPoint]:
    """Return a decorator for a module-level function that Python calls, see `EntryPoint`."""
    return lambda function: EntryPoint(function, arguments, fast=fast)


_Place = ctypes.c_char * 0


class Call:
    """A function of machine code with its constants; called with the other arguments."""

    def __init__(self, code: Any, wanted: list[Any], constants: tuple[Packed, ...]) -> None:
        self._code, self._wanted, self._constants = code, wanted, constants
        self._places = [each.place for each in constants]

    def __call__(self, *args: Any) -> int:
        """
        Call the machine code.

        Raises
        ------
        ValueError
            If an array is of another shape or type than the machine code reads.

        """
        places: list[Any] = []
        for wanted, value in zip(self._wanted, args, strict=True):
            if wanted is None:
                places.append(value)
                continue
            # Machine code checks nothing: an array that is too short would be read beyond its end.
            (shape, dtype), given = wanted, value.shape
            if given != shape and (shape[0] is not None or given[1:] != shape[1:]) or (
                    value.dtype != dtype):
                raise ValueError(f'compiled code needs {dtype} of shape {shape}, '
                                 f'got {value.dtype} of shape {given}')
            try:
                places.append(_Place.from_buffer(value))
            except (TypeError, ValueError, BufferError):  # read-only, or not in C order
                if not value.flags.c_contiguous:
                    raise ValueError('compiled code needs arrays in C order') from None
                places.append(value.ctypes.data)
        return self._code(*self._places, *places)
