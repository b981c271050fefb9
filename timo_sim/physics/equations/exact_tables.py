# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Constants of the compiled functions of the `exact` formulation."""

from collections import namedtuple
from typing import NamedTuple

import numpy as np


class Tables(NamedTuple):
    """Constants of the compiled functions; N modes, n_g quadrature nodes, n free q_i."""

    mass: float            # m_t
    kernel: np.ndarray     # K for x and for y, (2, n_g, n_g), or for both, (1, n_g, n_g)
    lever: np.ndarray      # d / m_t, (n_g,)
    rotation: np.ndarray   # Phi_i at the nodes, (1 + N, n_g)
    shear: np.ndarray      # Gamma_i at the nodes, (1 + N, n_g)
    rotary: np.ndarray     # Xi_ij = int J Phi_i Phi_j, the shaft's J_m included, (1 + N, 1 + N)
    straight: np.ndarray   # M^-1 of the straight arm, (n, n)
    damping: np.ndarray    # c_s, then 2 zeta_i omega_i, (1 + N,)
    drag: float            # c_c
    coulomb: np.ndarray    # `Manipulator.coulomb`, (2, 2)
    axes: np.ndarray       # axes along which the carrier is free
    anchor: np.ndarray     # position at which it is held, (2,)
    reach: np.ndarray      # from nodal values to their integral over the arm, (n_g,)
    turn: np.ndarray       # Phi_i at the tip, (1 + N,)
    weight: np.ndarray     # m_t g along world x and y, (2,)


# Number of sectors of half a turn with a linear part each, if one axis of the carrier is held.
SECTORS = 16

# Constants where the last R coordinates have rates in place of momenta (T35). In addition:
# - stretch: E_i of the last A coordinates, the axial ones, at the nodes, (A, n_g);
# - stiffness: omega_i^2, (1 + N,);
# - linear_rate: linear part of the last accelerations per q_i and per q_i', (R, 2, R);
# - sector: number of the sector for which the linear part is, -1: any.
RateTables = namedtuple(  # type: ignore[misc]
    'RateTables', (*Tables._fields, 'stretch', 'stiffness', 'linear_rate', 'sector'))

# Number of bands of the speed with a linear part each, on either side of 0, and their width, as a
# share of the first angular frequency.
BANDS, BAND = 32, 0.25

# Constants of an arm that stretches, with one axis of the carrier held. In addition:
# - pace: bands per p_0, or per q_0' of a driven shaft;
# - turning: what the linear part has for the speed of the band, (m, m). `sector` counts both:
#   SECTORS times the number of the band, plus that of the sector.
TurningTables = namedtuple(  # type: ignore[misc]
    'TurningTables', (*RateTables._fields, 'pace', 'turning'))
