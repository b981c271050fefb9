# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Equal time steps of many models of one size on a GPU: a lane is a thread of it."""

from functools import cached_property
from typing import Any

import numpy as np

from timo_sim.compiled.entry import EntryPoint
from timo_sim.compiled.functions import Thread, WARP
from timo_sim.model.formulation import Formulation
from timo_sim.model.layout import LOADS
from timo_sim.steps.lanes import advance_alike, advance_each, advance_group, Lane, LaneSteps

# As those of `lanes`, but a call advances one lane, whose number is its last argument.
thread_alike, thread_each = (
    EntryPoint(advance_group, {**entry.arguments, 'group': Thread}, name)
    for entry, name in ((advance_alike, 'thread_alike'), (advance_each, 'thread_each')))

# Numbers that resets and commands need in each lane for a moment.
_MOMENTARY = 3 * LOADS


class ThreadSteps(LaneSteps):
    """
    As `LaneSteps`, in groups of WARP. Models with sectors wait for the host at each step.

    The arrays are in the memory of a `device`: `xp` is its NumPy, `make_room(number)` raises an
    error if it has no room for so many bytes, `host(array)` returns an array of NumPy, and
    `kernel(entry, constants)` a function that calls an entry point with the first threads; its
    arguments are their number and what passes those of the entry point but the last. The room for
    the stacks of all threads is taken when the kernel is made.
    """

    width, most_numbers = WARP, 2**27

    def __init__(self, device: Any, models: list[Formulation], step: float, bend_limit: float,
                 bristles: np.ndarray, alike: bool) -> None:
        self._device, self.xp, self._count = device, device.xp, len(models)
        self._memory: list[Any] = []
        alike = alike and all(model is models[0] for model in models) and bool(
            (bristles == bristles[0]).all())
        # The first group tells how much memory all need.
        super().__init__(models[:WARP], step, bend_limit, bristles[:WARP], alike)
        self._kernel  # makes it
        alike = self._alike
        self.groups = -(-len(models) // WARP)
        repeated = [*2 * [1 if alike else self.groups], *2 * [self.groups]]
        kept = sum(each.length * count for each, count in zip(self._constants, repeated))
        device.make_room(kept + 8 * WARP * self.groups * _MOMENTARY)
        self._models, self._bristles = self._padded(models), bristles
        if self._sectors is not None:
            self._sectors = np.full(len(self._models), -1)
        packed = self._constants if alike else self._pack(
            self._models, bend_limit, self._padded(bristles))
        self._memory = [self.xp.tile(self.xp.asarray(each.memory.view(float)), count)
                        if count > each.groups else self.xp.asarray(each.memory.view(float))
                        for each, count in zip(packed, repeated)]
        self._name_fields()

    def _fields(self, part):
        packed, found = self._constants[part], super()._fields(part)
        return {name: self.xp.lib.stride_tricks.as_strided(
            self._memory[part][packed.offsets[name] // 8:], (self.groups, *view.shape[1:]),
            view.strides) for name, view in found.items()} if self._memory else found

    def host(self, array: Any) -> np.ndarray:
        """Return an array of the device as one of NumPy."""
        return self._device.host(array)

    def make_room(self, number: int) -> None:
        """Raise an error if there is no room for so many numbers in each lane."""
        self._device.make_room(8 * self.groups * WARP * (number + _MOMENTARY))

    def __getstate__(self):
        return {name: each for name, each in vars(self).items()
                if name not in ('xp', '_kernel', '_bands', *Lane._fields)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.xp = state['_device'].xp
        super().__setstate__(state)

    @cached_property
    def _kernel(self):
        return self._device.kernel(thread_alike if self._alike else thread_each, self._constants)

    def _call(self, columns, varying, sample_every, since, samples, tips):
        self._plan_call(columns, varying, sample_every, since, samples, tips)
        self._kernel(self._count, *self._memory, *map(self.xp.asarray, (
            self._constants[-1].memory, columns, varying)), samples, tips)
