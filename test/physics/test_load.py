# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Loads at the stages of a step: values, sides of jumps, sums."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import BPoly

import timo_sim
from timo_sim.model.layout import (
    ACCELERATION, AFTER, ANGLE, END, FORCE_X, LOADS, STEP_LOADS, TORQUE)
from timo_sim.scene.loads import Drive, Harmonic, Load, Table
from timo_sim.simulation.loads import Actuators

STEP = 0.1


def seen(term, first, count):
    """Return what the stages of steps see of a term of a torque, shape (count, 3)."""
    return Load({'torque': (term,)}).stages(first, count, STEP)[:, :3, TORQUE]


def test_piecewise_gives_each_step_its_own_piece():
    # 0.3 = 3 x 0.1 only up to rounding: steps are counted, not compared as times.
    values = seen(Table((0.3, 0.3, 0.5, 0.5), (0.0, 4.0, 4.0, -1.0)), 2, 4)
    assert values.tolist() == [[0.0] * 3, [4.0] * 3, [4.0] * 3, [-1.0] * 3]


def test_table_jumps_where_a_time_is_given_twice():
    table = Table((0.0, 0.3, 0.3, 0.5), (0.0, 3.0, -3.0, -5.0))
    values = seen(table, 2, 2)
    assert values == pytest.approx(np.array([[2, 2.5, 3], [-3, -3.5, -4]]))
    assert table.jumps() == (0.3,)


def test_stages_do_not_depend_on_where_a_block_begins():
    terms = [Harmonic(1.0, 3.0, 0.1), Table((0.2, 0.2, 0.7, 0.7), (0.0, 1.0, 1.0, 2.0)),
             Table((0.0, 0.4, 0.4, 0.9), (0.0, 1.0, 2.0, 0.0)),
             Table((0.31, 0.33, 0.72), (1.0, 2.0, 0.0))]
    for term in terms:
        assert np.array_equal(seen(term, 0, 12)[5:], seen(term, 5, 7))


def test_sum_of_terms_on_a_channel():
    scene = timo_sim.load_scene({
        'integrator.step': STEP,
        'load.torque.harmonic.amplitude': [1.0, 2.0], 'load.torque.harmonic.frequency': [1.0, 2.0],
        'load.torque.piecewise.time': [0.2], 'load.torque.piecewise.value': [10.0],
        'load.torque.table.time': [0.0, 1.0], 'load.torque.table.value': [0.0, 1.0]})
    loads = scene.load.stages(3, 1, STEP)[0]
    times = np.array([0.3, 0.35, 0.4])
    expected = np.sin(2 * np.pi * times) + 2 * np.sin(4 * np.pi * times) + 10.0 + times
    assert loads[:3, TORQUE] == pytest.approx(expected)
    assert loads[AFTER, TORQUE] == loads[END, TORQUE] and not loads[:, :TORQUE].any()


@pytest.mark.parametrize('kind, time, value', [
    ('piecewise', [0.25], [1.0]), ('table', [0.0, 0.25, 0.25, 1.0], [0.0, 1.0, 2.0, 2.0])])
def test_a_jump_inside_a_step_is_refused_with_the_ratio(kind, time, value):
    with pytest.raises(timo_sim.ParameterError, match=(
            rf'load\.force_y\.{kind}\.time\[\d\] = 0.25 must be a whole multiple of '
            r'integrator\.step = 0.1, the ratio is 2.5')):
        timo_sim.load_scene({'integrator.step': STEP, f'load.force_y.{kind}.time': time,
                             f'load.force_y.{kind}.value': value})


def moments(values):
    """Return int s^j p ds, j = 0, 1, 2, of parabolas by their values at 0, 1/2, 1, (n, 3)."""
    # Rows are the powers of s in which the parabola is written, by its values.
    powers = np.array([[1.0, 0.0, 0.0], [-3.0, 4.0, -1.0], [2.0, -4.0, 2.0]]) @ values.T
    return np.array([[1.0 / (i + j + 1) for i in range(3)] for j in range(3)]) @ powers


def true_moments(function, breaks, step):
    """Return these moments of a function of time over the step with number `step`."""
    edges = [step, *sorted(at for at in breaks if step < at < step + 1), step + 1]
    return [sum(quad(lambda at: (at - step)**j * function(at * STEP), low, high,
                     epsabs=1e-13)[0] for low, high in zip(edges, edges[1:])) for j in range(3)]


def test_a_step_with_knots_inside_has_the_integral_and_moments_of_the_load():
    random = np.random.default_rng(1)
    time = np.sort(random.uniform(0.0, 10.0 * STEP, 25))
    table = Table(tuple(time), tuple(random.normal(size=25)))
    loads = Load({'torque': (table,)}).stages(0, 12, STEP)[..., TORQUE]
    found = moments(loads[:, :3]).T
    for step in range(12):
        truth = true_moments(lambda t: np.interp(t, time, table.value), time / STEP, step)
        assert found[step] == pytest.approx(truth, abs=1e-12)
    # The load at the end of a step, for messages and samples, is the true one.
    assert loads[:, AFTER] == pytest.approx(
        np.interp(STEP * np.arange(1, 13), time, table.value))


def test_a_step_with_points_of_a_drive_inside_has_its_integral_and_moments():
    drive = Drive((0.0, 0.23, 0.27, 0.28), (0.0, 0.3, 0.1, 0.2), (0.0, 1.0, 0.0, 0.5),
                  (0.0, 0.0, 5.0, 0.0))
    loads = Load({'angle': (drive,)}).stages(0, 4, STEP)[..., ANGLE:ACCELERATION + 1]
    curve = BPoly.from_derivatives(drive.time, list(zip(drive.angle, drive.speed,
                                                        drive.acceleration)))
    for order in range(3):
        def function(t, order=order):
            return curve(t, order) if t < 0.28 else [0.2 + 0.5 * (t - 0.28), 0.5, 0.0][order]
        truth = true_moments(function, np.array(drive.time) / STEP, 2)
        assert moments(loads[2:3, :3, order])[:, 0] == pytest.approx(truth, abs=1e-10)
        assert loads[2, AFTER, order] == pytest.approx(function(0.3))


def test_a_step_in_which_a_force_reaches_its_goal_has_its_integral_and_moments():
    actuators = Actuators(timo_sim.load_scene({
        'integrator.step': STEP, 'carrier.force_rate_limit': 100.0,
        'motor.torque_rate_limit': 30.0}).values)
    commanded = np.zeros(LOADS)
    commanded[[FORCE_X, TORQUE]] = 13.0, -7.0
    loads = np.zeros((4, STEP_LOADS, LOADS))
    actuators.add(commanded, 0, loads)
    for column, rate, goal in ((FORCE_X, 100.0, 13.0), (TORQUE, -30.0, -7.0)):
        reached = goal / rate
        for step in range(4):
            truth = true_moments(lambda t: np.interp(t, [0.0, reached], [0.0, goal]),
                                 [reached / STEP], step)
            assert moments(loads[step:step + 1, :3, column])[:, 0] == pytest.approx(truth)


@pytest.mark.parametrize('time, value', [
    ([0.502, 0.503, 0.504], [0.0, 2000.0, 0.0]), ([0.5011, 0.5016, 0.5021], [0.0, 4000.0, 0.0]),
    ([0.4999, 0.5, 0.5003], [0.0, 20000.0, 0.0])])
def test_a_spike_inside_a_step_gives_its_impulse(time, value):
    scene = timo_sim.load_scene({
        'integrator.step': 0.01, 'carrier.held': 'both', 'model.modes': 0,
        'load.torque.table.time': time, 'load.torque.table.value': value})
    run = timo_sim.simulate(scene, 1.0, estimate=False)
    impulse = 0.5 * (time[2] - time[0]) * value[1]
    assert run.momentum()[-1, 2] == pytest.approx(impulse, rel=1e-12)
    # A triangular pulse has the effect of an impulse at its centroid.
    assert run.shaft[-1] - run.shaft[0] == pytest.approx(
        run.shaft_velocity[-1] * (1.0 - np.mean(time)), rel=1e-9)


@pytest.mark.parametrize('values', [
    {'load.torque.table.time': [0.0, 0.502, 0.503, 0.504],
     'load.torque.table.value': [0.0, 0.0, 2000.0, 0.0]},
    {'motor.shaft': 'driven', 'motor.drive.time': [0.0, 0.42, 0.52],
     'motor.drive.angle': [0.0, 0.0, 0.3], 'motor.drive.speed': [0.0, 0.0, 0.0],
     'motor.drive.acceleration': [0.0, 0.0, 0.0]}])
def test_an_arm_moves_as_its_load_inside_a_step_demands(values):
    tips = []
    for step in (1e-4, 0.01):
        scene = timo_sim.load_scene({}, {**values, 'integrator.step': step})
        tips.append(timo_sim.simulate(scene, 1.0, round(0.5 / step),
                                      estimate=False).position(2.0)[-1])
    truth, found = tips
    assert np.abs(found - truth).max() < 5e-6


def test_a_jump_near_a_boundary_counts_as_one_on_it():
    def run(time):
        return timo_sim.simulate(timo_sim.load_scene({
            'integrator.step': 0.01, 'load.torque.table.time': [0.0, time, time],
            'load.torque.table.value': [0.0, 0.0, 50.0]}), 1.0, estimate=False)
    assert np.array_equal(run(0.5).values, run(0.5 * (1.0 + 2e-12)).values)
    assert np.abs(run(0.5).values - run(0.5 + 0.9e-8).values).max() < 1e-6
    with pytest.raises(timo_sim.ParameterError, match='the ratio is 50.000002'):
        run(0.50000002)
    with pytest.raises(timo_sim.ParameterError, match='the ratio is 1000000000.4'):
        timo_sim.load_scene({'integrator.step': 1e-6, 'load.torque.piecewise.value': [1.0],
                             'load.torque.piecewise.time': [1000.0000004]})
