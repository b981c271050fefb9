"""The bodies of the manipulator and the constants that the equations take from them."""

from dataclasses import dataclass
import math


@dataclass(frozen=True)
class Beam:
    """
    A uniform Timoshenko beam of rectangular section: the arm.

    Source: paper, section 2.1 and Table 1.

    Attributes
    ----------
    length : float
        [m]
    width : float
        Section size normal to the plane of motion [m].
    height : float
        Section size in the plane of motion, the direction of bending [m].
    density : float
        [kg/m3]
    young_modulus, shear_modulus : float
        [Pa]
    shear_correction : float
        Shear correction factor kappa, paper eq. (37) for a rectangle.

    """

    length: float
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
    def shear_stiffness(self):
        """Shear stiffness kappa G A [N]."""
        return self.shear_correction * self.shear_modulus * self.area

    @property
    def cutoff(self):
        """Angular frequency above which the second spectrum begins, omega_0 [rad/s]."""
        return math.sqrt(self.shear_stiffness / self.inertia_per_length)


@dataclass(frozen=True)
class Manipulator:
    """
    Rigid carrier, motor, elastic arm and end effector.

    Source: paper, section 3.1 and Table 1.

    Attributes
    ----------
    arm : Beam
    carrier_mass, motor_mass : float
        m_c, m_m [kg]; the motor's rotor is on the carrier, so both masses only translate.
    shaft_inertia : float
        J_m [kg m2]
    tip_mass, tip_inertia : float
        Mass m_e [kg] and moment of inertia J_e [kg m2] of the end effector, at the arm's tip.

    """

    arm: Beam
    carrier_mass: float
    motor_mass: float
    shaft_inertia: float
    tip_mass: float
    tip_inertia: float

    @property
    def base_mass(self):
        """Mass at the root of the arm, m_c + m_m [kg]."""
        return self.carrier_mass + self.motor_mass

    @property
    def arm_mass(self):
        """Mass of the arm with its end effector [kg]."""
        return self.arm.mass_per_length * self.arm.length + self.tip_mass

    @property
    def mass(self):
        """Mass of everything that moves, m_t [kg]."""
        return self.base_mass + self.arm_mass

    @property
    def section_inertia(self):
        """Moment of inertia of all that turns with the sections, J_m + int J dxi [kg m2]."""
        arm = self.arm
        return self.shaft_inertia + arm.inertia_per_length * arm.length + self.tip_inertia
