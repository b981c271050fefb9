# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Modes of the clamped arm against the paper's table, identities and independent counts."""

import numpy as np
from numpy.polynomial import legendre
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh, expm
from scipy.optimize import brentq

from oracles.slips import THICK
from timo_sim.model.bodies import Beam, Manipulator, Quadrature, Section
from timo_sim.model.modes import GalerkinModes, modes_of, UniformModes

ARM = Section(0.02, 0.02, 2710.0, 70.5e9, 27e9, 0.85)
CUTOFF = np.sqrt(ARM.shear_stiffness / ARM.inertia_per_length)  # of the second spectrum [rad/s]
LENGTH, TIP = 2.0, (2.0, 0.5)


def arm(length=LENGTH, tip=TIP, section=ARM, positions=()):
    """Return a manipulator with this arm."""
    return Manipulator(Beam(length, section, positions), 5.0, 5.0, 2.0, *tip)


# [Hz]; the first five are the paper's Table 2 with two more digits.
TABLE = [1.786895, 9.073846, 29.810778, 74.990179, 143.887216, 235.702179, 350.158771, 486.992845]
PAPER_TABLE_2 = [1.7869, 9.0738, 29.8108, 74.9902, 143.8872]


def test_frequencies_are_those_of_the_table():
    hertz = modes_of(arm(), 8).omega / (2 * np.pi)
    assert np.abs(hertz - TABLE).max() < 1e-6  # the table's last digit
    assert np.round(hertz[:5], 4).tolist() == PAPER_TABLE_2
    assert CUTOFF / (2 * np.pi) == pytest.approx(80220.9, abs=0.05)


def test_fields_are_derivatives_of_each_other():
    modes = modes_of(arm(), 6)
    xi, h = np.linspace(0.1, 1.9, 7), 1e-4
    slope = (modes.deflection(xi + h) - modes.deflection(xi - h)) / (2 * h)
    curvature = (modes.rotation(xi + h) - modes.rotation(xi - h)) / (2 * h)
    # Central differences: relative error (k h)^2 / 6 of the shortest wave, k = 9 rad/m.
    scale = np.abs(modes.rotation(xi)).max(axis=0)
    assert (np.abs(slope - modes.rotation(xi) - modes.shear(xi)) / scale).max() < 1e-6
    assert (np.abs(curvature - modes.curvature(xi)) / scale).max() < 1e-5


def test_no_mode_is_missing_up_to_40():
    """The count by Wittrick and Williams is independent of the frequency equation."""
    omega = modes_of(arm(), 40).omega
    between = np.sqrt(omega[:-1] * omega[1:])
    assert [_count_below(limit) for limit in between] == list(range(1, 40))
    assert _count_below(0.99 * omega[0]) == 0
    assert _count_below(1.001 * omega[-1]) == 40


def _count_below(omega, elements=100):
    """
    Return the number of modes below omega: negative eigenvalues of the dynamic stiffness.

    The elements of 20 mm are so short that the first mode of one clamped at both ends, 70 kHz, is
    above the highest frequency of the test, 14 kHz.
    """
    length = LENGTH / elements
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
    count = 40
    closed, galerkin = UniformModes(arm(tip=tip), count), GalerkinModes(arm(tip=tip), count)
    # Singular values are exact to round-off of the largest: eps omega_n / omega_1, times five.
    tolerance = 5 * np.finfo(float).eps * closed.omega / closed.omega[0] + 1e-12
    assert np.all(np.abs(galerkin.omega / closed.omega - 1) < tolerance)
    assert tolerance.max() < 1e-10
    xi = np.linspace(0.0, LENGTH, 101)
    for field in ('deflection', 'rotation', 'curvature', 'shear'):
        one, other = getattr(closed, field)(xi), getattr(galerkin, field)(xi)
        assert (np.abs(one - other) / np.abs(one).max(axis=0)).max() < 1e-9


@pytest.mark.parametrize('tip', [(0.0, 0.0), (2e-3, 1e-3), (2e3, 0.0), (0.0, 1e4), (2e3, 1e4)])
def test_no_mode_is_missed(tip):
    """Tips have a thousandth to a thousand times the arm's mass; arms are slender and thick."""
    for height, count in ((0.002, 2), (0.02, 4), (0.6, 9), (0.002, 41), (0.6, 41)):
        body = arm(tip=tip, section=Section(0.02, height, 2710.0, 70.5e9, 27e9, 0.85))
        exact = GalerkinModes(body, count).omega
        assert modes_of(body, count).omega == pytest.approx(exact, rel=1e-8), (height, count)


def test_cantilever_without_tip_body_is_that_of_the_textbook():
    slender = Section(0.02, 0.002, 2710.0, 70.5e9, 27e9, 0.85)
    omega = modes_of(arm(tip=(0.0, 0.0), section=slender), 4).omega
    scale = np.sqrt(slender.bending_stiffness / slender.mass_per_length) / LENGTH**2
    # Roots of cos x cosh x = -1; shear and rotary inertia lower mode n by about (n pi r / l)^2.
    expected = np.array([1.875104069, 4.694091133, 7.854757438, 10.99554073])**2 * scale
    assert np.all(omega < expected)
    assert omega == pytest.approx(expected, rel=2e-4)


# Frequencies divided by the cut-off frequency, from an independent derivation.
SECOND_SPECTRUM = [1.092444, 1.237599, 1.320646, 1.479275, 1.606153, 1.724787]


def displacement_galerkin(length, tip, section, terms):
    """
    Return eigenfrequencies by expanding W and Phi themselves in xi times Legendre polynomials.

    Source: weak form of the paper's (1), (2): strain energy EI Phi'^2 + kappa G A (W' - Phi)^2.
    """
    x, weights = legendre.leggauss(terms + 8)
    xi, weights = 0.5 * length * (x + 1), 0.5 * length * weights
    polynomial = legendre.legvander(np.append(x, 1.0), terms - 1)
    slope = np.stack([legendre.legval(x, legendre.legder(row)) for row in np.eye(terms)],
                     axis=1) * 2 / length
    field = np.append(xi, length)[:, np.newaxis] / length * polynomial
    derivative = polynomial[:-1] / length + xi[:, np.newaxis] / length * slope
    none = np.zeros_like(field)
    w, phi = np.hstack([field, none]), np.hstack([none, field])
    shear = np.hstack([derivative, -field[:-1]])
    bend = np.hstack([none[:-1], derivative])

    def product(a, b):
        return a.T @ (b[:, np.newaxis] * a)
    stiffness = (product(shear, weights * section.shear_stiffness)
                 + product(bend, weights * section.bending_stiffness))
    mass = (product(w, np.append(weights * section.mass_per_length, tip[0]))
            + product(phi, np.append(weights * section.inertia_per_length, tip[1])))
    return np.sqrt(eigh(stiffness, mass, eigvals_only=True))


def test_second_spectrum_of_a_thick_arm():
    """7 modes are below the cut-off and 14 more below three times it; none is missed or double."""
    expected = displacement_galerkin(section=ARM, terms=40, **THICK)
    expected = expected[expected < 3.0 * CUTOFF]
    assert len(expected) == 21
    assert np.count_nonzero(expected < CUTOFF) == 7
    omega = modes_of(arm(**THICK), 21).omega
    assert np.abs(omega / expected - 1).max() < 1e-8
    assert (omega / CUTOFF)[7:13] == pytest.approx(SECOND_SPECTRUM, abs=5e-7)


def tapered(height=0.02, ratio=0.5, **tip):
    """Return an arm whose height falls linearly to `ratio` of that at the root."""
    section = Section(0.02, (height, ratio * height), 2710.0, 70.5e9, 27e9, 0.85)
    return arm(section=section, positions=(0.0, LENGTH), **tip)


def test_tapered_cantilever_is_that_of_the_literature():
    """Downs 1977, Banerjee and Williams 1985: Euler-Bernoulli, height halved linearly."""
    omega = modes_of(tapered(height=0.002, tip=(0.0, 0.0)), 3).omega
    root = Section(0.02, 0.002, 2710.0, 70.5e9, 27e9, 0.85)
    scale = np.sqrt(root.bending_stiffness / root.mass_per_length) / LENGTH**2
    # Shear and rotary inertia lower them by 1e-6 times the square of the wave number.
    assert omega / scale == pytest.approx([3.82378, 18.3173, 47.2648], rel=3e-5)


@pytest.mark.parametrize('jump', [False, True])
def test_varying_section_against_shooting(jump):
    """(1), (2) as first-order equations, integrated from the root by DOP853."""
    if jump:
        body = arm(section=Section(0.02, (0.03, 0.02, 0.01, 0.01), 2710.0, (
            70.5e9, 70.5e9, 10e9, 12e9), 27e9, 0.85), positions=(0.0, 0.7, 0.7, LENGTH))
    else:
        body = tapered()
    beam = body.arm

    def determinant(omega):
        y = np.concatenate([np.zeros((2, 2)), np.eye(2)]).ravel()  # by moment, by force
        for low, high in zip(beam.breaks, beam.breaks[1:]):
            def rate(xi, y):
                section = beam.at(np.clip(xi, low + 1e-12, high - 1e-12))
                w, phi, moment, force = y.reshape(4, 2)
                return np.concatenate([phi + force / section.shear_stiffness,
                                       moment / section.bending_stiffness,
                                       -section.inertia_per_length * omega**2 * phi - force,
                                       -section.mass_per_length * omega**2 * w])
            y = solve_ivp(rate, (low, high), y, 'DOP853', rtol=1e-12, atol=1e-15).y[:, -1]
        w, phi, moment, force = y.reshape(4, 2)
        return np.linalg.det([force - body.end_effector_mass * omega**2 * w,
                              moment - body.end_effector_inertia * omega**2 * phi])

    omega = modes_of(body, 4).omega
    for n in range(4):
        found = brentq(determinant, 0.99 * omega[n], 1.01 * omega[n], xtol=1e-14, rtol=1e-11)
        # DOP853 at 1e-12, magnified by the cancellation in the determinant.
        assert omega[n] == pytest.approx(found, rel=1e-9)


def test_an_arm_described_in_pieces_is_the_uniform_arm():
    pieces = Section(0.02, (0.02, 0.02, 0.02), 2710.0, 70.5e9, 27e9, 0.85)
    split = modes_of(arm(section=pieces, positions=(0.0, 0.31, LENGTH)), 8)
    whole = modes_of(arm(), 8)
    assert isinstance(whole, UniformModes) and isinstance(split, GalerkinModes)
    assert np.abs(split.omega / whole.omega - 1).max() < 1e-10


@pytest.mark.parametrize('body, count, static', [
    (arm(), 42, ()), (tapered(), 8, ()), (arm(), 3, ('force', 'torque')),
    (arm(tip=(0.0, 0.0)), 42, ('force', 'torque')), (tapered(height=0.005), 1, ('torque',)),
    (tapered(height=0.005), 12, ('force',))],
    ids=['uniform', 'tapered', 'heavy tip, static', 'no tip, static', 'tapered, static 1',
         'tapered, static 12'])
def test_modes_are_orthonormal_with_the_right_root_reactions_or_static_shapes(
        body, count, static):
    modes, count = modes_of(body, count, static), count + len(static)
    rule = Quadrature(body.arm.breaks, 200)
    mass, inertia = body.inertia(rule)
    w, phi = modes.deflection(rule.points), modes.rotation(rule.points)
    gram = (w.T * mass) @ w + (phi.T * inertia) @ phi
    section, nodes = body.arm.at(rule.nodes), rule.nodes
    bend, shear = modes.curvature(nodes), modes.shear(nodes)
    strain = ((bend.T * (rule.weights * section.bending_stiffness)) @ bend
              + (shear.T * (rule.weights * section.shear_stiffness)) @ shear)
    scaled = strain / np.outer(modes.omega, modes.omega)
    # Measured: 2e-10 for 40 modes with static shapes (2e-9 with SciPy 1.11), 1e-13 for few.
    assert np.abs(gram - np.eye(count)).max() < (5e-9 if static else 1e-12)
    assert np.abs(scaled - np.eye(count)).max() < 5e-9
    assert np.all(np.diff(modes.omega) > 0.0)
    if not static:  # the reactions at the root are the inertia forces
        root = body.arm.at(np.zeros(1))
        shear = root.shear_stiffness * modes.shear(np.zeros(1))[0]
        bending = root.bending_stiffness * modes.curvature(np.zeros(1))[0]
        assert shear == pytest.approx(modes.omega**2 * (mass @ w), rel=1e-8)
        moment = (mass * rule.points) @ w + inertia @ phi
        assert bending == pytest.approx(modes.omega**2 * moment, rel=1e-8)
    # Under a unit load the modal series must give the static moment, force times lever or torque.
    length = body.arm.length
    for load, moment in (('force', length - nodes), ('torque', np.ones_like(nodes))):
        if load in static:
            work = (w if load == 'force' else phi)[-1] / modes.omega**2
            found = section.bending_stiffness * (bend @ work)
            assert found == pytest.approx(moment, abs=1e-6 * length)
