# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A limit of a DC motor's current: closed forms, other integrators, a source of torque."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from oracles.energy import inertia_of, work
import timo_sim
from timo_sim.model.layout import LOADS, TORQUE

HELD = {'carrier.held': 'both', 'initial.shaft': 0.0}
RIGID = {**HELD, 'model.modes': 0}
# Seen from the shaft 6 N m/V, a back-EMF of 18 N m s/rad, and a current that gives 30 N m.
MOTOR = {'motor.dc.resistance': 0.5, 'motor.dc.torque_constant': 0.06,
         'motor.dc.gear_ratio': 50.0, 'motor.dc.current_limit': 10.0}
GAIN, BACK_EMF, LIMIT = 6.0, 18.0, 30.0
UNLIMITED = {'motor.dc.current_limit': math.inf}
GEAR = {**HELD, 'motor.shaft_inertia': 0.2, 'motor.gear.stiffness': 900.0,
        'motor.gear.damping': 2.0, 'motor.rotor.inertia': 0.5 / 50.0**2}
BUILDS_UP = {'motor.coulomb_friction': 4.0, 'motor.coulomb_speed': 0.3}


def limited(torque, speed):
    """Return the motor's torque on the shaft with that of its back-EMF."""
    return min(max(torque - BACK_EMF * speed, -LIMIT), LIMIT)


def test_a_start_is_a_constant_acceleration_then_an_exponential():
    """The first until the back-EMF leaves no more than the current's torque of the voltage's."""
    torque, errors = GAIN * 12.0, []
    for step in (0.004, 0.002, 0.001):
        scene = timo_sim.load_scene({}, {**RIGID, **MOTOR, 'integrator.step': step})
        inertia, simulator, found = inertia_of(scene), timo_sim.Simulator(scene), []
        slow = (torque - LIMIT) / BACK_EMF
        bend, final = slow * inertia / LIMIT, torque / BACK_EMF
        while simulator.t < 3.0 * bend:
            speed = float(simulator.step(voltage=12.0).shaft_velocity)
            t = simulator.t
            wanted = LIMIT / inertia * t if t < bend else (
                final - (final - slow) * np.exp(-BACK_EMF / inertia * (t - bend)))
            found.append((t, speed - wanted))
            if len(found) % 10 == 1:  # efforts are without the friction of the back-EMF
                assert simulator.snapshot().effort[2] == pytest.approx(
                    limited(torque, speed) + BACK_EMF * speed, rel=1e-12)
        t, error = np.array(found).T
        assert np.abs(error[t < bend]).max() < 1e-11
        errors.append(np.abs(error).max())
    # Measured: 3e-7 rad/s at 4 ms; less than the bend can change in a step.
    assert max(errors) < 1e-6
    for step, error in zip((0.004, 0.002, 0.001), errors):
        assert error < 0.125 * BACK_EMF * LIMIT / inertia**2 * step**2


def test_at_standstill_and_without_a_resistance_it_limits_the_torque_of_commands_and_loads():
    none = {'motor.dc.resistance': 0.0, 'load.torque.piecewise.time': [0.0],
            'load.torque.piecewise.value': [-20.0]}
    scene = timo_sim.load_scene({}, {**RIGID, **MOTOR, **none})
    simulator = timo_sim.Simulator(scene)
    for command, torque in ((40.0, 20.0), (60.0, 30.0), (-11.0, -30.0)):
        start = simulator.motion.shaft_velocity
        speed = simulator.step(duration=0.1, torque=command).shaft_velocity
        assert speed - start == pytest.approx(0.1 * torque / inertia_of(scene), rel=1e-12)
        assert simulator.snapshot().effort[2] == torque


@pytest.mark.parametrize('values', [
    {**HELD, **BUILDS_UP}, {'gravity': [0.0, -9.81], 'arm.damping_ratio': [0.01]},
    {**HELD, **BUILDS_UP, 'model.formulation': 'newton'}], ids=['held', 'free', 'newton'])
def test_second_order_over_its_bends(values):
    """Against SciPy with the equations of a scene without the limit, whose torque has the law."""
    swing = {'load.torque.harmonic.amplitude': [90.0], 'load.torque.harmonic.frequency': [1.1]}
    scene = timo_sim.load_scene({}, {**MOTOR, **values, 'model.modes': 2})
    model = scene.vary(UNLIMITED).build()
    half, load = model.size // 2, np.zeros(LOADS)
    other = timo_sim.Simulator(scene.vary(UNLIMITED)).integration
    start = model.state(scene.initial_motion())

    def wanted(t, state):
        speed = other.motion(state, np.zeros(LOADS))[half + 2]
        return 90.0 * np.sin(2.2 * np.pi * t) - BACK_EMF * speed, speed

    def rate(t, state, side):
        inner, speed = wanted(t, state)
        load[TORQUE] = (inner if side == 0 else side * LIMIT) + BACK_EMF * speed
        return model.rate(state, load)

    events = [lambda t, state, side, sign=sign: wanted(t, state)[0] - sign * LIMIT
              for sign in (1, -1)]
    for event in events:
        event.terminal = True
    t, state, side, bends = 0.0, start, 0, 0
    while t < 1.0:
        part = solve_ivp(rate, (t, 1.0), state, 'DOP853', rtol=1e-11, atol=1e-12, events=events,
                         args=(side,))
        t, state = part.t[-1], part.y[:, -1]
        if part.status == 1:
            # Beyond the event, where its function is no longer zero.
            side = 0 if side else 1 if len(part.t_events[0]) else -1
            ahead = 1e-9
            state, t, bends = state + ahead * rate(t, state, side), t + ahead, bends + 1
    assert bends >= 4
    errors = []
    for step in (0.004, 0.002, 0.001, 0.0005, 0.00025, 0.000125):
        run = timo_sim.simulate(scene.vary({**swing, 'integrator.step': step}), 1.0,
                                estimate=False)
        difference = model.state(run.values[-1]) - state
        errors.append(np.abs(difference).max() / np.abs(state).max())
    # Their factor depends on where in a step the bends are: measured, up to 4e-4 at 4 ms.
    factors = np.array(errors) * 4.0**np.arange(len(errors))
    assert factors.max() < 1e-3
    assert factors[3:].max() < 3.0 * factors[:3].max()


SATURATED = {
    'builds up': {**HELD, **BUILDS_UP}, 'newton': {**HELD, 'model.formulation': 'newton'},
    'free, hub': {'gravity': [0.0, -9.81], 'hub.radius': 0.2},
    'one axis held': {'carrier.held': 'x'},
    'stretches, one axis held': {'carrier.held': 'x', 'model.axial_modes': 1},
    'sticks': {**HELD, 'motor.coulomb_friction': 4.0},
    'newton, presliding': {**HELD, 'motor.coulomb_friction': 4.0,
                           'motor.coulomb_presliding': 0.01, 'model.formulation': 'newton'},
    'gear': GEAR,
    'gear, presliding': {**GEAR, 'motor.rotor.coulomb_friction': 4.0 / 50.0,
                         'motor.rotor.coulomb_presliding': 0.5}}


@pytest.mark.parametrize('name', SATURATED)
def test_beyond_the_limit_a_motor_is_a_constant_torque_without_back_emf(name):
    """Under a voltage out of reach of the back-EMF; dry friction is no part of the current."""
    values = {'model.modes': 1, **SATURATED[name]}
    scene = timo_sim.load_scene({}, {**MOTOR, **values})
    source = timo_sim.load_scene(values, {'motor.dc.gear_ratio': 50.0})
    motor, torque = timo_sim.Simulator(scene), timo_sim.Simulator(source)
    for sign in (1.0, 1.0, -1.0):
        motor.step(duration=0.1, voltage=sign * 100.0)
        torque.step(duration=0.1, torque=sign * LIMIT)
        expected = torque.motion.values
        # Measured: up to 1e-10, in the fast vibrations of an arm that stretches.
        assert motor.motion.values == pytest.approx(expected, rel=1e-6, abs=2e-7)
        found, wanted = motor.snapshot(), torque.snapshot()
        speed = motor.motion.values[motor.model.size // 2:] @ motor.model.rotor
        assert found.effort[2] == pytest.approx(sign * LIMIT + BACK_EMF * speed, rel=1e-12)
        # Accelerations are differences.
        assert found.joints.root_strain == pytest.approx(wanted.joints.root_strain, rel=1e-5)
        assert found.joints.tip_acceleration == pytest.approx(
            wanted.joints.tip_acceleration, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize('name', SATURATED)
def test_a_limit_that_is_not_reached_changes_nothing(name):
    scene = timo_sim.load_scene({}, {
        **MOTOR, **SATURATED[name], 'model.modes': 1, 'motor.dc.current_limit': 1e3})
    found, expected = timo_sim.Simulator(scene), timo_sim.Simulator(scene.vary(UNLIMITED))
    for voltage in (20.0, -30.0):
        found.step(duration=0.1, voltage=voltage)
        expected.step(duration=0.1, voltage=voltage)
    assert found.motion.values == pytest.approx(expected.motion.values, rel=1e-10, abs=1e-10)
    assert found.snapshot().effort[2] == expected.snapshot().effort[2] == GAIN * -30.0


def test_energy_is_the_work_of_efforts_less_that_of_friction_and_back_emf():
    scene = timo_sim.load_scene({}, {
        **MOTOR, **HELD, 'arm.damping_ratio': [0.02], 'load.torque.piecewise.time': [0.0],
        'load.torque.piecewise.value': [600.0]})
    run = timo_sim.simulate(scene, 1.0, estimate=False)
    speeds = np.column_stack([run.carrier_velocity, run.shaft_velocity])
    done = work(np.rint(run.t * 1e9), run.values[:, :3], speeds, run.effort).sum()
    left = run.energy()[-1] - run.energy()[0] + run.dissipated()[-1] - done
    assert abs(left) < 1e-6 * done
    # The work of the torque that really acts is that of the current's limit.
    assert done - (run.shaft[-1] * LIMIT) == pytest.approx(
        np.trapezoid(BACK_EMF * run.shaft_velocity**2, run.t), rel=1e-4)


@pytest.mark.parametrize('gear', [{}, GEAR], ids=['stiff', 'gear'])
def test_a_motor_that_brakes_at_its_limit_takes_no_more_energy_than_the_arm_loses(gear):
    """Without a voltage there is no work; at the limit the current takes LIMIT times the speed."""
    scene = timo_sim.load_scene({}, {
        **MOTOR, **HELD, **gear, 'initial.shaft_velocity': 4.0, 'arm.damping_ratio': [0.02]})
    run = timo_sim.simulate(scene, 1.6, estimate=False)
    assert not run.effort[:, 2].any() and LIMIT < BACK_EMF * run.shaft_velocity[0]
    lost = run.energy()[0] - run.energy()
    # Measured: 4e-7; the power bends where the limit ends.
    assert run.dissipated() == pytest.approx(lost, abs=1e-6 * lost.max())
    simulator = timo_sim.Simulator(scene)
    assert simulator.step(duration=0.01).shaft_velocity > LIMIT / BACK_EMF
    assert simulator.effort[2] == 0.0


def test_acts_on_the_rotor_of_an_elastic_gear():
    """Against SciPy: two bodies, a spring, and the law at the speed of the rotor."""
    scene = timo_sim.load_scene({}, {**MOTOR, **GEAR, 'model.modes': 0, 'integrator.step': 0.0005})
    arm, rotor = inertia_of(scene) - 0.5, 0.5

    def rate(t, y):
        gear = 900.0 * (y[1] - y[0]) + 2.0 * (y[3] - y[2])
        return [y[2], y[3], gear / arm,
                (limited(60.0 * np.sin(12.0 * t), y[3]) - gear) / rotor]

    times = np.linspace(0.0, 1.0, 201)
    expected = solve_ivp(rate, (0.0, 1.0), np.zeros(4), 'DOP853', times, rtol=1e-11, atol=1e-13,
                         max_step=1e-3).y
    found = timo_sim.simulate(scene.vary({
        'load.torque.harmonic.amplitude': [60.0],
        'load.torque.harmonic.frequency': [6.0 / np.pi]}), 1.0, estimate=False)
    half, turns = found.model.size // 2, found.model.rotor
    some = found.values[::10]
    reached = np.abs(60.0 * np.sin(12.0 * times) - BACK_EMF * expected[3]) > LIMIT
    assert 0.1 < reached.mean() < 0.9
    assert some[:, 2] == pytest.approx(expected[0], abs=2e-6)
    assert some[:, half:] @ turns == pytest.approx(expected[3], abs=2e-5)
    assert found.effort[::10, 2] == pytest.approx([
        limited(60.0 * np.sin(12.0 * t), v) + BACK_EMF * v
        for t, v in zip(times, expected[3])], abs=1e-3)


def test_a_joint_sticks_while_the_current_cannot_move_it():
    """A sudden load bends a bristle twice as far as a slow one: to 1 mrad at 60.2 N m."""
    stuck = {**RIGID, **MOTOR, 'motor.coulomb_friction': 60.2}
    simulator = timo_sim.Simulator(timo_sim.load_scene({}, stuck))
    assert 0.0 < simulator.step(duration=0.2, voltage=500.0).shaft < 1e-3
    loose = timo_sim.load_scene({}, {**stuck, 'motor.coulomb_friction': 29.9})
    simulator = timo_sim.Simulator(loose)
    early, late = (simulator.step(duration=0.2, voltage=500.0).shaft_velocity for _ in range(2))
    assert late - early == pytest.approx(0.2 * 0.1 / inertia_of(loose), rel=1e-9)


def test_linear_models_and_equilibria():
    """About states below the limit they are those without it; others are no equilibria."""
    scene = timo_sim.load_scene({}, {
        **MOTOR, **HELD, 'motor.dc.current_limit': 0.1, 'gravity': [9.81, 0.0],
        'load.torque.piecewise.time': [0.0], 'load.torque.piecewise.value': [0.2],
        'initial.equilibrium': True})
    found, expected = (timo_sim.linearize(each) for each in (scene, scene.vary(UNLIMITED)))
    for name in ('A', 'B', 'C', 'D', 'equilibrium'):
        assert np.array_equal(getattr(found, name), getattr(expected, name))
    beyond = scene.vary({'load.torque.piecewise.value': [40.0]})
    at_limit = scene.vary({'load.torque.piecewise.value': [0.3], **UNLIMITED})
    assert beyond.initial_motion() == pytest.approx(at_limit.initial_motion(), abs=1e-9)
    with pytest.raises(timo_sim.ParameterError, match='about an equilibrium'):
        timo_sim.linearize(beyond)


def test_derivatives_of_steps_are_differences_on_either_side():
    """By motion and torque; at the limit a torque does nothing, and the back-EMF either."""
    scene = timo_sim.load_scene({}, {**MOTOR, **HELD, **BUILDS_UP, 'initial.shaft_velocity': 0.5})
    for torque, moves in ((80.0, False), (25.0, True)):
        def end(start, torque=torque):
            simulator = timo_sim.Simulator(scene)
            simulator.set_motion(start)
            return simulator.step(duration=0.003, torque=torque).values

        simulator, start = timo_sim.Simulator(scene), scene.initial_motion()
        found = simulator.step_derivatives(['torque'], duration=0.003, torque=torque)
        half = len(start) // 2
        for k in (2, half + 2, 3, half + 3):
            change = 1e-5 * np.eye(len(start))[k]
            expected = (end(start + change) - end(start - change)) / 2e-5
            assert found.by_motion[:, k] == pytest.approx(expected, rel=1e-6, abs=1e-6)
        expected = (end(start, torque + 1e-3) - end(start, torque - 1e-3)) / 2e-3
        assert found.by_input[:, 0] == pytest.approx(expected, rel=1e-6, abs=1e-12)
        assert found.by_input.any() == moves


def test_a_fit_finds_the_limit():
    arm = {**MOTOR, **HELD, 'model.modes': 1, 'integrator.step': 0.002, **BUILDS_UP}
    t = 0.002 * np.arange(1001)
    voltage = 8.0 * np.sign(np.sin(5.0 * t)) + 4.0 * np.sin(17.0 * t)
    truth = timo_sim.load_scene(arm)
    simulator, shaft = timo_sim.Simulator(truth), [0.0]
    for value in voltage[:-1]:
        shaft.append(float(simulator.step(voltage=value).shaft))
    record = timo_sim.Record.of({'voltage': (t, voltage)}, {'shaft': (t, np.array(shaft))})
    found = timo_sim.fit(truth.vary({'motor.dc.current_limit': 7.0}), record,
                         ['motor.dc.current_limit'])
    assert found.values['motor.dc.current_limit'] == pytest.approx(10.0, rel=1e-4)
    with pytest.raises(timo_sim.ParameterError,
                       match='motor.dc.current_limit must be finite to be free, got inf'):
        timo_sim.fit(truth.vary(UNLIMITED), record, ['motor.dc.current_limit'])


def test_a_shaft_that_is_not_free_has_no_limit_and_a_limit_needs_the_torque_constant():
    scene = timo_sim.load_scene({}, {**MOTOR, **HELD, 'motor.shaft': 'locked'})
    simulator = timo_sim.Simulator(scene)
    simulator.step(torque=100.0)
    assert simulator.snapshot().effort[2] == pytest.approx(-100.0, rel=1e-12)
    with pytest.raises(timo_sim.ParameterError, match=(
            'motor.dc.torque_constant must be > 0 N m/A with motor.dc.current_limit = 2 A')):
        timo_sim.load_scene({'motor.dc.current_limit': 2.0})
