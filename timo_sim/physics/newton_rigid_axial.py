"""
The `newton_rigid_axial` formulation: the axial assumption that the paper warns of.

`newton` with (35) in place of (34): the axial force at the root is that of a rigid body,
`P(0) = -m_a a_I(chi)` with the acceleration (26) of the mass centre at xi = chi, w(chi) included:
doc/theory.md (T18).
"""

import numpy as np

from timo_sim.physics.newton import Newton


class NewtonRigidAxial(Newton):
    """The `newton_rigid_axial` formulation, see the module's text."""

    def laws(self):
        """Return the coefficients of the equations of motion."""
        centre = np.array([self.lever / self.arm_mass])
        return super().laws()._replace(axial=self.arm_mass * self.modes.deflection(centre)[0])
