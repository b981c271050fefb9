# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Estimated error of the tip in a model whose arm does not stretch."""

import math

import numpy as np


class StretchError:
    """
    An estimate for the straight arm that turns, see doc/theory.md, section 6.

    Centrifugal forces lengthen the arm by `omega^2 lengthening`. Its inertia about the centre of
    rotation grows by a share `omega^2 growth`; a free shaft then lags by `growth int omega^3 dt`.

    Parameters
    ----------
    model : Formulation

    Attributes
    ----------
    tip : float
        Largest estimated distance so far of the tip from that of an arm that stretches [m].
    told : str or None
        The warning of it that was given.

    """

    def __init__(self, model):
        self._free = not model.first
        self.reset()
        body, points, nodes = model.manipulator, model.points, model.quadrature.nodes
        mass, xi = model.point_mass, points.xi
        # The arm turns about the mass centre, the root, or with one axis held half-way between.
        centre = 0.5 * len(model.axes) * (mass @ xi) / model.mass
        lever = mass * (xi - centre)
        outboard = np.where(xi > nodes[:, np.newaxis], lever, 0.0).sum(axis=1)
        stiffness = np.broadcast_to(body.arm.at(nodes).axial_stiffness, nodes.shape)
        shift = (outboard / stiffness) @ points.integral
        inertia = (body.shaft_inertia + model.point_inertia.sum() + lever @ (xi - centre)
                   + body.base_mass * centre**2)
        if model.axial or not len(model.modes):
            shift[:] = 0.0  # the arm does stretch, or is rigid on purpose
        self._growth, self._lengthening = 2.0 * (lever @ shift) / inertia, shift[-1]
        self._reach = body.arm.length - centre

    def reset(self):
        """Set all errors to zero, and forget the warning."""
        self.tip, self._lag, self.told = 0.0, 0.0, None

    def follow(self, earlier):
        """Take over errors and warning from the estimate for an earlier model."""
        self.tip, self._lag, self.told = earlier.tip, earlier._lag, earlier.told

    def add(self, turn, duration, by_force=0.0):
        """Add a turn of the shaft [rad] within a time [s], and a shift by axial forces [m]."""
        speed = turn / duration if duration else 0.0
        self._lag += self._free * self._growth * speed**3 * duration
        self.tip = max(self.tip, math.hypot(self._reach * self._lag,
                                            max(self._lengthening * speed**2, by_force)))
