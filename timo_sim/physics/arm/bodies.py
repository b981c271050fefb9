# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The bodies of the manipulator and the constants that the equations take from them."""

from dataclasses import dataclass, fields
import math
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Section:
    """
    A rectangular cross-section of the arm, or arrays of them.

    Source: paper, section 2.1 and Table 1.

    Attributes
    ----------
    width : float or ndarray
        Section size normal to the plane of motion [m].
    height : float or ndarray
        Section size in the plane of motion, the direction of bending [m].
    density : float or ndarray
        [kg/m3]
    young_modulus, shear_modulus : float or ndarray
        [Pa]
    shear_correction : float
        Shear correction factor kappa, paper eq. (37) for a rectangle.

    """

    width: float
    height: float
    density: float
    young_modulus: float
    shear_modulus: float
    shear_correction: float

    @property
    def area(self):
        """Section area A [m2]."""
        return self.width * self.height

    @property
    def second_moment(self):
        """Second moment of the section about its neutral axis, I [m4]."""
        return self.width * self.height**3 / 12.0

    @property
    def mass_per_length(self):
        """Mass per length rho A [kg/m]."""
        return self.density * self.area

    @property
    def inertia_per_length(self):
        """Rotary inertia per length rho I [kg m]."""
        return self.density * self.second_moment

    @property
    def bending_stiffness(self):
        """Bending stiffness E I [N m2]."""
        return self.young_modulus * self.second_moment

    @property
    def axial_stiffness(self):
        """Axial stiffness E A [N]."""
        return self.young_modulus * self.area

    @property
    def shear_stiffness(self):
        """Shear stiffness kappa G A [N]."""
        return self.shear_correction * self.shear_modulus * self.area

    @property
    def cutoff(self):
        """Cut-off frequency omega_0, above which the second spectrum begins [rad/s]."""
        return math.sqrt(self.shear_stiffness / self.inertia_per_length)


@dataclass(frozen=True)
class Beam:
    """
    A Timoshenko beam of rectangular section: the arm.

    Attributes
    ----------
    length : float
        [m]
    section : Section
        Its fields are floats, or tuples of values at `positions` with linear interpolation.
    positions : tuple of float
        Distances from the root, ascending from 0 to `length` [m]; at a position given twice the
        section jumps. Empty for a uniform arm.

    """

    length: float
    section: Section
    positions: tuple = ()

    @property
    def uniform(self):
        """Whether the section is the same all along the arm."""
        return not self.positions

    @property
    def breaks(self):
        """Ends of the spans on which the section is smooth, from 0 to the length [m]."""
        if self.uniform:
            return np.array([0.0, self.length])
        return np.unique([0.0, *self.positions, self.length])

    def at(self, xi):
        """Return the sections at distances xi from the root, not at jumps, shape (p,) [m]."""
        if self.uniform:
            return self.section
        values: dict[str, Any] = {
            field.name: getattr(self.section, field.name) for field in fields(Section)}
        for name, value in values.items():
            if np.ndim(value):
                values[name] = np.interp(xi, self.positions, value)
        return Section(**values)


@dataclass(frozen=True)
class Manipulator:
    """
    Rigid carrier, motor, elastic arm and end effector.

    Source: paper, section 3.1 and Table 1.

    Attributes
    ----------
    arm : Beam
    carrier_mass, motor_mass : float
        m_c, m_m [kg]; the motor is on the carrier, so both masses only translate.
    shaft_inertia : float
        J_m [kg m2]
    end_effector_mass, end_effector_inertia : float
        Mass m_e [kg] and moment of inertia J_e [kg m2] of the end effector, at the arm's tip.
    carrier_friction, shaft_friction : float
        Viscous friction of the carrier along either axis, c_c [N s/m], and of the shaft, c_s
        [N m s/rad].
    coulomb : tuple of (float, float)
        Limits of the Coulomb friction of carrier [N] and shaft [N m] that builds up over a speed,
        each with this speed [m/s], [rad/s].

    """

    arm: Beam
    carrier_mass: float
    motor_mass: float
    shaft_inertia: float
    end_effector_mass: float
    end_effector_inertia: float
    carrier_friction: float = 0.0
    shaft_friction: float = 0.0
    coulomb: tuple = ((0.0, 1.0), (0.0, 1.0))

    @property
    def base_mass(self):
        """Mass at the root of the arm, m_c + m_m [kg]."""
        return self.carrier_mass + self.motor_mass

    def inertia(self, quadrature):
        """
        Return M(xi) and J(xi) of the paper's Remark 1, times the weights of an integral.

        Parameters
        ----------
        quadrature : Quadrature
            With p nodes on the arm.

        Returns
        -------
        mass, inertia : ndarray, shape (p + 1,)
            At the nodes, then those of the end effector at the tip [kg], [kg m2].

        """
        section, weights = self.arm.at(quadrature.nodes), quadrature.weights
        return (np.append(weights * section.mass_per_length, self.end_effector_mass),
                np.append(weights * section.inertia_per_length, self.end_effector_inertia))


@dataclass(frozen=True)
class Constraints:
    """
    Degrees of freedom that are removed from the state; no stiff springs are used.

    Attributes
    ----------
    carrier : tuple of float or None
        Position at which the carrier is held, x and y in world axes [m]; None: it is free to move
        along that axis.
    driven : bool
        Whether the shaft follows an angle that is given in the load, instead of a torque.
    locked : float or None
        The angle of a driven shaft that never moves [rad]; None for all others.

    """

    carrier: tuple = (None, None)
    driven: bool = False
    locked: float | None = None

    @property
    def free_axes(self):
        """Axes along which the carrier moves, of 0 (x) and 1 (y)."""
        return [axis for axis in range(2) if self.carrier[axis] is None]
