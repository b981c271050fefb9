# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The `newton_rigid_axial` formulation: the axial assumption that the paper warns of.

It is `newton` with (35) in place of (34): the axial force at the root is that of a rigid body,
`P(0) = -m_a a_I(chi)`, with the acceleration (26) of the mass centre at xi = chi, which includes
w(chi). See doc/theory.md (T21).
"""

import numpy as np

from timo_sim.physics.equations.newton import Newton


class NewtonRigidAxial(Newton):
    """The `newton_rigid_axial` formulation, see the module's text."""

    def laws(self):
        """Return the coefficients of the equations of motion."""
        centre = np.array([self.lever / self.arm_mass])
        return super().laws()._replace(axial=self.arm_mass * self.modes.deflection(centre)[0])
