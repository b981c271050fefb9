# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The motion at one step, and what messages need of it: sensors, and forces of joints."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np

from timo_sim.model.formulation import Formulation
from timo_sim.model.functions import spring_torque
from timo_sim.model.layout import (
    FORCE_I, FORCE_II, FORCE_X, FORCE_Y, Motion, MOTOR_FRICTION, place, rotate, TORQUE)
from timo_sim.scene.scene import Scene
from timo_sim.steps.bristles import DEFLECTION, memory_at, swing_of, UNITS
from timo_sim.topics.cdr import NANOSECONDS
from timo_sim.topics.outputs import SENSORS


def applied(model: Formulation, motions: np.ndarray, loads: np.ndarray) -> np.ndarray:
    """Return carrier forces [N] and motor torque [N m] of loads in n motions, shape (n, 3)."""
    x, y = rotate(motions[:, 2], loads[:, FORCE_I], loads[:, FORCE_II])
    excess = model.manipulator.excess(loads[:, TORQUE] - loads[:, MOTOR_FRICTION],
                                      motions[:, len(model.rotor):] @ model.rotor)
    return np.column_stack([loads[:, FORCE_X] + x, loads[:, FORCE_Y] + y,
                            loads[:, TORQUE] - excess])


class Joints:
    """
    Forces of carrier and shaft, moment and strain at the root in n motions, computed on demand.

    `motions` are (n, 2 (3 + N)), their states (n, m), by default computed from them; `loads`,
    (n, LOADS), are those that act, dry friction included.
    """

    def __init__(self, model: Formulation, motions: np.ndarray, loads: np.ndarray,
                 states: np.ndarray | None = None) -> None:
        self.model, self.motions, self._loads = model, motions, loads
        self._states = states

    @cached_property
    def _sensed(self):
        states = self.model.state(self.motions) if self._states is None else self._states
        return self.model.sense(self.motions, states, self._loads)

    @property
    def accelerations(self) -> np.ndarray:
        """Accelerations of the coordinates, (n, 3 + N)."""
        found = self._sensed.specific.copy()
        found[:, :2] += self.model.gravity
        return found

    @property
    def reactions(self) -> np.ndarray:
        """
        Force on the carrier, world axes [N], and torque on the shaft [N m] by constraints, (n, 3).

        Loads and a spring are not part of it. For a joint that is free it is the friction of the
        equations.
        """
        given = applied(self.model, self.motions, self._loads)
        given[:, 2] += spring_torque(self.model.manipulator, self.motions[:, 2])
        return self._sensed.needed - given

    @property
    def root_moment(self) -> np.ndarray:
        """Moment in the arm at its root, (n,) [N m]."""
        return self._sensed.shown[:, 0]

    @property
    def root_strain(self) -> np.ndarray:
        """Strain of the outer fibre at the gauge, axial strain included, shape (n,)."""
        return self._sensed.shown[:, 1]

    @property
    def tip_acceleration(self) -> np.ndarray:
        """Specific force at the IMU, acceleration less gravity, in its axes, (n, 2) [m/s2]."""
        return self._sensed.shown[:, 2:]

    @property
    def tip_turning(self) -> np.ndarray:
        """Angular velocity of the IMU, shape (n,) [rad/s]."""
        motion = Motion(self.motions)
        return motion.shaft_velocity + motion.qdot @ self.model.imu_point.rotation[:, 0]


def add_bristles(scene: Scene, model: Formulation, motions: np.ndarray, loads: np.ndarray) -> None:
    """
    Add the friction of bristles in sampled motions from t = 0 on, (n, 2 (3 + N)), to (n, LOADS).

    They follow the joints from sample to sample: a reversal between two samples is seen late.
    """
    places, speeds = (part @ model.joint_turns for part in np.hsplit(motions, 2))
    start = memory_at(scene.bristles, swing_of(model, scene.bristles), speeds[0])[DEFLECTION:]
    for k, (forward, backward, reach, more, slow) in enumerate(scene.bristles.tolist()):
        if not reach:
            continue
        deflections = [deflection := float(start[k])]
        for way in np.diff(places[:, k]).tolist():
            deflection += way
            if deflection > reach:
                deflection = reach
            elif deflection < -reach:
                deflection = -reach
            deflections.append(deflection)
        bent = np.array(deflections) / reach * (1.0 + more / (1.0 + (speeds[:, k] / slow)**2))
        loads[:, UNITS[k] != 0.0] -= (
            np.where(bent > 0.0, forward, backward) * bent)[:, np.newaxis]


class Sensors:
    """The sensors at one step, by name: a float, or an array for a sensor of several axes."""

    def __init__(self, snapshot: Snapshot) -> None:
        self._snapshot = snapshot

    def __dir__(self):
        return [sensor.name for sensor in SENSORS]

    def __repr__(self):
        return f'<Sensors {", ".join(f"{name} = {getattr(self, name)}" for name in dir(self))}>'

    def __getattr__(self, name):
        if name not in FIRST_AXES:
            raise AttributeError(f'there is no sensor {name!r}; there are {", ".join(dir(self))}')
        axes = self._snapshot.sensor(name)
        return axes[0] if len(axes) == 1 else np.array(axes)


def reading(scene: Scene, name: str, step: int,
            quantities: Sequence[float]) -> tuple[float, ...]:
    """
    Return the reading of a sensor at a step for the true quantities, a float for each axis.

    The noise is a function of seed, sensor, axis and time step alone; other measurements do not
    change it.
    """
    if not scene.has_sensor_errors:
        return tuple(quantities)
    values = np.array(quantities, dtype=float)
    scene.add_sensor_errors(FIRST_AXES[name], step, len(values), values)
    return tuple(values.tolist())


_SENSORS = {sensor.name: sensor for sensor in SENSORS}
FIRST_AXES = dict(zip(_SENSORS, accumulate((len(each.columns) for each in SENSORS), initial=0)))


class Snapshot:
    """
    The motion, (2 (3 + N),), at one step; costly quantities are computed on demand.

    `load` is that at the end of the last step, or at the start, LOADS floats. `acts` are the
    state, (m,), and the load that acts, (LOADS,), friction included. Accelerations, strains and
    forces of constraints need it. Without them, as of a run, `effort` may be set. `time` is sim
    time in [s] and [ns].
    """

    def __init__(self, scene: Scene, model: Formulation, step: int, motion: np.ndarray,
                 load: Sequence[float] = (),
                 acts: tuple[np.ndarray, np.ndarray] | None = None) -> None:
        self._scene, self.model, self._load = scene, model, load
        self._acts: Any = acts
        self.step, self.motion = step, motion
        self.nanoseconds = round(step * scene.step * 1e9)
        self.time = divmod(self.nanoseconds, NANOSECONDS)
        self._values = motion.tolist()
        self._half = len(self._values) // 2

    @property
    def joint_positions(self) -> list[float]:
        """Carrier x, y [m] and shaft angle [rad]."""
        return self._values[:3]

    @property
    def joint_velocities(self) -> list[float]:
        """Carrier x, y [m/s] and shaft speed [rad/s]."""
        return self._values[self._half:self._half + 3]

    @property
    def modal_state(self) -> list[float]:
        """Modal coordinates [m sqrt(kg)], then their rates [m sqrt(kg)/s]."""
        return self._values[3:self._half] + self._values[self._half + 3:]

    @cached_property
    def joints(self) -> Joints:
        """Forces, moment and strain at the root, and what an IMU shows: Joints of one motion."""
        state, acting = self._acts
        return Joints(self.model, self.motion[np.newaxis], acting[np.newaxis], state[np.newaxis])

    @cached_property
    def effort(self) -> tuple[float, ...]:
        """
        Forces on the carrier in world axes [N] and torque on the shaft [N m].

        For a free joint those of commands and loads, for others those that hold or drive it.
        """
        load = self._load
        torque = self.model.manipulator.effort(
            load[TORQUE], self.motion[self._half:] @ self.model.rotor)
        effort = (*place(load[FORCE_X], load[FORCE_Y], self._values[2], load[FORCE_I],
                         load[FORCE_II]), float(torque))
        constrained = self.model.constrained
        if not constrained.any():
            return effort
        return tuple(np.where(constrained, self.joints.reactions[0], effort).tolist())

    @cached_property
    def tip(self) -> list[float]:
        """Position of the tip in the arm frame [m], and its rotation from the shaft [rad]."""
        return self.model.tip(self.motion).tolist()

    @property
    def link_turns(self) -> np.ndarray:
        """Turn of each of LINKS links along the arm from the one before it, (LINKS,) [rad]."""
        ends = self.model.centre_line(
            self.motion[np.newaxis, 3:self._half], self.model.link_ends)[0]
        along, across = np.diff(ends, axis=0).T
        return np.diff(np.arctan2(across, along), prepend=0.0)

    def sensor(self, name: str) -> tuple[float, ...]:
        """Return what a sensor reads, a tuple of float, one for each axis."""
        return reading(self._scene, name, self.step,
                       _SENSORS[name].of_joints(self.joints)[0].tolist())

    def variance(self, name: str) -> float:
        """Return the variance of what a sensor reads; its error of rounding is uniform."""
        noise, resolution = (self._scene.values[f'sensor.{name}.{kind}']
                             for kind in ('noise', 'resolution'))
        return noise**2 + resolution**2 / 12.0

    @cached_property
    def energy(self) -> float:
        """Kinetic plus strain energy and the potential of gravity [J]."""
        return float(self.model.energy(self.motion[np.newaxis])[0])
