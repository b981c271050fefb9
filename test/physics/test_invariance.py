# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Invariances of the equations (place, direction, units, time, ...), for random scenes."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

import timo_sim
from timo_sim.model.exact import Exact
from timo_sim.simulation.simulator import Simulator

# Each example takes some runs of milliseconds; examples are the same each time.
runs = settings(max_examples=12, deadline=None, derandomize=True)
exact_and_newton = pytest.mark.parametrize('formulation', ['exact', 'newton'])
STEP, STEPS = 0.001, 1000  # [s]


def number(low, high):
    """Return a strategy for floats."""
    return st.floats(low, high, allow_subnormal=False)


SCENES = st.fixed_dictionaries({
    'position': st.tuples(number(-3.0, 3.0), number(-3.0, 3.0)),
    'velocity': st.tuples(number(-2.0, 2.0), number(-2.0, 2.0)),
    'shaft': number(-3.0, 3.0), 'spin': number(-3.0, 3.0),
    'bend': st.tuples(number(-0.3, 0.3), number(-0.05, 0.05), number(-0.01, 0.01)),
    'force': st.tuples(number(-50.0, 50.0), number(-50.0, 50.0)),
    'torque': number(-10.0, 10.0), 'frequency': number(0.0, 5.0),
    'tip mass': number(0.0, 5.0), 'tip inertia': number(0.0, 1.0), 'damping': number(0.0, 0.2)})


def run(formulation, scene, **values):
    """Return the motion of a scene over 1000 steps, shape (11, 12)."""
    values = {
        'model.formulation': formulation, 'model.static_modes': 'none',  # six coordinates, always
        **{f'initial.carrier_{axis}': scene['position'][k] for k, axis in enumerate('xy')},
        **{f'initial.carrier_{axis}_velocity': scene['velocity'][k]
           for k, axis in enumerate('xy')},
        'initial.shaft': scene['shaft'], 'initial.shaft_velocity': scene['spin'],
        'initial.modal_coordinates': scene['bend'],
        **{f'load.force_{axis}.harmonic.amplitude': [scene['force'][k]]
           for k, axis in enumerate('xy')},
        'load.torque.harmonic.amplitude': [scene['torque']],
        **{f'load.{channel}.harmonic.frequency': [scene['frequency']]
           for channel in ('force_x', 'force_y', 'torque')},
        **{f'load.{channel}.harmonic.phase': [0.3] for channel in ('force_x', 'force_y')},
        'end_effector.mass': scene['tip mass'], 'end_effector.inertia': scene['tip inertia'],
        'arm.damping_ratio': [scene['damping']], **values}
    return Simulator(timo_sim.load_scene({}, values)).advance(STEPS, sample_every=STEPS // 10)[0]


def same(found, expected, rounding=1e-9):
    """Assert that motions agree, relative to the largest of each kind of coordinate."""
    for part in (slice(0, 2), slice(2, 3), slice(3, 6), slice(6, 8), slice(8, 9), slice(9, 12)):
        size = max(np.abs(expected[:, part]).max(), 1e-2)
        np.testing.assert_allclose(found[:, part], expected[:, part], rtol=0, atol=rounding * size)


@exact_and_newton
@given(scene=SCENES, angle=number(-3.0, 3.0),
       shift=st.tuples(number(-5.0, 5.0), number(-5.0, 5.0)),
       drift=st.tuples(number(-4.0, 4.0), number(-4.0, 4.0)))
@runs
def test_place_direction_and_speed_of_the_observer(formulation, scene, angle, shift, drift):
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    expected = run(formulation, scene)
    t = np.linspace(0.0, STEPS * STEP, len(expected))[:, np.newaxis]
    expected[:, 0:2] = expected[:, 0:2] @ turn.T + shift + t * drift
    expected[:, 6:8] = expected[:, 6:8] @ turn.T + drift
    expected[:, 2] += angle
    same(run(formulation, {
        **scene, 'position': turn @ scene['position'] + shift,
        'velocity': turn @ scene['velocity'] + drift,
        'shaft': scene['shaft'] + angle, 'force': turn @ scene['force']}), expected)


@exact_and_newton
@given(scene=SCENES)
@runs
def test_mirror(formulation, scene):
    expected = run(formulation, scene)
    expected[:, [1, 2, 3, 4, 5, 7, 8, 9, 10, 11]] *= -1.0
    flip = np.array([1.0, -1.0])
    same(run(formulation, {
        **scene, 'shaft': -scene['shaft'], 'spin': -scene['spin'], 'torque': -scene['torque'],
        'bend': -np.array(scene['bend']), 'position': flip * scene['position'],
        'velocity': flip * scene['velocity'], 'force': flip * scene['force']}), expected)


@exact_and_newton
@given(scene=SCENES, metre=number(0.1, 10.0), kilogram=number(0.01, 100.0),
       second=number(0.2, 5.0))
@runs
def test_units(formulation, scene, metre, kilogram, second):
    """A model in which all lengths, masses and times are larger moves in the same way."""
    newton, modal = kilogram * metre / second**2, metre * math.sqrt(kilogram)
    expected = run(formulation, scene)
    expected[:, 0:2] *= metre
    expected[:, 3:6] *= modal
    expected[:, 6:8] *= metre / second
    expected[:, 8] /= second
    expected[:, 9:12] *= modal / second
    model = {
        'arm.length': 2.0 * metre, 'arm.section.width': 0.02 * metre,
        'arm.section.height': 0.02 * metre,
        'arm.density': 2710.0 * kilogram / metre**3,
        'arm.young_modulus': 70.5e9 * newton / metre**2,
        'arm.shear_modulus': 27e9 * newton / metre**2, 'carrier.mass': 5.0 * kilogram,
        'motor.mass': 5.0 * kilogram, 'motor.shaft_inertia': 2.0 * kilogram * metre**2,
        'integrator.step': STEP * second}
    scaled = {
        'position': np.multiply(scene['position'], metre), 'shaft': scene['shaft'],
        'velocity': np.multiply(scene['velocity'], metre / second),
        'spin': scene['spin'] / second, 'bend': np.multiply(scene['bend'], modal),
        'force': np.multiply(scene['force'], newton), 'torque': scene['torque'] * newton * metre,
        'frequency': scene['frequency'] / second, 'tip mass': scene['tip mass'] * kilogram,
        'tip inertia': scene['tip inertia'] * kilogram * metre**2, 'damping': scene['damping']}
    units = np.array([metre, metre, 1.0, modal, modal, modal])
    units = np.concatenate([units, units / second])
    same(run(formulation, scaled, **model) / units, expected / units)


@exact_and_newton
@given(first=SCENES, second=SCENES)
@runs
def test_small_motions_add_up(formulation, first, second):
    def small(shares):
        mixed = {name: shares[0] * np.array(first[name]) + shares[1] * np.array(second[name])
                 for name in ('position', 'velocity', 'spin', 'bend', 'force', 'torque')}
        return run(formulation, {**first, **mixed})

    size = 1e-5
    none, one, two, both = map(small, [(0.0, 0.0), (size, 0.0), (0.0, size), (size, size)])
    np.testing.assert_allclose(one - none + two, both, rtol=0.0, atol=1e4 * size**2)


@given(scene=SCENES)
@runs
def test_frequencies_only_fall_as_modes_are_added(scene):
    """Each further mode gives the shape of a vibration more freedom: Rayleigh and Ritz."""
    body = timo_sim.load_scene({'end_effector.mass': scene['tip mass'],
                                'end_effector.inertia': scene['tip inertia']}).manipulator
    before = np.full(1, np.inf)
    for modes in range(1, 9):
        # All with 24 nodes: by default their number grows with the modes, and quadrature has 1e-5.
        linear = Exact(body, modes, nodes=24).linear
        found = np.sort(np.linalg.eigvals(linear).imag)[-modes:]
        assert np.all(found[:len(before)] <= before * (1.0 + 1e-9))
        before = found


@exact_and_newton
@given(scene=SCENES)
@runs
def test_reversed_velocities_lead_back_to_the_start(formulation, scene):
    """Errors of odd order do not cancel on the way back: half the step has 1/32 of them."""
    def off(step, steps):
        simulator = Simulator(timo_sim.load_scene({
            'model.formulation': formulation, 'model.static_modes': 'none',
            'initial.shaft_velocity': scene['spin'],
            'initial.modal_coordinates': scene['bend'], 'end_effector.mass': scene['tip mass'],
            'initial.carrier_x_velocity': scene['velocity'][0], 'integrator.step': step}))
        start, travel = simulator.motion.values, simulator.model.tip_travel
        for _ in range(2):
            simulator.advance(steps)
            motion = simulator.motion.values
            motion[6:] *= -1.0
            simulator._state[:] = simulator.model.state(motion)
        return np.abs(simulator.motion.values[:6] - start[:6]) @ travel
    assert off(5e-4, 2 * STEPS) <= max(off(1e-3, STEPS) / 10.0, 1e-12)


def test_momenta_of_a_free_manipulator_are_kept_to_the_bit():
    """Over a minute; momenta computed from a motion have the round-off of positions and speeds."""
    simulator = Simulator(timo_sim.load_scene({
        'initial.carrier_x_velocity': 0.4, 'initial.carrier_y_velocity': -0.3,
        'initial.shaft_velocity': 1.5, 'initial.modal_rates': [2.0, 1.0, 0.0]}))
    before = simulator._state[6:9].copy()
    motions, _ = simulator.advance(60 * STEPS, sample_every=STEPS)
    assert np.array_equal(simulator._state[6:9], before)
    momentum = simulator.model.momentum(motions)
    assert np.abs(momentum / momentum[0] - 1.0).max() < 1e-11
    energy = simulator.model.energy(motions)
    assert np.abs(energy / energy[0] - 1.0).max() < 1e-11


@exact_and_newton
def test_a_carrier_that_is_set_elsewhere_and_boosted_takes_the_arm_along(formulation):
    """A boost changes no accelerations."""
    scene = timo_sim.load_scene({'model.formulation': formulation, 'initial.shaft_velocity': 2.0})
    plain, boosted = Simulator(scene), Simulator(scene)
    plain.advance(200)
    boosted.advance(100)
    place, velocity = np.array([3.0, -2.0]), np.array([0.4, 0.7])
    motion = boosted.motion.values
    motion[:2] += place
    motion[6:8] += velocity
    boosted.set_motion(motion)
    boosted.advance(100)
    expected = plain.motion.values.copy()
    expected[:2] += place + velocity * 100 * STEP
    expected[6:8] += velocity
    # Round-off of positions of metres.
    assert boosted.motion.values == pytest.approx(expected, rel=0.0, abs=1e-13)


def test_a_carrier_at_rest_that_is_boosted_drifts_with_the_arm():
    """No forces act, and shaft and arm are at rest in it."""
    simulator = Simulator({})
    simulator.advance(10)
    motion = simulator.motion.values
    motion[[0, 1, 6]] = 1.0, 2.0, 0.5
    simulator.set_motion(motion)
    simulator.advance(1000)
    assert simulator.motion.values[6:] == pytest.approx([0.5, *5 * [0.0]], abs=1e-13)
    assert simulator.motion.carrier == pytest.approx([1.5, 2.0], abs=1e-13)
