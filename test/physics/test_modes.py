"""Modes of the clamped arm against the paper's table, identities and independent counts."""

import numpy as np
import pytest

from timo_sim.physics.bodies import Beam
from timo_sim.physics.galerkin import frequencies
from timo_sim.physics.modes import Modes
from timo_sim.physics.quadrature import Quadrature

ARM = Beam(2.0, 0.02, 0.02, 2710.0, 70.5e9, 27e9, 0.85)
TIP = 2.0, 0.5
# [Hz]; the first five are the paper's Table 2 with two more digits.
TABLE = [1.786895, 9.073846, 29.810778, 74.990179, 143.887216, 235.702179, 350.158771, 486.992845]
PAPER_TABLE_2 = [1.7869, 9.0738, 29.8108, 74.9902, 143.8872]


def integrals(modes):
    """Return W, Phi and the weights of M and J at Gauss points fine enough for 40 modes."""
    quadrature = Quadrature(ARM.length, 200)
    points = np.append(quadrature.nodes, ARM.length)
    mass = np.append(quadrature.weights * ARM.mass_per_length, TIP[0])
    inertia = np.append(quadrature.weights * ARM.inertia_per_length, TIP[1])
    return points, modes.deflection(points), modes.rotation(points), mass, inertia


def test_frequencies_are_those_of_the_table():
    hertz = Modes(ARM, *TIP, 8).omega / (2 * np.pi)
    assert np.abs(hertz - TABLE).max() < 1e-6  # the table's last digit
    assert np.round(hertz[:5], 4).tolist() == PAPER_TABLE_2
    assert ARM.cutoff / (2 * np.pi) == pytest.approx(80220.9, abs=0.05)


@pytest.mark.parametrize('count', [1, 8, 40])
def test_modes_are_orthonormal(count):
    points, w, phi, mass, inertia = integrals(Modes(ARM, *TIP, count))
    gram = w.T @ (mass[:, np.newaxis] * w) + phi.T @ (inertia[:, np.newaxis] * phi)
    assert np.abs(gram - np.eye(count)).max() < 1e-12


@pytest.mark.parametrize('count', [8, 40])
def test_root_reactions_are_the_modal_inertia_forces(count):
    modes = Modes(ARM, *TIP, count)
    points, w, phi, mass, inertia = integrals(modes)
    root = np.zeros(1)
    force, moment = mass @ w, (mass * points) @ w + inertia @ phi
    shear = ARM.shear_stiffness * modes.shear(root)[0]
    bending = ARM.bending_stiffness * modes.curvature(root)[0]
    assert np.abs(shear / (modes.omega**2 * force) - 1).max() < 1e-9
    assert np.abs(bending / (modes.omega**2 * moment) - 1).max() < 1e-9


def test_share_of_mass_and_inertia_that_modes_carry():
    points, w, phi, mass, inertia = integrals(Modes(ARM, *TIP, 8))
    force, moment = mass @ w, (mass * points) @ w + inertia @ phi
    mass_share = np.cumsum(force**2) / mass.sum()
    inertia_share = np.cumsum(moment**2) / (mass @ points**2 + inertia.sum())
    chosen = [0, 1, 2, 4, 7]
    assert mass_share[chosen] == pytest.approx([0.677, 0.828, 0.900, 0.948, 0.970], abs=5e-4)
    assert inertia_share[chosen] == pytest.approx(
        [0.973, 0.9947, 0.9989, 0.99985, 0.99997], abs=5e-5)


def test_fields_are_derivatives_of_each_other():
    modes = Modes(ARM, *TIP, 6)
    xi, h = np.linspace(0.1, 1.9, 7), 1e-4
    slope = (modes.deflection(xi + h) - modes.deflection(xi - h)) / (2 * h)
    curvature = (modes.rotation(xi + h) - modes.rotation(xi - h)) / (2 * h)
    # Central differences: relative error (k h)^2 / 6 of the shortest wave, k = 9 rad/m.
    scale = np.abs(modes.rotation(xi)).max(axis=0)
    assert (np.abs(slope - modes.rotation(xi) - modes.shear(xi)) / scale).max() < 1e-6
    assert (np.abs(curvature - modes.curvature(xi)) / scale).max() < 1e-5


def test_no_mode_is_missing_up_to_40():
    """A count by Wittrick and Williams, which knows nothing of the frequency equation."""
    omega = Modes(ARM, *TIP, 40).omega
    between = np.sqrt(omega[:-1] * omega[1:])
    assert [_count_below(limit) for limit in between] == list(range(1, 40))
    assert _count_below(0.99 * omega[0]) == 0
    assert _count_below(1.001 * omega[-1]) == 40


def _count_below(omega, elements=200):
    """
    Return the number of modes below omega: negative eigenvalues of the dynamic stiffness.

    Elements are so short (10 mm) that none of them has a mode of its own, clamped at both ends,
    below the highest frequency of the test, 14 kHz; the first is above 1 MHz / 10.
    """
    length = ARM.length / elements
    element = _dynamic_stiffness(omega, length)
    size = 2 * (elements + 1)
    matrix = np.zeros((size, size))
    for e in range(elements):
        matrix[2 * e:2 * e + 4, 2 * e:2 * e + 4] += element
    matrix[-2, -2] -= TIP[0] * omega**2
    matrix[-1, -1] -= TIP[1] * omega**2
    return int(np.count_nonzero(np.linalg.eigvalsh(matrix[2:, 2:]) < 0))


def _dynamic_stiffness(omega, length):
    # Exact for (1), (2): the first-order system y' = A y for (w, phi, moment, force), whose
    # transition matrix is turned into end forces for end displacements.
    from scipy.linalg import expm
    system = np.array([
        [0, 1, 0, 1 / ARM.shear_stiffness],
        [0, 0, 1 / ARM.bending_stiffness, 0],
        [0, -ARM.inertia_per_length * omega**2, 0, -1],
        [-ARM.mass_per_length * omega**2, 0, 0, 0]])
    transition = expm(system * length)
    (a, b), (c, d) = [[transition[i:i + 2, j:j + 2] for j in (0, 2)] for i in (0, 2)]
    inverse = np.linalg.inv(b)
    swap = np.array([[0, 1], [1, 0]])  # (moment, force) to (force, moment)
    stiffness = np.block([[swap @ inverse @ a, -swap @ inverse],
                          [swap @ (c - d @ inverse @ a), swap @ d @ inverse]])
    return 0.5 * (stiffness + stiffness.T)


@pytest.mark.parametrize('tip', [(0.0, 0.0), (2.0, 0.5), (200.0, 0.0), (0.0, 50.0)])
def test_galerkin_agrees_with_the_frequency_equation(tip):
    omega = Modes(ARM, *tip, 10).omega
    # 1/omega^2 is exact to round-off of the first mode's: eps (omega_n / omega_1)^2, times ten.
    tolerance = 10 * np.finfo(float).eps * (omega / omega[0])**2 + 1e-12
    assert np.all(np.abs(frequencies(ARM, *tip, 40)[:10] / omega - 1) < tolerance)


def test_cantilever_without_tip_body_is_that_of_the_textbook():
    slender = Beam(2.0, 0.02, 0.002, 2710.0, 70.5e9, 27e9, 0.85)
    omega = Modes(slender, 0.0, 0.0, 4).omega
    scale = np.sqrt(slender.bending_stiffness / slender.mass_per_length) / slender.length**2
    # Roots of cos x cosh x = -1; shear and rotary inertia lower mode n by about (n pi r / l)^2.
    expected = np.array([1.875104069, 4.694091133, 7.854757438, 10.99554073])**2 * scale
    assert np.all(omega < expected)
    assert omega == pytest.approx(expected, rel=2e-4)


def test_a_thick_arm_has_only_so_many_modes_of_the_first_spectrum():
    thick = Beam(0.08, 0.02, 0.02, 2710.0, 70.5e9, 27e9, 0.85)
    assert len(Modes(thick, 0.05, 1e-5, 7)) == 7
    with pytest.raises(ValueError, match='has 7 modes below its cut-off.*8 were asked for'):
        Modes(thick, 0.05, 1e-5, 8)
