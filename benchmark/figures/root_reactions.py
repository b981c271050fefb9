# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Two formulations that the source paper mentions: `newton` with other reactions at the root.

`FORMULATIONS.update(MENTIONED)` lets scenes choose them, as those of any package.
"""

import numpy as np

from timo_sim.model.newton import Laws, Newton

MENTIONED = {'newton_root_stress': f'{__name__}:NewtonRootStress',
             'newton_rigid_axial': f'{__name__}:NewtonRigidAxial'}


class NewtonRootStress(Newton):
    """
    The `newton_root_stress` formulation: root reactions from the truncated series.

    This is the literal reading of the paper's section 3.3: `V(0) = kappa G A (w' - phi)(0)` and
    `M(0) = E I phi'(0)` with (36), where `kappa G A (W_n' - Phi_n)(0) = omega_n^2 a_n` and
    `E I Phi_n'(0) = omega_n^2 b_n`; a damped mode adds its damping stress. With the k of `newton`,

        J_m theta'' = tau + b.k     V(0) = a.k                               (T20)

    replace its rows for theta and V(0). The mass beyond mode N does not load the carrier: with
    N = 5 in the paper's scene 5 % of the arm's mass. Forces on the tip and the arm, of which the
    paper's scene has none, would still act as in `newton`, on the shaft and the carrier, too.
    """

    def laws(self) -> Laws:
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
            matrix=matrix, column=np.append(0.0, self.modal_moments), softening=softening,
            stress=stress, shear_mass=0.0, shear_row=np.zeros_like(laws.column),
            shear_softening=zero, shear_stress=self.modal_moments)


class NewtonRigidAxial(Newton):
    """
    The `newton_rigid_axial` formulation: the axial assumption that the paper warns of.

    It is `newton` with (35) in place of (34): the axial force at the root is that of a rigid body,
    `P(0) = -m_a a_I(chi)`, with the acceleration (26) of the mass centre at xi = chi, which
    includes w(chi). See doc/theory.md (T21).
    """

    def laws(self) -> Laws:
        """Return the coefficients of the equations of motion."""
        centre = np.array([self.point_mass @ self.points.xi / self.arm_mass])
        return super().laws()._replace(axial=self.arm_mass * self.modes.deflection(centre)[0])
