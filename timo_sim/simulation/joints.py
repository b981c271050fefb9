# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Forces that hold or drive joints, and moment and strain at the root, from accelerations."""

from functools import cached_property, partial

import numpy as np

from timo_sim.physics.integrate.steps import Steps
from timo_sim.physics.layout import FORCE_I, FORCE_II, FORCE_X, FORCE_Y, rotate, TORQUE

_FRICTION = [FORCE_X, FORCE_Y, TORQUE]  # columns of a load, by joint
# Speed of a joint below which Coulomb friction holds it [m/s, rad/s], doc/theory.md, section 8;
# sweeps over the joints that it holds.
_STILL, _SWEEPS = 1e-7, 200


def applied(loads, theta):
    """Return carrier forces [N] and shaft torque [N m] of loads, (n, 14), shape (n, 3)."""
    x, y = rotate(theta, loads[:, FORCE_I], loads[:, FORCE_II])
    return np.column_stack([loads[:, FORCE_X] + x, loads[:, FORCE_Y] + y, loads[:, TORQUE]])


class Joints:
    """
    Forces of carrier and shaft, moment and strain at the root in n motions, computed on demand.

    Parameters
    ----------
    model : Formulation
    motions : ndarray, shape (n, 2 (3 + N))
        See `physics.layout`.
    accelerations : ndarray, shape (n, 3 + N)
    loads : ndarray, shape (n, 14)
        Loads that act, dry friction included.

    """

    def __init__(self, model, motions, accelerations, loads):
        self._model, self._motions, self._loads = model, motions, loads
        self._accelerations = accelerations
        self._applied = applied(loads, motions[:, 2])

    @cached_property
    def _needed(self):
        return self._model.effort(self._motions, self._accelerations, self._loads)

    @property
    def reactions(self):
        """
        Force on the carrier, world axes [N], and torque on the shaft [N m] by constraints, (n, 3).

        Loads are not part of it. For a joint that is free it is the friction of the equations.
        """
        return self._needed - self._applied

    @property
    def root_moment(self):
        """Moment in the arm at its root, from the shaft's own balance (T43), shape (n,) [N m]."""
        model = self._model
        if model.constrained[2]:
            torque = self._needed[:, 2]
        else:
            torque = self._applied[:, 2] - model.friction(self._motions)[:, 2]
        return model.manipulator.shaft_inertia * self._accelerations[:, 2] - torque

    @property
    def root_strain(self):
        """Strain of the outer fibre at the root, axial strain included, shape (n,)."""
        per_moment, per_q, per_rate = root_strain(self._model)
        half = self._motions.shape[1] // 2
        return per_moment * self.root_moment + self._motions[:, 3:half] @ per_q + (
            self._motions[:, half + 3:] @ per_rate)


def root_strain(model):
    """Return the strain of the outer fibre per moment at the root, per q and per rate of q."""
    root, modes = np.zeros(1), model.modes
    section = model.manipulator.arm.at(root)
    height, stiffness = (np.ravel(value)[0] for value in (
        section.height, section.bending_stiffness))
    axial = modes.stretch(root)[0] if model.axial else np.zeros(len(modes))
    # Modal damping adds to the moment, but not to the strain, so its moment is subtracted.
    return (0.5 * height / stiffness, axial,
            -0.5 * height * modes.curvature(root)[0] * 2.0 * model.damping / modes.omega)


def accelerations_of(integration, state, load):
    """Return the accelerations of the coordinates of a state under a load, shape (3 + N,)."""
    before, after, half_time = integration.flow(state, load)
    return (after - before)[0, before.shape[1] // 2:] / (2.0 * half_time[0])


def joints_of_state(integration, motion, state, load):
    """Return the Joints of a motion, with its state, by `Steps` under a load that acts."""
    accelerations = accelerations_of(integration, state, load)
    return Joints(integration.model, motion[np.newaxis], accelerations[np.newaxis],
                  load[np.newaxis])


def joints_of_run(scene, model, motions, loads):
    """
    Return the Joints of sampled motions of a scene.

    Where dry friction holds a joint, it is what cancels the joint's acceleration.

    Parameters
    ----------
    scene : Scene
    model : Formulation
    motions : ndarray, shape (n, 2 (3 + N))
    loads : ndarray, shape (n, 14)
        Without dry friction.

    """
    integration, limit = Steps(model, scene.step), scene.friction
    accelerations, acting = np.empty((len(motions), motions.shape[1] // 2)), loads.copy()
    speeds = motions[:, motions.shape[1] // 2:][:, :3]
    for k, motion in enumerate(motions):
        accelerate = partial(accelerations_of, integration, integration.model.state(motion))
        if limit.any():
            acting[k, _FRICTION] += _friction(accelerate, loads[k], speeds[k], limit)
        accelerations[k] = accelerate(acting[k])
    return Joints(integration.model, motions, accelerations, acting)


def _friction(accelerate, load, speed, limit):
    """Return the Coulomb friction: of joints that slide, or what holds the others, shape (3,)."""
    friction = np.where(np.abs(speed) > _STILL, -limit * np.sign(speed), 0.0)
    held = np.flatnonzero((limit > 0.0) & (np.abs(speed) <= _STILL))
    if not len(held):
        return friction
    # Accelerations are linear in a load.
    load = load.copy()
    load[_FRICTION] += friction
    free = accelerate(load)[held]
    mobility = np.column_stack([
        accelerate(load + np.eye(len(load))[_FRICTION[joint]])[held] - free for joint in held])
    holding = np.zeros(len(held))
    for _ in range(_SWEEPS):
        for j, joint in enumerate(held):
            left = free[j] + mobility[j] @ holding
            holding[j] = np.clip(holding[j] - left / mobility[j, j], -limit[joint], limit[joint])
    friction[held] = holding
    return friction
