# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Estimated errors of runs in lanes at the tip, as `RunError` has them of one (T38) to (T40)."""

from typing import NamedTuple

import numpy as np

from timo_sim.jit.constants import local, pack, pack_lanes
from timo_sim.jit.decorators import entry_point, inlined
from timo_sim.jit.lanes import as_lanes, as_shared, WIDTH
from timo_sim.physics.equations.stack import stacked
from timo_sim.physics.integrate.etdrk4 import copy
from timo_sim.physics.integrate.flow import flow
from timo_sim.physics.integrate.global_error import POINTS, weights_of
from timo_sim.physics.integrate.kept import kept
from timo_sim.physics.integrate.lane_steps import from_lanes, to_lanes
from timo_sim.physics.integrate.left_out import LeftOut
from timo_sim.physics.integrate.propagator import phi_functions
from timo_sim.physics.integrate.run_error import linearised, tip_distances
from timo_sim.physics.layout import AFTER, LOADS, START

_NOTED = 16  # steps between errors that are looked at


class Matrices(NamedTuple):
    """Matrices of (T38), for one linear part and one step size."""

    power: np.ndarray    # exp(h L), transposed, (m, m)
    weights: np.ndarray  # of n in the integral of a step, transposed, (POINTS - 1, POINTS, m, m)


@inlined
def _follow(matrices, history, error, errors):
    """Follow the errors of some lanes over the steps of a history, see `follow_each`."""
    power, weights = matrices.power, matrices.weights
    size, following, apart = len(power), local((power,)), local((power,))
    steps = len(history) - 1
    for k in range(steps):
        first = min(max(k - POINTS // 2 + 1, 0), steps + 1 - POINTS)
        for i in range(size):
            apart[i] = error[i] - history[k, i]
            following[i] = history[k + 1, i]
        for j in range(size):
            value = apart[j]
            for i in range(size):
                following[i] += power[j, i] * value
        for point in range(POINTS):
            for j in range(size):
                value = history[first + point, size + j]
                for i in range(size):
                    following[i] -= weights[k - first, point, j, i] * value
        copy(following, error)
        if (k + 1) % _NOTED == 0:
            copy(error, errors[(k + 1) // _NOTED - 1])
    copy(error, errors[len(errors) - 1])


@entry_point
def follow_alike(matrices, history, error, errors):
    """Do what `follow_each` does for lanes with the same matrices."""
    for g in range(len(error)):
        _follow(as_shared(matrices), as_lanes(history[g]), as_lanes(error[g]), as_lanes(errors[g]))


@entry_point
def follow_each(matrices, history, error, errors):
    """
    Follow the errors of groups of lanes over steps, by their defects.

    Parameters
    ----------
    matrices : ndarray, shape (groups,)
        Packed `Matrices`.
    history : ndarray, shape (groups, steps + 1, 2 m + 3, WIDTH)
        See `lane_steps.advance_each`; the last row is that at the end.
    error : ndarray, shape (groups, m, WIDTH)
        Advanced in place.
    errors : ndarray, shape (groups, k, m, WIDTH)
        Receives the errors after every `_NOTED` steps, then those at the end.

    """
    for g in range(len(error)):
        _follow(as_lanes(matrices[g]), as_lanes(history[g]), as_lanes(error[g]),
                as_lanes(errors[g]))


class LaneErrors:
    """
    Estimated errors of n runs.

    Parameters
    ----------
    lanes : LaneSteps
        Of models that have modes, and the same linear part for all angles of the shaft.

    Attributes
    ----------
    tip, modes_tip : ndarray, shape (n,)
        Largest estimated distance of the tip so far, by steps and by modes [m].
    stretch : ndarray, shape (n,)
        Largest shift of the tip so far that the axial force would cause [m].

    """

    def __init__(self, lanes):
        models, self._lanes, self.kept = lanes.models, lanes, {}
        self._model = stacked(models)
        self._alike = self._model is models[0]
        if self._alike:
            self.kept = models[0].kept(lanes.step)
        self._left_out = LeftOut(models, self.kept)
        self._error = np.zeros_like(lanes.state)
        self.tip, self.modes_tip, self.stretch = np.zeros((3, lanes.count))
        self._shift, self._ahead = np.zeros((2, lanes.count))

    @kept
    def _matrices(self):
        lanes = self._lanes
        if self._alike:
            return pack(_matrices(self._model.linear, lanes.step))
        linear = from_lanes(to_lanes(self._linear), WIDTH * len(lanes.own))
        return pack_lanes(_matrices(linear, lanes.step))

    def follow(self, columns, varying, history):
        """
        Estimate the errors after some steps under smooth loads.

        Parameters
        ----------
        columns, varying
            As for `LaneSteps.advance`.
        history : ndarray, shape (groups, steps + 1, 2 m + 3, WIDTH)
            What `LaneSteps.advance` has written; the last row is written here.

        """
        lanes, steps = self._lanes, history.shape[1] - 1
        size = lanes.state.shape[1]
        history[:, -1, :size], history[:, -1, 2 * size:] = lanes.state, lanes.tip
        history[:, -1, size:2 * size] = lanes.rates(columns, varying[:, -1, AFTER])
        errors = lanes.room(steps // _NOTED + 1, size)
        (follow_alike if self._alike else follow_each)(
            self._matrices, history, self._error, errors)
        self._note(errors, history)
        load = np.zeros((lanes.count, LOADS))
        load[:, columns] = from_lanes(varying[:, -1, AFTER], lanes.count)
        end = from_lanes(history[:, -1, :2 * size], lanes.count)
        self._look(end[:, :size], end[:, size:], load)
        # The run ahead follows from the rate, to which a constant deflection does not contribute.
        left, ahead = self._vibrations
        rate = self._rate(end[:, :size], end[:, size:])
        amplitude = np.abs(left @ rate[..., np.newaxis])[..., 0]
        self._ahead += steps * np.sum(amplitude * ahead, axis=-1)
        self._look_at_peak(columns, varying, history)
        self.modes_tip = np.maximum(self.modes_tip, _finite(self._shift + self._ahead))

    def _note(self, errors, history):
        lanes, model = self._lanes, self._model
        theta = from_lanes(lanes.motion[:, 2:3], lanes.count)
        if not model.first:
            rows = np.append(np.arange(_NOTED, history.shape[1], _NOTED), -1)
            theta = from_lanes(history[:, rows, len(model.axes)], lanes.count)
        distance = tip_distances(self._linearised[1], from_lanes(errors, lanes.count), theta)
        self.tip = np.maximum(self.tip, _finite(distance.max(axis=1)))

    def _look_at_peak(self, columns, varying, history):
        # The shape of the most strained state.
        lanes, half = self._lanes, history.shape[2] // 4
        count, size = lanes.count, 2 * half
        q = from_lanes(history[:, :-1, half - len(self._model.modes.omega):half], count)
        peak = np.argmax(self._left_out.strains(q), axis=1)
        group, lane = np.divmod(np.arange(count), WIDTH)
        there = history[group, peak, :2 * size, lane]
        load = np.zeros((count, LOADS))
        load[:, columns] = varying[group, peak + 1, START, :, lane]
        self._look(there[:, :size], there[:, size:], load)

    def _look(self, states, rates, loads):
        # Shifts by the strains of states, (n, m), with their n, under their loads, (n, 14).
        states, rates, loads = (part[:, np.newaxis] for part in (
            states, self._rate(states, rates), loads))
        before, after, half_time = flow(self._model, states, rates, loads, self._observe)
        bent, stretched = self._left_out.shifts(before, after, half_time, loads)
        self._shift = np.maximum(self._shift, np.linalg.norm(bent[:, 0], axis=-1))
        self.stretch = np.maximum(self.stretch, np.linalg.norm(stretched[:, 0], axis=-1))

    def _rate(self, states, rates):
        if self._alike:
            return states @ self._model.linear.T + rates
        return (self._linear @ states[..., np.newaxis])[..., 0] + rates

    @kept
    def _linear(self):
        return np.array([model.linear for model in self._lanes.models])

    def _observe(self, states, loads):
        return self._lanes.motions(states[:, 0], loads[:, 0])[:, np.newaxis]

    @kept
    def _vibrations(self):
        return self._left_out.vibrations(self._lanes.step, *self._linearised)

    @kept
    def _linearised(self):
        lanes, none = self._lanes, np.zeros((self._lanes.count, LOADS))

        def observe(states):
            rows = np.moveaxis(np.broadcast_to(states, (lanes.count, *states.shape[-2:])), 1, 0)
            motions = np.stack([lanes.motions(row, none) for row in rows], axis=1)
            return motions[0] if self._alike else motions
        return linearised(lanes.models, self._model, observe)


def _matrices(linear, step):
    phi = phi_functions(linear, step, POINTS)
    return Matrices(np.swapaxes(phi[0], -1, -2), np.swapaxes(
        np.moveaxis(weights_of(phi, step), (0, 1), (-4, -3)), -1, -2))


def _finite(distances):
    return np.where(np.isfinite(distances), distances, np.inf)
