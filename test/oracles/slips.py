# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The slips in the text of the source paper, each with a check that confirms its correction."""

import numpy as np
from numpy.polynomial import Legendre

from oracles.references import ROOT
import timo_sim
from timo_sim.model.bodies import Beam, Manipulator, Section
from timo_sim.model.modes import UniformModes

SECTION = Section(0.02, 0.02, 2710.0, 70.5e9, 27e9, 0.85)
# A thick arm: 7 modes below its cut-off frequency, 14 between that and three times it.
THICK = {'length': 0.08, 'tip': (0.05, 1e-5)}


def second_frequency_equation(omega, corrected_11, corrected_22):
    """
    Return the left side of the paper's (17) for the thick arm, over the size of its terms.

    Parameters
    ----------
    omega : float
        Above the cut-off frequency [rad/s].
    corrected_11, corrected_22 : bool
        Whether to correct A'_11 and A'_22 of (15).

    Returns
    -------
    float
        0 at an eigenfrequency, of the order of 1 between them.

    """
    length, (m0, j0) = THICK['length'], THICK['tip']
    r2 = SECTION.second_moment / SECTION.area
    zeta = SECTION.young_modulus / (SECTION.shear_correction * SECTION.shear_modulus)
    rho_a = SECTION.mass_per_length
    o2 = np.sqrt(rho_a / SECTION.bending_stiffness) * omega
    root = np.sqrt(((1 - zeta) / 2)**2 * r2**2 * o2**2 + 1)
    alpha = np.sqrt(o2 * ((1 + zeta) / 2 * r2 * o2 + root))
    beta = np.sqrt(o2 * ((1 + zeta) / 2 * r2 * o2 - root))
    nu = zeta * r2 * o2**2
    la, lb = (nu - alpha**2) / alpha, (nu - beta**2) / beta
    sa, ca, sb, cb = (f(k * length) for k in (alpha, beta) for f in (np.sin, np.cos))
    sign, last = 1 if corrected_11 else -1, lb if corrected_22 else la
    a11 = [-m0 / rho_a * nu * sa, (alpha + la) * ca, m0 / rho_a * la / lb * nu * sb,
           -la * (beta / lb + sign) * cb]
    a12 = [-m0 / rho_a * nu * ca, -(alpha + la) * sa, m0 / rho_a * nu * cb, (beta + lb) * sb]
    a21 = [la * alpha * sa, j0 / rho_a * la * o2**2 * ca, -la * beta * sb,
           -j0 / rho_a * la * o2**2 * cb]
    a22 = [la * alpha * ca, -j0 / rho_a * la * o2**2 * sa, -lb * beta * cb,
           j0 / rho_a * last * o2**2 * sb]
    size = np.sum(np.abs(a11)) * np.sum(np.abs(a22)) + np.sum(np.abs(a12)) * np.sum(np.abs(a21))
    return (sum(a11) * sum(a22) - sum(a12) * sum(a21)) / size


def thick_frequencies():
    """Return the frequencies of the thick arm above its cut-off and below three times it."""
    body = Manipulator(Beam(THICK['length'], SECTION), 5.0, 5.0, 2.0, *THICK['tip'])
    return UniformModes(body, 21).omega[7:]


def _largest(corrected_11, corrected_22):
    return max(abs(second_frequency_equation(omega, corrected_11, corrected_22))
               for omega in thick_frequencies())


def force_balance():
    """
    Return the residual of (32) in the paper's scene, as printed and as corrected [N].

    The reactions are integrals of (26), (27) over the arm, with the accelerations of a `newton`
    run; with them the forces on the carrier must balance its inertia.
    """
    scene = timo_sim.load_scene(ROOT / 'config' / 'paper.yaml', {
        'model.formulation': 'newton', 'model.modes': 5, 'integrator.step': 0.005})
    run = timo_sim.simulate(scene, 10.0)
    model, half, worst = run.model, run.values.shape[1] // 2, np.zeros(2)
    loads = scene.load.stages(0, len(run.t), scene.step)[:, 0]
    mass, xi, shape = model.point_mass, model.points.xi, model.points.deflection
    for motion, load in zip(run.values, loads):
        acceleration = model.rate(model.state(motion), load)[half:]
        (x, y, turn), bend = acceleration[:3], acceleration[3:]
        theta, speed = motion[2], motion[half + 2]
        cosine, sine = np.cos(theta), np.sin(theta)
        w, w_t, w_tt = motion[3:half] @ shape, motion[half + 3:] @ shape, bend @ shape
        along = -w * turn - 2 * speed * w_t - xi * speed**2 + x * cosine + y * sine
        across = w_tt + xi * turn - w * speed**2 - x * sine + y * cosine
        axial, shear = -mass @ along, -mass @ across
        balance = model.manipulator.base_mass * y - axial * sine - load[1]
        worst = np.maximum(worst, np.abs([balance - shear * sine, balance - shear * cosine]))
    return worst


def operators():
    """
    Return the residuals of a mode in (20), and in (22) with (24), as printed and as corrected.

    Each row of operators, applied to mode 3, is compared with the inertia that it must balance.
    """
    model = timo_sim.load_scene({'model.modes': 3}).build()
    modes, section, xi = model.modes, SECTION, np.linspace(0.0, 2.0, 400)
    w, phi, shear, curvature = (
        Legendre.fit(xi, getattr(modes, field)(xi)[:, 2], 30)
        for field in ('deflection', 'rotation', 'shear', 'curvature'))
    kga, ei, omega2 = section.shear_stiffness, section.bending_stiffness, modes.omega[2]**2
    inertia = -omega2 * section.mass_per_length * w(xi)
    force = kga * shear.deriv()(xi)
    first = [force + 2 * kga * phi.deriv()(xi) - inertia, force - inertia]
    turning = -omega2 * section.inertia_per_length * phi(xi)
    bending = ei * curvature.deriv()(xi)
    slope = (phi + shear)(xi)
    second = [bending + kga * (slope - phi.deriv()(xi)) - turning,
              bending + kga * (slope - phi(xi)) - turning]
    return ([np.abs(row).max() / np.abs(inertia).max() for row in first],
            [np.abs(row).max() / np.abs(bending).max() for row in second])


def _round_off(value):
    """Return a number as text, without the digits of round-off, which machines differ in."""
    return f'{value:.0e}' if value > 1e-10 else '< 1e-10'


def rows():
    """Return the rows: equation, printed, corrected, check, and its result for either."""
    printed_32, corrected_32 = force_balance()
    (printed_20, corrected_20), (printed_22, corrected_22) = operators()
    first = timo_sim.load_scene({'model.modes': 1}).build().modes.omega[0] / (2 * np.pi)
    check_17 = 'largest left side of (17), over its terms, at the 14 frequencies of a thick arm'
    best = _round_off(_largest(True, True))
    return [
        ['(32)', 'V(0,t) sin(theta)', 'V(0,t) cos(theta)',
         "what is left of the carrier's balance of forces, N",
         f'{printed_32:.3g}', _round_off(corrected_32)],
        ["(15), A'_11", "-lambda_1' (beta'/lambda_2' - 1) cos(beta' l)",
         "-lambda_1' (beta'/lambda_2' + 1) cos(beta' l)", check_17,
         f'{_largest(False, True):.2g}', best],
        ["(15), A'_22", "lambda_1' in the last term", "lambda_2'", check_17,
         f'{_largest(True, False):.2g}', best],
        ['Table 1', 'density in kg/m2', 'kg/m3', 'first frequency of Table 2, 1.7869 Hz',
         'no frequency', f'{first:.4f} Hz'],
        ['(20), first row', '+ d/dxi (kappa G A phi)', '- d/dxi (kappa G A phi), as in (1)',
         'residual of mode 3 over its inertia force', f'{printed_20:.2g}',
         _round_off(corrected_20)],
        ['(22), (24), second row', "d/dxi (E I Phi' - kappa G A Phi)",
         "d/dxi (E I Phi') - kappa G A Phi, as in (2)", 'residual of mode 3 over its bending term',
         f'{printed_22:.2g}', _round_off(corrected_22)],
    ]
