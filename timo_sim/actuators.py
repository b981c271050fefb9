"""From commands to what acts: limits of forces and torque, how fast they change, a DC motor."""

import numpy as np

from timo_sim.parameters import ParameterError
from timo_sim.physics.etdrk4 import STAGES
from timo_sim.physics.formulation import (
    FORCE_I, FORCE_II, FORCE_X, FORCE_Y, LOADS, TORQUE, VOLTAGE)

# Columns of a load with a limit, and the parameters of the limit and of the largest rate.
_LIMITED = {
    (FORCE_X, FORCE_Y, FORCE_I, FORCE_II): ('carrier.force_limit', 'carrier.force_rate_limit'),
    (TORQUE,): ('motor.torque_limit', 'motor.torque_rate_limit'),
    (VOLTAGE,): ('motor.dc.voltage_limit', None),
}


def motor_constants(values):
    """
    Return what a DC motor without inductance makes of a voltage V at its terminals.

    `n k/R V - (n k)^2/R theta'` is its torque on the shaft: torque constant k, resistance R, gear
    n; the second term is the back-EMF's.

    Parameters
    ----------
    values : dict
        The scene's, by name.

    Returns
    -------
    gain, drag : float
        [N m/V], [N m s/rad]; 0 without a motor.

    """
    resistance, constant = values['motor.dc.resistance'], values['motor.dc.torque_constant']
    if not resistance:
        return 0.0, 0.0
    if not constant:
        raise ParameterError('motor.dc.torque_constant must be > 0 N m/A with motor.dc.resistance '
                             f'= {resistance:g} ohm, got {constant}')
    at_shaft = values['motor.dc.gear'] * constant
    return at_shaft / resistance, at_shaft**2 / resistance


class Actuators:
    """
    What the commands of a scene become; its own loads are as they are.

    A command is cut off at its limit. Towards that, force and torque change at most at their
    rates: on a straight line since the step at which it became another one, so that what acts in a
    step does not depend on how many steps are done at once.

    Parameters
    ----------
    values : dict
        The scene's, by name.
    first : int, optional
        Step from which they act.
    reached : ndarray, shape (14,), optional
        What has acted until then, see `physics.formulation`; by default nothing.

    """

    def __init__(self, values, first=0, reached=None):
        self._period = values['integrator.step']
        self._limit, self._rate = np.full(LOADS, np.inf), np.full(LOADS, np.inf)
        for columns, names in _LIMITED.items():
            for bounds, name in zip((self._limit, self._rate), names):
                if name and values[name]:
                    bounds[list(columns)] = values[name]
        self._slow = np.flatnonzero(np.isfinite(self._rate))
        self._gain, _ = motor_constants(values)
        self._ideal = np.isinf([self._limit, self._rate]).all() and not self._gain
        self._since, self._start = first, np.zeros(LOADS) if reached is None else reached
        self._goal = self._start

    def command(self, held, first):
        """Take what is commanded from a step on, shape (14,)."""
        goal = held if self._ideal else np.clip(held, -self._limit, self._limit)
        if len(self._slow) and not np.array_equal(goal, self._goal):
            self._start, self._since = self.reached(first), first
        self._goal = goal

    def reached(self, step):
        """Return what of the commands acts at a step, a voltage not yet as a torque, (14,)."""
        return self._at(np.array((step - self._since) * self._period))

    def loads(self, first, count, parts=1):
        """Return what acts in parts of some steps, shape (14,) or (count parts, 3, 14)."""
        if self._ideal:
            return self._goal
        begin = parts * (first - self._since)
        number = np.arange(begin, begin + parts * count)[:, np.newaxis]
        acting = self._at((number + np.arange(STAGES) / (STAGES - 1)) * (self._period / parts))
        acting[..., TORQUE] += self._gain * acting[..., VOLTAGE]
        return acting

    def _at(self, elapsed):
        # The straight lines towards the goal, at times since they began.
        acting = np.empty((*elapsed.shape, LOADS))
        acting[...] = self._goal
        slow, start = self._slow, self._start[self._slow]
        way, most = self._goal[slow] - start, elapsed[..., np.newaxis] * self._rate[slow]
        # Exactly the goal once it is reached.
        acting[..., slow] = np.where(np.abs(way) <= most, self._goal[slow],
                                     start + np.sign(way) * most)
        return acting
