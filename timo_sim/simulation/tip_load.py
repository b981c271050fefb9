# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The load at the tip, which changes while a simulation runs."""

from copy import copy
from dataclasses import replace
import math

import numpy as np

from timo_sim.physics.equations.pick_up import pick_up


class TipLoad:
    """
    Mass and inertia at the tip; the modes stay those of the end effector of the first scene.

    Sections keep place and velocity, since the modes do; a load that is picked up from rest
    changes velocities, see `physics.equations.pick_up`.

    Parameters
    ----------
    scene : Scene

    Attributes
    ----------
    tip : tuple of float
        Mass [kg] and inertia [kg m2] now.
    lost : float
        Energy lost in plastic impacts since the initial motion [J].

    """

    def __init__(self, scene):
        self._first = self.tip = _own(scene)
        self._payloads, self._next, self.lost = scene.payloads, 0, 0.0

    def copy(self):
        """Return a copy as it is now."""
        return copy(self)

    def reset(self, scene):
        """Return to the end effector of a scene, and whether that is another one than now."""
        before, self.tip, self._next, self.lost = self.tip, _own(scene), 0, 0.0
        return self.tip != before

    @property
    def next_step(self):
        """Number of the step at which the scene changes the load next; infinite: never."""
        return self._payloads[self._next][0] if self._next < len(self._payloads) else math.inf

    def take_next(self):
        """Return mass and inertia from `next_step` on, and go to the change after it."""
        self._next += 1
        return self._payloads[self._next - 1][1:]

    def of_change(self, before, scene):
        """Return mass and inertia after a change of the scene: its own, if it changes them."""
        return self.tip if _own(scene) == _own(before) else _own(scene)

    def add(self, tip):
        """Set mass and inertia; return what is added of each, or None if nothing changes."""
        before, self.tip = self.tip, tip
        return None if tip == before else [now - then for now, then in zip(tip, before)]

    def model(self, scene):
        """Return the formulation of a scene with this load."""
        mass, inertia = self._first
        return scene.build(replace(scene.manipulator, end_effector_mass=mass,
                                   end_effector_inertia=inertia), self.tip)

    def picked_up(self, scene, model, motion, added):
        """Return the motion after mass and inertia are added."""
        taken = [max(change, 0.0) for change in added]
        if scene.values['end_effector.pick_up'] == 'at_rest' and any(taken):
            motion, lost = pick_up(model, motion, *taken)
            self.lost += lost
        return motion


def pieces(scene, steps, payloads):
    """
    Return the formulations of a run whose load at the tip changes, and their samples.

    Parameters
    ----------
    scene : Scene
    steps : ndarray of int, shape (n,)
        Of the samples, ascending; one at the step of a change is from before it. If there are
        several, which a reset divides, the last is from after it.
    payloads : sequence of (int, float, float)
        Step, mass [kg] and inertia [kg m2] from then on, ascending.

    Returns
    -------
    list of (Formulation, slice)

    """
    first, last = (np.searchsorted(steps, [step for step, *_ in payloads], side)
                   for side in ('left', 'right'))
    bounds = [0, *(last - (last - first > 1)), len(steps)]
    tips = [None, *((mass, inertia) for _, mass, inertia in payloads)]
    return [(scene.build(scene.manipulator, tip), slice(first, last))
            for tip, first, last in zip(tips, bounds, bounds[1:]) if first < last]


def _own(scene):
    return scene.manipulator.end_effector_mass, scene.manipulator.end_effector_inertia
