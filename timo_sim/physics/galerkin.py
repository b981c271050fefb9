"""Legendre-Galerkin eigenfrequencies of the clamped arm: the independent count of its modes."""

import numpy as np

from timo_sim.physics.quadrature import legendre_values, Quadrature


def frequencies(arm, tip_mass, tip_inertia, terms):
    """
    Approximate the angular eigenfrequencies of the clamped arm, both spectra together.

    Curvature and shear strain are expanded in Legendre polynomials, so the stiffness matrix is
    diagonal and the mass matrix a compact operator: its eigenvalues are 1/omega^2, and the small
    ones are exact to round-off of the largest. Being Ritz values, they never lie below the
    true frequencies.

    Source: weak form of the paper's (1), (2) with M, J of its Remark 1.

    Parameters
    ----------
    arm : Beam
    tip_mass, tip_inertia : float
        [kg], [kg m2]
    terms : int
        Polynomials for each of the two strains.

    Returns
    -------
    ndarray, shape (2 * terms,)
        Ascending [rad/s]. The upper part is not converged.

    """
    # Products of two fields of degree terms + 1 are integrated exactly.
    quadrature = Quadrature(arm.length, terms + 3)
    points = np.append(quadrature.nodes, arm.length)
    _, once = legendre_values(2.0 * points / arm.length - 1.0, terms)
    once *= 0.5 * arm.length
    twice = quadrature.integrate_to(points) @ once[:-1]

    # int P_k^2 = length / (2 k + 1): scaling by it makes the stiffness matrix the identity.
    norm = np.sqrt((2 * np.arange(terms) + 1) / arm.length)
    bend = norm / np.sqrt(arm.bending_stiffness)
    shear = norm / np.sqrt(arm.shear_stiffness)
    deflection = np.hstack([twice * bend, once * shear])
    rotation = np.hstack([once * bend, np.zeros_like(once)])

    mass = np.append(quadrature.weights * arm.mass_per_length, tip_mass)[:, np.newaxis]
    inertia = np.append(quadrature.weights * arm.inertia_per_length, tip_inertia)[:, np.newaxis]
    compliance = deflection.T @ (mass * deflection) + rotation.T @ (inertia * rotation)
    inverse_squares = np.linalg.eigvalsh(compliance)[::-1]
    return 1.0 / np.sqrt(np.maximum(inverse_squares, np.finfo(float).tiny))
