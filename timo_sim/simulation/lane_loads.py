# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The loads of many scenes at once: their own, and those that actuators make of commands."""

import numpy as np

from timo_sim.jit.lanes import WIDTH
from timo_sim.physics.integrate.lane_steps import to_lanes
from timo_sim.physics.layout import AFTER, LOADS, START, STEP_LOADS, TORQUE, VOLTAGE
from timo_sim.simulation.actuators import Actuators


class LaneLoads:
    """
    Loads of n scenes with the same time step.

    Parameters
    ----------
    scenes : list of Scene

    """

    def __init__(self, scenes):
        self._step, self._scenes = scenes[0].step, scenes
        kinds = [(id(scene.load.terms), scene.load.drive) for scene in scenes]
        loads = {kind: scene.load for kind, scene in zip(kinds, scenes)}
        self._loads, place = list(loads.values()), {kind: k for k, kind in enumerate(loads)}
        self._which = np.array([place[kind] for kind in kinds])
        actuators = {id(scene): Actuators(scene.values) for scene in scenes}
        self._limit, self._gain = (np.array([
            getattr(actuators[id(scene)], name) for scene in scenes])
            for name in ('limit', 'gain'))
        self._slow, slow = {}, set()
        for lane, scene in enumerate(scenes):
            if len(actuators[id(scene)].slow):
                slow.update(actuators[id(scene)].slow)
                self._slow[lane] = None
        own = (load.columns for load in self._loads)
        self.columns = np.array(sorted(slow.union(*own)), dtype=np.int64)
        self._places = np.searchsorted(self.columns, np.arange(LOADS))
        self.reset(range(len(scenes)), 0)

    def reset(self, lanes, first):
        """Let no command act in some lanes from step `first` on."""
        for lane in self._slow.keys() & set(lanes):
            self._slow[lane] = Actuators(self._scenes[lane].values, first)

    def command(self, commanded, first):
        """
        Take the commands from step `first` on.

        Parameters
        ----------
        commanded : ndarray, shape (n, 14)
            See `physics.layout`.
        first : int

        Returns
        -------
        ndarray, shape (n, 14)
            What acts of them and does not vary with time.

        """
        acting = np.clip(commanded, -self._limit, self._limit)
        acting[:, TORQUE] += self._gain * acting[:, VOLTAGE]
        for lane, actuators in self._slow.items():
            actuators.command(commanded[lane], first)
            acting[lane, actuators.slow] = 0.0
        return acting

    def varying(self, first, count, origin):
        """
        Return what varies with time of the loads of some steps.

        Parameters
        ----------
        first, count : int
            Number of the first step, and number of steps.
        origin : ndarray, shape (n,)
            Number of the step at which the scene's own loads begin, in each lane.

        Returns
        -------
        ndarray, shape (groups, 1 + count, 4, len(columns), WIDTH)
            See `lane_steps.advance_each`.

        """
        shape = 1 + count, STEP_LOADS, len(self.columns)
        if not len(self.columns):
            return np.empty((-(-len(origin) // WIDTH), *shape, WIDTH))
        # Lanes with the same load that began at the same step; complex numbers are sorted fast.
        kinds, kind = np.unique(self._which + 1j * (first - origin), return_inverse=True)
        found = np.zeros((len(kinds), *shape))
        for number, begin, loads in zip(kinds.real.astype(int), kinds.imag.astype(int), found):
            load = self._loads[number]
            if begin:  # from the step before, whose end is the beginning of these
                load.fill(loads, self._places, begin - 1, count + 1, self._step)
            else:
                load.fill(loads[1:], self._places, 0, count, self._step)
                loads[0, AFTER] = loads[1, START] if count else load.stages(
                    0, 1, self._step)[0, START, self.columns]
        if self._slow:
            found, kind = found[kind], np.arange(len(kind))
        for lane, actuators in self._slow.items():
            among = np.isin(self.columns, actuators.slow)
            found[lane, 1:, :, among] += np.moveaxis(
                actuators.loads(first, count)[..., actuators.slow], -1, 0)
        return to_lanes(found, kind)
