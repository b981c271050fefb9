# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
A device for a Batch on machines without a GPU: the CPU calls the same kernel for each thread.

Its arrays cannot be mixed with those of NumPy, as those of CuPy cannot.
"""

import ctypes
from functools import partial
from types import SimpleNamespace

import numpy as np

import timo_sim
from timo_sim.compiled import machine
from timo_sim.simulation.cuda import Cuda


class Away(np.ndarray):
    """An array of the device: together with one of the host it is an error, as CuPy says."""

    def __array_ufunc__(self, function, method, *given, **options):
        assert all(isinstance(each, Away) or np.ndim(each) == 0 for each in given)
        if 'out' in options:
            options['out'] = tuple(each.view(np.ndarray) for each in options['out'])
        return np.asarray(getattr(function, method)(*map(np.asarray, given), **options)).view(Away)

    def __setitem__(self, key, value):
        assert isinstance(value, Away) or np.ndim(value) == 0
        super().__setitem__(key, value)


class Library:
    """NumPy, in place of CuPy."""

    ndarray, lib = Away, SimpleNamespace(stride_tricks=SimpleNamespace(
        as_strided=partial(np.lib.stride_tricks.as_strided, subok=True)))

    def __getattr__(self, name):
        return lambda *given, **options: np.array(getattr(np, name)(*given, **options)).view(Away)


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
