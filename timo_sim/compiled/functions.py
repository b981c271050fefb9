# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Decorators of compiled functions, and the calls of their machine code."""

from collections.abc import Callable
import ctypes
import math
from typing import Any, NamedTuple

import numpy as np

from timo_sim.compiled import machine
from timo_sim.compiled.constants import Packed


class Function:
    """
    A function that only compiled functions call; it becomes a part of them.

    Parameters
    ----------
    function : function
    fast : bool
        Whether sums may be reordered and products fused.
    merge : bool
        Whether it becomes a part of its callers; else it is one function that they call.

    """

    def __init__(self, function: Callable, fast: bool = True, merge: bool = True) -> None:
        self.function, self.fast, self.merge = function, fast, merge
        self.__doc__, self.__name__ = function.__doc__, function.__name__
        self.__module__, self.__wrapped__ = function.__module__, function

    def __call__(self, *args: Any) -> Any:
        """Call the Python function."""
        return self.function(*args)


def inner(function: Callable) -> Function:
    """Compile a function that only compiled functions call; it becomes part of its callers."""
    return Function(function)


def separate(function: Callable) -> Function:
    """Compile a function that only compiled functions call, as one copy for all of them."""
    return Function(function, merge=False)


def strict(function: Callable) -> Function:
    """Compile a function that only compiled functions call, without any fast math."""
    return Function(function, fast=False)


class Declaration(Function):
    """
    A function whose body is chosen, when it is compiled, by the kind of its first argument.

    `@declared.of(Kind)` registers the body for constants of a kind.
    """

    def __init__(self, function: Callable) -> None:
        super().__init__(function)
        self.bodies: dict[type, Function] = {}

    def of(self, kind: type, merge: bool = False) -> Callable[[Callable], Function]:
        """Return a decorator that registers the body for constants of a kind, see `Function`."""
        def add(function: Callable) -> Function:
            self.bodies[kind] = Function(function, merge=merge)
            return self.bodies[kind]
        return add


def declare(function: Callable) -> Declaration:
    """Declare a function whose bodies are registered by kinds of constants."""
    return Declaration(function)


class Array(NamedTuple):
    """
    An argument of an entry point: an array in C order.

    Attributes
    ----------
    dims : tuple of int, str or None
        Lengths of its axes: numbers, names of sizes, None for the first one if any will do.
    lanes : bool
        Whether lanes are one more axis, the last.
    whole : bool
        Whether its numbers are whole, of 64 bits.

    """

    dims: tuple[int | str | None, ...]
    lanes: bool = False
    whole: bool = False


class Constants(NamedTuple):
    """
    An argument of an entry point: packed constants.

    Attributes
    ----------
    form : str
        'floats'; 'shared': floats that are the same for all lanes; 'lanes': one block of lanes for
        each group of them.

    """

    form: str = 'floats'


class EntryPoint(Function):
    """
    A function that Python calls.

    Parameters
    ----------
    function : function
    arguments : dict
        What its arguments are, by name: `Constants` first, then `Array`, int or float. It returns
        an int or nothing.

    """

    def __init__(self, function: Callable, arguments: dict[str, Any]) -> None:
        super().__init__(function)
        self.arguments = arguments
        self.name = f'{function.__module__.removeprefix("timo_sim.")}.{function.__name__}'
        self._arrays = [given for given in arguments.values() if not isinstance(given, Constants)]
        self._prototype = ctypes.CFUNCTYPE(ctypes.c_int64, *(
            {int: ctypes.c_int64, float: ctypes.c_double}.get(given, ctypes.c_void_p)
            for given in arguments.values()))
        self._known: dict[Any, Any] = {}

    def of(self, *constants: Packed) -> 'Call':
        """Return the function for some constants, with machine code for their sizes."""
        key = self._key(constants)
        if key not in self._known:
            self._known[key] = self._prototype(machine.load(self, constants))
        return Call(self._known[key], constants, self._arrays)

    def _key(self, constants):
        return tuple(each.key for each in constants)

    def __call__(self, *args: Any) -> Any:
        """Call the machine code; `of` is faster where constants stay the same."""
        count = len(self.arguments) - len(self._arrays)
        return self.of(*args[:count])(*args[count:])


def entry_point(**arguments: Any) -> Callable[[Callable], EntryPoint]:
    """Return a decorator for a module-level function that Python calls, see `EntryPoint`."""
    return lambda function: EntryPoint(function, arguments)


_Place = ctypes.c_char * 0


class Call:
    """A function of machine code with its constants; called with the other arguments."""

    def __init__(self, code: Any, constants: tuple[Packed, ...], arguments: list[Any]) -> None:
        self._code, self._constants = code, constants
        self._places = tuple(each.place for each in constants)
        sizes = {name: size for each in constants for name, size in each.sizes.items()}
        self._shapes = [
            None if given in (int, float) else
            (tuple(sizes.get(dim, dim) for dim in given.dims) + given.lanes * (machine.WIDTH,),
             np.dtype(np.int64 if given.whole else float))
            for given in arguments]

    def __call__(self, *args: Any) -> int:
        """
        Call the machine code.

        Raises
        ------
        ValueError
            If an array is of another shape or type than the machine code reads.

        """
        places: list[Any] = []
        for wanted, value in zip(self._shapes, args, strict=True):
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


# Functions that compiled functions call; `emit` gives them their code. Here they are as Python
# would compute them.

def local(like: Any) -> Any:
    """
    Return a work array, not initialised, for the current call of a compiled function.

    Parameters
    ----------
    like : tuple of arrays
        The length of the new array's k-th axis is that of the k-th array's first axis. The array
        must not outlive the function that makes it.

    """
    return np.empty([len(array) for array in like])


def as_vectors(array: Any) -> Any:
    """
    Return an array of floats as one of vectors of WIDTH numbers; what is one stays as it is.

    The length of its last axis is a multiple of WIDTH.
    """
    return array.reshape(*array.shape[:-1], -1, machine.WIDTH)


def sum_of(vector: Any, like: Any) -> Any:
    """
    Return the sum of a vector's numbers, if `like` is an array of floats.

    If it is one of lanes, each number belongs to another run, and the vector stays as it is.
    """
    return np.sum(vector)


def floor(value: Any) -> float:
    """Return the largest whole number up to a value, as a float."""
    return float(math.floor(value))


def magnitude(value: Any) -> Any:
    """Return the absolute value."""
    return abs(value)


def square_root(value: Any) -> Any:
    """Return the square root."""
    return math.sqrt(value)


def where(condition: Any, yes: Any, no: Any) -> Any:
    """Return `yes` where a condition holds, else `no`; both have been computed."""
    return yes if condition else no


def some(condition: Any) -> Any:
    """Return whether a condition holds, in any lane."""
    return condition
