# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Decorators of compiled functions, kinds of arguments of entry points, and what they may call."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

WIDTH = 8  # number of floats in a vector, and of lanes
WARP = 32  # number of lanes side by side in memory where each is a thread of a GPU


class Function:
    """
    A function that only compiled functions call.

    If it is `fast`, sums may be reordered and products fused. It becomes a part of its callers if
    `merge`, else it is one function that they call.
    """

    def __init__(self, function: Callable, fast: bool = True, merge: bool = True) -> None:
        self.function, self.fast, self.merge = function, fast, merge
        self.__doc__, self.__name__ = function.__doc__, function.__name__
        self.__module__, self.__wrapped__ = function.__module__, function

    def __call__(self, *args: Any) -> Any:
        """Call the Python function."""
        return self.function(*args)


class Declaration(Function):
    """
    A function whose body is chosen, when it is compiled, by the kind of its first argument.

    `@declared.of(Kind)` registers the body for constants of a kind; with `duals` one that takes
    its place for duals.
    """

    def __init__(self, function: Callable) -> None:
        super().__init__(function)
        self.bodies: dict[Any, Function] = {}

    def of(self, kind: type, merge: bool = False, duals: bool = False,
           fast: bool = True) -> Callable[[Callable], Function]:
        """Return a decorator that registers the body for constants of a kind, see `Function`."""
        def add(function: Callable) -> Function:
            made = self.bodies[(kind, 'duals') if duals else kind] = Function(
                function, fast, merge)
            return made
        return add


# Decorators of functions that only compiled functions call.
inner = Function                           # part of its callers
strict = partial(Function, fast=False)     # without any fast math
declare = Declaration


class Array(NamedTuple):
    """An argument of an entry point: an array in C order."""

    # Lengths of its axes: numbers, names of sizes, None for the first one if any will do.
    dims: tuple[int | str | None, ...]
    lanes: bool = False  # whether lanes are one more axis, the last
    whole: bool = False  # whether its numbers are whole, of 64 bits
    # Whether callers give no other code a reference, with which its memory could be freed: then
    # the same array is checked once.
    own: bool = False


class Constants(NamedTuple):
    """
    An argument of an entry point: packed constants.

    Their form is 'floats'; 'shared', floats that are the same for all lanes; or 'lanes', one block
    of lanes for each group of them. Of the latter two, `constants[g]` are those of group g. If
    `duals` > 0, they are floats beside duals of that size.
    """

    form: str = 'floats'
    duals: int = 0


class Thread:
    """
    An argument of an entry point of lanes, the last: the number of a thread, which is a lane.

    The function gets the number of its group of WARP lanes, and lanes of width 1.
    """


# Functions that compiled functions call; `emit` gives them their code. Here they are as Python
# would compute them, also of arrays: so formulas of compiled functions serve NumPy, too.

def local(like: Any) -> Any:
    """
    Return a work array, not initialised, for the current call of a compiled function.

    The length of its k-th axis is that of the first axis of the k-th array in `like`. It must not
    outlive the function that makes it.
    """
    return np.empty([len(array) for array in like])


def as_vectors(array: Any) -> Any:
    """
    Return an array of floats as one of vectors of WIDTH numbers; what is one stays as it is.

    The length of its last axis is a multiple of WIDTH. In a NamedTuple of `local_arrays` this is
    done with each array whose last axis is padded.
    """
    return array.reshape(*array.shape[:-1], -1, WIDTH)


def sum_of(vector: Any, like: Any) -> Any:
    """
    Return the sum of a vector's numbers, if `like` is an array of floats.

    If it is one of lanes, each number belongs to another run, and the vector stays as it is.
    """
    return np.sum(vector)


def floor(value: Any) -> Any:
    """Return the largest whole number up to a value, as a float."""
    return np.floor(value)


def magnitude(value: Any) -> Any:
    """Return the absolute value."""
    return abs(value)


def square_root(value: Any) -> Any:
    """Return the square root."""
    return np.sqrt(value)


def where(condition: Any, yes: Any, no: Any) -> Any:
    """Return `yes` where a condition holds, else `no`; both have been computed."""
    return np.where(condition, yes, no)


def some(condition: Any) -> Any:
    """Return whether a condition holds, in any lane."""
    return np.any(condition)


def value_of(number: Any) -> Any:
    """Return a number without its derivatives."""
    return number


def chain(value: Any, slope: Any, number: Any) -> Any:
    """Return a value with the derivatives of a number, if it has some, times a slope."""
    return value


def with_derivatives(array: Any) -> Any:
    """Return an array of duals as one of floats: the last axis has a number and derivatives."""
    return array


def without_derivatives(constants: Any) -> Any:
    """Return constants beside duals as those of a function of floats."""
    return constants
