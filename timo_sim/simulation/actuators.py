# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Actuators: limits of commanded forces and torque and of their rates, and a DC motor."""

from typing import Any

import numpy as np

from timo_sim.physics.layout import (
    AFTER, END, FORCE_I, FORCE_II, FORCE_X, FORCE_Y, LOADS, STAGES, STEP_LOADS, TIP_TORQUE, TIP_X,
    TIP_Y, TORQUE, VOLTAGE)
from timo_sim.scene.build import motor_constants
from timo_sim.scene.moments import on_boundaries, parabolas
from timo_sim.scene.parameter import ParameterError, short

# Columns of a load with a limit, and the parameters of the limit and of the largest rate.
_LIMITED = {
    (FORCE_X, FORCE_Y, FORCE_I, FORCE_II): ('carrier.force_limit', 'carrier.force_rate_limit'),
    (TORQUE,): ('motor.torque_limit', 'motor.torque_rate_limit'),
    (VOLTAGE,): ('motor.dc.voltage_limit', None),
}
# Columns of a load that the commands of `Simulator.step` set.
COMMANDS: dict[str, Any] = {
    'torque': TORQUE, 'force': [FORCE_X, FORCE_Y], 'tip_force': [TIP_X, TIP_Y],
    'tip_torque': TIP_TORQUE, 'voltage': VOLTAGE}


def commanded_load(motor, many=(), **commands):
    """
    Return commands as a load, or as many loads.

    Parameters
    ----------
    motor : bool or ndarray of bool, shape `many`
        Whether there is a DC motor.
    many : tuple of int
        Shape of the array of loads; the same shape precedes that of commands of their own.
    **commands : float or sequence of float
        See `Simulator.step`.

    Returns
    -------
    ndarray, shape (*many, 14)

    Raises
    ------
    ParameterError
        If a command has not the right number of finite values, or a voltage has no DC motor.

    """
    load = np.zeros((*many, LOADS))
    for name, columns in COMMANDS.items():
        shape = np.shape(columns)
        try:
            numbers = np.asarray(commands[name], dtype=float)
            good = numbers.shape in (shape, (*many, *shape)) and np.isfinite(numbers).all()
        except (TypeError, ValueError):
            good = False
        if not good:
            kind = 'two finite numbers' if shape else 'a finite number'
            kind += f', or an array of them of shape {(*many, *shape)}' if many else ''
            raise ParameterError(f'{name} must be {kind}, got {short(commands[name])}')
        load[..., columns] = numbers
    lacking = load[..., VOLTAGE][(load[..., VOLTAGE] != 0.0) & ~np.asarray(motor)]
    if lacking.size:
        raise ParameterError(f'voltage = {lacking.flat[0]:g} V needs a DC motor: '
                             'motor.dc.resistance must be > 0 ohm')
    return load


class Actuators:
    """
    The actuators of a scene, which turn commands into loads; the scene's own loads bypass them.

    The goal of a force or torque is its command, clipped at its limit. With a limit of its rate it
    moves to the goal on a straight line that begins at the step at which the goal changed, so that
    what acts in a step does not depend on how many steps are done at once.

    Parameters
    ----------
    values : dict
        The scene's parameters, by name.
    first : int, optional
        Step from which they act.
    reached : ndarray, shape (14,), optional
        Load that has acted until then, see `physics.layout`; by default none.

    Attributes
    ----------
    limit : ndarray, shape (14,)
        Limits of commands.
    slow : ndarray of int
        Columns of a load with a limit of their rate.
    gain : float
        Torque per voltage [N m/V].

    """

    def __init__(self, values, first=0, reached=None):
        self._period = values['integrator.step']
        self.limit, self._rate = np.full(LOADS, np.inf), np.full(LOADS, np.inf)
        for columns, names in _LIMITED.items():
            for bounds, name in zip((self.limit, self._rate), names):
                if name:
                    bounds[list(columns)] = values[name]
        self.slow = np.flatnonzero(np.isfinite(self._rate))
        self.gain, _ = motor_constants(values)
        self._ideal = np.isinf([self.limit, self._rate]).all() and not self.gain
        self._since, self._start = first, np.zeros(LOADS) if reached is None else reached
        self._given, self._goal = b'', self._start

    def command(self, commanded, first):
        """Take the commands from step `first` on, shape (14,)."""
        given = commanded.tobytes()
        if given == self._given:
            return
        goal = np.clip(commanded, -self.limit, self.limit)
        if len(self.slow) and not np.array_equal(goal, self._goal):
            self._start, self._since = self.reached(first), first
        self._given, self._goal = given, goal

    def _ends(self):
        # When lines reach their goals, counted in steps since they began.
        way = np.abs(self._goal - self._start)[self.slow]
        return on_boundaries(way / (self._rate[self.slow] * self._period))

    def reached(self, step):
        """Return what acts of the commands at a step, (14,); a voltage is not yet a torque."""
        return self._at(np.array((step - self._since) * self._period))

    def loads(self, first, count):
        """Return what acts in some steps, shape (14,) or (count, 4, 14)."""
        if self._ideal:
            return self._goal
        begin, period = first - self._since, self._period
        acting = np.empty((count, STEP_LOADS, LOADS))
        acting[:, :STAGES] = self._at(
            (np.arange(begin, begin + count)[:, np.newaxis] + [0.0, 0.5, 1.0]) * period)
        acting[:, AFTER] = acting[:, END]
        steps, seen = parabolas(lambda at: self._at(at * period), self._ends(), 1, begin, count)
        acting[steps, :STAGES] = seen
        acting[..., TORQUE] += self.gain * acting[..., VOLTAGE]
        return acting

    def _at(self, elapsed):
        # The straight lines towards the goal, at times since they began.
        acting = np.empty((*elapsed.shape, LOADS))
        acting[...] = self._goal
        slow, start = self.slow, self._start[self.slow]
        way, most = self._goal[slow] - start, elapsed[..., np.newaxis] * self._rate[slow]
        # Exactly the goal once it is reached.
        acting[..., slow] = np.where(np.abs(way) <= most, self._goal[slow],
                                     start + np.sign(way) * most)
        return acting
