# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Natural vibrations against tables of the literature, finite elements and closed forms."""

import re

from command_line import call
import numpy as np
from oracles.linear_beam import ELEMENTS, LinearBeam, ORDER, spinning, WRIGHT
import pytest
import scipy.linalg

import timo_sim

BARE = {'arm.length': 1.0, 'arm.section.width': 0.01, 'end_effector.mass': 0.0,
        'end_effector.inertia': 0.0}
# Rubber-like, with a tip: it stretches by percents, and vibrations along and across it couple.
SOFT = {'arm.length': 1.0, 'arm.section.width': 0.05, 'arm.section.height': 0.1,
        'arm.young_modulus': 1e9,
        'arm.shear_modulus': 4e8, 'end_effector.mass': 3.0, 'end_effector.inertia': 0.02}


@pytest.mark.parametrize('found, tolerance', [('modes', 9e-4), ('oracle', 6e-4)])
def test_spinning_arms_have_the_frequencies_of_the_literature(found, tolerance):
    """As thin as 1/5000, with twelve modes; the table has three decimals."""
    scene = timo_sim.load_scene({}, {**BARE, 'arm.section.height': 2e-4, 'model.modes': 12})
    section = scene.manipulator.arm.section
    unit = np.sqrt(section.bending_stiffness / section.mass_per_length)
    speeds = np.array([*WRIGHT])
    if found == 'modes':
        omega = np.array([timo_sim.modes(scene, unit * each).omega[:3] for each in speeds])
    else:
        omega = np.array([spinning(scene, unit * each, 3) for each in speeds])
    # Across the plane of rotation, as in the table.
    assert np.hypot(omega / unit, speeds[:, np.newaxis]) == pytest.approx(
        np.array([*WRIGHT.values()]), abs=tolerance)


@pytest.mark.parametrize('values, speeds', [
    (SOFT, (0.0, 20.0, 60.0)), ({'model.modes': 12}, (0.0, 10.0, 30.0))], ids=['soft', 'paper'])
def test_spinning_arms_that_stretch_have_the_frequencies_of_finite_elements(values, speeds):
    """The first three; up to one and a half and three times the first one at rest."""
    scene = timo_sim.load_scene({}, {'model.modes': 8, 'model.axial_modes': 3, **values})
    for speed in speeds:
        expected = spinning(scene, speed, 3)
        assert timo_sim.modes(scene, speed).omega[:3] == pytest.approx(expected, rel=1e-4)
    if values is SOFT:
        without = timo_sim.modes(scene.vary({'model.axial_modes': 0}), speed).omega[:3]
        assert np.abs(without / expected - 1.0).max() > 1e-2


def test_the_stated_error_is_that_of_the_frequencies():
    """Of a spinning arm, which converges with the number of modes."""
    scene, speed = timo_sim.load_scene({}, {
        **BARE, 'arm.section.height': 0.002, 'model.static_modes': 'none'}), 60.0
    expected, errors = spinning(scene, speed, 3), []
    for count in (3, 5, 8):
        found = timo_sim.modes(scene.vary({'model.modes': count}), speed)
        errors.append(np.abs(found.omega[:3] / expected - 1.0))
        assert (found.error[:3] / errors[-1] > 0.5).all()
        assert (found.error[:3] / errors[-1] < 1.1).all()
    # At 5.8 times the first frequency at rest: order 3 at least.
    assert 0.1 > errors[0][0] > (8.0 / 3.0)**3 * errors[2][0] > 1e-3


@pytest.mark.parametrize('static', ['auto', 'both'])
def test_static_shapes_of_a_bare_arm_are_no_vibrations(static):
    """The next frequency of a slender arm is 34.4 times the first, that of its shape 60 times."""
    scene = timo_sim.load_scene({}, {**BARE, 'arm.section.height': 0.01,
                                     'model.static_modes': static})
    for speed in None, 0.0:
        found = timo_sim.modes(scene, speed)
        assert found.omega.shape == (3,) == found.error.shape and found.error.max() < 2e-2
    assert scene.static and found.omega == pytest.approx(scene.build().modes.omega[:3])


@pytest.mark.parametrize('values', [{}, {'carrier.held': 'both'}, {'motor.shaft': 'locked'}],
                         ids=str)
def test_shapes_and_frequencies_at_rest_are_those_of_finite_elements(values):
    """With the carrier, the shaft and the tip of the paper."""
    scene = timo_sim.load_scene({}, {'model.modes': 8, 'initial.shaft': 0.0, **values})
    beam = LinearBeam(scene, held='carrier.held' in values, locked='motor.shaft' in values)
    of_free = np.ix_(beam.free, beam.free)
    squares, vectors = scipy.linalg.eigh(beam.stiffness[of_free], beam.mass[of_free])
    first = np.argmax(squares > 1.0)
    found = timo_sim.modes(scene)
    assert found.omega[:4] == pytest.approx(np.sqrt(squares[first:first + 4]), rel=1e-5)
    u = np.zeros((len(beam.mass), 4))
    u[beam.free] = vectors[:, first:first + 4]
    across = u[:len(u) // 2:ORDER].T
    shapes = found.shapes(np.linspace(0.0, beam.length, ELEMENTS + 1))[:4]
    assert np.abs(shapes[:, :, 0]).max() < 1e-6 and np.abs(shapes.imag).max() < 1e-6
    scale = np.sum(across * shapes[:, :, 1].real, axis=1) / np.sum(across**2, axis=1)
    assert shapes[:, :, 1].real == pytest.approx(across * scale[:, np.newaxis], abs=1e-4)
    largest = np.abs(found.shapes(np.linspace(0.0, beam.length, 1001))).max(axis=(1, 2))
    assert largest == pytest.approx(1.0, abs=0.03)


def test_a_rigid_arm_swings_about_the_angle_at_which_it_hangs():
    """`omega^2 = m g a / J`, from a horizontal start; friction damps it, `c / (2 J omega)`."""
    scene = timo_sim.load_scene({
        'model.modes': 0, 'carrier.held': 'both', 'gravity': [3.0, -4.0], 'initial.shaft': 0.0,
        'motor.viscous_friction': 0.5})
    body, length = scene.manipulator, 2.0
    mass = body.arm.section.mass_per_length * length
    inertia = (mass * length**2 / 3.0 + body.arm.section.inertia_per_length * length
               + body.shaft_inertia + body.end_effector_mass * length**2
               + body.end_effector_inertia)
    omega = np.sqrt(5.0 * (0.5 * mass + body.end_effector_mass) * length / inertia)
    found = timo_sim.modes(scene)
    assert found.omega == pytest.approx([omega], rel=1e-9) and found.error == 0.0
    assert found.damping == pytest.approx([0.25 / (inertia * omega)], rel=1e-6)
    assert found.motion.shaft == pytest.approx(np.arctan2(-4.0, 3.0), abs=1e-9)
    # In the axes of the shaft the tip moves across.
    assert np.abs(found.shapes([2.0])[0, 0]) == pytest.approx([0.0, 1.0], abs=1e-9)


def test_a_heavy_arm_vibrates_about_its_bend():
    """As the linear model about the same equilibrium, with a locked shaft or a speed of 0."""
    scene = timo_sim.load_scene({}, {'gravity': [0.0, -9.81], 'carrier.held': 'both',
                                     'motor.shaft': 'locked', 'arm.section.height': 0.005,
                                     'initial.shaft': 0.4, 'arm.damping_ratio': [0.01]})
    found = timo_sim.modes(scene)
    poles = timo_sim.linearize(scene.vary({'initial.equilibrium': True})).poles()
    assert found.poles == pytest.approx(poles[poles.imag > 0.0], rel=1e-9)
    assert abs(found.model.tip(found.motion.values)[2]) > 0.3
    assert timo_sim.modes(scene.vary({'motor.shaft': 'free'}), 0.0).poles == pytest.approx(
        found.poles, rel=1e-9)


def test_damping_of_the_system_is_not_that_of_the_clamped_arm():
    scene = timo_sim.load_scene({}, {'arm.damping_ratio': [0.01], 'arm.damping_of': 'system'})
    assert timo_sim.modes(scene).damping == pytest.approx(0.01, rel=0.02)
    clamped = timo_sim.modes(scene, 0.0)
    assert clamped.damping == pytest.approx(scene.build().damping, rel=1e-6)
    assert clamped.omega == pytest.approx(scene.build().modes.omega, rel=1e-9)
    # At a speed the ratios fall as the frequencies rise: forces of damping stay.
    turning = timo_sim.modes(scene, 10.0)
    assert (turning.damping * turning.omega)[1] == pytest.approx(
        clamped.damping[1] * clamped.omega[1], rel=2e-2)


def test_a_critically_damped_mode_is_no_vibration_until_it_is_stiffer():
    scene = timo_sim.load_scene({}, {'arm.damping_ratio': [0.01, 1.0, 0.01]})
    assert timo_sim.modes(scene, 0.0).damping.max() < 0.02
    damping = timo_sim.modes(scene, 10.0).damping
    assert len(damping) == 3 and 0.9 < damping[1] < 1.0


def test_a_rigid_arm_that_is_clamped_has_no_vibrations():
    found = timo_sim.modes({'model.modes': 0}, 0.0)
    assert found.frequency.shape == (0,) and found.shapes([1.0, 2.0]).shape == (0, 2, 2)


@pytest.mark.parametrize('values, speed, words', [
    ({'model.formulation': 'newton'}, 5.0, 'need model.formulation = exact.*got newton'),
    ({'gravity': [0.0, -9.81]}, 5.0, r'gravity = \[0, 0\].*got exact, \[0.0, -9.81\]'),
    ({}, np.nan, 'speed must be a finite number, got nan'),
    ({'gravity': [0.0, -9.81]}, None, 'there must be a state of rest, but .* carrier is free')])
def test_states_that_are_not_steady_are_refused(values, speed, words):
    with pytest.raises(timo_sim.ParameterError, match=words):
        timo_sim.modes(values, speed)


def test_the_command_prints_and_draws(tmp_path):
    shapes, campbell = tmp_path / 'shapes.png', tmp_path / 'campbell.png'
    system, clamped = call('modes', 'paper', '--png', shapes).split('clamped arm:')
    assert '   1       4.26714       26.8112' in system
    assert clamped.count('\n') == 6 and shapes.stat().st_size > 20000
    told = call('modes', 'spin_up', '--png', campbell, '--speed', 0, 3, 6)
    *_, last = re.findall(r'shaft at (\S+) rad/s:\n.*\n +1 +(\S+)', told)
    # The textbook's arm, by finite elements.
    expected = spinning(timo_sim.load_scene('spin_up'), 6.0, 1)[0] / (2.0 * np.pi)
    assert last[0] == '6.0' and float(last[1]) == pytest.approx(expected, rel=2e-3)
    assert campbell.stat().st_size > 15000


@pytest.mark.parametrize('held', ['both', 'none'])
def test_shapes_are_drawn_with_the_carrier_where_it_is(held):
    """Not at the root, which a hub turns round the shaft."""
    scene = timo_sim.load_scene({}, {
        'carrier.held': held, 'hub.radius': 0.3, 'initial.shaft': 0.5})
    for axes in timo_sim.modes(scene).plot().axes:
        (before, *_), (after, *_) = (
            line.get_xydata() for line in axes.lines if line.get_marker() == 's')
        assert before == pytest.approx(-after)
        across = next(line.get_ydata() for line in axes.lines if line.get_marker() == '.')
        if held == 'both':
            assert not after.any() and abs(across[1]) > 1e-3  # the root turns with the shaft
        else:
            assert abs(after[1]) > 1e-3
