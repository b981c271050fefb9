# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Dry friction with presliding: closed forms, limits, an integration that stops at each event."""

import math
import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from oracles.energy import balance, inertia_of
import timo_sim
from timo_sim.model.layout import FORCE_X, FORCE_Y, LOADS, SHAFT_FRICTION, TORQUE
from timo_sim.simulation.simulator import Simulator

LIMIT, REACH = 2.0, 0.01
SHAFT = {'motor.coulomb_friction': LIMIT, 'motor.coulomb_presliding': REACH}
RIGID = {'model.modes': 0, 'carrier.held': 'both', 'initial.shaft': 0.0, **SHAFT}
# The carrier slides on its bristles, and the arm vibrates.
LIVELY = {**SHAFT, 'carrier.coulomb_friction': 4.0, 'carrier.coulomb_presliding': 0.004,
          'initial.carrier_x_velocity': 0.1, 'initial.carrier_y_velocity': -0.05,
          'initial.shaft_velocity': 0.2}
GEAR = {'motor.gear.stiffness': 300.0, 'motor.gear.damping': 0.5, 'motor.rotor.inertia': 0.05,
        'motor.dc.gear_ratio': 5.0, 'motor.rotor.coulomb_friction': 0.3,
        'motor.rotor.coulomb_presliding': 0.05, **SHAFT}
SHAKEN = {'load.torque.harmonic.amplitude': [6.0], 'load.torque.harmonic.frequency': [1.1],
          'load.force_x.harmonic.amplitude': [9.0], 'load.force_x.harmonic.frequency': [1.7]}


def by_events(rate, places, start, bristles, until, times):
    """
    Return states at times, (n, m), by DOP853 that stops where a bristle is full or a joint turns.

    `rate(t, state, friction)` is the rate of the states, `places(state)` are places and speeds of
    the joints, `bristles` their limits forward and backward and their reach.
    """
    forward, backward, reach = np.array(bristles).T
    t, state, found = 0.0, np.array(start), np.empty((len(times), len(start)))
    # side: 0 in the bristle, +-1 sliding, as of joints that move at the start
    anchor, speed = places(state)
    side = np.sign(speed) * (np.abs(speed) > 1e-9)

    def friction(state):
        deflection = np.where(side != 0.0, side * reach, places(state)[0] - anchor)
        return np.where(deflection > 0.0, forward, backward) * deflection / reach

    def event(number, way):
        def full(_, state):
            return places(state)[0][number] - anchor[number] - way * reach[number]

        def turning(_, state):
            return places(state)[1][number]
        function = turning if side[number] else full
        function.terminal = True
        function.direction = -side[number] if side[number] else way
        return function

    while t < until:
        events = [(k, way) for k in range(len(reach))
                  for way in ([side[k]] if side[k] else [-1.0, 1.0])]
        part = solve_ivp(lambda t, state: rate(t, state, friction(state)), (t, until), state,
                         'DOP853', rtol=1e-11, atol=1e-13, dense_output=True, max_step=0.02,
                         events=[event(*each) for each in events])
        inside = (times >= t) & (times <= part.t[-1])
        if inside.any():
            found[inside] = part.sol(times[inside]).T
        t, state = part.t[-1], part.y[:, -1]
        for (number, way), seen in zip(events, part.t_events):
            if len(seen) and side[number]:
                anchor[number] = places(state)[0][number] - side[number] * reach[number]
                side[number] = 0.0
            elif len(seen):
                side[number] = way
    return found


def by_events_of_scene(scene, until, times):
    """Return motions by the equations without friction, which is added to the load."""
    none = {name: 0.0 for name, value in scene.values.items()
            if 'coulomb' in name and not name.endswith('static') and value}
    simulator = Simulator(scene.vary(none))
    model, half = simulator.model, simulator.model.size // 2
    joints = model.joint_turns
    rows = np.flatnonzero(scene.bristles[:, 2])
    columns = np.array([FORCE_X, FORCE_Y, TORQUE, SHAFT_FRICTION])[rows]

    def places(state):
        motion = simulator.integration.motion(state, np.zeros(LOADS))
        return motion[:half] @ joints[:, rows], motion[half:] @ joints[:, rows]

    def rate(t, state, friction):
        load = np.zeros(LOADS)
        for name, column in (('torque', TORQUE), ('force_x', FORCE_X)):
            for amplitude, frequency in zip(
                    scene.values[f'load.{name}.harmonic.amplitude'],
                    scene.values[f'load.{name}.harmonic.frequency']):
                load[column] += amplitude * math.sin(2.0 * math.pi * frequency * t)
        load[columns] -= friction
        return model.rate(state, load)

    states = by_events(rate, places, model.state(scene.initial_motion()),
                       scene.bristles[rows, :3], until, times)
    return np.array([simulator.integration.motion(each, np.zeros(LOADS)) for each in states])


def order(steps, errors):
    """Return the slope of errors over steps in logarithms."""
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_small_motions_are_those_of_a_spring(formulation):
    scene = timo_sim.load_scene({}, {
        **RIGID, 'model.formulation': formulation, 'integrator.step': 0.005,
        'load.torque.piecewise.time': [0.0], 'load.torque.piecewise.value': [0.4 * LIMIT]})
    run = timo_sim.simulate(scene, 20.0, estimate=False)
    omega = math.sqrt(LIMIT / REACH / inertia_of(scene))
    wanted = 0.4 * REACH * (1.0 - np.cos(omega * run.t))
    # Measured: 7e-10 rad, and the order.
    np.testing.assert_allclose(run.shaft, wanted, rtol=0.0, atol=2e-9)
    steps = [0.08, 0.04, 0.02]
    errors = [np.abs(timo_sim.simulate(
        scene.vary({'integrator.step': step}), 20.0, sample_every=round(0.08 / step),
        estimate=False).shaft - wanted[::16]).max() for step in steps]
    assert 3.9 < order(steps, errors) < 4.1
    spring = 0.5 * LIMIT / REACH * run.shaft**2  # no heat
    np.testing.assert_allclose(run.friction_heat, spring, rtol=0.0, atol=1e-15)


def test_a_slow_cycle_is_a_loop_of_the_bristle_and_what_it_takes_is_heat():
    """A pendulum under a slow torque: T = m g l sin(angle) + friction, both ways."""
    period, torque, weight = 1600.0, 12.0, 9.81
    scene = timo_sim.load_scene({}, {
        **RIGID, 'motor.coulomb_presliding': 0.03, 'initial.shaft': -0.5 * math.pi,
        'gravity': [0.0, -weight], 'integrator.step': 0.02,
        'load.torque.harmonic.amplitude': [torque],
        'load.torque.harmonic.frequency': [1.0 / period]})
    run = timo_sim.simulate(scene, 1.75 * period, sample_every=5, estimate=False)
    moment = 2710.0 * 4e-4 * 2.0**2 / 2.0 + 2.0 * 2.0
    angle, far = run.shaft + 0.5 * math.pi, math.asin((torque - LIMIT) / (moment * weight))
    friction = torque * np.sin(2.0 * np.pi * run.t / period) - moment * weight * np.sin(angle)
    # From the second peak at 1.25 periods the bristle bends back, then the joint slides.
    back = (run.t > 1.25 * period) & (run.t < 1.7 * period)
    wanted = np.maximum(LIMIT - (far - angle) * LIMIT / 0.03, -LIMIT)
    # Starts and ends of slides excite swings of the square of 2 pi / period over 2 rad/s.
    assert np.abs(friction - wanted)[back].max() < 0.01 * LIMIT
    heat = run.friction_heat[np.searchsorted(run.t, [0.75 * period, 1.75 * period])]
    assert np.diff(heat)[0] == pytest.approx(2.0 * LIMIT * (2.0 * far - 2.0 * 0.03), rel=2e-3)


@pytest.mark.parametrize('more', [
    {}, {'model.formulation': 'newton'}, {'motor.coulomb_asymmetry': 0.4},
    {'motor.coulomb_static': 1.3, 'motor.coulomb_speed': 0.2}], ids=str)
def test_stick_slip_is_of_second_order(more):
    """Against an integration that stops at each event, with and without Stribeck's effect."""
    scene = timo_sim.load_scene({}, {**RIGID, 'load.torque.harmonic.amplitude': [3.0],
                                     'load.torque.harmonic.frequency': [1.1], **more})
    inertia, uneven = inertia_of(scene), scene.values['motor.coulomb_asymmetry']
    more_at_rest = scene.values['motor.coulomb_static'] - 1.0

    def rate(t, state, friction):
        share = 1.0 + more_at_rest / (1.0 + (state[1] / 0.2)**2)
        return [state[1], (3.0 * math.sin(2.2 * math.pi * t) - share * friction[0]) / inertia]

    times, steps = np.arange(0.0, 3.001, 0.04), 0.04 * 0.5**np.arange(6)
    truth = by_events(rate, lambda state: (state[:1], state[1:]), [0.0, 0.0], [
        [LIMIT * (1.0 + uneven), LIMIT * (1.0 - uneven), REACH]], 3.0, times)[:, 0]
    errors = [np.abs(timo_sim.simulate(
        scene.vary({'integrator.step': step}), 3.0, sample_every=round(0.04 / step),
        estimate=False).shaft - truth).max() for step in steps]
    # Events fall anywhere in their steps: errors are 0.002 to 0.036 h^2.
    assert np.all(errors < 0.06 * steps**2) and order(steps, errors) > 1.8


@pytest.mark.parametrize('more', [
    {}, {'model.formulation': 'newton'}, {**GEAR}, {'carrier.held': 'x', 'model.axial_modes': 1},
    {'carrier.held': 'both', **GEAR, 'model.axial_modes': 1, 'motor.rotor.coulomb_asymmetry': 0.5},
], ids=str)
def test_all_joints_follow_an_integration_that_stops_at_each_event(more):
    start = {name: value for name, value in LIVELY.items() if not (
        more.get('carrier.held') and name.startswith('initial.carrier'))}
    scene = timo_sim.load_scene({}, {
        'arm.damping_ratio': [0.02], **SHAKEN, **start, **more})
    times, steps, errors = np.arange(0.0, 1.001, 0.02), [0.004, 0.002, 0.001, 0.0005, 0.00025], []
    truth = by_events_of_scene(scene, 1.0, times)
    slides = np.abs(np.diff(truth[:, 0 if 'carrier.held' not in more else 2])).sum()
    assert slides > 5.0 * REACH
    for step in steps:
        run = timo_sim.simulate(scene.vary({'integrator.step': step}), 1.0,
                                sample_every=round(0.02 / step), estimate=False)
        errors.append(np.abs(run.values - truth)[:, :3].max())
    # Events fall anywhere in their steps: errors are 0.005 to 0.13 h^2.
    assert np.all(errors < 0.25 * np.square(steps))


@pytest.mark.parametrize('more', [0.0, 0.6, -0.5])
def test_a_shaft_coasts_as_the_closed_form_says_with_and_without_stribeck(more):
    """It has slid before, so that even the first step is that of friction in full."""
    first, slow = 0.5, 0.1
    scene = timo_sim.load_scene({}, {
        **RIGID, 'initial.shaft_velocity': first, 'motor.coulomb_presliding': 1e-5,
        'motor.coulomb_speed': slow, 'motor.coulomb_static': 1.0 + more})
    run = timo_sim.simulate(scene, 1.5, estimate=False)

    def until(speed):
        """Return the integral of 1 / (1 + more / (1 + (speed / slow)^2)) over the speed."""
        root = math.sqrt(1.0 + more)
        return speed - more * slow / root * np.arctan(speed / slow / root)
    passed = inertia_of(scene) / LIMIT * (until(first) - until(run.shaft_velocity))
    assert run.shaft_velocity[-1] > 0.1 * first
    assert np.abs(passed - run.t).max() < (3e-7 if more else 1e-12)


@pytest.mark.parametrize('modes', [0, 3])
def test_a_joint_at_rest_does_not_creep(modes):
    """In an hour under nine tenths of the friction, with which it begins in motion."""
    scene = timo_sim.load_scene({}, {
        'model.modes': modes, 'carrier.coulomb_friction': 2.0, 'motor.coulomb_friction': 1.0,
        'initial.carrier_x': 0.3, 'integrator.step': 0.01, 'arm.damping_ratio': modes * [0.02]})
    simulator, load = Simulator(scene), np.zeros(LOADS)
    load[[FORCE_X, FORCE_Y, TORQUE]] = 1.8, -1.35, 0.9
    motions, _ = simulator.advance(360000, load, sample_every=1000)
    settled = motions[1:, :3]
    assert np.all(np.ptp(settled, axis=0) < [1e-4, 1e-4, 1e-3])
    assert np.all(np.abs(settled - motions[0, :3]) < [1e-3, 1e-3, 1e-2])


@pytest.mark.parametrize('more', [{}, GEAR], ids=str)
def test_energy_and_what_friction_takes_are_the_work_of_the_loads(more):
    scene = timo_sim.load_scene({}, {**LIVELY, **more})
    load, steps, errors = np.zeros(LOADS), [0.004, 0.002, 0.001], []
    load[[FORCE_X, FORCE_Y, TORQUE]] = 3.0, -5.0, 4.0
    for step in steps:
        simulator = Simulator(scene.vary({'integrator.step': step}))
        motions, heat = simulator.advance(round(2.0 / step), load, sample_every=1)
        model = simulator.model
        energy, places = model.energy(motions), motions[:, :model.size // 2] @ model.joint_turns
        work = (places - places[0])[:, :3] @ load[[FORCE_X, FORCE_Y, TORQUE]]
        damped = np.append(0.0, np.cumsum(0.5 * step * (
            model.dissipation(motions)[1:] + model.dissipation(motions)[:-1])))
        errors.append(np.abs(energy - energy[0] + heat + damped - work).max())
        assert heat[-1] > 0.3
    # Measured: 0.15 to 0.35 h^2, in J/s^2.
    assert np.all(errors < 0.7 * np.square(steps))


def test_the_balance_of_energy_closes():
    run = timo_sim.simulate(timo_sim.load_scene({}, {**LIVELY, **SHAKEN}), 2.0, estimate=False)
    assert np.abs(balance(run)).max() < 1e-5


@pytest.mark.parametrize('more', [
    {}, GEAR, {**GEAR, 'model.axial_modes': 1, 'carrier.held': 'x'}], ids=str)
def test_the_linear_model_has_the_springs_of_the_bristles(more):
    """Within presliding a run is the step response of the linear model, sensors included."""
    still = {name: value for name, value in LIVELY.items() if 'initial' not in name}
    scene = timo_sim.load_scene({}, {**still, 'initial.shaft': 0.4, **more})
    with pytest.warns(timo_sim.ModelWarning, match='motions within coulomb_presliding'):
        linear = timo_sim.linearize(scene).select(['torque_N_m'])
    torque, duration = 1e-3, 0.3
    discrete = linear.to_discrete(duration)
    wanted = discrete.B[:, 0] * torque
    simulator = Simulator(scene)
    motion = simulator.step(torque=torque, duration=duration)
    change = (motion.values - linear.equilibrium)[linear.places]
    # What is of second order in the motion.
    assert np.abs(change - wanted).max() < 1e-5 * np.abs(wanted).max()
    shown = dict(zip(linear.outputs, linear.C @ wanted + linear.D[:, 0] * torque))
    strain = next(value for name, value in shown.items() if 'strain' in name)
    assert simulator.sensors.root_strain == pytest.approx(strain, rel=1e-5)


@pytest.mark.parametrize('scene', [RIGID, {**SHAFT, **GEAR}, LIVELY], ids=str)
def test_steps_too_long_for_the_spring_are_refused(scene):
    stiff = {**scene, 'motor.coulomb_presliding': 1e-8, 'motor.rotor.coulomb_presliding': 0.0,
             'carrier.coulomb_presliding': 0.0}
    with pytest.raises(timo_sim.ParameterError, match='integrator.step = 0.001 s must be at most '
                       '.* s for Coulomb friction with so small a presliding: take') as caught:
        timo_sim.load_scene({}, stiff)
    step, factor = map(float, re.search('most (.*) s for .* coulomb_presliding (.*) times', str(
        caught.value)).groups())
    timo_sim.load_scene({}, {**stiff, 'motor.coulomb_presliding': 1e-8 * 1.01 * factor})
    # At the limit it swings without a gain of energy, and a rigid arm with that of the stages.
    simulator = Simulator(timo_sim.load_scene({}, {
        **stiff, 'integrator.step': step, **{name: 0.0 for name in scene if 'velocity' in name},
        'initial.shaft_velocity': 1e-6}))
    simulator.integration.memory[:] = 0.0
    motions, heat = simulator.advance(2000, sample_every=1)
    energy = simulator.model.energy(motions)
    energy = (energy + heat) / energy[0]
    assert np.all(energy < 1.001)
    if scene == RIGID:  # of amplitude 5e-4 a step at the limit, the step is 0.99 of it
        assert -np.log(energy[-1]) / 2.0 / 2000.0 == pytest.approx(0.99**6 * 5e-4, rel=0.05)


@pytest.mark.parametrize('values, told', [
    ({**SHAFT, 'motor.coulomb_static': 2.0},
     'motor.coulomb_static = 2 needs motor.coulomb_speed '),
    ({'carrier.coulomb_static': 0.5, 'carrier.coulomb_speed': 1.0},
     'carrier.coulomb_static = 0.5 needs carrier.coulomb_speed and carrier.coulomb_presliding'),
    ({'motor.rotor.coulomb_presliding': 0.1}, 'motor.rotor.coulomb_presliding needs motor.gear.')])
def test_what_does_not_fit_together_is_refused(values, told):
    with pytest.raises(timo_sim.ParameterError, match=re.escape(told)):
        timo_sim.load_scene({}, values)


@pytest.mark.parametrize('more', [
    {}, {'model.formulation': 'newton'},
    {**GEAR, 'model.axial_modes': 1, 'motor.coulomb_asymmetry': 0.4, 'motor.coulomb_static': 1.6,
     'motor.coulomb_speed': 0.05}], ids=str)
def test_a_batch_does_what_a_simulator_does(more):
    """One lane is without friction of the shaft; bits depend on its own numbers alone."""
    scene = timo_sim.load_scene({}, {**LIVELY, **SHAKEN, 'model.modes': 1, **more})
    scenes = [scene.vary({'motor.coulomb_friction': limit, 'arm.length': 2.0 + 0.01 * limit})
              for limit in np.linspace(1.0, 3.0, 9)]
    scenes[3] = scene.vary({f'motor.coulomb_{name}': 0.0 for name in (
        'friction', 'presliding', 'asymmetry', 'speed')} | {'motor.coulomb_static': 1.0})
    batch = timo_sim.Batch(scenes)
    motions = batch.advance(1000, sample_every=100)
    for number in (0, 3, 8):
        found, heat = Simulator(scenes[number]).advance(1000, sample_every=100)
        assert np.abs(motions[number] - found).max() < 1e-11
        assert batch.friction_heat[number] == pytest.approx(heat[-1], rel=1e-11)
    # Lanes with the same body have other code, which is compiled for one scene.
    alone = timo_sim.Batch(scenes[8:] + scenes[:bool(more)])
    for _ in range(10):
        alone.advance(100)
    assert np.array_equal(alone.motion.values[0], motions[8, -1])
    batch.reset(np.arange(9) == 8)
    assert np.array_equal(batch.advance(1000, sample_every=100)[8], motions[8])
