"""Eigenfrequencies and mode shapes of the arm clamped at its root, tip mass and inertia on it."""

import functools

import numpy as np
from scipy.optimize import brentq

from timo_sim.physics.galerkin import GalerkinModes
from timo_sim.physics.quadrature import Quadrature


@functools.lru_cache(maxsize=16)
def modes_of(manipulator, count):
    """
    Return the lowest modes of a manipulator's arm, both spectra together.

    Kept for those that ask again: the check of a scene, its projection, its run.

    Parameters
    ----------
    manipulator : Manipulator
    count : int
        Number of modes N.

    Returns
    -------
    UniformModes or GalerkinModes
        The closed form where there is one.

    """
    kind = UniformModes if manipulator.arm.uniform else GalerkinModes
    return kind(manipulator, count)


class UniformModes:
    """
    The lowest modes of a uniform arm in closed form, mass-normalised.

    With `s` either root of the characteristic equation (8), `-alpha^2` or one that is `beta^2`
    below the cut-off frequency and `-beta'^2` above it, and `g'' = s g`, `g = G'`, the field
    equations (1), (2) have the solutions

        W = g     Phi = (s + nu) G     W' - Phi = -nu G     nu = rho A omega^2 / (kappa G A)

    and a mode is the sum of four. The pair (g, G) is (cos, sin / k) and (-k sin, cos) of k xi for
    s = -k^2, the same with cosh and sinh for a small s > 0, and otherwise exponentials that decay
    from either end; sinh and cosh of beta xi, as printed in (18), cancel beyond the twelfth
    mode. All are analytic in s, so nothing happens at the cut-off. The sign makes the root
    curvature positive.

    Source: paper eqs. (8)-(19), (23), with the corrections listed in doc/paper.md;
    doc/theory.md (T5), (T6), and (T7) for the boundary conditions.

    Parameters
    ----------
    manipulator : Manipulator
        With a uniform arm.
    count : int
        Number of modes N.

    Attributes
    ----------
    omega : ndarray, shape (N,)
        Angular eigenfrequencies, ascending [rad/s].

    Raises
    ------
    ValueError
        If two modes are too close to be told apart.

    """

    def __init__(self, manipulator, count):
        self._body, self._length = manipulator, manipulator.arm.length
        self._section = manipulator.arm.section
        self.omega = self._roots(count)
        self._shape = np.zeros((4, count))
        for n, omega in enumerate(self.omega):
            matrix, scale = self._boundary_matrix(omega)
            self._shape[:, n] = np.linalg.svd(matrix)[2][-1] / scale
        fine = Quadrature(manipulator.arm.breaks, 4 * count + 40)
        mass, inertia = manipulator.inertia(fine)
        modal_mass = mass @ self.deflection(fine.points)**2 + inertia @ self.rotation(
            fine.points)**2
        self._shape *= np.sign(self.curvature(np.zeros(1))[0]) / np.sqrt(modal_mass)

    def __len__(self):
        return len(self.omega)

    def deflection(self, xi):
        """Return W_n(xi), shape (len(xi), N) [1/sqrt(kg)]."""
        return self._sum(xi, lambda g, integral, s, nu: g)

    def rotation(self, xi):
        """Return Phi_n(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        return self._sum(xi, lambda g, integral, s, nu: (s + nu) * integral)

    def curvature(self, xi):
        """Return Phi_n'(xi), shape (len(xi), N) [1/(m2 sqrt(kg))]."""
        return self._sum(xi, lambda g, integral, s, nu: (s + nu) * g)

    def shear(self, xi):
        """Return the shear strain (W_n' - Phi_n)(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        # The difference of W' and Phi would lose seven digits on a slender arm.
        return self._sum(xi, lambda g, integral, s, nu: -nu * integral)

    def _sum(self, xi, field):
        values = np.empty((len(xi), len(self)))
        for n, omega in enumerate(self.omega):
            values[:, n] = self._shape[:, n] @ field(*self._waves(omega, np.asarray(xi)))
        return values

    def _waves(self, omega, xi):
        """Return g, G, shape (4, p), s of each, shape (4, 1), and nu."""
        section = self._section
        radius2 = section.second_moment / section.area
        ratio = section.young_modulus / (section.shear_correction * section.shear_modulus)
        k2 = omega * np.sqrt(section.mass_per_length / section.bending_stiffness)
        root = np.sqrt((0.5 * (1.0 - ratio) * radius2 * k2)**2 + 1.0)
        mean = 0.5 * (1.0 + ratio) * radius2 * k2
        first = -k2 * (root + mean)
        # root - mean, written without the cancellation near the cut-off, where it changes sign.
        second = k2 * (1.0 - ratio * (radius2 * k2)**2) / (root + mean)

        pairs = _standing(first, xi)
        if second * self._length**2 > 1.0:
            beta = np.sqrt(second)
            from_root, from_tip = np.exp(-beta * xi), np.exp(-beta * (self._length - xi))
            pairs += [(from_root, -from_root / beta), (from_tip, from_tip / beta)]
        else:
            pairs += _standing(second, xi)
        g, integral = (np.stack(values) for values in zip(*pairs))
        nu = section.mass_per_length / section.shear_stiffness * omega**2
        return g, integral, np.array([first, first, second, second])[:, np.newaxis], nu

    def _boundary_matrix(self, omega):
        # Rows: W(0), Phi(0), shear force and moment balance of the end effector; columns: waves,
        # scaled, and the scale.
        body, section = self._body, self._section
        g, integral, s, nu = self._waves(omega, np.array([0.0, self._length]))
        (w_root, w_tip), (phi_root, phi_tip) = g.T, ((s + nu) * integral).T
        matrix = np.array([
            w_root, phi_root,
            -section.shear_stiffness * nu * integral[:, 1] - body.tip_mass * omega**2 * w_tip,
            section.bending_stiffness * (s[:, 0] + nu) * w_tip
            - body.tip_inertia * omega**2 * phi_tip])
        matrix /= np.linalg.norm(matrix, axis=1, keepdims=True)
        scale = np.linalg.norm(matrix, axis=0)
        return matrix / scale, scale

    def _roots(self, count):
        if count == 0:
            return np.zeros(0)
        guesses = GalerkinModes(self._body, count + 1).omega
        # Between two limits the Galerkin count rises by one, and the determinant of the boundary
        # conditions must change sign.
        limits = np.sqrt(guesses[:-1] * guesses[1:])
        limits = np.insert(limits, 0, 0.5 * guesses[0])

        def determinant(omega):
            return np.linalg.det(self._boundary_matrix(omega)[0])

        signs = np.sign([determinant(limit) for limit in limits])
        if not np.all(signs[1:] * signs[:-1] < 0):
            missed = int(np.argmin(signs[1:] * signs[:-1] < 0)) + 1
            raise ValueError(f'mode {missed} of the arm is not separate from its neighbours')
        return np.array([brentq(determinant, low, high, xtol=1e-300, rtol=4 * np.finfo(float).eps)
                         for low, high in zip(limits[:-1], limits[1:])])


def _standing(s, xi):
    # The pairs (cos, sin / k), (-k sin, cos) of k xi for s = -k^2; hyperbolic for s > 0.
    k = np.sqrt(abs(s))
    if s > 0.0:
        even, odd = np.cosh(k * xi), np.sinh(k * xi)
    else:
        even, odd = np.cos(k * xi), np.sin(k * xi)
    integral = odd / k if k > 0.0 else xi
    return [(even, integral), (s * integral, even)]
