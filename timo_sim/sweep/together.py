# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Runs of a sweep done together, as lanes."""

from typing import NamedTuple

import numpy as np

from timo_sim.jit.code_store import compiling
from timo_sim.physics.integrate.lane_steps import from_lanes, LaneSteps, to_lanes
from timo_sim.physics.integrate.steps import CHUNK
from timo_sim.simulation.batch import refusal
from timo_sim.simulation.lane_loads import LaneLoads
from timo_sim.simulation.model_warnings import divergence, unseen_load
from timo_sim.simulation.simulator import MOST_BENT


class Kind(NamedTuple):
    """What runs must have in common to be done together."""

    step: float   # [s]
    steps: int    # their number
    sizes: tuple  # of the models
    joints: tuple


def kind_of(scene, steps):
    """
    Return the Kind of a run, or None if it cannot be done together with others.

    It depends on the run alone, so that its numbers do not depend on what else a sweep has.
    """
    values = scene.values
    if values['model.formulation'] != 'exact' or not scene.modal_count or refusal(scene):
        return None
    return Kind(scene.step, steps,
                (values['model.modes'], values['model.axial_modes'],
                 len(scene.build().quadrature.nodes)),
                (values['carrier.held'], values['motor.shaft']))


class Together:
    """
    Runs that are done together.

    Parameters
    ----------
    scenes : list of Scene
    kind : Kind
        Of all of them.

    Attributes
    ----------
    motion : ndarray, shape (n, 2 (3 + N))
        At the end.
    peak, peak_time, rotation, squares : ndarray, shape (n,)
        Largest |w(l)| [m] and its time [s], largest |phi(l)| [rad], sum of w(l)^2 over the start
        and the ends of steps [m2].
    deflection : ndarray, shape (n,)
        w(l) at the end [m].
    warnings : list of (str or None)
    reasons : list of str
        Why a run failed, or ''.

    """

    def __init__(self, scenes, kind):
        self._scenes, self._models = scenes, [scene.build() for scene in scenes]
        self._lanes = LaneSteps(self._models, kind.step, MOST_BENT)
        self._lanes.state[:] = to_lanes(np.array([
            model.state(scene.initial_motion())
            for scene, model in zip(scenes, self._models)]))
        self._loads = LaneLoads(scenes)
        self._origin = np.zeros(len(scenes), dtype=int)
        with compiling(*self._lanes.constants):
            self._lanes.advance(self._loads.columns, self._loads.varying(0, 0, self._origin))
        self.warnings = [unseen_load(scene) for scene in scenes]
        self.peak, self.rotation, self.squares = np.zeros((3, len(scenes)))
        self.peak_time = np.zeros(len(scenes))
        self._take(0, self._tips(self._lanes.tip[:, np.newaxis]))
        for first in range(0, kind.steps, CHUNK):
            self._advance(first, min(CHUNK, kind.steps - first))
        self.motion = from_lanes(self._lanes.motion, len(scenes))
        self.deflection = from_lanes(self._lanes.tip, len(scenes))[:, 1]
        self.reasons = [self._reason(number) for number in range(len(scenes))]

    def _advance(self, first, count):
        lanes = self._lanes
        tips = lanes.room(count, 3)
        lanes.advance(self._loads.columns, self._loads.varying(first, count, self._origin),
                      tips=tips)
        self._take(first + 1, self._tips(np.concatenate(
            [tips[:, 1:], lanes.tip[:, np.newaxis]], axis=1)))

    def _tips(self, places):
        # In one order of memory, on which the last bits of sums depend.
        return np.ascontiguousarray(from_lanes(places, len(self._scenes)))

    def _take(self, first, tips):
        # Tips after the steps `first`, `first` + 1, ..., (n, k, 3), for the summary.
        size = np.abs(tips[:, :, 1])
        at = np.argmax(size, axis=1)
        found = size[np.arange(len(size)), at]
        self.peak_time = np.where(found > self.peak, (first + at) * self._lanes.step,
                                  self.peak_time)
        self.peak = np.maximum(self.peak, found)
        self.rotation = np.maximum(self.rotation, np.abs(tips[:, :, 2]).max(axis=1))
        self.squares += np.sum(size**2, axis=1)

    def _reason(self, number):
        alive, done = from_lanes(self._lanes.progress, len(self._scenes))[number]
        if alive:
            return ''
        model, motion = self._models[number], self.motion[number]
        bend = np.abs(motion[3:model.size // 2]) @ model.reach[3:]
        return divergence(self._scenes[number], round(done), motion, model.reach, bend,
                          self.warnings[number])
