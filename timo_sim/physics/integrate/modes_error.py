# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Estimated tip error by the modes that a model lacks, see doc/theory.md (T39), (T40)."""

import math

import numpy as np
from scipy.linalg import eig

from timo_sim.physics.integrate.kept import kept
from timo_sim.physics.layout import tip_force, TIP_TORQUE

_GROWTH = 1.25  # factor by which the strain of the last modes must grow for new `shifts`
_LAST = 2  # number of last bending modes whose strain is watched
_PAUSE = 8192  # steps after which `shifts` are computed without such growth


class ModesError:
    """
    Estimate of what the modes of a model lack, by forces and moments along the arm.

    Inertia and loads outboard of a section determine its bending moment and shear force, and so
    the strains that the arm would have. The part of them that is not in the modes shifts the tip.
    It also makes natural frequencies too high, so that vibrations run ahead.

    Parameters
    ----------
    steps : Steps

    Attributes
    ----------
    tip : float
        Largest estimated distance of the tip from that of a model with more modes, so far [m].
    stretch : float
        Largest shift of the tip so far that the axial force would cause, if the model does not
        stretch [m].

    """

    def __init__(self, steps):
        self._steps, self._model, self.kept = steps, steps.model, steps.kept
        self.reset()

    def reset(self):
        """Set all errors to zero."""
        self.tip, self._shift, self._strain, self._pause, self._ahead = 0.0, 0.0, 0.0, 0, 0.0
        self.stretch = 0.0

    def go_on(self, earlier):
        """Take over the errors from the estimate for an earlier model of the same size."""
        self.tip, self._shift, self._ahead = earlier.tip, earlier._shift, earlier._ahead

    def look(self, state, load, rate, count):
        """
        Update the estimate by one state.

        Parameters
        ----------
        state : ndarray, shape (m,)
        load : ndarray, shape (14,)
            Load that acts, friction included.
        rate : ndarray, shape (m,)
            Rate of the state, or of the state a step before.
        count : int
            Steps since the last call.

        """
        if not len(self._model.modes):
            return  # without modes the arm is rigid on purpose
        self._pause += count
        self._look_at_shape(self._strains(state[np.newaxis])[0], state, load)
        # Amplitudes follow from the rate, to which a constant deflection does not contribute.
        left, ahead = self._vibrations
        self._ahead += count * float(np.abs(left @ rate) @ ahead)
        tip = self._shift + self._ahead
        self.tip = max(self.tip, tip if math.isfinite(tip) else math.inf)

    def look_for_peak(self, states, loads):
        """Update by the most strained of some states, (n, m), under their loads, (n, 14)."""
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
        # Strain of the last bending modes: those left out vary at least as fast along the arm.
        omega, axial = self._model.modes.omega, self._model.axial
        last = slice(max(0, len(omega) - axial - _LAST), len(omega) - axial)
        q = states[:, states.shape[1] // 2 - len(omega):]
        return np.abs(q[:, last]) @ omega[last]

    def shifts(self, state, load):
        """
        Return the shifts of the tip along and across the shaft, shape (2, 2) [m].

        The first is that by the strains of bending and shear that are not in the modes; the second
        that by the axial force, if the model does not stretch.
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
        # Forces in axes of the shaft.
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

        For q, (..., N); forces and moments at the points of mass, (..., p, 2), (..., p); slopes
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

    @kept
    def _weights(self):
        return self._model.quadrature.weights

    @kept
    def _fields(self):
        """Rotation, curvature, shear of the modes at the nodes; bending and shear stiffness."""
        model = self._model
        nodes = model.quadrature.nodes
        section = model.manipulator.arm.at(nodes)
        return (model.modes.rotation(nodes).T, model.modes.curvature(nodes).T,
                model.modes.shear(nodes).T,
                *(np.broadcast_to(stiffness, nodes.shape)
                  for stiffness in (section.bending_stiffness, section.shear_stiffness)))

    @kept
    def _softness(self):
        # Axial strain per axial force; 0 if the model stretches.
        model = self._model
        return (not model.axial) / model.manipulator.arm.at(model.quadrature.nodes).axial_stiffness

    @kept
    def _inboard(self):
        return self._model.quadrature.integrate_to(self._model.quadrature.nodes)

    @kept
    def _whole(self):
        return self._model.tip_point.integral[:, 0]

    @kept
    def _rest(self):
        # From nodal values to their integrals from each node to the tip.
        return self._whole - self._inboard

    @kept
    def _outboard(self):
        # From values at the points of mass to their sums outboard of each node.
        return self._model.points.integral / self._weights[:, np.newaxis]

    @kept
    def _vibrations(self):
        """
        Return the left eigenvectors of the straight arm's natural vibrations (T40).

        With them, how far the tip runs ahead in a step, per modal component of the state's rate.
        """
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
