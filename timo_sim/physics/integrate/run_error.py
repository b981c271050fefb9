# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Estimated error of a run at the tip, by its steps and by its modes."""

import math

import numpy as np

from timo_sim.physics.integrate.global_error import GlobalError, LEAST
from timo_sim.physics.integrate.kept import kept
from timo_sim.physics.integrate.modes_error import ModesError
from timo_sim.physics.layout import ANGLE, LOADS, rotate, START

CHUNK = 2048  # most steps at once
_KEPT = 4096  # most steps between estimates, if their states are kept
_STEPS_PER_ESTIMATE = 128  # least mean number of steps for each estimate, to limit its cost
_OF_STEP = 16.0 / 15.0  # error of a step, over its difference from its halves
_BENT = 1e-5  # largest rotation of a section in the linearisation [rad]
_FEW = 512  # most steps between estimates, if their states are not kept
_STEPS_PER_LOOK = 16  # least number of steps after which `cut` estimates the modes' error again


class RunError:
    """
    The estimated error of a run, see doc/theory.md (T38).

    For steps between which no load jumps it follows from their defects. Where loads jump every few
    steps, one step in a while is done in halves, too; its error stands for that of unseen steps.

    Parameters
    ----------
    steps : Steps

    Attributes
    ----------
    tip : float
        Largest estimated distance of the tip from that of the exact solution so far [m].
    modes : ModesError
        Estimate of what the model's modes lack.
    by_load : bool
        Whether changes of the load at the tip are part of it.
    unseen : int
        Number of steps that no estimate covers yet.

    """

    def __init__(self, steps):
        self._steps, self.kept = steps, steps.kept
        self._error = GlobalError(steps.model.linear, steps.step, steps.kept)
        self.tip, self.unseen, self.modes, self._unlooked = 0.0, 0, ModesError(steps), 0
        self.by_load = False
        # Number of steps since the last cut, and y and n of (T38) at their starts.
        self._open, self._credit = 0, CHUNK
        self._states, self._rates = np.zeros((2, _KEPT + 1, len(steps.model.linear)))

    def reset(self):
        """Set all errors to zero."""
        self.tip, self.unseen, self._open, self._credit = 0.0, 0, 0, CHUNK
        self._unlooked, self._error.error[:], self.by_load = 0, 0.0, False
        self.modes.reset()

    def go_on(self, earlier):
        """Take over the errors from the estimate for an earlier model of the same size."""
        self.tip, self.unseen, self.by_load = earlier.tip, earlier.unseen, earlier.by_load
        self._error.error = earlier._error.error
        self.modes.go_on(earlier.modes)

    @property
    def total(self):
        """Estimated error of steps and modes together, at the tip [m]."""
        return self.tip + self.modes.tip

    def add(self, error):
        """Add an error by a load that changes, shape (m,); it grows with the steps to come."""
        self.by_load = True
        self._error.add(error[np.newaxis])

    def give_up(self):
        """Forget the steps since the last cut."""
        self._open = 0

    @property
    def room(self):
        """Number of steps that can be done before the next cut."""
        return (_KEPT if self._steps.keeps_states else _FEW) - self._open

    @property
    def rest(self):
        """Arrays for y and n of (T38) of coming steps, (k, m)."""
        return self._states[self._open:], self._rates[self._open:]

    def count(self, done, state, load):
        """Count steps that are done; state and load are those at their end."""
        self._open += done
        self._unlooked += done
        self._credit = min(self._credit + done, CHUNK)
        self._look_at_modes(state, load, CHUNK)

    def cut(self, state, load, smooth=True):
        """
        Estimate the error of the steps since the last cut.

        If they are too few, or an estimate would cost too much, a later estimate includes them.

        Parameters
        ----------
        state : ndarray, shape (m,)
        load : ndarray, shape (14,)
            At the end of the last step.
        smooth : bool
            Whether the load was smooth since the last cut; if not, `look` has counted the steps.

        """
        self._look_at_modes(state, load, _STEPS_PER_LOOK)
        count, self._open = self._open, 0
        if not (smooth and self._steps.keeps_states and count >= LEAST and self._pay()):
            self.unseen += count * smooth
            self._error.grow(count)
            return
        weight, self.unseen = (count + self.unseen) / count, 0
        states, rates = self._states[:count + 1], self._rates[:count + 1]
        states[-1] = state
        errors, numbers = self._steps.follow_errors(self._error, states, rates, load, weight)
        self._note(errors, states[numbers], load)

    def look(self, state, tabulate, number, count):
        """
        Estimate the error of `count` steps from step `number` on, and of all unseen ones.

        All are taken to have the error of step `number`, done as a whole and in halves on copies.
        """
        self.unseen += count
        if not self._pay():
            return
        ends = []
        for level in range(2):
            loads, end = tabulate(number, 1, 2**level), state.copy()
            self._steps.step_once(level, end, loads)
            ends.append(end)
        self._error.add(_OF_STEP * self.unseen * (ends[0] - ends[1])[np.newaxis])
        self.unseen = 0
        self._note(self._error.error, state, loads[0, START])

    def conclude(self, state, load, tabulate, number):
        """Estimate the error of all steps so far, if necessary by that of the step `number`."""
        self._credit = CHUNK
        self.cut(state, load)
        self._look_at_modes(state, load, 1)
        if self.unseen:
            self.look(state, tabulate, number, 0)

    def _look_at_modes(self, state, load, least):
        if self._unlooked >= least:
            model, last, load = self._steps.model, self._open - 1, self._steps.acting(load)
            rate = (model.linear @ self._states[last] + self._rates[last]
                    if self._open and self._steps.keeps_states else self._steps.rate(state, load))
            self.modes.look(state, load, rate, self._unlooked)
            self._unlooked = 0

    def _pay(self):
        # Whether there were enough steps to afford an estimate.
        enough = self._credit >= _STEPS_PER_ESTIMATE
        self._credit -= _STEPS_PER_ESTIMATE * enough
        return enough

    def _note(self, errors, states, load):
        model = self._steps.model
        theta = load[ANGLE] if model.first else states[..., len(model.axes)]
        largest = tip_distances(self.tip_shift, np.atleast_2d(errors), np.asarray(theta)).max()
        self.tip = max(self.tip, float(largest) if math.isfinite(largest) else math.inf)

    @property
    def motions(self):
        """Coordinates of the motion per coordinate of the state, (3 + N, m / 2)."""
        return self._linearised[0]

    @property
    def tip_shift(self):
        """Shift of the tip per coordinate of the state, (4, m / 2), see `linearised`."""
        return self._linearised[1]

    @kept
    def _linearised(self):
        model, load = self._steps.model, np.zeros(LOADS)
        return linearised([model], model, lambda states: np.array(
            [self._steps.motion(state, load) for state in states]))


def linearised(models, stack, observe):
    """
    Linearise motion and tip of the straight arm, or of one in equilibrium.

    Parameters
    ----------
    models : list of Formulation
    stack : Formulation
        What `stacked` makes of them.
    observe : function(ndarray) -> ndarray
        Takes states, (..., k, m), and returns their motions without loads, (..., k, 2 (3 + N)).

    Returns
    -------
    motions : ndarray, shape (..., 3 + N, m / 2)
        Coordinates of the motion per coordinate of the state.
    tip_shift : ndarray, shape (..., 4, m / 2)
        Shift of the tip: x and y in world axes by the carrier; along and across the shaft by all
        others [m].

    """
    model, size = models[0], len(models[0].linear)
    half, carrier, count = size // 2, len(model.axes), len(model.modes)
    turn = np.abs(stack.points.rotation).max(axis=-1, initial=0.0)
    bent = np.full((*turn.shape[:-1], half), _BENT)
    bent[..., half - count:] /= np.where(turn > 0.0, turn, 1.0)
    states = np.zeros((*turn.shape[:-1], 1 + half, size))
    states[..., range(1, 1 + half), range(half)] = bent
    if any(each.rest is not None for each in models):
        rests = [np.zeros(size) if each.rest is None else _at_rest(each) for each in models]
        states += rests[0] if states.ndim == 2 else np.array(rests)[:, np.newaxis]
    motions = observe(states)
    tips = stack.world(motions, stack.tip_point)[..., 0, :]
    change = np.swapaxes((tips[..., 1:, :] - tips[..., :1, :]) / bent[..., np.newaxis], -1, -2)
    shift = np.zeros((*change.shape[:-2], 4, half))
    shift[..., :2, :carrier] = change[..., :carrier]
    shift[..., 2:, carrier:] = change[..., carrier:]
    moved = (motions[..., 1:, :] - motions[..., :1, :])[..., :model.size // 2]
    return np.swapaxes(moved / bent[..., np.newaxis], -1, -2), shift


def _at_rest(model):
    rest = model.rest.copy()
    rest[:3] = 0.0  # as seen from the shaft
    return model.state(rest)


def tip_distances(tip_shift, errors, theta):
    """
    Return how far errors of states shift the tip [m].

    Parameters
    ----------
    tip_shift : ndarray, shape (..., 4, m / 2)
        See `linearised`.
    errors : ndarray, shape (..., k, m)
    theta : ndarray, shape (..., k) or (...,)
        Shaft angles [rad].

    Returns
    -------
    ndarray, shape (..., k)

    """
    half = tip_shift.shape[-1]
    shift = np.moveaxis(errors[..., :half] @ np.swapaxes(tip_shift, -1, -2), -1, 0)
    x, y = shift[2:]
    if tip_shift[..., :2, :].any():
        x, y = rotate(theta, x, y)
    return np.sqrt((shift[0] + x)**2 + (shift[1] + y)**2)
