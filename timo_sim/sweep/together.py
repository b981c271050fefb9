# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Runs of a sweep done together, as lanes, with estimates of their errors."""

import copy
from typing import NamedTuple

import numpy as np

from timo_sim.jit.code_store import compiling
from timo_sim.physics.integrate.global_error import LEAST
from timo_sim.physics.integrate.lane_errors import LaneErrors
from timo_sim.physics.integrate.lane_steps import from_lanes, LaneSteps, to_lanes
from timo_sim.physics.integrate.run_error import CHUNK
from timo_sim.simulation.batch import refusal
from timo_sim.simulation.lane_loads import LaneLoads
from timo_sim.simulation.model_warnings import divergence, in_lanes, unseen_load
from timo_sim.simulation.simulator import MOST_BENT
from timo_sim.simulation.stretch import StretchError

_ROOM = 40_000  # most numbers of the history of a run that is kept at a time


class Kind(NamedTuple):
    """What runs must have in common to be done together."""

    step: float   # [s]
    edges: tuple  # steps at which loads jump or have a kink, from 0 to the number of steps
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
    edges = 0, *(at for at in scene.load.breaks(0, steps, scene.step) if 0 < at < steps), steps
    if min(np.diff(edges)) < LEAST:  # errors of steps between close jumps are estimated otherwise
        return None
    return Kind(scene.step, edges,
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
    step_error, modes_error, stretch_error : ndarray, shape (n,)
        Largest estimated distances of the tip, as in `Run.stats` [m].
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
        self._errors = LaneErrors(self._lanes)
        models = {id(model): model for model in self._models}
        stretch = {key: StretchError(model) for key, model in models.items()}
        self._stretch = [copy.copy(stretch[id(model)]) for model in self._models]
        self.warnings = [unseen_load(scene) for scene in scenes]
        self.peak, self.rotation, self.squares = np.zeros((3, len(scenes)))
        self.peak_time = np.zeros(len(scenes))
        self._take(0, self._tips(self._lanes.tip[:, np.newaxis]))
        for begin, end in zip(kind.edges, kind.edges[1:]):
            self._smooth(begin, end)
        self.motion = from_lanes(self._lanes.motion, len(scenes))
        self.deflection = from_lanes(self._lanes.tip, len(scenes))[:, 1]
        self.step_error, self.modes_error = self._errors.tip, self._errors.modes_tip
        self.stretch_error = np.array([stretch.tip for stretch in self._stretch])
        self.reasons = [self._reason(number) for number in range(len(scenes))]

    def _smooth(self, begin, end):
        # Steps under smooth loads, in parts that are neither too many nor too few.
        size = 2 * self._lanes.state.shape[1] + 3
        most = max(2 * LEAST, min(CHUNK, _ROOM // size))
        count = -(-(end - begin) // most)
        parts = [begin + (end - begin) * k // count for k in range(count + 1)]
        for first, last in zip(parts, parts[1:]):
            self._advance(first, last - first)

    def _advance(self, first, count):
        lanes, step = self._lanes, self._lanes.step
        angle = lanes.motion[:, 2].copy()
        varying = self._loads.varying(first, count, self._origin)
        history = lanes.room(count + 1, 2 * lanes.state.shape[1] + 3)
        lanes.advance(self._loads.columns, varying, history=history)
        self._errors.follow(self._loads.columns, varying, history)
        self._take(first + 1, self._tips(history[:, 1:, 2 * lanes.state.shape[1]:]))
        errors, turns = self._errors, from_lanes(lanes.motion[:, 2] - angle, len(self._scenes))
        alive = from_lanes(lanes.progress, len(self._scenes))[:, 0] > 0.0
        for k in np.flatnonzero(alive):  # the others have no estimate of these steps
            self._stretch[k].add(turns[k], count * step, errors.stretch[k])
            self.warnings[k] = in_lanes(self._scenes[k], errors.tip[k], errors.modes_tip[k],
                                        self._stretch[k], (first + count) * step,
                                        self.warnings[k])

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
