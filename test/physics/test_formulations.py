# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The formulations against finite elements, rigid bodies, conservation laws, the elastica."""

import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from oracles import elastica
from oracles.references import STATIONS
import timo_sim
from timo_sim.model import FORMULATIONS

ARM_LENGTH = 2.0
# Formulations that account for every force on carrier and shaft, whatever the number of modes.
ALL_FORCES = ['exact', 'newton']
MANY_MODES = [('exact', 12), ('newton', 40)]  # 40 of `exact` take long to compile


# Largest errors of carrier x, y and shaft angle, of deflections and rotations of four sections.
@pytest.mark.parametrize('formulation, modes, step, limits', [
    ('exact', 3, 0.010, (6e-5, 6e-5, 5e-5, 1.0e-4, 9e-5)),
    ('exact', 5, 0.005, (2e-5, 2e-5, 2e-6, 4.0e-6, 2e-5)),
    # The paper's equations: their own error is 0.3 mm of carrier motion, more than the modes'.
    ('newton', 3, 0.005, (3.5e-4, 4.2e-4, 1.9e-4, 1.4e-4, 1.3e-4)),
])
def test_paper_scene_against_finite_elements(paper, reference, formulation, modes, step, limits):
    scene = timo_sim.load_scene(paper, {
        'model.formulation': formulation, 'model.modes': modes, 'integrator.step': step})
    run = timo_sim.simulate(scene, 10.0, sample_every=round(0.01 / step), estimate=False)
    assert np.allclose(run.t, reference['t'], atol=1e-12)
    errors = [run.carrier[:, 0] - reference['x_c_m'], run.carrier[:, 1] - reference['y_c_m'],
              run.shaft - reference['theta_rad']]
    sections = [(share * ARM_LENGTH, name) for name, share in STATIONS.items() if share]
    errors.append([run.deflection(xi)[:, 1] - reference[f'w_{name}_m'] for xi, name in sections])
    errors.append([run.rotation(xi) - reference[f'phi_{name}_rad'] for xi, name in sections])
    assert np.all([np.abs(each).max() for each in errors] < np.array(limits))


@pytest.mark.parametrize('formulation', ALL_FORCES)
@pytest.mark.parametrize('modes', [8, 40])
def test_free_free_frequencies_of_the_whole_system(formulation, modes):
    """The linear part alone gives the natural frequencies of the free manipulator [Hz]."""
    model = timo_sim.load_scene({'model.modes': modes, 'model.formulation': formulation}).build()
    omega = np.sort(np.abs(np.linalg.eigvals(model.linear).imag))[-2 * modes:]
    hertz = omega[::2] / (2 * np.pi)
    assert hertz[:5] == pytest.approx([4.2671, 9.960, 30.59, 75.63, 144.46], rel=2e-4)


def vibrating(formulation, **overrides):
    """Return a scene that starts with w_t = 1.5 z^2 - 0.5 z^3 m/s, z = xi/l, phi_t its slope."""
    values = {'model.formulation': formulation, 'model.modes': 3, **overrides}
    rates = timo_sim.project_on_modes(
        timo_sim.load_scene({}, values),
        lambda xi: 1.5 * (xi / ARM_LENGTH)**2 - 0.5 * (xi / ARM_LENGTH)**3,
        lambda xi: (3.0 * (xi / ARM_LENGTH) - 1.5 * (xi / ARM_LENGTH)**2) / ARM_LENGTH)
    return timo_sim.load_scene({}, values).vary({'initial.modal_rates': rates})


@pytest.mark.parametrize('picked_up', [False, True])
@pytest.mark.parametrize('values', [
    {}, {'model.modes': 0}, {'model.axial_modes': 2}, {'carrier.held': 'x'},
    {'carrier.held': 'x', 'model.axial_modes': 1}, {'carrier.held': 'both'},
    {'model.formulation': 'newton', 'motor.shaft': 'locked'}])
def test_energy_is_that_of_masses_and_strain(values, picked_up):
    """Kinetic energy by the mass matrix, gravity's by the places of the masses, both in NumPy."""
    scene = timo_sim.load_scene({}, {'model.modes': 3, 'gravity': [1.5, -9.81], **values})
    model = scene.build((3.0, 0.15)) if picked_up else scene.build()
    motions = np.random.default_rng(7).normal(scale=0.3, size=(20, model.size))
    half, body, found = model.size // 2, model.manipulator, []
    for motion in motions:
        rates, strained = motion[half:], motion[3:half]**2 @ model.modes.omega**2
        moment = body.base_mass * motion[:2] + model.point_mass @ model.world(
            motion[np.newaxis], model.points)[0]
        found.append(0.5 * (rates @ model.mass_matrix(motion)[0] @ rates + strained)
                     - model.gravity @ moment)
    wide = np.repeat(motions, 2, axis=1)[:, ::2]  # not in C order
    np.testing.assert_allclose(model.energy(wide), found, rtol=1e-11)
    assert model.energy(motions[:0]).shape == (0,)


@pytest.mark.parametrize('held', ['none', 'both'])
def test_a_state_has_the_momenta_that_the_mass_matrix_gives(held):
    """Of a free manipulator P, its spin about the mass centre, and that centre."""
    model = timo_sim.load_scene({}, {'carrier.held': held, 'hub.radius': 0.1}).build()
    motion = np.random.default_rng(3).normal(scale=0.4, size=model.size)
    state, half = model.state(motion), model.size // 2
    motion[half:half + 2] *= held == 'none'
    momenta = model.mass_matrix(motion)[0] @ motion[half:]
    if held == 'both':
        assert state[len(state) // 2:] == pytest.approx(momenta[2:], rel=1e-12)
        return
    mass, points = model.point_mass, model.world(motion[np.newaxis], model.points)[0]
    centre = (model.manipulator.base_mass * motion[:2] + mass @ points) / model.mass
    x, y = centre - motion[:2]
    spin = momenta[2] - (x * momenta[1] - y * momenta[0])
    assert state[:2] == pytest.approx(centre, rel=1e-12)
    assert state[half:half + 3] == pytest.approx([*momenta[:2], spin], rel=1e-12)


@pytest.mark.parametrize('values', [
    {'model.modes': 0}, {'model.modes': 12}, {'arm.shear_modulus': 1e6},
    {'model.modes': 5, 'arm.profile.position': [0.0, 1.2, 1.2, 2.0],
     'arm.profile.height': [0.03, 0.02, 0.015, 0.01]}], ids=str)
def test_exact_conserves_energy_and_momentum(values):
    scene = vibrating('exact', **{
        'initial.carrier_x_velocity': 0.4, 'initial.carrier_y_velocity': -0.3,
        'initial.shaft_velocity': 1.5, **values})
    run = timo_sim.simulate(scene, 5.0, estimate=False)
    energy, momentum = run.energy(), run.momentum()
    assert np.abs(energy / energy[0] - 1).max() < 1e-8
    # P and spin are constant by construction; computing momenta from a motion adds round-off.
    assert np.abs(momentum / momentum[0] - 1).max() < 1e-11


def test_newton_conserves_linear_momentum_only():
    """Its equation (29) lacks the moment of axial inertia forces: angular momentum drifts."""
    run = timo_sim.simulate(vibrating('newton'), 5.0, estimate=False)
    momentum = run.momentum()
    # Kept to the error of the step, not by construction: 1e-9 at 1 ms.
    assert np.abs(momentum[:, :2] - momentum[0, :2]).max() < 5e-9
    assert np.abs(momentum[:, 2] - momentum[0, 2]).max() > 1e-6


@pytest.mark.parametrize('formulation', ALL_FORCES)
def test_rigid_arm_is_a_rigid_body(formulation):
    """Compare with Euler's equations of a body pushed off its mass centre, solved by SciPy."""
    scene = timo_sim.load_scene({
        'model.modes': 0, 'model.formulation': formulation, 'integrator.step': 0.001,
        'initial.shaft_velocity': 2.0, 'load.force_x.harmonic.amplitude': [7.0],
        'load.force_x.harmonic.frequency': [1.0], 'load.torque.harmonic.amplitude': [3.0],
        'load.torque.harmonic.frequency': [2.0]})
    run = timo_sim.simulate(scene, 2.0, estimate=False)
    body, section = scene.manipulator, scene.manipulator.arm.section
    rho_a = section.mass_per_length
    mass = body.base_mass + rho_a * 2.0 + body.end_effector_mass
    lever = rho_a * 2.0**2 / 2 + body.end_effector_mass * 2.0
    inertia = (body.shaft_inertia + section.inertia_per_length * 2.0 + body.end_effector_inertia
               + rho_a * 2.0**3 / 3 + body.end_effector_mass * 2.0**2 - lever**2 / mass)

    def rate(t, y):
        force, torque = 7.0 * np.sin(2 * np.pi * t), 3.0 * np.sin(4 * np.pi * t)
        spin = (torque + force * np.sin(y[2]) * lever / mass) / inertia
        return [y[3], y[4], y[5], force / mass, 0.0, spin]

    theta, omega = np.pi / 4, 2.0
    centre = lever / mass * np.array([np.cos(theta), np.sin(theta)])
    centre_rate = omega * lever / mass * np.array([-np.sin(theta), np.cos(theta)])
    truth = solve_ivp(rate, (0, 2.0), [*centre, theta, *centre_rate, omega], rtol=1e-12,
                      atol=1e-13, t_eval=run.t).y
    carrier = truth[:2] - lever / mass * np.array([np.cos(truth[2]), np.sin(truth[2])])
    # ETDRK4 at 1 ms under 2 Hz loads: (2 pi f h)^4 / 2880 of the motion, below 1e-10.
    assert np.abs(run.carrier - carrier.T).max() < 1e-10
    assert np.abs(run.shaft - truth[2]).max() < 1e-10


@pytest.mark.parametrize('formulation, modes', MANY_MODES)
def test_many_modes_agree_with_finite_elements(formulation, modes, paper, reference):
    scene = timo_sim.load_scene(paper, {'model.modes': modes, 'model.formulation': formulation,
                                        'integrator.step': 0.005})
    run = timo_sim.simulate(scene, 2.0, sample_every=2, estimate=False)
    limit = 2e-6 if formulation == 'exact' else 2e-4
    error = np.abs(run.deflection(ARM_LENGTH)[:, 1] - reference['w_l_m'][:201])
    assert error.max() < limit


@pytest.mark.parametrize('formulation', ALL_FORCES)
def test_constant_force_gives_momentum_force_times_time(formulation):
    scene = timo_sim.load_scene({
        'model.formulation': formulation, 'load.force_x.piecewise.time': [0.0],
        'load.force_x.piecewise.value': [4.0], 'load.force_y.piecewise.time': [0.5],
        'load.force_y.piecewise.value': [-2.0]})
    run = timo_sim.simulate(scene, 2.0, estimate=False)
    momentum = run.momentum()
    limit = 1e-11 if formulation == 'exact' else 1e-7  # by construction, or to the step's error
    assert np.abs(momentum[:, 0] - 4.0 * run.t).max() < limit
    assert np.abs(momentum[:, 1] + 2.0 * np.maximum(run.t - 0.5, 0.0)).max() < limit


def test_damping_takes_energy_at_the_modal_rate():
    """A heavy base leaves the arm clamped: its first mode decays with exp(-2 zeta omega t)."""
    scene = timo_sim.load_scene({}, {
        'arm.damping_ratio': [0.02], 'carrier.mass': 1e9, 'motor.shaft_inertia': 1e9,
        'initial.modal_rates': [1e-3, 0.0, 0.0]})
    run = timo_sim.simulate(scene, 4.0, estimate=False)
    omega, zeta = scene.build().modes.omega[0], 0.02
    damped = omega * np.sqrt(1 - zeta**2)
    expected = 1e-3 * np.exp(-zeta * omega * run.t) * np.sin(damped * run.t) / damped
    # The base gives way by 14 kg m2 / 1e9 kg m2, over 45 rad of decaying vibration.
    assert np.abs(run.q[:, 0] - expected).max() < 2e-7 * np.abs(expected).max()


def test_a_rotating_arm_stiffens_under_its_centrifugal_force():
    """Against the closed form of a tip mass on a massless arm under the tension m l Omega^2."""
    length, tip, speed = 2.0, 2.0, 5.0
    scene = timo_sim.load_scene({}, {
        'arm.density': 1.0, 'arm.section.height': 0.005, 'carrier.mass': 1e8,
        'motor.shaft_inertia': 1e8,
        'end_effector.mass': tip, 'end_effector.inertia': 0.0, 'model.modes': 5,
        'initial.shaft_velocity': speed, 'initial.modal_rates': [1e-4] + [0.0] * 4,
        # The light arm under tension is a string: the phase of mode 5 grows by 0.4 rad in a step.
        'integrator.step': 5e-5})
    run = timo_sim.simulate(scene, 10.0, estimate=False)
    across = run.deflection(length)[:, 1]
    crossings = run.t[1:][(across[:-1] < 0) & (across[1:] >= 0)]
    measured = 2 * np.pi * (len(crossings) - 1) / (crossings[-1] - crossings[0])

    # EI w'''' = T w'': tip stiffness T k / (k l - tanh k l), k^2 = T / EI; in the plane of the
    # spin it is lower by m Omega^2.
    bending = scene.manipulator.arm.section.bending_stiffness
    tension = tip * length * speed**2
    k = np.sqrt(tension / bending)
    stiffness = tension * k / (k * length - np.tanh(k * length))
    expected = np.sqrt(stiffness / tip - speed**2)
    # Five modes bend the string 4e-4 too stiffly, eight 3e-5; a quarter of the arm's mass counts,
    # which is 1e-4 of the tip's.
    assert measured == pytest.approx(expected, rel=5e-4)
    assert expected > 1.05 * np.sqrt(3 * bending / length**3 / tip)


@pytest.mark.parametrize('modes, step, limit', [(12, 0.010, 1e-4), (3, 0.001, 1e-8)])
def test_fast_spin_with_large_vibration_stays_bounded(modes, step, limit):
    """At 30 rad/s and 0.13 m at the tip; classical Runge-Kutta diverges with N = 5 at 5 ms."""
    start = vibrating('exact', **{'model.modes': modes})
    scene = timo_sim.load_scene(start.values, {
        'integrator.step': step, 'initial.shaft_velocity': 30.0,
        'initial.modal_rates': [5.0 * rate for rate in start.values['initial.modal_rates']]})
    run = timo_sim.simulate(scene, 5.0, estimate=False)
    energy = run.energy()
    assert np.abs(run.deflection(ARM_LENGTH)[:, 1]).max() == pytest.approx(0.13, abs=0.01)
    assert np.abs(energy / energy[0] - 1).max() < limit


# `axial`: force along the arm over Euler's load of the clamped arm; `across`: force across it [N].
@pytest.mark.parametrize('name, axial, across, silent', [
    ('newton', 0.0, 10.0, True), ('newton', -0.02, 10.0, True), ('newton', -0.3, 10.0, False),
    ('newton', 0.3, 10.0, False), ('newton', -1.55, 0.0, False), ('newton', -0.95, 1.0, False),
    ('newton', 0.0, 120.0, False)])
def test_newton_warns_where_axial_force_and_deflection_matter(name, axial, across, silent):
    """There is no warning where `exact` agrees to a thousandth of the arm's length, only there."""
    base = {'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.shaft': 0.0,
            'arm.damping_ratio': [0.7]}
    arm = timo_sim.load_scene({}, base).manipulator.arm
    euler = np.pi**2 * arm.section.bending_stiffness / (4.0 * arm.length**2)
    forces = {f'load.tip_force_{axis}.piecewise': {'time': [0.0], 'value': [force]}
              for axis, force in (('x', axial * euler), ('y', across))}
    runs = []
    for formulation in (name, 'exact'):
        scene = timo_sim.load_scene({}, {**base, 'model.formulation': formulation, **forces})
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter('always')
            runs.append(timo_sim.simulate(scene, 4.0, estimate=False))
        expected = silent or formulation == 'exact'
        assert len(told) == (not expected) and (expected or 'axial force' in str(told[0].message))
    newton, exact = (run.deflection(arm.length)[-1, 1] for run in runs)
    if across:  # without this force a compressed arm stays straight
        assert (abs(newton - exact) < 1e-3 * arm.length) == silent


@pytest.mark.parametrize('name', FORMULATIONS)
@pytest.mark.parametrize('modes', [0, 3, 5])
def test_tip_is_the_end_of_the_centre_line(name, modes):
    formulation = timo_sim.load_scene(
        {'model.formulation': name, 'model.modes': modes}).build()
    motion = np.random.default_rng(modes).normal(scale=0.3, size=formulation.size)
    end, q = formulation.at([2.0]), motion[np.newaxis, 3:3 + modes]
    along, across, rotation = formulation.tip(motion)
    # Both sum the same few terms in another order.
    assert (along, across) == pytest.approx(formulation.centre_line(q, end)[0, 0], abs=1e-14)
    assert rotation == pytest.approx(formulation.section_rotation(q, end)[0, 0], abs=1e-14)


def test_a_load_on_the_tip_does_its_work_and_gives_its_momentum():
    """Constant force and torque on the end effector of an arm that turns and bends far."""
    force, torque = np.array([6.0, -4.0]), 3.0
    scene = timo_sim.load_scene({}, {
        'initial.shaft_velocity': 1.0, 'initial.modal_rates': [4.0, 1.0, 0.0],
        **{f'load.tip_{name}.piecewise.{key}': [value] for name, size in (
            ('force_x', force[0]), ('force_y', force[1]), ('torque', torque))
           for key, value in (('time', 0.0), ('value', size))}})
    run = timo_sim.simulate(scene, 2.0, estimate=False)
    tip = run.position(2.0)
    turn = run.shaft + run.rotation(2.0)
    assert np.abs(run.deflection(2.0)[:, 1]).max() > 0.08
    # The work of a constant load depends on its end points only; measured: 3e-12.
    work = (tip - tip[0]) @ force + torque * (turn - turn[0])
    energy = run.energy()
    assert np.abs(energy - energy[0] - work).max() < 1e-10 * energy.max()
    momentum = run.momentum() - run.momentum()[0]
    # Measured: 2e-12, the round-off of momenta computed from the motion.
    assert np.abs(momentum[:, :2] - np.outer(run.t, force)).max() < 1e-11
    moment = tip[:, 0] * force[1] - tip[:, 1] * force[0] + torque
    # Boole's rule over four steps.
    gained = sum(weight * moment[k:len(moment) - 4 + k:4] for k, weight in enumerate(
        (7.0, 32.0, 12.0, 32.0))) + 7.0 * moment[4::4]
    gained = np.cumsum(gained) * 4.0 * scene.step / 90.0
    assert np.abs(momentum[4::4, 2] - gained).max() < 1e-9


# Deflections far from small: a tip turned by more than 60 degrees, against the elastica.

BENT = 3.2  # P l^2 / (E I)


def test_the_boundary_value_solver_gives_the_closed_form():
    section = timo_sim.load_scene({}, elastica.ARM).manipulator.arm.section
    load = BENT * section.bending_stiffness / elastica.LENGTH**2
    found, closed = elastica.boundary_value(section, load, 0.0), elastica.elastica(BENT)
    # Shear adds EI / (kappa G A l^2) = 1.6e-6 of the deflection.
    assert np.abs(found - closed).max() < 5e-6


@pytest.mark.parametrize('modes, rotation, deflection', [(3, 5e-2, 5e-5), (5, 5e-3, 2e-6)])
def test_exact_agrees_with_the_elastica(modes, rotation, deflection):
    with warnings.catch_warnings():  # a finer run with too long steps for its stretch is far off
        warnings.simplefilter('error', timo_sim.ModelWarning)
        run, truth = elastica.compare(modes, BENT)
    assert np.degrees(truth[0]) > 60.0
    error = np.abs(run - truth)
    assert np.degrees(error[0]) < rotation
    assert elastica.LENGTH * error[1] < deflection
    assert elastica.LENGTH * error[2] < 2.0 * deflection + 2e-6


def test_newton_does_not_agree_with_the_elastica_and_warns():
    with pytest.warns(timo_sim.ModelWarning, match='take model.formulation exact'):
        run, truth = elastica.compare(3, BENT, 'newton')
    assert elastica.LENGTH * np.abs(run - truth)[1] > 0.5
