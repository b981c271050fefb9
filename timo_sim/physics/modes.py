"""Eigenfrequencies and mode shapes of the arm clamped at its root, tip mass and inertia on it."""

import numpy as np
from scipy.optimize import brentq

from timo_sim.physics.galerkin import frequencies
from timo_sim.physics.quadrature import Quadrature


class Modes:
    """
    The lowest modes of the first spectrum, mass-normalised.

    A mode is `W = c . w(xi)`, `Phi = c . p(xi)` over four functions: sin and cos of alpha xi, and
    exponentials that decay from either end; sinh and cosh of beta xi, as printed in the paper's
    (18), cancel beyond the twelfth mode. The sign makes the root curvature positive.

    Source: paper eqs. (9), (10), (14)-(16), (18), (23).

    Parameters
    ----------
    arm : Beam
    tip_mass, tip_inertia : float
        [kg], [kg m2]
    count : int
        Number of modes N.

    Attributes
    ----------
    omega : ndarray, shape (N,)
        Angular eigenfrequencies, ascending [rad/s].

    Raises
    ------
    ValueError
        If the arm has fewer than `count` modes below its cut-off frequency.

    """

    def __init__(self, arm, tip_mass, tip_inertia, count):
        self.arm, self.tip_mass, self.tip_inertia = arm, tip_mass, tip_inertia
        self.omega = self._roots(count)
        self._alpha, self._beta, self._lambda = self._wave_numbers(self.omega)
        self._shape = np.zeros((4, count))
        for n, omega in enumerate(self.omega):
            self._shape[:, n] = np.linalg.svd(self._boundary_matrix(omega))[2][-1]
        self._shape *= np.sign(self.curvature(np.zeros(1))[0]) / np.sqrt(self._modal_mass())

    def __len__(self):
        return len(self.omega)

    def deflection(self, xi):
        """Return W_n(xi), shape (len(xi), N) [1/sqrt(kg)]."""
        return self._evaluate(xi, ('sin', 'cos', 'root', 'tip'), (1, 1, 1, 1))

    def rotation(self, xi):
        """Return Phi_n(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        first, second = self._lambda
        return self._evaluate(xi, ('cos', 'sin', 'root', 'tip'), (first, -first, -second, second))

    def curvature(self, xi):
        """Return Phi_n'(xi), shape (len(xi), N) [1/(m2 sqrt(kg))]."""
        bend = -self._lambda[0] * self._alpha
        grow = self._lambda[1] * self._beta
        return self._evaluate(xi, ('sin', 'cos', 'root', 'tip'), (bend, bend, grow, grow))

    def shear(self, xi):
        """Return the shear strain (W_n' - Phi_n)(xi), shape (len(xi), N) [1/(m sqrt(kg))]."""
        # W' - Phi is written out: the difference of the two loses seven digits on a slender arm.
        wave = self._shear_ratio * self.omega**2
        return self._evaluate(
            xi, ('cos', 'sin', 'root', 'tip'),
            (wave / self._alpha, -wave / self._alpha, wave / self._beta, -wave / self._beta))

    @property
    def _shear_ratio(self):
        return self.arm.mass_per_length / self.arm.shear_stiffness

    def _evaluate(self, xi, functions, factors):
        # Sum over the four functions of coefficient x factor x function of xi.
        xi = np.asarray(xi, dtype=float)[:, np.newaxis]
        values = {
            'sin': lambda: np.sin(self._alpha * xi),
            'cos': lambda: np.cos(self._alpha * xi),
            'root': lambda: np.exp(-self._beta * xi),
            'tip': lambda: np.exp(-self._beta * (self.arm.length - xi)),
        }
        return sum(self._shape[k] * factor * values[name]()
                   for k, (name, factor) in enumerate(zip(functions, factors)))

    def _wave_numbers(self, omega):
        # alpha, beta of eqs. (9), (10); lambda: ratio of rotation to deflection of each wave.
        arm = self.arm
        omega = np.asarray(omega)
        ratio = arm.bending_stiffness / (arm.shear_stiffness * arm.second_moment / arm.area)
        radius2 = arm.second_moment / arm.area
        k2 = omega * np.sqrt(arm.mass_per_length / arm.bending_stiffness)
        root = np.sqrt((0.5 * (1.0 - ratio) * radius2 * k2)**2 + 1.0)
        mean = 0.5 * (1.0 + ratio) * radius2 * k2
        alpha = np.sqrt(k2 * (root + mean))
        # root - mean without cancellation near the cut-off, where it vanishes.
        beta = np.sqrt(k2 * np.maximum(1.0 - ratio * (radius2 * k2)**2, 0.0) / (root + mean))
        wave = self._shear_ratio * omega**2
        return alpha, beta, ((alpha**2 - wave) / alpha, (beta**2 + wave) / beta)

    def _boundary_matrix(self, omega):
        # Rows: W(0), Phi(0), shear force and moment balance of the end effector; columns: waves.
        arm, length = self.arm, self.arm.length
        alpha, beta, (first, second) = self._wave_numbers(omega)
        sin, cos, decay = np.sin(alpha * length), np.cos(alpha * length), np.exp(-beta * length)
        wave = self._shear_ratio * omega**2
        deflection = np.array([sin, cos, decay, 1.0])
        rotation = np.array([first * cos, -first * sin, -second * decay, second])
        shear = wave * np.array([cos / alpha, -sin / alpha, decay / beta, -1.0 / beta])
        curvature = np.array([-first * alpha * sin, -first * alpha * cos,
                              second * beta * decay, second * beta])
        matrix = np.array([
            [0.0, 1.0, 1.0, decay],
            [first, 0.0, -second, second * decay],
            arm.shear_stiffness * shear - self.tip_mass * omega**2 * deflection,
            arm.bending_stiffness * curvature - self.tip_inertia * omega**2 * rotation])
        return matrix / np.linalg.norm(matrix, axis=1, keepdims=True)

    def _roots(self, count):
        if count == 0:
            return np.zeros(0)
        # 40 modes of a slender arm need count + 20 terms; the rest is margin for a heavy tip.
        guesses = frequencies(self.arm, self.tip_mass, self.tip_inertia, count + 30)
        below = int(np.count_nonzero(guesses < self.arm.cutoff))
        if below < count:
            raise ValueError(
                f'the arm has {below} modes below its cut-off frequency of '
                f'{self.arm.cutoff / (2 * np.pi):.6g} Hz, {count} were asked for')
        limits = np.sqrt(guesses[:count] * np.minimum(guesses[1:count + 1], self.arm.cutoff))
        limits = np.insert(limits, 0, 0.5 * guesses[0])

        def determinant(omega):
            return np.linalg.det(self._boundary_matrix(omega))

        # Between two limits the Galerkin count rises by one, and the determinant must change sign.
        signs = np.sign([determinant(limit) for limit in limits])
        if not np.all(signs[1:] * signs[:-1] < 0):
            missed = int(np.argmin(signs[1:] * signs[:-1] < 0)) + 1
            raise ValueError(f'mode {missed} of the arm is not separate from its neighbours')
        return np.array([brentq(determinant, low, high, xtol=1e-300, rtol=4 * np.finfo(float).eps)
                         for low, high in zip(limits[:-1], limits[1:])])

    def _modal_mass(self):
        quadrature = Quadrature(self.arm.length, 4 * len(self) + 40)
        points = np.append(quadrature.nodes, self.arm.length)
        mass = np.append(quadrature.weights * self.arm.mass_per_length, self.tip_mass)
        inertia = np.append(quadrature.weights * self.arm.inertia_per_length, self.tip_inertia)
        return mass @ self.deflection(points)**2 + inertia @ self.rotation(points)**2
