# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Arms that stretch: closed forms of the rod, conserved quantities, spectral elements."""


import numpy as np
import pytest
from scipy.optimize import brentq

from oracles import references, spectral_elements
import timo_sim
from timo_sim.model.bodies import Quadrature
from timo_sim.model.modes import axial_modes
from timo_sim.simulation.simulator import Simulator

HELD = {'carrier.held': 'both', 'initial.shaft': 0.0}
SPINNING = {'initial.shaft_velocity': 10.0, 'load.tip_force_y.piecewise.time': [0.0, 0.1],
            'load.tip_force_y.piecewise.value': [20.0, 0.0]}
DRIVEN = {'motor.shaft': 'driven', 'motor.drive.time': [0.0, 1.0],
          'motor.drive.angle': [0.0, 5.0], 'motor.drive.speed': [0.0, 10.0],
          'motor.drive.acceleration': [0.0, 0.0]}
TAPERED = {'arm.profile.position': [0.0, 0.8, 0.8, 2.0],
           'arm.profile.height': [0.04, 0.03, 0.02, 0.02]}
CONE = {'arm.profile.position': [0.0, 2.0], 'arm.profile.height': [0.04, 0.02]}


def scene_of(*parts, **values):
    merged = {'model.axial_modes': 1}
    for part in parts:
        merged.update(part)
    return timo_sim.load_scene({}, {**merged, **values})


@pytest.mark.parametrize('count, limit', [(3, 1e-4), (4, 3e-7)])
@pytest.mark.parametrize('mass', [0.0, 2.0, 50.0])
def test_three_and_four_modes_have_the_first_frequency_of_the_rod(mass, count, limit):
    """`beta l tan(beta l) = m_arm / m_e`, or `beta l = pi/2` without an end effector."""
    scene = scene_of(HELD, **{'end_effector.mass': mass})
    section, length = scene.manipulator.arm.section, 2.0
    ratio = section.mass_per_length * length / max(mass, 1e-300)
    root = brentq(lambda x: x * np.sin(x) - ratio * np.cos(x), 1e-9, np.pi / 2) if mass else (
        np.pi / 2)
    omega = root / length * np.sqrt(section.young_modulus / section.density)
    found = axial_modes(scene.manipulator, count, scene.constraints).omega[0]
    assert found == pytest.approx(omega, rel=limit)


@pytest.mark.parametrize('mass', [0.0, 2.0])
def test_one_mode_stretches_as_centrifugal_forces_do(mass):
    """At rest in the turning axes `E A u' = w^2 int M xi`, integrated from xi to the tip."""
    scene = scene_of(HELD, **{'end_effector.mass': mass})
    model, section, length, speed = scene.build(), scene.manipulator.arm.section, 2.0, 10.0
    xi = np.linspace(0.0, length, 9)
    line, stiffness = section.mass_per_length, section.young_modulus * section.area
    strain = speed**2 * (line * (length**2 - xi**2) / 2.0 + mass * length) / stiffness
    shape = model.modes.displacement(model.points.xi)[:, -1]
    load = speed**2 * (model.point_mass * model.points.xi) @ shape
    q = load / model.modes.omega[-1]**2
    assert q * model.modes.stretch(xi)[:, -1] == pytest.approx(strain, rel=1e-9)


def test_a_rod_hangs_on_its_accelerated_root():
    """With the second mode `E A u' = -a int M` is exact for a constant acceleration a."""
    scene = scene_of(TAPERED, **{'model.axial_modes': 2})
    model, arm = scene.build(), scene.manipulator.arm
    nodes = model.points.xi[:-1]
    loads = model.modes.displacement(model.points.xi)[:, -2:].T @ model.point_mass
    strain = model.modes.stretch(nodes)[:, -2:] @ (loads / model.modes.omega[-2:]**2)
    rule = Quadrature(arm.breaks, 20)
    outboard = model.arm_mass - rule.integrate_to(nodes) @ arm.at(rule.nodes).mass_per_length
    section = arm.at(nodes)
    assert strain * section.young_modulus * section.area == pytest.approx(outboard, rel=1e-9)


@pytest.mark.parametrize('values', [{}, CONE], ids=['uniform', 'tapered'])
def test_a_free_arm_that_stretches_conserves_energy_and_momentum(values):
    """The arm is as soft as rubber; spinning makes it some percent longer."""
    scene = scene_of(values, **{
        'arm.young_modulus': 1e8, 'arm.shear_modulus': 4e7, 'initial.shaft_velocity': 6.0,
        'model.modes': 5, 'initial.modal_rates': [0.5, 0.1, 0.0, 0.0, 0.0, 0.3],
        'initial.carrier_x_velocity': 0.4,
        **({'arm.profile.young_modulus': [1e8] * 2} if values else {})})
    run = timo_sim.simulate(scene, 5.0, estimate=False)
    energy, momentum = run.energy(), run.momentum()
    assert np.abs(run.deflection(2.0)[:, 0]).max() > 0.01
    assert np.abs(energy / energy[0] - 1.0).max() < 1e-6
    assert np.abs(momentum / momentum[0] - 1.0).max() < 1e-11


@pytest.mark.parametrize('held', ['both', 'x'])
def test_an_arm_that_only_stretches_vibrates_about_its_centrifugal_stretch(held):
    """It begins unstretched, so its largest stretch is twice that at rest in turning axes."""
    scene = scene_of(**{'carrier.held': held, 'initial.shaft': 0.0, 'model.modes': 0,
                        'initial.shaft_velocity': 3.0, 'integrator.step': 1e-4})
    run = timo_sim.simulate(scene, 0.02, estimate=False)
    model = run.model
    force = 9.0 * (model.point_mass * model.points.xi) @ model.modes.displacement(model.points.xi)
    if held == 'both':  # about the root
        assert run.q.max() == pytest.approx(2.0 * force[0] / model.modes.omega[0]**2, rel=1e-3)
    energy = run.energy()
    assert np.ptp(run.q) > 1e-6 and np.abs(energy / energy[0] - 1.0).max() < 1e-8


# `effect`: least effect of the stretch, `limit`: largest error, in lengths. The errors are those
# of the step, which does not resolve the ringing of an arm that starts unstretched, and of the
# modes in bending; with x held five modes would leave 3e-5.
@pytest.mark.parametrize('values, modes, step, effect, limit', [
    ({'carrier.held': 'both', **SPINNING}, 5, 0.005, 2e-4, 4e-5),
    (SPINNING, 5, 0.005, 1e-4, 2e-5),
    ({'carrier.held': 'x', **SPINNING}, 8, 0.001, 1e-4, 2e-5),
    ({'carrier.held': 'both', **DRIVEN}, 5, 0.005, 2e-5, 5e-6),
], ids=['held', 'free', 'x held', 'driven'])
def test_one_axial_mode_moves_as_spectral_elements(values, modes, step, effect, limit):
    scene = scene_of(values, **{'model.modes': modes, 'integrator.step': step})
    tip = spectral_elements.simulate(scene, 0.05, 30, courant=0.9)[2]
    off = [np.linalg.norm(timo_sim.simulate(each, 1.5, round(0.05 / step),
                                            estimate=False).position(2.0) - tip,
                          axis=1).max() / 2.0
           for each in (scene.vary({'model.axial_modes': 0, 'model.modes': 3}), scene)]
    assert off[0] > effect
    assert off[1] < limit


def test_spectral_elements_are_the_stored_reference_but_for_the_stretch(spin_up):
    """The stored reference of Simo and Vu-Quoc's arm is extrapolated to an inextensible arm."""
    scene = timo_sim.load_scene(spin_up)
    stored = references.read('spin_up')[1]['w_l_m'][:301:5]
    off = []
    for stretch in (1.0, 0.3):
        _, shaft, tip, _ = spectral_elements.simulate(
            scene, 0.1, 60, order=6, courant=0.9, stretch=stretch)
        off.append(np.abs(np.cos(shaft) * tip[:, 1] - np.sin(shaft) * tip[:, 0] - stored).max())
    assert off[0] > 1e-5
    assert off[1] == pytest.approx(0.3 * off[0], rel=0.03)


def test_axial_coordinates_are_the_last_of_all_lists():
    last = [0.0] * 5
    scene = scene_of(**{'model.modes': 5, 'initial.modal_coordinates': [*last, 1e-3],
                        'arm.damping_ratio': [*last, 0.02], 'integrator.step': 2e-5})
    model = scene.build()
    along, across, rotation = model.tip(scene.initial_motion())
    assert along - 2.0 == pytest.approx(1e-3 * model.modes.displacement([2.0])[0, 5])
    assert across == rotation == 0.0
    # The strain at the root is that of the inertia forces of the shape, near E(0) q.
    strain = Simulator(scene).sensors.root_strain
    assert strain == pytest.approx(1e-3 * model.modes.stretch(np.zeros(1))[0, 5], rel=0.02)
    linear = timo_sim.linearize(scene.vary({'initial.modal_coordinates': []}))
    assert linear.states[8] == 'mode_6_m_sqrt_kg'
    # Of a rod between the masses of carrier and end effector, in closed form [Hz].
    assert np.abs(linear.poles()).max() == pytest.approx(2.0 * np.pi * 415.2601, abs=0.12)
    with pytest.raises(timo_sim.ParameterError, match='0 or 1 or 6 elements for model.modes = 5 '
                       'and model.axial_modes = 1'):
        scene.vary({'arm.damping_ratio': last})


def test_stretch_that_matters_gives_a_warning():
    fast = {**HELD, 'model.modes': 5, 'initial.shaft_velocity': 10.0}
    with pytest.warns(timo_sim.ModelWarning, match='take model.axial_modes 1'):
        timo_sim.simulate(timo_sim.load_scene(fast), 4.0, 10)
    assert timo_sim.simulate(timo_sim.load_scene({}, {**fast, 'model.axial_modes': 1}), 4.0,
                             10).warning is None


@pytest.mark.parametrize('axial', [0, 2, 3])
def test_the_estimate_of_a_pulled_arm_is_its_error_until_three_axial_modes_have_none(axial):
    """A soft arm of a kilogram is 10 % longer in the end; the remedy is one more axial mode."""
    scene = timo_sim.load_scene({
        'arm.length': 1.0, 'arm.section.height': 0.1, 'arm.section.width': 0.01,
        'arm.density': 1000.0, 'arm.young_modulus': 1e6, 'arm.shear_modulus': 3.4e5,
        'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.equilibrium': True,
        'load.tip_force_x.piecewise.time': [0.0], 'load.tip_force_x.piecewise.value': [100.0],
        'model.axial_modes': axial})
    run = timo_sim.simulate(scene, 0.004)
    error = np.hypot(*(run.position()[-1] - [1.1, 0.0]))
    estimate = run.stats['estimated_tip_error_m']
    if axial == 3:
        assert error < 1e-10 and estimate < 1e-10 and run.warning is None
    else:  # that of the first axial mode would be 5/6 of the whole
        assert error > 1e-3 and 0.8 < estimate / error < 1.0001
        assert run.warning.endswith(f'take model.axial_modes {axial + 1}')


@pytest.mark.parametrize('values', [{}, TAPERED, CONE, {'end_effector.mass': 0.0}, {
    'end_effector.mass': 5000.0}], ids=['uniform', 'steps', 'cone', 'no tip', 'heavy tip'])
def test_four_axial_modes_are_orthonormal_and_answer_a_force_on_the_tip(values):
    """As those of the finer run of three; the force stretches by F / E A, wherever."""
    scene = scene_of(HELD, values)
    body, length = scene.manipulator, np.array([2.0])
    found, rule = axial_modes(body, 4, scene.constraints), Quadrature(body.arm.breaks, 200)
    along, strain = found.displacement(rule.points), found.stretch(rule.nodes)
    stiffness = rule.weights * body.arm.at(rule.nodes).axial_stiffness
    scale = np.outer(found.omega, found.omega)
    assert (along.T * body.inertia(rule)[0]) @ along == pytest.approx(np.eye(4), abs=1e-10)
    assert (strain.T * stiffness) @ strain / scale == pytest.approx(np.eye(4), abs=1e-10)
    q = found.displacement(length)[0] / found.omega**2  # of 1 N
    assert strain @ q == pytest.approx(rule.weights / stiffness, rel=1e-10)


BENT = {'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.shaft': 0.0, 'model.modes': 5,
        'model.axial_modes': 1, 'integrator.step': 0.005}
BUCKLED = {'load.tip_force_x.table.time': [0.0, 1.0],
           'load.tip_force_x.table.value': [0.0, -900.0],
           'load.tip_force_y.piecewise.time': [0.0], 'load.tip_force_y.piecewise.value': [2.0]}
LARGE = {'end_effector.mass': 0.5, 'end_effector.inertia': 0.01, 'arm.section.height': 0.01,
         'load.tip_force_y.piecewise.time': [0.0], 'load.tip_force_y.piecewise.value': [60.0]}


# Errors grow while the arm buckles; measured: 1e-2 and below 1e-3 lengths.
@pytest.mark.parametrize('load, coarse, until, limit', [
    (BUCKLED, 0.005, 1.6, 2e-2), (LARGE, 0.005, 1.0, 1e-3), (LARGE, 0.0005, 0.5, 1e-3)],
    ids=['buckled', 'large', 'large, 1.4 rad in a step'])
def test_an_arm_whose_steps_do_not_resolve_its_stretch_moves_as_with_finer_ones(
        load, coarse, until, limit):
    """The coarse steps see 0.2 to 3 periods of the axial vibration each, which once diverged."""
    scene = timo_sim.load_scene({}, {**BENT, **load, 'integrator.step': coarse})
    run = timo_sim.simulate(scene, until, round(0.005 / coarse), estimate=False)
    assert 'axial vibrations slowed down to' in run.message
    step = 0.005 / 512
    fine = timo_sim.simulate(scene.vary({'integrator.step': step}), until, 512, estimate=False)
    assert 'slowed down' not in fine.message and np.abs(fine.q[:, 0]).max() > 0.05
    off = np.linalg.norm(run.position(2.0) - fine.position(2.0), axis=1)
    assert off.max() < limit * 2.0


def test_what_is_slowed_down_stretches_as_far_and_has_the_same_linear_model():
    scene = timo_sim.load_scene({}, {**BENT, 'end_effector.mass': 2.0, 'arm.damping_ratio': [0.05],
                                     'load.tip_force_x.piecewise.time': [0.0],
                                     'load.tip_force_x.piecewise.value': [1e4]})
    fine = scene.vary({'integrator.step': 1e-5})
    assert scene.fastest == 100.0 and fine.fastest == np.inf
    run = timo_sim.simulate(scene, 3.0, estimate=False)
    section = scene.manipulator.arm.section
    stretch = 1e4 * 2.0 / (section.young_modulus * section.area)
    assert run.deflection()[-1, 0] == pytest.approx(stretch, rel=0.02)  # one mode: 1.4 % less
    still = {'load.tip_force_x.piecewise.value': [0.0]}
    linear = [timo_sim.linearize(each.vary(still)).A for each in (scene, fine)]
    poles = [timo_sim.modes(each.vary(still)).poles for each in (scene, fine)]
    assert np.array_equal(*linear) and np.array_equal(*poles)


@pytest.mark.parametrize('mass, axial', [(0.5, 1), (0.0, 2)])
def test_an_arm_that_hangs_has_the_root_strain_of_all_weights_below_it(mass, axial):
    """`(m_arm + m_tip) g / E A` plus a pull along the arm over E A; 18 % are not in one mode."""
    pull = 3.0
    scene = timo_sim.load_scene({
        **HELD, 'motor.shaft': 'locked', 'initial.shaft': -np.pi / 2, 'gravity': [0.0, -9.81],
        'arm.length': 1.0, 'arm.section.height': 0.01, 'arm.section.width': 0.03,
        'arm.density': 2710.0, 'arm.young_modulus': 70e9, 'arm.shear_modulus': 27e9,
        'motor.mass': 0.0, 'motor.shaft_inertia': 0.1, 'carrier.mass': 1.0,
        'end_effector.mass': mass, 'end_effector.inertia': 0.004 * mass,
        'load.tip_force_y.piecewise.time': [0.0], 'load.tip_force_y.piecewise.value': [-pull],
        'initial.equilibrium': True, 'model.axial_modes': axial, 'arm.damping_ratio': [0.02]})
    stiffness = 70e9 * 3e-4
    expected = ((2710.0 * 3e-4 + mass) * 9.81 + pull) / stiffness
    run = timo_sim.simulate(scene, 0.002, estimate=False)
    assert run.root_strain() == pytest.approx(expected, rel=1e-6)
    assert Simulator(scene).sensors.root_strain == pytest.approx(expected, rel=1e-6)
    model = timo_sim.linearize(scene).select(['tip_force_y_N'], ['root_strain'])
    still = model.frequency_response([0.0])[0, 0, 0]
    assert still == pytest.approx(-1.0 / stiffness, rel=1e-6)
