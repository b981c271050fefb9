# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The `newton_root_stress` formulation: root reactions from the truncated series.

This is the literal reading of the paper's section 3.3: `V(0) = kappa G A (w' - phi)(0)` and
`M(0) = E I phi'(0)` with (36), where `kappa G A (W_n' - Phi_n)(0) = omega_n^2 a_n` and
`E I Phi_n'(0) = omega_n^2 b_n`; a damped mode adds its damping stress. With the k of `newton`,

    J_m theta'' = tau + b.k     V(0) = a.k                               (T20)

replace its rows for theta and V(0). A load on the tip acts on the modes and P(0) alone. The mass
beyond mode N does not load the carrier: with N = 5 in the paper's scene 5 % of the arm's mass.
"""

import numpy as np

from timo_sim.physics.equations.newton import Newton


class NewtonRootStress(Newton):
    """The `newton_root_stress` formulation, see the module's text."""

    def laws(self):
        """Return the coefficients of the equations of motion."""
        laws, body = super().laws(), self.manipulator
        if body.shaft_inertia == 0.0 and not self.constraints.driven:
            raise ValueError('newton_root_stress needs a shaft inertia > 0: the reaction M(0) of '
                             'the truncated series acts on the shaft alone')
        if not self.own_modes:
            raise ValueError('newton_root_stress knows the reactions of the modes of one end '
                             'effector alone: it cannot be changed')
        matrix, softening, stress = laws.matrix.copy(), laws.softening.copy(), laws.stress.copy()
        matrix[0] = 0.0
        matrix[0, 0] = body.shaft_inertia
        softening[0] = 0.0
        stress[0] = -laws.matrix[0, 1:]
        zero = np.zeros_like(laws.axial)
        return laws._replace(
            matrix=matrix, column=np.append(0.0, self.moment), softening=softening, stress=stress,
            shear_mass=0.0, shear_row=np.zeros_like(laws.column), shear_softening=zero,
            shear_stress=self.moment, tip_share=0.0)
