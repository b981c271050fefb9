# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
A device for a Batch on machines without a GPU: the CPU calls the same kernel for each thread.

Its arrays cannot be mixed with those of NumPy, as those of CuPy cannot.
"""

import ctypes
from functools import partial
from types import SimpleNamespace
import weakref

import numpy as np

import timo_sim
from timo_sim.compiled import machine
from timo_sim.simulation.cuda import Cuda


LIVE = [0, 0]  # bytes of arrays of the device now, and at most


def _count(array):
    """Count the memory of a new array of NumPy as the device's; return it."""
    def add(number):
        LIVE[0] += number
        LIVE[1] = max(LIVE)
    add(array.nbytes)
    weakref.finalize(array, add, -array.nbytes)
    return array


class Away(np.ndarray):
    """An array of the device: together with one of the host it is an error, as CuPy says."""

    __array_priority__ = 1.0  # also of what is made of several

    def __array_ufunc__(self, function, method, *given, **options):
        assert all(isinstance(each, Away) or np.ndim(each) == 0 for each in given)
        if 'out' in options:
            options['out'] = tuple(each.view(np.ndarray) for each in options['out'])
        return _count(np.asarray(
            getattr(function, method)(*map(np.asarray, given), **options))).view(Away)

    def __array_finalize__(self, source):
        if self.flags.owndata:  # a copy; others are views
            _count(self)

    def __getitem__(self, key):
        found = super().__getitem__(key)
        chosen = isinstance(found, Away) and not np.may_share_memory(found, self)
        return _count(found) if chosen and not found.flags.owndata else found

    def __setitem__(self, key, value):
        assert isinstance(value, Away) or np.ndim(value) == 0
        super().__setitem__(key, value)


class Library:
    """NumPy, in place of CuPy."""

    ndarray, lib = Away, SimpleNamespace(stride_tricks=SimpleNamespace(
        as_strided=partial(np.lib.stride_tricks.as_strided, subok=True)))

    def __getattr__(self, name):
        def call(*given, **options):
            found = getattr(np, name)(*given, **options)
            if isinstance(found, Away) or (
                    isinstance(given[0], Away) and np.may_share_memory(found, given[0])):
                return found.view(Away)
            return _count(np.array(found)).view(Away)
        return call


class Processor(Cuda):
    """The device, see the text of the module."""

    xp, free = Library(), 2**40

    def __init__(self):
        pass

    def owns(self, given):
        return isinstance(given, Away)

    def host(self, array):
        return np.array(array) if isinstance(array, Away) else array

    def make_room(self, number):
        if number > self.free:
            raise timo_sim.ParameterError('n must fit')

    def kernel(self, entry, constants):
        code = ctypes.CFUNCTYPE(ctypes.c_int64)(machine.load(entry, constants))

        def launch(count, *arrays):
            assert all(isinstance(each, Away) and each.flags.c_contiguous for each in arrays)
            places = [ctypes.c_void_p(each.ctypes.data) for each in arrays]
            for thread in range(count):
                code(*places, ctypes.c_int64(thread))
        return launch
