# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Dry friction with little presliding: closed forms that stick, Radau, a locked shaft."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from oracles.energy import balance
import timo_sim
from timo_sim.model.layout import FORCE_X, FORCE_Y, LOADS, rotate, TORQUE
from timo_sim.simulation.simulator import Simulator
from timo_sim.simulation.snapshot import Joints
from timo_sim.steps.bristles import DEFLECTION

# The paper's manipulator with a rigid arm: mass of all, static moment and inertia about the shaft.
DENSITY, LENGTH, AREA, SECOND_MOMENT = 2710.0, 2.0, 4e-4, 0.02**4 / 12.0
MASS = 10.0 + DENSITY * AREA * LENGTH + 2.0
MOMENT = DENSITY * AREA * LENGTH**2 / 2.0 + 2.0 * LENGTH
INERTIA = (2.0 + DENSITY * (AREA * LENGTH**3 / 3.0 + SECOND_MOMENT * LENGTH)
           + 2.0 * LENGTH**2 + 0.5)
HELD = {'model.modes': 0, 'carrier.held': 'both', 'initial.shaft': 0.0}
SMALL = 1e-5  # way of presliding, so that friction is nearly that which sticks [m, rad]
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
    torque, limit, jump = 3.0, 1.9, 1.2
    run = timo_sim.simulate(timo_sim.load_scene({}, {
        **HELD, 'model.formulation': formulation, 'motor.coulomb_friction': limit,
        'motor.coulomb_presliding': SMALL, 'load.torque.piecewise.time': [0.0, jump],
        'load.torque.piecewise.value': [torque, 0.0]}), 4.0, estimate=False)
    faster, slower = (torque - limit) / INERTIA, limit / INERTIA
    rest = jump + jump * faster / slower
    coasting = np.clip(run.t, jump, rest) - jump
    angle = (0.5 * faster * np.minimum(run.t, jump)**2 + jump * faster * coasting
             - 0.5 * slower * coasting**2)
    # It begins later by the square root of its presliding, and swings on its bristle at the end.
    assert np.abs(run.shaft - angle).max() < 0.8 * math.sqrt(SMALL)
    assert np.ptp(run.shaft[run.t > rest + 0.02]) < 2.01 * SMALL
    work = torque * run.shaft[np.searchsorted(run.t, jump)]
    assert abs(run.friction_heat[-1] - work) < limit * SMALL


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
def test_with_little_presliding_it_is_friction_that_sticks(limit):
    times, ways = np.arange(0.0, 3.001, 0.02), 4e-4 * 0.5**np.arange(5)
    truth, errors = stick_slip(3.0, 1.1, limit, times), []
    for way in ways:
        run = timo_sim.simulate(timo_sim.load_scene({}, {
            **HELD, 'motor.coulomb_friction': limit, 'motor.coulomb_presliding': way,
            'integrator.step': 0.0005, 'load.torque.harmonic.amplitude': [3.0],
            'load.torque.harmonic.frequency': [1.1]}), 3.0, sample_every=40, estimate=False)
        errors.append(np.abs(run.shaft - truth).max())
    # By the swings on bristles that break away; measured: 0.07 to 0.23 of the root.
    assert np.all(errors < 0.4 * np.sqrt(ways))
    assert 0.3 < order(ways, errors) < 1.0


def test_friction_of_shaft_and_carrier_against_another_integrator():
    """Radau integrates the rigid arm's equations with a steep tangent; apart by presliding."""
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
    ways, errors = np.array([8e-5, 4e-5, 2e-5]), []
    for way in ways:
        scene = timo_sim.load_scene({}, {**values, 'carrier.coulomb_presliding': way,
                                         'motor.coulomb_presliding': way})
        run = timo_sim.simulate(scene, 1.0, sample_every=20, estimate=False)
        errors.append(np.abs(run.values - truth)[:, :3].max())
    # Measured: 0.08 of the root.
    assert np.all(errors < 0.15 * np.sqrt(ways))


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_a_shaft_held_by_friction_is_like_a_locked_one(formulation):
    slew = timo_sim.load_scene({}, {
        'model.formulation': formulation, 'motor.coulomb_friction': 90.0,
        'motor.coulomb_presliding': 1e-4, 'initial.shaft_velocity': 0.4})
    stopped = timo_sim.simulate(slew, 0.2, estimate=False)
    last, half = stopped.values[-1], stopped.values.shape[1] // 2
    begin = {'initial.carrier_x': last[0], 'initial.carrier_y': last[1], 'initial.shaft': last[2],
             'initial.modal_coordinates': last[3:half], 'initial.carrier_x_velocity': last[half],
             'initial.carrier_y_velocity': last[half + 1], 'initial.shaft_velocity': 0.0,
             'initial.modal_rates': last[half + 3:]}
    locked = timo_sim.simulate(slew.vary({**begin, 'motor.coulomb_friction': 0.0,
                                          'motor.shaft': 'locked'}), 2.0, estimate=False)
    ways, errors = np.array([4e-4, 2e-4, 1e-4]), []
    for way in ways:
        held = timo_sim.simulate(slew.vary({**begin, 'motor.coulomb_presliding': way}), 2.0,
                                 estimate=False)
        errors.append(np.abs(held.q - locked.q).max())
        assert np.ptp(held.shaft) < 2.0 * way
    assert np.abs(locked.q).max() > 0.09 and errors[-1] < 0.01
    assert 0.8 < order(ways, errors) < 1.2


def test_each_step_obeys_the_law():
    simulator = Simulator(timo_sim.load_scene({}, LIVELY))
    limits, reach = simulator.scene.bristles[:3, [0, 2]].T
    seen = np.zeros((2, 3), dtype=int)
    for _ in range(4000):
        simulator.advance(1, loaded(PUSHES))
        speed, memory = simulator.motion.values[6:9], simulator.integration.memory
        r, bent = memory[:3], memory[DEFLECTION:][:3] / reach
        np.testing.assert_allclose(r, -limits * bent, rtol=1e-14)
        assert np.all(np.abs(bent) <= 1.0)
        slides = np.abs(bent) == 1.0
        # A joint that slides moves against its friction, but for one that has just turned.
        assert np.all((speed * bent)[slides] > -1e-3)
        seen += [slides, ~slides]
    assert np.all(seen >= 50), 'joints of this scene do not slide and rest often enough'


def test_a_run_has_the_heat_of_its_samples():
    scene = timo_sim.load_scene({}, LIVELY)
    fine, coarse = (timo_sim.simulate(scene, 2.0, every, estimate=False) for every in (1, 8))
    assert np.array_equal(coarse.friction_heat, fine.friction_heat[::8])
    assert fine.friction_heat[0] == 0.0 and fine.friction_heat[-1] > 0.1
    # The balance closes to the error of the steps.
    assert np.abs(balance(fine)).max() < 5e-5


def test_the_acceleration_of_the_tip_includes_friction():
    scene = timo_sim.load_scene({'model.modes': 0, 'motor.coulomb_friction': 5.0,
                                 'initial.shaft_velocity': 2.0})
    simulator, formulation = Simulator(scene), scene.build()
    motions, _ = simulator.advance(200, sample_every=1)
    load = simulator.load[np.newaxis]
    found = np.array(rotate(simulator.motion.shaft, *simulator.sensors.tip_acceleration))
    motions = np.vstack([motions[-2:], simulator.advance(1, sample_every=1)[0][1:]])
    tip = formulation.world(motions, formulation.at([LENGTH]))[:, 0]
    second = (tip[0] - 2.0 * tip[1] + tip[2]) / scene.step**2
    # This is the error of the differences; friction makes a tenth of the acceleration.
    assert np.abs(found - second).max() < 1e-5
    without = Joints(formulation, motions[1:2], load).tip_acceleration[0]
    assert np.abs(rotate(motions[1, 2], *without) - found).max() > 0.5
