# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How far the tip is off because a model has no more modes, see doc/theory.md (T39), (T40)."""

from functools import cached_property
import math

import numpy as np
from scipy.linalg import eig

from timo_sim.physics.layout import tip_force, TIP_TORQUE

_GROWTH = 1.25  # of the strain at which the shape is looked at again
_LAST = 2  # modes that tell how much is left out
_PAUSE = 8192  # steps after which it is anyway


class ModesError:
    """
    What the modes of a model leave out, by the balance of forces and moments along the arm.

    Inertia and loads outboard of a section tell its bending moment and shear force, and these the
    strains that the arm would have. What of them is not in the modes is left out: it shifts the
    tip, and it makes natural frequencies too high, so that vibrations run ahead.

    Parameters
    ----------
    steps : Steps

    Attributes
    ----------
    tip : float
        Largest distance of the tip from where more modes would have it so far [m].
    stretch : float
        Largest shift of the tip by the axial force of an arm that does not stretch [m].

    """

    def __init__(self, steps):
        self._steps, self._model = steps, steps.model
        self.reset()

    def reset(self):
        """Begin anew."""
        self.tip, self._shift, self._strain, self._pause, self._ahead = 0.0, 0.0, 0.0, 0, 0.0
        self.stretch = 0.0

    def go_on(self, earlier):
        """Go on where an earlier one, of a model of the same size, has ended."""
        self.tip, self._shift, self._ahead = earlier.tip, earlier._shift, earlier._ahead

    def look(self, state, load, rate, count):
        """
        Look at a state.

        Parameters
        ----------
        state : ndarray, shape (m,)
        load : ndarray, shape (14,)
            That acts.
        rate : ndarray, shape (m,)
            Of the state, here or a step before.
        count : int
            Steps since the last look.

        """
        if not len(self._model.modes):
            return  # a rigid arm is meant to be one
        self._pause += count
        self._look_at_shape(self._strains(state[np.newaxis])[0], state, load)
        # By the rate: what does not change does not vibrate.
        left, ahead = self._vibrations
        self._ahead += count * float(np.abs(left @ rate) @ ahead)
        tip = self._shift + self._ahead
        self.tip = max(self.tip, tip if math.isfinite(tip) else math.inf)

    def look_for_peak(self, states, loads):
        """Look at the most strained of some states, (n, m), under their loads, (n, 14)."""
        if len(self._model.modes):
            strains = self._strains(states)
            peak = np.argmax(strains)
            self._look_at_shape(strains[peak], states[peak], loads[peak])

    def _look_at_shape(self, strain, state, load):
        if strain > _GROWTH * self._strain or self._pause > _PAUSE:
            self._strain, self._pause = max(strain, self._strain), 0
            bent, stretched = self.shifts(state, load)
            self._shift = max(self._shift, math.hypot(*bent))
            self.stretch = max(self.stretch, math.hypot(*stretched))

    def _strains(self, states):
        # Of the last two modes in bending: what is left out is as sharp or sharper.
        omega, axial = self._model.modes.omega, self._model.axial
        last = slice(max(0, len(omega) - axial - _LAST), len(omega) - axial)
        q = states[:, states.shape[1] // 2 - len(omega):]
        return np.abs(q[:, last]) @ omega[last]

    def shifts(self, state, load):
        """
        Return how the tip shifts along and across the shaft [m].

        By what is left out of bending and shear, and by the axial force; shape (2, 2).
        """
        model = self._model
        motions, half_time = self._steps.flow(state, load)
        motion = motions.mean(axis=0)
        velocity, turning = model.velocities(motions, model.points)
        force = -model.point_mass[:, np.newaxis] * (velocity[1] - velocity[0]) / (2.0 * half_time)
        moment = -model.point_inertia * (turning[1] - turning[0]) / (2.0 * half_time)
        force += model.point_mass[:, np.newaxis] * model.gravity
        force[-1] += np.ravel(tip_force(load[np.newaxis], motion[2:3]))
        moment[-1] += load[TIP_TORQUE]
        # The arm is seen from the shaft.
        cosine, sine = math.cos(motion[2]), math.sin(motion[2])
        force = force @ np.array([[cosine, -sine], [sine, cosine]])
        q, (rotation, _, shear, *_) = motion[3:len(motion) // 2], self._fields
        phi, gamma = q @ rotation, q @ shear
        cosine, sine = np.cos(phi), np.sin(phi)
        slope = cosine - gamma * sine, sine + gamma * cosine
        curvature, shear = self._left_out(q, force, moment, slope, (cosine, sine))
        turn = self._inboard @ curvature
        strain = (self._outboard @ force @ np.stack([cosine, sine])).diagonal() * self._softness
        return np.array([
            self._whole @ np.column_stack([-slope[1] * turn - sine * shear,
                                           slope[0] * turn + cosine * shear]),
            self._whole @ np.column_stack([strain * cosine, strain * sine])])

    def _left_out(self, q, force, moment, slope, normal):
        """
        Return the curvature and shear strain at the nodes that are not in the modes (T39).

        Of q, (..., N); forces and moments at the points of mass, (..., p, 2), (..., p); slopes
        a, b of the centre line; cosine and sine of the sections' rotation.
        """
        nodal = self._outboard @ force
        bending = (slope[0] * nodal[..., 1] - slope[1] * nodal[..., 0]) @ self._rest.T + (
            moment @ self._outboard.T)
        _, curvature, shear, stiffness, shear_stiffness = self._fields
        curved = bending / stiffness - q @ curvature
        sheared = (normal[0] * nodal[..., 1] - normal[1] * nodal[..., 0]) / shear_stiffness - (
            q @ shear)
        share = ((curved * self._weights * stiffness) @ curvature.T
                 + (sheared * self._weights * shear_stiffness) @ shear.T
                 ) / self._model.modes.omega**2
        return curved - share @ curvature, sheared - share @ shear

    @cached_property
    def _weights(self):
        return self._model.quadrature.weights

    @cached_property
    def _fields(self):
        """Rotation, curvature, shear of the modes at the nodes, stiffnesses of bending, shear."""
        model = self._model
        nodes = model.quadrature.nodes
        section = model.manipulator.arm.at(nodes)
        return (model.modes.rotation(nodes).T, model.modes.curvature(nodes).T,
                model.modes.shear(nodes).T,
                *(np.broadcast_to(stiffness, nodes.shape)
                  for stiffness in (section.bending_stiffness, section.shear_stiffness)))

    @cached_property
    def _softness(self):
        # Strain per axial force, of arms that do not stretch in the model.
        model = self._model
        return (not model.axial) / model.manipulator.arm.at(model.quadrature.nodes).axial_stiffness

    @cached_property
    def _inboard(self):
        return self._model.quadrature.integrate_to(self._model.quadrature.nodes)

    @cached_property
    def _whole(self):
        return self._model.tip_point.integral[:, 0]

    @cached_property
    def _rest(self):
        # From nodal values to their integral up to the tip.
        return self._whole - self._inboard

    @cached_property
    def _outboard(self):
        # From values at the points of mass to their sums outboard of the nodes.
        return self._model.points.integral / self._weights[:, np.newaxis]

    @cached_property
    def _vibrations(self):
        """
        The natural vibrations of the straight arm, as the modes have them (T40).

        Their left eigenvectors, and by how much the tip runs ahead in a step, per rate.
        """  # noqa: D401
        model, step, tip_shift = self._model, self._steps.step, self._steps.errors.tip_shift
        values, left, right = eig(model.linear, left=True)
        kept = values.imag > 1e-6 * np.abs(values).max()
        values, left, right = values[kept], left[:, kept].conj().T, right[:, kept]
        left = left / np.sum(left * right.T, axis=1)[:, np.newaxis]
        half = len(right) // 2
        # As motions: carrier along y, shaft, modes.
        shapes = (self._steps.errors.motions @ right[:half]).T
        y, theta, q = shapes[:, 1:2], shapes[:, 2:3], shapes[:, 3:]
        omega = values.imag[:, np.newaxis]
        points = model.points
        force = omega**2 * model.point_mass * (y + theta * points.xi + q @ points.deflection)
        moment = omega**2 * model.point_inertia * (theta + q @ points.rotation)
        straight = np.ones(1), np.zeros(1)
        curvature, shear = self._left_out(q, np.stack([0.0 * force, force], axis=-1), moment,
                                          straight, straight)
        _, _, _, stiffness, shear_stiffness = self._fields
        energy = (np.abs(curvature)**2 * stiffness + np.abs(shear)**2 * shear_stiffness
                  ) @ self._weights
        share = 0.5 * energy / (np.abs(q)**2 @ model.modes.omega**2)
        reach = np.linalg.norm(tip_shift @ right[:half], axis=0)
        # What vibrates is twice the real part of an eigenvector.
        return left, 2.0 * share * step * reach * values.imag / np.abs(values)
