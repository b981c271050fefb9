# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The device of a Batch that is a GPU of NVIDIA: memory and kernels by CuPy, the extra `cuda`."""

from collections.abc import Callable
from typing import Any

import numpy as np

from timo_sim.compiled import machine
from timo_sim.extras import optional
from timo_sim.scene.parameters import ParameterError

_BLOCK = 64  # threads of a block
_OLDEST, _NEWEST = 80, 90  # compute capabilities for which PTX is made; later GPUs take the last
_MEMORIES = 2, 13  # of DLPack's kinds of memory: that of a GPU, and that which CUDA manages
_KERNELS: dict[Any, Any] = {}  # by their text and number of the device


class Cuda:
    """
    The current device of CuPy, see `steps.threads.ThreadSteps`.

    Raises MissingPackage without CuPy, ParameterError without such a GPU.
    """

    def __init__(self) -> None:
        cuda = self.xp.cuda
        try:
            capability = int(cuda.Device().compute_capability)
        except cuda.runtime.CUDARuntimeError as error:
            raise ParameterError("device must be 'cpu' without an NVIDIA GPU and its driver, got "
                                 f"'cuda': {error}") from None
        if capability < _OLDEST:
            raise ParameterError(f"device = 'cuda' needs a GPU of compute capability "
                                 f'{_OLDEST / 10} or newer, got {capability / 10}')
        self._processor = f'sm_{_NEWEST if capability >= _NEWEST else _OLDEST}'

    @property
    def xp(self) -> Any:
        """CuPy."""
        with optional():
            import cupy
        return cupy

    def owns(self, given: Any) -> bool:
        """Return whether something is an array of a device."""
        return hasattr(given, '__dlpack_device__') and given.__dlpack_device__()[0] in _MEMORIES

    def array(self, name: str, given: Any, shape: tuple[int, ...]) -> Any:
        """Return an array of finite numbers that the device has, or raise ParameterError."""
        array = self._taken(given)
        if array.shape != shape or not self.xp.isfinite(array).all():
            raise ParameterError(f'{name} must have shape {shape} and finite numbers, got shape '
                                 f'{array.shape}, {self.host(array).ravel()[:3]} ...')
        return array

    def host(self, array: Any) -> np.ndarray:
        """Return an array of the device as one of NumPy."""
        return self.xp.asnumpy(self._taken(array))

    def _taken(self, given):
        ours = isinstance(given, self.xp.ndarray) or not self.owns(given)
        return given if ours else self.xp.from_dlpack(given)

    def make_room(self, number: int) -> None:
        """Raise ParameterError if the device has no room for so many bytes, else keep them."""
        try:
            self.xp.cuda.alloc(number)  # CuPy's pool has them for the arrays that are made next
        except MemoryError:
            free = (self.xp.cuda.Device().mem_info[0]
                    + self.xp.get_default_memory_pool().free_bytes())
            raise ParameterError(
                f'n must fit into the memory of the GPU: {number / 2**30:.1f} GiB are needed, '
                f'{free / 2**30:.1f} GiB are free') from None

    def kernel(self, entry: Any, constants: tuple[Any, ...]) -> Callable[..., None]:
        """Return a function that calls an entry point with the first threads."""
        text = machine.ptx(entry, constants, self._processor)
        key = text, self.xp.cuda.Device().id

        def launch(count: int, *arrays: Any) -> None:
            _KERNELS[key]((1 + count // _BLOCK,), (_BLOCK,), (*arrays, self.xp.int64(count)))

        if key not in _KERNELS:
            module = self.xp.cuda.Module()
            module.load(text)
            _KERNELS[key] = module.get_function(machine.KERNEL)
            # At its first call the driver takes room for the stacks of all threads, and keeps it.
            launch(0, *[self.xp.uint64(0)] * (len(entry.arguments) - 1))
        return launch
