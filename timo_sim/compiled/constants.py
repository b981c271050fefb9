# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Constants of compiled functions: named numbers and arrays in one block of memory.

A kind of constants is a NamedTuple. Its annotations say what the fields are: `float`, `int`, or
`Annotated[np.ndarray, dims...]` with the lengths of the axes, which are numbers or names of sizes,
and `int` before them if the array is one of whole numbers. An axis whose name begins with `padded`
gets zeros at its end, up to a whole number of vectors, unless the constants are those of lanes.
"""

import ctypes
import functools
import math
from typing import Any, get_args, get_type_hints, NamedTuple

import numpy as np

from timo_sim.compiled.functions import WIDTH

_CACHE_LINE = 64  # alignment of blocks in memory [B]
_NUMBER = 8       # length of a number [B]


class Field(NamedTuple):
    """A field of constants."""

    name: str
    whole: bool  # whether its numbers are whole
    dims: tuple[int | str, ...]  # lengths of its axes, () of a single number


@functools.cache
def fields_of(kind: Any) -> tuple[Field, ...]:
    """Return the fields of a kind of constants."""
    hints = get_type_hints(kind, include_extras=True)
    return tuple(Field(name, hint is int or int in get_args(hint), tuple(
        each for each in get_args(hint)[1:] if each is not int)) for name, hint in hints.items())


def local_arrays(kind: Any, like: Any) -> Any:
    """
    Return new work arrays, not initialised, for the current call of a compiled function.

    They must not outlive it. The annotations of `kind`, a NamedTuple, say what they are, as those
    of constants do; they are of lanes if the packed constants `like` are. `emit` makes the code;
    here it is what Python would do.
    """
    return kind(*(np.empty([like.sizes.get(dim, dim) for dim in field.dims])
                  for field in fields_of(kind)))


@functools.lru_cache(maxsize=1024)
def _layout(kind, shapes, lanes, pad, given):
    """
    Return the layout of constants of a kind whose fields have these shapes.

    That is sizes by name; offsets of the fields in a block, by name, and the length of a block
    [B]; types, shapes, padded, and strides [B] of the fields in a block, by name; the places of
    all their numbers in a block without lanes; and the key of its machine code.
    """
    sizes, offsets, views, places, end = dict(given), {}, {}, [np.empty(0, dtype=int)], 0
    for field, shape in zip(fields_of(kind), shapes):
        padded = tuple(size + -size % WIDTH if pad and str(dim).startswith('padded') else size
                       for dim, size in zip(field.dims, shape))
        for dim, size in zip(field.dims, padded, strict=True):
            if sizes.setdefault(dim, size) != size if isinstance(dim, str) else dim != size:
                raise ValueError(f'{field.name} of {kind.__name__} has shape {padded}, not '
                                 f'{field.dims} as of {sizes}')
        offsets[field.name] = end
        whole = *padded, *_vectors(field, lanes)
        strides = tuple(_NUMBER * math.prod(whole[axis + 1:]) for axis in range(len(whole)))
        views[field.name] = np.int64 if field.whole else float, whole, strides
        places.append(end // _NUMBER + np.arange(math.prod(padded)).reshape(padded)[
            tuple(map(slice, shape))].ravel())
        length = _NUMBER * math.prod(whole)
        end += _CACHE_LINE * math.ceil(length / _CACHE_LINE)  # as vectors should begin
    key = kind, lanes, tuple(sorted(sizes.items()))
    return sizes, offsets, max(end, _CACHE_LINE), views, np.concatenate(places), key


def _vectors(field, lanes):
    """Return the axis of lanes of a field; lanes that are vectors have whole numbers in common."""
    return (lanes,) if lanes and not (field.whole and lanes == WIDTH) else ()


class Packed:
    """
    Constants in one block of memory, or a block for each group of lanes.

    `fields` are a NamedTuple, the `kind` of constants. `lanes` is the number of lanes in a group,
    WIDTH or WARP, or 0; with lanes the first axis of every array is that of lanes, and whole
    numbers are the same in all. Axes are padded if `pad`, not for constants that are the same for
    all lanes. `sizes`, by name, are given for what no field has.

    `offsets` are the places of fields in a block, by name, `length` is that of a block [B], and
    `groups` the number of blocks. A field is also an attribute, an array with lanes last.
    """

    def __init__(self, fields: Any, lanes: int, pad: bool, sizes: dict[str, int]) -> None:
        self.kind: Any = type(fields)
        self._lanes = lanes
        kind: Any = self.kind
        described = fields_of(kind)
        values = [np.asarray(value, dtype=np.int64 if field.whole else float)
                  for field, value in zip(described, fields)]
        layout = _layout(kind, tuple(value.shape[lanes > 0:] for value in values), lanes, pad,
                         tuple(sizes.items()))
        self.sizes, self.offsets, self.length, self._layout, places, self.key = layout
        self.groups = len(values[0]) // lanes if lanes else 1
        memory = np.zeros(self.groups * self.length + _CACHE_LINE, dtype=np.uint8)
        begin = -ctypes.addressof((ctypes.c_char * 0).from_buffer(memory.data)) % _CACHE_LINE
        self.memory = memory[begin:begin + self.groups * self.length]
        if not lanes:  # what is padded stays zero
            self.memory.view(float)[places] = np.concatenate(values, axis=None)
        for field, value in zip(described, values):
            if lanes:
                view, vectors = self._array(field.name), _vectors(field, lanes)
                view[:] = np.moveaxis(value.reshape(
                    self.groups, lanes, *value.shape[1:]), 1, -1) if vectors else (
                        value[:self.groups])
            elif field.whole:
                self._array(field.name)[...] = value
        self.place = (ctypes.c_char * 0).from_buffer(self.memory.data)

    @property
    def views(self) -> dict[str, np.ndarray]:
        """The fields as arrays, by name."""
        return {name: self._array(name) for name in self._layout}

    def __reduce__(self):
        lanes = self._lanes
        values = [np.moveaxis(view, -1, 1).reshape(
            self.groups * lanes, *view.shape[1:-1]) if _vectors(field, lanes) else np.repeat(
                view, lanes, 0) for field, view in zip(
                fields_of(self.kind), self.views.values())] if lanes else self.views.values()
        return Packed, (self.kind._make(values), lanes, False, self.sizes)

    def __getattr__(self, name: str) -> np.ndarray:
        """Return a field as an array; one that has the name of another attribute is in `views`."""
        if name not in self.__dict__.get('_layout', ()):
            raise AttributeError(name)
        return self.__dict__.setdefault(name, self._array(name))

    def _array(self, name):
        kind, shape, strides = self._layout[name]
        if self._lanes:
            shape, strides = (self.groups, *shape), (self.length, *strides)
        return np.ndarray(shape, kind, self.memory, self.offsets[name], strides)


def pack(fields: Any, pad: bool = True, **sizes: int) -> Packed:
    """Return constants in one block of memory, see `Packed`."""
    return Packed(fields, 0, pad, sizes)


def pack_lanes(fields: Any, lanes: int = WIDTH, **sizes: int) -> Packed:
    """Return constants of a multiple of `lanes` lanes in blocks of memory, see `Packed`."""
    return Packed(fields, lanes, False, sizes)
