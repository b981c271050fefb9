# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Coulomb friction against closed forms, other integrators, a locked shaft and conservation."""

import math
import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from oracles.energy import balance
import timo_sim
from timo_sim.model.layout import FORCE_X, FORCE_Y, LOADS, TORQUE
from timo_sim.simulation.simulator import Simulator
from timo_sim.steps.bristles import HEAT

# The paper's manipulator with a rigid arm: mass of all, static moment and inertia about the shaft.
DENSITY, LENGTH, AREA, SECOND_MOMENT = 2710.0, 2.0, 4e-4, 0.02**4 / 12.0
MASS = 10.0 + DENSITY * AREA * LENGTH + 2.0
MOMENT = DENSITY * AREA * LENGTH**2 / 2.0 + 2.0 * LENGTH
INERTIA = (2.0 + DENSITY * (AREA * LENGTH**3 / 3.0 + SECOND_MOMENT * LENGTH)
           + 2.0 * LENGTH**2 + 0.5)
STUCK = {'model.modes': 0, 'carrier.coulomb_friction': 1e3}  # the carrier always sticks
ALL = {'carrier.coulomb_friction': 2.0, 'motor.coulomb_friction': 1.0}
# All three joints slide, stop, stick and break away, and the arm vibrates.
LIVELY = {'carrier.coulomb_friction': 12.0, 'motor.coulomb_friction': 15.0,
          'initial.carrier_x_velocity': 0.1, 'initial.carrier_y_velocity': -0.05,
          'initial.shaft_velocity': 0.1, 'initial.modal_coordinates': [0.1, 0.01, 0.0]}
PUSHES = np.array([6.0, -7.0, 9.0])


def loaded(pushes):
    """Return a load with forces x, y on the carrier and a torque on the shaft."""
    load = np.zeros(LOADS)
    load[[FORCE_X, FORCE_Y, TORQUE]] = pushes
    return load


def order(steps, errors):
    """Return the slope of errors over steps in logarithms."""
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_a_rigid_arm_speeds_up_coasts_to_rest_and_stays(formulation):
    step, torque, limit, jump = 0.001, 3.0, 1.9, 1.2
    run = timo_sim.simulate(timo_sim.load_scene({}, {
        **STUCK, 'model.formulation': formulation, 'motor.coulomb_friction': limit,
        'integrator.step': step, 'initial.shaft': 0.0, 'load.torque.piecewise.time': [0.0, jump],
        'load.torque.piecewise.value': [torque, 0.0]}), 4.0, estimate=False)
    faster, slower = (torque - limit) / INERTIA, limit / INERTIA
    rest = jump + jump * faster / slower  # in the middle of a step
    coasting = np.clip(run.t, jump, rest) - jump
    angle = (0.5 * faster * np.minimum(run.t, jump)**2 + jump * faster * coasting
             - 0.5 * slower * coasting**2)
    over = run.t > rest + step
    # The carrier may give way by less than 1e-12 m in a step: measured 1.4e-11 in the angle.
    assert np.abs(run.shaft - angle).max() < 2e-11
    assert np.ptp(run.shaft[over]) == 0.0 and np.abs(run.shaft_velocity[over]).max() < 1e-16
    assert abs(run.friction_heat[-1] - torque * run.shaft[np.searchsorted(run.t, jump)]) < 1e-12


def test_a_sudden_stop_leaves_the_arm_the_right_vibration():
    """The shaft stops within 3 ms; the reference has short steps, then a locked shaft."""
    values = {'motor.coulomb_friction': 3e3, 'initial.shaft_velocity': 1.0}
    stopped = timo_sim.simulate(timo_sim.load_scene({}, {**values, 'integrator.step': 1e-4}), 0.1,
                                estimate=False)
    last, half = stopped.values[-1], stopped.values.shape[1] // 2
    locked = timo_sim.simulate(timo_sim.load_scene({}, {
        'motor.shaft': 'locked', **dict(zip(
            ('initial.carrier_x', 'initial.carrier_y', 'initial.shaft'), last)), **dict(zip(
                ('initial.carrier_x_velocity', 'initial.carrier_y_velocity'), last[half:])),
        'initial.modal_coordinates': last[3:half], 'initial.modal_rates': last[half + 3:]}), 0.9,
        sample_every=10, estimate=False)
    steps, errors, angles = np.array([0.01, 0.005, 0.0025]), [], []
    for step in steps:
        run = timo_sim.simulate(timo_sim.load_scene({}, {**values, 'integrator.step': step}), 1.0,
                                sample_every=round(0.01 / step), estimate=False)
        errors.append(np.abs(run.q[10:] - locked.q).max())
        angles.append(np.abs(run.shaft[10:] - last[2]).max())
    # Measured: 8e-4 and 2e-4 at 10 ms; friction constant over the step would give about 3e-3.
    assert max(errors) < 1.5e-3 and max(angles) < 4e-4
    assert order(steps, errors) > 2.8 and order(steps, angles) > 2.8


@pytest.mark.parametrize('formulation, modes', [('exact', 0), ('exact', 3), ('newton', 3)])
def test_loads_below_the_limits_of_friction_move_no_joint(formulation, modes):
    simulator = Simulator(timo_sim.load_scene({}, {
        **ALL, 'model.modes': modes, 'model.formulation': formulation,
        'initial.carrier_x': 0.3}))
    start, pushes = simulator.motion.values, np.array([1.99, -1.5, 0.99])
    motions, _ = simulator.advance(10000, loaded(pushes), sample_every=1)
    # To the last bit; coordinates that are 0 have round-off, measured 3e-17 and 2e-17.
    np.testing.assert_array_equal(motions[:, [0, 2]], np.tile(start[[0, 2]], (10001, 1)))
    np.testing.assert_allclose(motions, np.tile(start, (10001, 1)), rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(simulator.integration.memory[:3], -pushes, rtol=1e-11)


def stick_slip(torque, frequency, limit, times):
    """Return angles of a rigid arm under a harmonic torque, in closed form piece by piece."""
    w, fine = 2.0 * math.pi * frequency, 1e-3 / frequency

    def speed(t, begin, side):
        return (torque * (math.cos(w * begin) - math.cos(w * t)) / w
                - limit * side * (t - begin)) / INERTIA

    def angle(t, begin, side):
        return (torque * (np.cos(w * begin) * (t - begin)
                          - (np.sin(w * t) - np.sin(w * begin)) / w) / w
                - 0.5 * limit * side * (t - begin)**2) / INERTIA

    def excess(t):
        return abs(torque * math.sin(w * t)) - limit

    t, place, found = 0.0, 0.0, np.zeros(len(times))
    while t < times[-1]:
        found[times >= t] = place
        if excess(t) <= 0.0:  # at rest until the torque is large enough
            end = t + fine
            while excess(end) <= 0.0:
                end += fine
            t = brentq(excess, t, end, xtol=1e-15)
        side, end = math.copysign(1.0, math.sin(w * t)), t + fine
        while speed(end, t, side) * side > 0.0:
            end += fine
        end = brentq(speed, end - fine, end, args=(t, side), xtol=1e-15)
        sliding = times >= t
        found[sliding] = place + angle(times[sliding], t, side)
        place += angle(end, t, side)
        t = end
    return found


@pytest.mark.parametrize('limit', [0.5, 2.0])  # turns round at once; sticks first
def test_turning_round_and_stick_slip_are_of_second_order(limit):
    times, steps, errors = np.arange(0.0, 3.001, 0.02), 0.02 * 0.5**np.arange(8), []
    truth = stick_slip(3.0, 1.1, limit, times)
    for step in steps:
        run = timo_sim.simulate(timo_sim.load_scene({}, {
            **STUCK, 'motor.coulomb_friction': limit, 'integrator.step': step,
            'load.torque.harmonic.amplitude': [3.0], 'load.torque.harmonic.frequency': [1.1]}),
            3.0, sample_every=round(0.02 / step), estimate=False)
        errors.append(np.abs(run.shaft - run.shaft[0] - truth).max())
    # Events fall anywhere in their steps: errors are 0.03 to 0.31 h^2.
    assert np.all(errors < 0.6 * steps**2) and 1.7 < order(steps, errors) < 2.3


def test_friction_of_shaft_and_carrier_against_another_integrator():
    """Radau integrates the rigid arm's equations, with a steep hyperbolic tangent for friction."""
    limits, smooth, frequencies = np.array([2.0, 2.0, 1.0]), 1e-8, np.array([2.0, 3.0, 4.0])

    def rate(t, state):
        theta, speeds = state[2], state[3:]
        c, s = MOMENT * math.cos(theta), MOMENT * math.sin(theta)
        matrix = np.array([[MASS, 0.0, -s], [0.0, MASS, c], [-s, c, INERTIA]])
        force = 5.0 * np.sin(2.0 * np.pi * frequencies * t) - limits * np.tanh(speeds / smooth)
        force[:2] += speeds[2]**2 * np.array([c, s])
        return np.concatenate([speeds, np.linalg.solve(matrix, force)])

    times = np.linspace(0.0, 1.0, 51)
    start = np.array([0.0, 0.0, 0.7, 0.3, -0.2, 0.5])
    truth = solve_ivp(rate, (0.0, 1.0), start, 'Radau', times, rtol=1e-10, atol=1e-12).y.T
    values = {**ALL, 'model.modes': 0}
    for k, (joint, load) in enumerate((
            ('carrier_x', 'force_x'), ('carrier_y', 'force_y'), ('shaft', 'torque'))):
        values |= {f'initial.{joint}': start[k], f'initial.{joint}_velocity': start[3 + k],
                   f'load.{load}.harmonic.amplitude': [5.0],
                   f'load.{load}.harmonic.frequency': [frequencies[k]]}
    for step in 0.02, 0.01, 0.005:
        scene = timo_sim.load_scene({}, values).vary({'integrator.step': step})
        run = timo_sim.simulate(scene, 1.0,
                                sample_every=round(0.02 / step), estimate=False)
        # Measured: 7e-7 m or rad at 20 ms, 5e-8 at the others.
        assert np.abs(run.values - truth)[:, :3].max() < 2e-6


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_a_shaft_held_by_friction_is_like_a_locked_one(formulation):
    slew = timo_sim.load_scene({'model.formulation': formulation, 'motor.coulomb_friction': 90.0,
                                'initial.shaft_velocity': 0.4})
    stopped = timo_sim.simulate(slew, 0.2, estimate=False)
    last, half = stopped.values[-1], stopped.values.shape[1] // 2
    begin = {'initial.carrier_x': last[0], 'initial.carrier_y': last[1], 'initial.shaft': last[2],
             'initial.modal_coordinates': last[3:half], 'initial.carrier_x_velocity': last[half],
             'initial.carrier_y_velocity': last[half + 1], 'initial.shaft_velocity': 0.0,
             'initial.modal_rates': last[half + 3:]}
    locked = timo_sim.simulate(timo_sim.load_scene({}, {
        'model.formulation': formulation, **begin, 'motor.shaft': 'locked'}), 2.0,
        sample_every=4, estimate=False)
    steps, errors = [0.004, 0.002, 0.001], []
    for step in steps:
        held = timo_sim.simulate(slew.vary({**begin, 'integrator.step': step}), 2.0,
                                 sample_every=round(0.004 / step), estimate=False)
        errors.append(np.abs(held.q - locked.q).max())
        # This is the effect of a slope of 1e-9 of the limit; measured: 2.5e-11.
        assert np.abs(held.shaft_velocity).max() < 1e-10
        # It may give way by less than 1e-12 in a step.
        assert np.ptp(held.shaft) < 1e-10
    assert np.abs(locked.q).max() > 0.1 and errors[-1] < 1e-8
    assert 3.9 < order(steps, errors) < 4.1


def test_energy_and_heat_are_the_work_of_the_loads():
    steps, errors = [0.01, 0.005, 0.0025], []
    for step in steps:
        simulator = Simulator(timo_sim.load_scene({}, {**LIVELY, 'integrator.step': step}))
        motions, heat = simulator.advance(round(2.0 / step), loaded(PUSHES), sample_every=1)
        energy = simulator.model.energy(motions)
        work = (motions[:, :3] - motions[0, :3]) @ PUSHES
        errors.append(np.abs(energy - energy[0] + heat - work).max())
        assert heat[-1] == simulator.integration.memory[HEAT] > 0.8
    # Events do not lower the integrator's order; measured: 2e-7 J of 1.7 J at 2.5 ms.
    assert errors[-1] < 1e-6 and order(steps, errors) > 3.8


def test_each_step_obeys_the_law():
    simulator = Simulator(timo_sim.load_scene({}, {**LIVELY, 'integrator.step': 0.005}))
    limits, seen = simulator.scene.friction, np.zeros((3, 3), dtype=int)
    after = simulator.motion.values[6:9]
    for _ in range(800):
        simulator.advance(1, loaded(PUSHES))
        before, after = after, simulator.motion.values[6:9]
        r = simulator.integration.memory[:3].copy()
        # Joints that are about to break away may have 1e-6 rad/s; those that slide have 0.1.
        rests, came = np.abs(after) < 1e-5, np.abs(before) < 1e-5
        slides = (before * after > 0.0) & ~rests & ~came
        assert np.all(np.abs(r) <= limits * (1.0 + 1e-14))
        np.testing.assert_allclose(r[slides], -(limits * np.sign(after))[slides], rtol=1e-14)
        # A joint that breaks away moves against its friction.
        assert np.all((r * after)[came & ~rests] < 0.0)
        seen += [slides, rests & came, came & ~rests]
    assert np.all(seen >= 5), 'joints of this scene do not slide, stop and break away often enough'


def test_a_run_has_the_heat_of_its_samples():
    scene = timo_sim.load_scene({}, {**LIVELY, 'integrator.step': 0.005})
    fine, coarse = (timo_sim.simulate(scene, 6.0, every, estimate=False) for every in (1, 8))
    assert np.array_equal(coarse.friction_heat, fine.friction_heat[::8])
    assert fine.friction_heat[0] == 0.0 and fine.friction_heat[-1] > 0.1
    # The balance closes to the error of the steps, 5e-6 of 0.8 J.
    assert np.abs(balance(fine)).max() < 1.5e-5


def test_the_acceleration_of_the_tip_includes_friction():
    scene = timo_sim.load_scene({'model.modes': 0, 'motor.coulomb_friction': 5.0,
                                 'initial.shaft_velocity': 2.0})
    simulator, formulation = Simulator(scene), scene.build()
    motions, _ = simulator.advance(200, sample_every=1)
    found = simulator.snapshot().accelerations[1]
    motions = np.vstack([motions[-2:], simulator.advance(1, sample_every=1)[0][1:]])
    tip = formulation.world(motions, formulation.at([LENGTH]))[:, 0]
    second = (tip[0] - 2.0 * tip[1] + tip[2]) / scene.step**2
    # This is the error of the differences; friction makes a tenth of the acceleration.
    assert np.abs(found - second).max() < 1e-5
    _, without = formulation.accelerations(
        motions[1:2], formulation.state(motions[1:2]), simulator.load[np.newaxis])
    assert np.abs(without - found).max() > 0.5


LIGHT = {'motor.shaft_inertia': 0.01, 'motor.coulomb_friction': 30.0,
         'load.torque.harmonic.amplitude': [36.0], 'load.torque.harmonic.frequency': [0.3]}
THICK = {'arm.section.height': 0.2, 'motor.coulomb_friction': 1e4, 'carrier.coulomb_friction': 1e4,
         'initial.shaft_velocity': 1.0}


@pytest.mark.parametrize('scene, step, warned', [
    (LIGHT, 0.01, True), (LIGHT, 0.002, False), (THICK, 0.01, True), (THICK, 0.0005, False)])
def test_steps_that_cannot_hold_a_joint_give_a_warning(scene, step, warned):
    """A light shaft vibrates at 70 Hz, a thick arm faster: 10 ms are more than half a period."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', timo_sim.ModelWarning)
        run = timo_sim.simulate(timo_sim.load_scene({}, {**scene, 'integrator.step': step}), 1.0,
                                round(0.05 / step))
    assert ('take a smaller integrator.step' in (run.warning or '')) == warned
