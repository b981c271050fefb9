"""A run: motions at sampled times, and what is read off them."""

from dataclasses import dataclass

import numpy as np

from timo_sim.energy import integral
from timo_sim.physics.formulation import Formulation
from timo_sim.scene import Scene


@dataclass(frozen=True)
class Run:
    """
    A simulated run of n samples with N modes.

    Attributes
    ----------
    scene : Scene
    formulation : Formulation
    t : ndarray, shape (n,)
        Sim time [s].
    motion : ndarray, shape (n, 2 (3 + N))
        See `physics.formulation`.
    friction_heat : ndarray, shape (n,)
        What Coulomb friction has made of the work of the loads since the start [J].

    """

    scene: Scene
    formulation: Formulation
    t: np.ndarray
    motion: np.ndarray
    friction_heat: np.ndarray

    @property
    def _half(self):
        return self.motion.shape[1] // 2

    @property
    def carrier(self):
        """Carrier position in world axes, shape (n, 2) [m]."""
        return self.motion[:, :2]

    @property
    def carrier_velocity(self):
        """Carrier velocity in world axes, shape (n, 2) [m/s]."""
        return self.motion[:, self._half:self._half + 2]

    @property
    def shaft(self):
        """Shaft angle, not wrapped, shape (n,) [rad]."""
        return self.motion[:, 2]

    @property
    def shaft_velocity(self):
        """Shaft speed, shape (n,) [rad/s]."""
        return self.motion[:, self._half + 2]

    @property
    def q(self):
        """Modal coordinates, shape (n, N) [m sqrt(kg)]."""
        return self.motion[:, 3:self._half]

    @property
    def qdot(self):
        """Modal rates, shape (n, N) [m sqrt(kg)/s]."""
        return self.motion[:, self._half + 3:]

    def position(self, xi):
        """
        Return where the centre line's point xi is, in world axes.

        Parameters
        ----------
        xi : float
            Distance from the root along the undeformed arm, 0 to its length [m].

        Returns
        -------
        ndarray, shape (n, 2)
            [m]

        """
        return self.formulation.world(self.motion, self._at(xi))[:, 0]

    def deflection(self, xi):
        """Return the axial and transverse deflection of point xi, arm frame, (n, 2) [m]."""
        return self.formulation.centre_line(self.q, self._at(xi))[:, 0] - np.array([xi, 0.0])

    def rotation(self, xi):
        """Return the rotation of section xi relative to the shaft, shape (n,) [rad]."""
        return self.formulation.section_rotation(self.q, self._at(xi))[:, 0]

    def energy(self):
        """Return kinetic plus strain energy, shape (n,) [J]."""
        return self.formulation.energy(self.motion)

    def dissipated(self):
        """Return what viscous friction and modal damping have taken so far, shape (n,) [J]."""
        taken = integral(np.rint(self.t * 1e9), self.formulation.dissipation(self.motion))
        return np.append(0.0, np.cumsum(taken))

    def momentum(self):
        """
        Return the momentum of the whole manipulator.

        Returns
        -------
        ndarray, shape (n, 3)
            Linear momentum in world x and y [kg m/s], angular momentum about the world's origin
            [kg m2/s].

        """
        return self.formulation.momentum(self.motion)

    def _at(self, xi):
        length = self.scene.manipulator.arm.length
        if not 0.0 <= xi <= length:
            raise ValueError(f'xi must be between 0 and arm.length = {length} m, got {xi}')
        return self.formulation.at([xi])
