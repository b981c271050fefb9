# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Convert damping ratios of the whole manipulator to those of the clamped arm's modes."""

import numpy as np


def clamped_ratios(model, ratios):
    """
    Return the ratios of the clamped modes that give the manipulator's vibrations stated ratios.

    Let x_n be the modal coordinates of the manipulator's k-th undamped vibration, of unit modal
    mass and frequency Omega_k. Damping of the n-th clamped mode adds `2 zeta_n omega_n x_n^2` to
    `2 zeta_k Omega_k`. This gives as many equations as modes, right to first order in the ratios.

    Parameters
    ----------
    model : Formulation
        Its own damping is not used.
    ratios : float or ndarray, shape (N,)
        Stated ratios of the manipulator's vibrations, by ascending frequency.

    Returns
    -------
    ndarray, shape (N,)
        An entry is negative if no positive damping of the clamped modes gives these ratios.

    """
    half, omega = len(model.linear) // 2, model.modes.omega
    squares, shapes = np.linalg.eig(-model.linear[:half, half:] @ model.linear[half:, :half])
    vibrating = np.argsort(squares.real)[half - len(omega):]
    frequency = np.sqrt(squares.real[vibrating])
    energy = omega[:, np.newaxis]**2 * shapes.real[half - len(omega):, vibrating]**2
    share = energy / energy.sum(axis=0)  # of the clamped modes in the strain energy, (N, N)
    # With x_n^2 = share frequency^2 / omega_n^2.
    matrix = (share / omega[:, np.newaxis]).T * frequency[:, np.newaxis]
    return np.linalg.solve(matrix, np.broadcast_to(ratios, omega.shape))
