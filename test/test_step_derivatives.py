# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of steps against differences of steps."""

from copy import copy

import numpy as np
import pytest

import timo_sim
from timo_sim.model.layout import (
    ANGLE, FORCE_X, FORCE_Y, LOADS, PUSH_X, PUSH_Y, SPEED, TIP_TORQUE, TIP_X, TIP_Y, TORQUE)
from timo_sim.steps.derivatives import step_derivatives

MOVING = {'initial.modal_rates': [0.3, 0.2], 'initial.shaft_velocity': 3.0, 'model.modes': 2}
# Duals of the size of other scenes, which take longest to compile.
HELD = {**MOVING, 'carrier.held': 'both', 'model.modes': 3,
        'initial.modal_rates': [0.3, 0.2, 0.1]}
INPUTS = [FORCE_X, FORCE_Y, TORQUE, TIP_X, TIP_Y, TIP_TORQUE, PUSH_X, PUSH_Y]
RUBS = {'carrier.coulomb_friction': 2.0, 'motor.coulomb_friction': 0.5,
        'carrier.coulomb_speed': 0.3, 'motor.coulomb_speed': 2.0, 'motor.viscous_friction': 0.4,
        'arm.damping_ratio': [0.02], 'hub.radius': 0.3}
SCENES = {
    'rubs': {**MOVING, **RUBS, 'carrier.viscous_friction': 3.0},
    'held, at the limit of the current': {
        **HELD, 'gravity': [1.0, -9.81], 'push.position': 0.7,
        'motor.dc.resistance': 2.0, 'motor.dc.torque_constant': 0.5,
        'motor.dc.current_limit': 2.0},
    'driven, stretches': {
        'model.modes': 1, 'initial.modal_rates': [0.3, 0.01], 'model.axial_modes': 1,
        'motor.shaft': 'driven', 'motor.drive.time': [0.0, 1.0], 'motor.drive.angle': [0.3, 4.0],
        'motor.drive.speed': [2.0, 3.0], 'motor.drive.acceleration': [0.0, 0.0]},
    'gear with play': {
        **MOVING, **RUBS, 'initial.modal_rates': [0.3, 0.2, 0.01], 'motor.gear.stiffness': 2000.0,
        'motor.gear.damping': 5.0, 'motor.rotor.inertia': 0.001, 'motor.dc.gear_ratio': 10.0,
        'motor.gear.backlash': 1e-4},
    'one axis held, presliding': {
        **MOVING, 'carrier.held': 'y', 'gravity': [1.0, -9.81], 'initial.shaft': 0.1,
        'initial.shaft_velocity': 0.0, 'motor.coulomb_friction': 0.5,
        'motor.coulomb_presliding': 0.5, 'carrier.coulomb_friction': 1.0,
        'carrier.coulomb_presliding': 0.01},
    'newton': {**MOVING, **RUBS, 'model.formulation': 'newton', 'carrier.held': 'x',
               'gravity': [1.0, -9.81], 'push.position': 0.7}}


@pytest.mark.parametrize('name', SCENES)
def test_derivatives_are_those_of_three_steps(name):
    """Under loads of all kinds, also along the arm's axes; differences are good to 1e-9."""
    values = SCENES[name]
    simulator = timo_sim.Simulator(timo_sim.load_scene({}, values))
    random = np.random.default_rng(1)

    def drawn(*shape):
        return np.pad(random.standard_normal((*shape, ANGLE)), [
            *len(shape) * [(0, 0)], (0, LOADS - ANGLE)])
    simulator.advance(50, 3.0 * drawn())
    model, steps, load = simulator.model, simulator.integration, simulator.load
    start, size = simulator.motion.values, simulator.model.size
    loads = np.tile(5.0 * drawn(3, 1), (1, 4, 1))
    if 'push.position' in values:
        loads[..., [PUSH_X, PUSH_Y]] = 4.0, -3.0
    if len(model.manipulator.motor_limit):
        loads[..., TORQUE] = 5.0  # far above the limit, 1 N m, also less the differences
    loads[..., [ANGLE, SPEED]] = load[[ANGLE, SPEED]]
    samples, memory = steps.samples(3, 3), steps.memory.copy()

    def end(motion, added=0.0):
        steps.memory[:] = memory
        assert steps.advance(model.state(motion), load, loads + added, samples) == 3
        return samples.motions[1].copy()

    def derivative(at, change):
        return (8.0 * (at(change) - at(-change)) - at(2.0 * change) + at(-2.0 * change)) / 12.0
    unit = np.eye(LOADS)[INPUTS if 'push.position' in values else INPUTS[:-2]]
    step = 1e-4 * np.eye(size)
    if model.gear or model.axial:
        step[5] *= 1e-2
    expected = np.column_stack([derivative(lambda change: end(start + change), each) / each.max()
                                for each in step]
                               + [derivative(lambda change: end(start, change), each)
                                  for each in unit])
    held = [k for k in range(3) if model.constrained[k]]
    expected[:, held + [size // 2 + k for k in held]] = 0.0
    steps.memory[:] = memory
    found, _ = step_derivatives(steps, model.state(start), load, loads, unit)
    scale = np.maximum(np.abs(expected).max(axis=1, keepdims=True), 1e-6)
    assert np.abs(found - expected).max() > 0.0
    assert (np.abs(found - expected) <= 1e-9 * scale).all()


def test_derivatives_of_a_turn_are_those_of_its_parts():
    """With one axis held, and a shaft that turns from one sector into another."""
    simulator = timo_sim.Simulator(timo_sim.load_scene({}, {
        **MOVING, 'carrier.held': 'y', 'initial.shaft': 0.95 * np.pi / 16}))
    other = copy(simulator)
    whole = simulator.step_derivatives(['torque'], duration=0.01, torque=1.0)
    parts = [other.step_derivatives(['torque'], duration=0.005, torque=1.0) for _ in range(2)]
    assert simulator.model.sector(simulator._state, simulator.load) == 1
    assert whole.by_motion == pytest.approx(parts[1].by_motion @ parts[0].by_motion, rel=1e-10,
                                            abs=1e-12)
    assert whole.by_input == pytest.approx(
        parts[1].by_motion @ parts[0].by_input + parts[1].by_input, rel=1e-10, abs=1e-12)


def test_a_simulator_goes_on_as_by_step_and_has_the_derivatives_of_what_acts():
    """Of a motor that reaches its limit, and by a voltage."""
    scene = timo_sim.load_scene({}, {
        **HELD, 'motor.torque_limit': 8.0, 'motor.dc.resistance': 2.0,
        'motor.dc.torque_constant': 0.5, 'motor.dc.gear_ratio': 3.0})
    simulator, other = timo_sim.Simulator(scene), timo_sim.Simulator(scene)
    found = simulator.step_derivatives(['torque', 'voltage'], duration=0.02, torque=7.0)
    assert np.array_equal(simulator.motion.values,
                          other.step(duration=0.02, torque=7.0).values)
    assert found.by_input[:, 1] == pytest.approx(0.75 * found.by_input[:, 0], rel=1e-12)
    start = simulator.motion.values
    first = simulator.step(duration=0.02, torque=8.0).values
    simulator.set_motion(start)
    found = simulator.step_derivatives(['torque'], duration=0.02, torque=80.0)
    assert simulator.motion.values == pytest.approx(first, rel=1e-12, abs=1e-14)
    simulator.set_motion(start)
    less = simulator.step(duration=0.02, torque=7.5).values
    assert first - less == pytest.approx(0.5 * found.by_input[:, 0], rel=1e-3, abs=1e-9)


PAYLOAD = {**MOVING, 'payload.time': [0.01], 'payload.mass': [3.0], 'payload.inertia': [0.6],
           'carrier.coulomb_friction': 1.0, 'carrier.coulomb_presliding': 0.01}


def test_derivatives_of_steps_in_which_a_load_is_picked_up_are_differences():
    """They go on in the same motion with another mass, and with bent bristles."""
    scene = timo_sim.load_scene({}, PAYLOAD)
    start, size = timo_sim.Simulator(scene).motion.values, 1e-6

    def end(shift=0.0, torque=1.0):
        simulator = timo_sim.Simulator(scene)
        simulator.set_motion(start + shift)
        return simulator.step(duration=0.02, torque=torque).values
    found = timo_sim.Simulator(scene).step_derivatives(['torque'], duration=0.02, torque=1.0)
    wanted = [end(size * each) - end(-size * each) for each in np.eye(len(start))]
    assert found.by_motion == pytest.approx(np.transpose(wanted) / (2.0 * size), abs=1e-6)
    assert found.by_input[:, 0] == pytest.approx(0.5 * (end(torque=2.0) - end(torque=0.0)),
                                                 abs=1e-7)


def test_derivatives_refuse_a_load_that_is_picked_up_at_rest():
    simulator = timo_sim.Simulator(timo_sim.load_scene({}, {
        **PAYLOAD, 'end_effector.pick_up': 'at_rest'}))
    with pytest.raises(timo_sim.ParameterError, match='at step 10'):
        simulator.step_derivatives(duration=0.02)
    assert simulator.steps == 0


def test_bad_inputs_and_motions_are_refused():
    simulator = timo_sim.Simulator('paper')
    for call, words in (
            (lambda: simulator.step_derivatives(['torqe']), 'did you mean torque'),
            (lambda: simulator.step_derivatives(['voltage']), 'needs motor.dc.resistance > 0'),
            (lambda: simulator.set_motion([0.0]), 'motion must be 12 finite numbers'),
            (lambda: simulator.set_motion(np.full(12, np.nan)), 'finite'),
            (lambda: timo_sim.EstimatingSimulator('paper').set_motion(np.zeros(12)), 'estimate')):
        with pytest.raises(timo_sim.ParameterError, match=words):
            call()
