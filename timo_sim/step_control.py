"""The error of a time step: estimated now and then, or in each step and kept below a tolerance."""

import math

import numpy as np

from timo_sim.physics import etdrk4
from timo_sim.physics.compiled import record

# With a tolerance, a step is done in 2^(1 + FINEST) parts at most.
FINEST = 5
# Error per second of sim time, in arm lengths, that needs a warning.
_ALARMING = 1e-3
# From a load at start, middle and end of a step to the same of its halves: a parabola.
_HALVES = np.array([[1.0, 0.0, 0.0], [0.375, 0.75, -0.125], [0.0, 1.0, 0.0],
                    [0.0, 1.0, 0.0], [-0.125, 0.75, 0.375], [0.0, 0.0, 1.0]])


class StepControl:
    """
    Errors of the steps of a scene, as shifts of the tip (`Formulation.tip_shift`).

    Attributes
    ----------
    tolerance : float
        Of a step [m]; 0: none is split.
    largest : float
        Largest estimated error of a step so far [m].
    splits : int
        Steps that were split.
    coarse : int
        Steps whose error was above the tolerance in the smallest parts, too.

    """

    def __init__(self, scene, formulation):
        self._scene, self._formulation = scene, formulation
        self.tolerance = scene.values['integrator.tolerance']
        self._alarming = _ALARMING * scene.manipulator.arm.length * scene.step
        self._shift = np.ascontiguousarray(formulation.tip_shift())
        self._propagators = {}
        self.largest, self.splits, self.coarse = 0.0, 0, 0

    def following(self, scene, formulation):
        """Return the control of a scene that takes the place of this one; it counts on."""
        control = StepControl(scene, formulation)
        control.largest, control.splits, control.coarse = self.largest, self.splits, self.coarse
        return control

    def propagator(self, level=0):
        """Return the matrices of a step divided by 2^level, a record."""
        if level not in self._propagators:
            pair = etdrk4.propagators(self._formulation.linear, self._scene.step / 2**level)
            for number, matrices in enumerate(pair, start=level):
                self._propagators[number] = record(matrices)
        return self._propagators[level]

    def loads(self, first, count, actuators, level=0):
        """Return the loads of parts of steps, those of the scene and commands, (parts, 3, 14)."""
        parts = 2**level
        loads = self._scene.load.stages(parts * first, parts * count, self._scene.step / parts)
        return loads if actuators is None else loads + actuators.loads(first, count, parts)

    def advance(self, state, load, loads, first, actuators, every):
        """
        Integrate `state` in place, each step in as many parts as the tolerance asks for.

        Parameters
        ----------
        state, load, every
            See `Formulation.advance`.
        loads : ndarray, shape (2 steps, 3, 14)
            Of the halves of the steps, see `loads`.
        first : int
            Number of the first step, since the start of the scene's loads.
        actuators : Actuators or None
            What acts of commands is part of `loads`.

        Returns
        -------
        done, motions
            See `Formulation.advance`.

        """
        steps, errors, done = len(loads) // 2, np.zeros(2), 0
        motions = np.empty((1 + steps // every if every else 0, self._formulation.size))
        while True:
            done = self._advance_within(
                self.tolerance, 0, state, load, loads, done, every, motions, errors)
            if done == steps or not self._split(state, load, first + done, actuators, errors):
                break
            load = loads[2 * done + 1, -1]
            done += 1
        self.largest = max(self.largest, errors[0])
        return done, motions

    def _advance_within(self, tolerance, level, state, load, loads, *rest):
        return etdrk4.advance_within(
            self._formulation.packed, self.propagator(level), self.propagator(level + 1),
            self._shift, tolerance, state, load, loads, *rest)

    def _split(self, state, load, number, actuators, errors):
        # Do one step in parts; say whether the state is still finite.
        level, none = 0, np.empty((0, self._formulation.size))
        while True:
            # Of parts half as large each makes 1/32 of the error, all together 1/16.
            excess = errors[1] / self.tolerance * 2**level
            level += max(1, math.ceil(math.log2(excess) / 4.0)) if math.isfinite(excess) else 1
            level = min(level, FINEST)
            parts, trial, of_parts = 2**level, state.copy(), np.zeros(2)
            tolerance = math.inf if level == FINEST else self.tolerance / parts
            loads = self.loads(number, 1, actuators, level + 1)
            done = self._advance_within(tolerance, level, trial, load, loads, 0, 0, none, of_parts)
            errors[1] = of_parts[1]
            if done == parts:
                break
            if level == FINEST:
                return False
        state[:] = trial
        self.splits += 1
        error = parts * of_parts[0]
        self.coarse += int(error > self.tolerance)
        errors[0] = max(errors[0], error)
        return True

    def look_ahead(self, state, loads):
        """
        Estimate the error of a step: it is done as a whole and in halves, on copies.

        Parameters
        ----------
        state : ndarray, shape (m,)
            At its start.
        loads : ndarray, shape (1, 3, 14)
            Of the step; those of its halves are interpolated.

        Returns
        -------
        error : float
            [m]; inf if the step diverges.
        alarming : bool
            Whether after a second of such steps the tip would be off by `_ALARMING` arm lengths.

        """
        ends = []
        for level, parts in enumerate((loads, (_HALVES @ loads[0]).reshape(2, *loads.shape[1:]))):
            end = state.copy()
            done, _ = self._formulation.advance(self.propagator(level), end, parts[0, 0], parts)
            if done < len(parts):
                return math.inf, True
            ends.append(end)
        error = float(np.abs(self._shift @ (ends[0] - ends[1])).sum())
        self.largest = max(self.largest, error)
        return error, not error <= self._alarming
