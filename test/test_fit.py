# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Fits of scenes to records: truth recovered, inputs, sensors, doubts."""

import math
import re

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import toeplitz
from scipy.signal import lfilter, lsim

from benchmark.accuracy import fits
import timo_sim
from timo_sim.fitting.objective import Objective, times_of_motion
from timo_sim.fitting.record import Channel, OUTPUTS
from timo_sim.fitting.problem import covariance, loads_of, Problem, whiteness
from timo_sim.fitting.search import Search
from timo_sim.model.differences import Secants
from timo_sim.model.layout import AFTER, TORQUE
from timo_sim.runs.run import run_scene

ARM = {'carrier.held': 'both', 'arm.length': 0.42, 'arm.section.height': 0.001,
       'arm.section.width': 0.02,
       'arm.density': 7800.0, 'arm.young_modulus': 2e11, 'arm.shear_modulus': 7.7e10,
       'arm.damping_ratio': [0.01], 'motor.shaft_inertia': 0.002, 'end_effector.mass': 0.03,
       'end_effector.inertia': 1e-5, 'motor.viscous_friction': 0.01, 'initial.shaft': 0.0,
       'integrator.step': 0.002}
MOTOR = {'motor.dc': {'resistance': 2.6, 'torque_constant': 0.0077, 'gear_ratio': 70.0}}
T = 0.002 * np.arange(1501)
VOLTAGE = np.sign(np.sin(2.0 * np.pi * 0.7 * T)) * 2.0 + np.sin(2.0 * np.pi * 3.1 * T)
SHAFT = {'shaft': (T, T**2)}  # it begins at rest


def predicted(scene, inputs, outputs, values=None, t=T):
    """Return a noise-free Record of a scene; `values` are those of sensors."""
    blank = timo_sim.Record.of(inputs, {name: (t, np.zeros_like(t)) for name in outputs})
    problem = Problem(timo_sim.load_scene(scene), blank, ['arm.length'], {}, blank.duration)
    return timo_sim.Record.of(inputs, {
        name: (t, shown) for name, shown in problem.predicted(values or {}).items()})


def noisy(record, deviations, seed=1):
    """Return a record with white noise on its outputs."""
    random = np.random.default_rng(seed)
    return timo_sim.Record.of(record.inputs, {
        name: channel._replace(values=channel.values + deviations[name]
                               * random.standard_normal(len(channel.t)))
        for name, channel in record.outputs.items()})


def test_the_truth_is_recovered_from_a_record_without_noise():
    truth = {'arm.young_modulus': 2e11, 'end_effector.mass': 0.03, 'arm.damping_ratio': 0.01,
             'motor.viscous_friction': 0.01, 'motor.shaft_inertia': 0.002}
    record = predicted({**ARM, **MOTOR}, {'voltage': (T, VOLTAGE)}, ['shaft', 'tip_transverse'])
    guess = timo_sim.load_scene({**ARM, **MOTOR}, {
        'arm.young_modulus': 1.6e11, 'end_effector.mass': 0.04, 'arm.damping_ratio': [0.03],
        'motor.viscous_friction': 0.005, 'motor.shaft_inertia': 0.003})
    found = timo_sim.fit(guess, record, list(truth))
    assert found.values == pytest.approx(truth, rel=1e-5)
    for name, value in found.scene.values.items():
        if name in truth:
            assert np.ravel(value)[0] == found.values[name]
    assert min(each.r_squared for each in found.errors.values()) > 1.0 - 1e-9
    assert 'residuals of the fit are numerical errors alone' in found.report()


def test_held_values_give_a_rigid_shaft_their_impulse():
    """A shaft with inertia alone has the speed of the impulse, however uneven the samples."""
    random = np.random.default_rng(3)
    t, torque = np.cumsum(random.uniform(0.0005, 0.007, 60)), random.standard_normal(60)
    t -= t[0]
    scene = timo_sim.load_scene({}, {**ARM, 'model.modes': 0, 'motor.viscous_friction': 0.0})
    for delay in (0.0, 0.0031):
        record = predicted(scene, {'torque': (t, torque)}, ['shaft_velocity'],
                           {'torque.delay': delay})
        wanted = np.zeros(len(T))
        for k, at in enumerate(T):
            edges = np.clip(np.append(t, np.inf) + delay, 0.0, at)
            edges[0] = 0.0
            wanted[k] = np.diff(edges) @ torque
        inertia = scene.build().mass_matrix(scene.initial_motion())[0][2, 2]
        assert record.outputs['shaft_velocity'].values * inertia == pytest.approx(
            wanted, abs=1e-12)


def test_values_joined_by_lines_are_the_table_of_a_scene():
    t, torque = [0.0, 0.01, 0.5, 3.0], [0.0, 0.05, -0.02, 0.0]
    scene = timo_sim.load_scene({}, {**ARM, 'load.torque.table': {'time': t, 'value': torque}})
    run = timo_sim.simulate(scene, T[-1], estimate=False)
    channel = Channel(np.array(t), np.array(torque), hold='linear')
    record = predicted(ARM, {'torque': channel}, ['shaft'])
    assert record.outputs['shaft'].values == pytest.approx(run.shaft, abs=1e-9)


@pytest.mark.parametrize('values, name, size', [
    ({**MOTOR, 'motor.coulomb_friction': 0.01, 'motor.dc.voltage_limit': 2.5}, 'voltage', 1.0),
    ({'motor.torque_limit': 0.08, 'motor.torque_rate_limit': 3.0}, 'torque', 0.04)])
def test_an_input_acts_as_that_of_the_simulator(values, name, size):
    """Motor, friction and limits included."""
    scene = timo_sim.load_scene(ARM, values)
    simulator, shaft = timo_sim.Simulator(scene), [0.0]
    for value in size * VOLTAGE[:-1]:
        shaft.append(float(simulator.step(**{name: value}).shaft))
    record = predicted(scene, {name: (T, size * VOLTAGE)}, ['shaft'])
    # The impulse of a step is a difference of sums.
    assert record.outputs['shaft'].values == pytest.approx(shaft, abs=1e-9)
    # The limits are those of what acts: a record of a third of it, less an offset, is the same.
    record = predicted(scene, {name: (T, (size * VOLTAGE - 0.1) / 3.0)}, ['shaft'],
                       {f'{name}.gain': 3.0, f'{name}.bias': 0.1})
    assert record.outputs['shaft'].values == pytest.approx(shaft, abs=1e-9)


def test_a_driven_shaft_follows_the_samples():
    """A polynomial of degree five is met everywhere; the arm moves as under motor.drive."""
    angle = 0.4 * T**3 / 9.0 - 0.05 * T**5 / 81.0
    drive = np.polynomial.Polynomial([0.0, 0.0, 0.0, 0.4 / 9.0, 0.0, -0.05 / 81.0])
    speed, acceleration = drive.deriv(1), drive.deriv(2)
    points = np.linspace(0.0, T[-1], 7)
    scene = timo_sim.load_scene(ARM, {'motor.shaft': 'driven', 'motor.drive': {
        'time': points, 'angle': drive(points), 'speed': speed(points),
        'acceleration': [*acceleration(points[:-1]), 0.0]}})
    run = timo_sim.simulate(scene, T[-1], estimate=False)
    record = predicted(ARM, {'drive': (T, angle)}, ['shaft', 'tip_transverse'])
    whole = slice(0, 1200)  # the last piece of motor.drive ends without acceleration
    assert record.outputs['shaft'].values == pytest.approx(angle, abs=1e-12)
    assert record.outputs['tip_transverse'].values[whole] == pytest.approx(
        run.deflection(0.42)[whole, 1], abs=1e-8)
    for loads in {}, {'load.tip_torque.piecewise': {'time': [1e9], 'value': [1.0]}}:
        found = timo_sim.fit(timo_sim.load_scene(ARM, loads), record, ['arm.young_modulus'],
                             quick=True, starts=1)
        assert ('loads of the scene act beside' in found.report()) == bool(loads)


def test_a_driven_shaft_stands_before_its_record_where_its_smooth_angle_begins():
    """Not at the first sample, which has an error that the knots take out."""
    angle = 0.3 + 0.05 * T**2
    angle[0] += 0.05
    shaft = predicted(ARM, {'drive': Channel(T, angle, knots=0.5)}, ['shaft'],
                      {'drive.delay': 0.1}).outputs['shaft'].values
    assert shaft[:50] == pytest.approx(0.3, abs=0.01)
    assert abs(np.diff(shaft)).max() < 1e-3


@pytest.mark.parametrize('more', [
    {'carrier.held': 'none', 'carrier.mass': 5.0, 'motor.mass': 5.0}, {'gravity': [0.0, -9.81]},
    {'motor.shaft': 'locked'},
    {'load.tip_force_y.harmonic': {'amplitude': [0.3], 'frequency': [1.0]},
     'load.tip_torque.harmonic': {'amplitude': [0.02], 'frequency': [2.0]},
     'sensor.root_strain.position': 0.1, 'sensor.tip_imu.position': 0.2}])
def test_strain_and_acceleration_are_those_of_the_sensors(more):
    scene = timo_sim.load_scene(ARM, {
        'initial.modal_coordinates': [0.003, 0.0, 0.0], **more,
        'load.torque.harmonic': {'amplitude': [0.05], 'frequency': [3.0]}})
    simulator, strain, acceleration = timo_sim.Simulator(scene), [], []
    for _ in T[:500]:
        strain.append(simulator.sensors.root_strain)
        acceleration.append(simulator.sensors.tip_acceleration[1])
        simulator.advance(1)
    run = timo_sim.simulate(scene, T[500], estimate=False)
    inner = slice(5, 495)  # a spline is less accurate at its ends
    for name, wanted in ('root_strain', strain), ('tip_acceleration', acceleration):
        found = OUTPUTS[name].of_run(run)[:500]
        assert found[inner] == pytest.approx(wanted[inner], abs=2e-3 * np.ptp(wanted)), name


def test_sensors_have_gain_bias_delay_and_lag():
    """A first-order sensor of a sine, in closed form; delays need not be whole steps."""
    scene = {**ARM, 'motor.shaft': 'driven', 'motor.drive': {
        'time': [0.0], 'angle': [0.2], 'speed': [0.7], 'acceleration': [0.0]}}
    values = {'shaft.gain': 1.5, 'shaft.bias': 0.3, 'shaft.delay': 0.0123, 'shaft.lag': 0.05}
    record = predicted(scene, {}, ['shaft'], values)
    late = T - 0.0123
    wanted = np.where(late < 0.0, 0.2, 0.2 + 0.7 * (late - 0.05 * (1.0 - np.exp(-late / 0.05))))
    assert record.outputs['shaft'].values == pytest.approx(1.5 * wanted + 0.3, abs=2e-5)


@pytest.mark.parametrize('count', [5, 6, 7, 1501])
def test_between_steps_a_sensor_shows_the_cubic_spline_of_scipy(count):
    """Before t = 0 it shows the first motion; few values are joined by lines."""
    late, t = 0.0031, T[:count]
    run = run_scene(timo_sim.load_scene({}, {**ARM, 'initial.shaft_velocity': 3.0}), count - 1)
    blank = timo_sim.Record.of({}, {'tip_transverse': (T, 0.0 * T)})
    problem = Problem(run.scene, blank, ['arm.length'], {}, blank.duration)
    shown = problem.predicted({'tip_transverse.delay': late}, t[-1], run)['tip_transverse']
    spline = CubicSpline(run.t, run.deflection()[:, 1]) if count > 5 else (
        lambda at: np.interp(at, run.t, run.deflection()[:, 1]))
    assert shown == pytest.approx(spline(np.maximum(t - late, 0.0)), abs=1e-14)


@pytest.mark.parametrize('hold', ['zero', 'linear'])
def test_inputs_lag_in_closed_form(hold):
    """Jumps, or a ramp, of a torque through a first-order lag; a delay is no whole step."""
    t = np.array([0.0, 0.1, 0.5, 1.0])
    record = timo_sim.Record.of({'torque': Channel(t, np.array([1.0, 1.0, 3.0, 3.0]), hold=hold)},
                                {'shaft': (T, T)})
    scene = timo_sim.load_scene(ARM)
    acting = loads_of(record, scene, {'torque.lag': 0.03, 'torque.delay': 0.0123,
                                      'torque.gain': 2.0}).stages(0, 600, scene.step)
    late = scene.step * np.arange(1, 601) - 0.0123

    def after(begin):  # time since then, and how much of a jump has come through
        since = np.maximum(late - begin, 0.0)
        return since, 1.0 - np.exp(-since / 0.03)
    if hold == 'zero':
        wanted = 1.0 + 2.0 * after(0.5)[1]
    else:
        (up, rise), (flat, fall) = after(0.1), after(0.5)
        wanted = 1.0 + 5.0 * (up - 0.03 * rise - flat + 0.03 * fall)
    # A jump of 4 N m within a step counts as its mean over the step, which is off by an eighth of
    # the square of step / lag at most.
    assert acting[:, AFTER, TORQUE] == pytest.approx(2.0 * wanted, abs=4.0 / 8.0 / 15.0**2)


def test_steep_friction_is_found_with_shorter_steps():
    """The record's friction is too steep for the step of the scene that is fitted."""
    truth = {'motor.coulomb_friction': 0.1, 'motor.coulomb_speed': 0.01}
    record = predicted({**ARM, **MOTOR, **truth, 'integrator.step': 2.5e-4},
                       {'voltage': (T, VOLTAGE)}, ['shaft', 'tip_transverse'])
    with pytest.raises(timo_sim.ParameterError, match='must be at most'):
        timo_sim.load_scene({}, {**ARM, **MOTOR, **truth})
    guess = {**ARM, **MOTOR, 'motor.coulomb_friction': 0.07, 'motor.coulomb_speed': 0.1}
    found = timo_sim.fit(guess, record, list(truth), quick=True)
    # These steps are near the longest that are stable, which shows in the steep part.
    assert found.values['motor.coulomb_friction'] == pytest.approx(0.1, rel=2e-3)
    assert found.values['motor.coulomb_speed'] == pytest.approx(0.01, rel=0.1)
    assert found.scene.step < 0.002 and timo_sim.simulate(found.scene, 0.1).scene == found.scene
    # Of these steps the fit looks at those that the scene has.
    every = run_scene(found.run.scene, round(T[-1] / found.scene.step))
    assert found.run.t == pytest.approx(T)
    assert np.array_equal(found.run.values, every.values[::round(0.002 / found.scene.step)])


def test_sensors_are_fitted():
    values = {'voltage.lag': 0.015, 'tip_transverse.gain': 1.2, 'tip_transverse.bias': 0.002,
              'tip_transverse.delay': 0.0073, 'tip_transverse.lag': 0.02, 'voltage.bias': 0.05}
    scene = {**ARM, **MOTOR}
    record = predicted(scene, {'voltage': (T, VOLTAGE)}, ['shaft', 'tip_transverse'], values)
    found = timo_sim.fit(scene, record, list(values), quick=True)
    assert found.values == pytest.approx(values, rel=1e-3)


def test_a_fit_begins_with_the_guesses_that_are_given():
    values = {'arm.young_modulus': 2e11, 'voltage.gain': 4.0, 'voltage.delay': 0.0073}
    guesses = {'arm.young_modulus': 1.7e11, 'voltage.gain': 3.0, 'voltage.delay': 0.004}
    record = predicted({**ARM, **MOTOR}, {'voltage': (T, VOLTAGE)}, ['shaft'], values)
    found = timo_sim.fit({**ARM, **MOTOR, 'arm.young_modulus': 9e10}, record, [
        f'{name}={guess}' for name, guess in guesses.items()], {'voltage.delay': (0.0, 0.1)},
        quick=True)
    assert found.values == pytest.approx(values, rel=1e-4) and found.starts == 1
    assert {name: each.start for name, each in found.estimates.items()} == guesses


def test_guesses_with_widths_give_the_posterior_in_closed_form():
    """Of a shaft that rests: its angle a and the bias b of its sensor show as a + b alone."""
    noise, n, (a, wide_a), (b, wide_b) = 0.01, 100, (0.1, 0.05), (0.0, 0.2)
    angle = 0.3 + noise * np.random.default_rng(2).standard_normal(n)
    record = timo_sim.Record.of({}, {'shaft': (T[:n], angle, noise)})
    found = timo_sim.fit(ARM, record, [f'initial.shaft={a}~{wide_a}', f'shaft.bias~{wide_b}'])
    whole = wide_a**2 + wide_b**2 + noise**2 / n
    for name, guess, wide in ('initial.shaft', a, wide_a), ('shaft.bias', b, wide_b):
        each, share = found.estimates[name], wide**2 / whole
        assert each.value == pytest.approx(guess + share * (angle.mean() - a - b), abs=1e-6)
        assert each.deviation == pytest.approx(wide * np.sqrt(1.0 - share), rel=1e-4)
        assert each.high - each.low == pytest.approx(2.0 * 1.959964 * each.deviation, rel=1e-6)
    assert list(found.values) == ['shaft.bias'] and 'from your guess' in found.report()
    drawn = found.sample(1000).values
    assert np.std(drawn['initial.shaft'] + drawn['shaft.bias']) == pytest.approx(1e-3, rel=0.1)
    # Far from its guess a value is not from there, however little the record narrows it.
    record.outputs['shaft'].values[:] += 2.0
    far = timo_sim.fit(ARM, record, [f'initial.shaft={a}~{wide_a}', f'shaft.bias~{wide_b}'])
    assert not far.estimates['initial.shaft'].identified
    assert 'no interval' in far.report() and 'from your guess' not in far.report()


def test_what_the_field_knows_is_the_usual_width():
    scene = timo_sim.load_scene({**ARM, **MOTOR, 'arm.material': 'steel'})
    record = timo_sim.Record.of({'voltage': (T, VOLTAGE)}, {'shaft': (T, T)})
    names = ['arm.young_modulus', 'arm.length', 'shaft.gain', 'shaft.gain=1.1',
             'motor.viscous_friction', 'shaft.bias', 'shaft.delay', 'motor.shaft_inertia',
             'arm.length~5%', 'motor.viscous_friction~x2', 'arm.density~inf']
    found = [Problem(scene, record, [name], {}, T[-1]).free[0] for name in names]
    assert [each.width * (1.0 if each.log else each.scale) for each in found] == pytest.approx([
        0.05, 0.01, np.log(3.0), 0.05, np.log(3.0), 0.05 * T[-1], np.inf, np.log(10.0), 0.05,
        np.log(2.0), np.inf])
    usual, own = Problem(scene, record, ['~inf', 'arm.length', 'arm.density~2%'], {}, T[-1]).free
    assert (usual.width, own.width) == (np.inf, 0.02)


def test_secants_foresee_the_last_step_and_nothing_else_changes():
    """Of a function that bends a little; where it bends much, derivatives are made anew."""
    random, begun = np.random.default_rng(4), []
    matrix, bend = random.standard_normal((30, 3)) * [1.0, 1e-3, 1e3], 50.0

    def function(x):
        return matrix @ (x + [0.0, bend * x[0]**2, 0.0])

    def exact(x):
        begun.append(x)
        return matrix @ (np.eye(3) + [[0.0] * 3, [2.0 * bend * x[0], 0.0, 0.0], [0.0] * 3])

    jacobian = Secants(function, exact, 8)
    places = random.standard_normal((9, 3)) * [1.0, 1e3, 1e-3]
    before = jacobian(places[0])
    assert before == pytest.approx(exact(places[0]))
    for number, (last, x) in enumerate(zip(places, places[1:]), 1):
        now, move = jacobian(x), x - last
        assert jacobian.count == number
        assert now @ move == pytest.approx(function(x) - function(last))
        # Moves across it, as long as they move the values, change them as before.
        size = np.linalg.norm(before, axis=0)
        across = np.linalg.svd((size * move)[np.newaxis])[2][1:] / size
        assert now @ across.T == pytest.approx(before @ across.T, abs=1e-9)
        before = now
    begun.clear()
    jacobian(places[0])
    assert jacobian.count == 0 and len(begun) == 1  # after eight of them
    bend = 5000.0
    assert jacobian(places[1]) == pytest.approx(exact(places[1])) and jacobian.count == 0


def test_a_search_needs_few_runs_and_ends_where_no_direction_leads_down(monkeypatch):
    """Where directions look alike, differences alone take 344 runs."""
    runs, run = [], Problem.run
    monkeypatch.setattr(Problem, 'run', lambda *given: runs.append(1) or run(*given))
    record = fits.record(0, 2.0)
    objective = Objective([Problem(fits.guess(), record, fits.FREE, {}, 2.0)])
    search = Search(objective)
    search.run(1)
    count, here = len(runs), objective.residuals(search.x)
    jacobian = objective.jacobian(search.x)
    foreseen = here - jacobian @ np.linalg.lstsq(jacobian, here)[0]
    assert foreseen @ foreseen > (1.0 - 2e-4) * (here @ here)
    assert count < 220


def test_a_quick_fit_is_the_same_without_profiles_and_suspects():
    scene, free = {**ARM, **MOTOR}, ['motor.viscous_friction', 'arm.young_modulus']
    record = noisy(predicted({**scene, 'motor.coulomb_friction': 0.02}, {
        'voltage': (T[:751], VOLTAGE[:751])}, ['shaft'], t=T[:751]), {'shaft': 1e-3})
    quick, whole = (timo_sim.fit(scene, record, free, quick=quick) for quick in (True, False))
    assert quick.scene.values == whole.scene.values and not quick.white
    assert whole.suspects and not quick.suspects
    assert not any(each.profile for each in quick.estimates.values())


def test_a_product_that_alone_matters_is_named_and_not_returned():
    names = ['motor.dc.torque_constant', 'motor.dc.gear_ratio', 'motor.shaft_inertia']
    scene = {**ARM, **MOTOR}
    record = noisy(predicted(scene, {'voltage': (T, VOLTAGE)}, ['shaft']), {'shaft': 1e-3})
    with pytest.warns(timo_sim.ModelWarning, match='cannot be identified'):
        found = timo_sim.fit(scene, record, ['~inf', *names])
    assert list(found.values) == ['motor.shaft_inertia']
    assert all(np.isnan(found.estimates[name].value) for name in names[:2])
    parts, = found.unidentified
    assert abs(parts.pop(names[0])) == pytest.approx(0.5**0.5, abs=1e-3)
    assert abs(parts.pop(names[1])) == pytest.approx(0.5**0.5, abs=1e-3) and not parts
    assert 'not identified by this record' in found.report()


def test_a_record_that_rests_at_first_is_fitted_where_it_moves():
    """The first part of a record, to which starts are fitted, has a quarter of its motion."""
    t = 0.002 * np.arange(2501)
    volts = np.where(t > 4.0, 4.0 * np.sign(np.sin(12.0 * t)), 0.0)
    record = noisy(predicted({**ARM, **MOTOR}, {'voltage': (t, volts)}, ['shaft'], t=t),
                   {'shaft': 1e-3})
    problem = Problem(timo_sim.load_scene({}, {**ARM, **MOTOR}), record, ['arm.length'], {}, t[-1])
    assert 4.1 < times_of_motion(problem, 0.25)[0] < 4.9


def test_what_is_held_out_is_not_fitted():
    scene, free = {**ARM, **MOTOR}, ['motor.viscous_friction', 'arm.young_modulus']
    guess = timo_sim.load_scene(scene, {'motor.viscous_friction': 0.02})
    record = noisy(predicted(scene, {'voltage': (T, VOLTAGE)}, ['shaft']), {'shaft': 1e-3})
    late = T > 0.5 * T[-1]
    channel = record.outputs['shaft']
    other = timo_sim.Record.of(record.inputs, {
        'shaft': channel._replace(values=channel.values + late)})
    one, two = (timo_sim.fit(guess, each, free, hold_out=0.5, quick=True)
                for each in (record, other))
    assert one.values == two.values
    assert one.errors['shaft'].rms == pytest.approx(1e-3, rel=0.1)
    assert one.errors['shaft'].hold_out_rms == pytest.approx(1e-3, rel=0.1)
    assert two.errors['shaft'].hold_out_rms == pytest.approx(1.0, rel=0.01)


def test_a_first_part_does_not_lead_a_good_guess_astray():
    """Friction that sticks: the first quarter of this record leads 12 deviations off."""
    record = fits.record(52, 4.0)
    found = timo_sim.fit(fits.SCENE, record, fits.FREE, quick=True)
    errors = [fits.coordinate(name, found.values[name]) - fits.coordinate(name, fits.TRUTH[name])
              for name in fits.FREE]
    assert np.abs(errors / fits.bound(4.0)).max() < 3.0


def test_a_loss_against_outliers():
    scene, free = {**ARM, **MOTOR}, ['motor.viscous_friction', 'arm.young_modulus']
    record = noisy(predicted(scene, {'voltage': (T, VOLTAGE)}, ['shaft']), {'shaft': 1e-3})
    channel = record.outputs['shaft']
    spoiled = np.where(np.arange(len(T)) % 50 == 7, channel.values + 0.2, channel.values)
    record = timo_sim.Record.of(record.inputs, {'shaft': (T, spoiled)})
    errors = []
    for loss in ('linear', 'cauchy'):
        found = timo_sim.fit(scene, record, free, loss=loss, quick=True)
        errors.append(abs(np.log(found.values['motor.viscous_friction'] / 0.01)))
    assert errors[1] < 0.01 and errors[1] < 0.5 * errors[0]


def test_presliding_and_friction_at_rest_are_found():
    """From noise of 0.1 mm and 0.1 mrad; the squares have no jumps."""
    truth = {'motor.coulomb_friction': 0.02, 'motor.coulomb_presliding': 0.004,
             'motor.coulomb_static': 0.6}
    scene = {**ARM, **MOTOR, **truth, 'motor.coulomb_speed': 0.3}
    record = noisy(predicted(scene, {'voltage': (T, VOLTAGE)}, ['shaft', 'tip_transverse']),
                   {'shaft': 1e-4, 'tip_transverse': 1e-4})
    guess = timo_sim.load_scene(scene, {
        'motor.coulomb_friction': 0.03, 'motor.coulomb_presliding': 0.002,
        'motor.coulomb_static': 0.8})
    found = timo_sim.fit(guess, record, list(truth))
    assert found.values == pytest.approx(truth, rel=0.01)  # measured: 0.001
    assert not any('in jumps' in each for each in found.warnings)


def test_the_initial_state_is_fitted():
    moving = {'initial.shaft': 0.3, 'initial.shaft_velocity': 0.5,
              'initial.modal_coordinates[0]': 0.004, 'initial.modal_rates[0]': 0.05,
              **{f'initial.modal_{kind}[{n}]': 0.0  # the last is of a static shape
                 for kind in ('coordinates', 'rates') for n in (1, 2, 3)}}
    record = predicted({**ARM, 'initial.shaft': 0.3, 'initial.shaft_velocity': 0.5,
                        'initial.modal_coordinates': [0.004, 0.0, 0.0],
                        'initial.modal_rates': [0.05, 0.0, 0.0]}, {}, ['shaft', 'tip_transverse'])
    found = timo_sim.fit(ARM, record, ['initial', 'motor.viscous_friction'], quick=True)
    assert found.values == pytest.approx({**moving, 'motor.viscous_friction': 0.01}, abs=1e-6)


@pytest.mark.parametrize('more, told', [
    ({'motor.coulomb_friction': 0.4}, True),    # sticks for most of the time
    ({'gravity': [0.0, -9.81]}, False),
    ({'load.torque.harmonic': {'amplitude': [0.1], 'frequency': [1.3]}}, False)])
def test_missing_dry_friction_is_a_suspect(more, told):
    """Residuals of records of arms that the scene is not: with dry friction, and otherwise."""
    record = noisy(predicted({**ARM, **MOTOR, **more}, {'voltage': (T[:751], VOLTAGE[:751])}, [
        'shaft', 'tip_transverse'], t=T[:751]), {'shaft': 1e-3, 'tip_transverse': 3e-4})
    found = timo_sim.fit({**ARM, **MOTOR}, record, [
        'arm.young_modulus', 'motor.viscous_friction', 'motor.shaft_inertia',
        'end_effector.mass'], starts=1)
    assert ('free motor.coulomb_friction=' in found.report()) == told
    assert 'carrier.coulomb_friction' not in found.report()


def test_missing_friction_of_the_carrier_is_a_suspect():
    scene = {**ARM, 'carrier.held': 'none', 'carrier.mass': 1.0}
    force = 2.0 * np.sign(np.sin(5.0 * T))
    record = noisy(predicted({**scene, 'carrier.coulomb_friction': 0.2}, {
        'force_x': (T, force)}, ['carrier_x']), {'carrier_x': 1e-3})
    with pytest.warns(timo_sim.ModelWarning, match='free carrier.coulomb_friction='):
        timo_sim.fit(scene, record, ['carrier.mass'], starts=1)


def test_a_delay_of_an_input_is_none_of_all_outputs():
    """Friction is missing, not a second delay beside those of all outputs."""
    record = noisy(predicted({**ARM, **MOTOR, 'motor.coulomb_friction': 0.02}, {
        'voltage': (T[:751], VOLTAGE[:751])}, ['shaft'], {'shaft.delay': 0.01}, T[:751]),
        {'shaft': 1e-3})
    found = timo_sim.fit({**ARM, **MOTOR}, record, ['motor.viscous_friction', 'shaft.delay'],
                         starts=1)
    assert 'a delay of voltage' not in {each.name for each in found.suspects}


def test_a_bound_that_is_met_is_told():
    scene = {**ARM, **MOTOR}
    record = noisy(predicted(scene, {'voltage': (T, VOLTAGE)}, ['shaft']), {'shaft': 1e-4})
    guess = timo_sim.load_scene(scene, {'motor.viscous_friction': 0.02})
    with pytest.warns(timo_sim.ModelWarning, match='at a bound, .*: motor.viscous_friction'):
        found = timo_sim.fit(guess, record, ['motor.viscous_friction'],
                             {'motor.viscous_friction': (0.015, 0.1)})
    assert found.estimates['motor.viscous_friction'].bound == 'low'
    assert found.values['motor.viscous_friction'] == pytest.approx(0.015, rel=1e-6)


def test_values_that_a_scene_cannot_have_are_told():
    """The friction of the record is steeper than a sixteenth of the steps of the fit allows."""
    scene = {**ARM, **MOTOR, 'motor.coulomb_speed': 0.01}
    record = noisy(predicted({**scene, 'motor.coulomb_friction': 0.05, 'integrator.step': 0.0002},
                             {'voltage': (T[:501], VOLTAGE[:501])}, ['shaft'], t=T[:501]),
                   {'shaft': 1e-4})
    with pytest.raises(timo_sim.ParameterError, match='slope') as caught:
        timo_sim.load_scene({}, {**scene, 'motor.coulomb_friction': 0.05, 'integrator.step': 0.01})
    step = float(re.search('at most (.*) s for', str(caught.value))[1])
    guess = {**scene, 'motor.coulomb_friction': 0.001, 'integrator.step': 40.0 * step}
    with pytest.warns(timo_sim.ModelWarning, match='ended where values are refused.*slope'):
        timo_sim.fit(guess, record, ['motor.coulomb_friction'], starts=1, quick=True)


def test_a_search_ends_where_a_run_is_possible():
    """
    A cable holds the shaft as a spring does: without it runs are far off, refused ones are not.

    The arm is rigid and the motor a torque k u less k^2 of the speed, over the resistance.
    """
    t, voltage, constant = T[:751], VOLTAGE[:751], 70.0 * 0.0077
    torque = constant * voltage / 2.6
    motion = lsim(([1.0], [0.0063, 0.01 + constant**2 / 2.6, 2.0]), torque, t)[1]
    record = timo_sim.Record.of({'voltage': (t, voltage)}, {'shaft': (t, motion, 1e-4)})
    guess = {**ARM, **MOTOR, 'motor.coulomb_friction': 0.05, 'motor.coulomb_speed': 0.1}
    free = ['motor.coulomb_friction', 'motor.viscous_friction', 'motor.coulomb_speed']
    with pytest.warns(timo_sim.ModelWarning, match='shaft is off by'):
        found = timo_sim.fit(guess, record, free, starts=1, quick=True)
    assert timo_sim.simulate(found.scene, 0.1).scene == found.scene and found.run is not None


def test_a_fit_whose_time_is_up_has_the_best_so_far():
    record = noisy(predicted({**ARM, **MOTOR}, {'voltage': (T, VOLTAGE)}, ['shaft']),
                   {'shaft': 1e-4})
    guess = {**ARM, **MOTOR, 'motor.viscous_friction': 0.02}
    with pytest.warns(timo_sim.ModelWarning, match='best values so far.*its time was up'):
        found = timo_sim.fit(guess, record, ['motor.viscous_friction'], time=1e-6)
    assert found.values == {'motor.viscous_friction': 0.02} and found.errors['shaft'].rms > 1e-4
    assert found.stopped and 'best so far' in found.report() and 'best so far' in repr(found)
    with pytest.raises(timo_sim.ParameterError, match='must have intervals'):
        found.sample(3)


def test_a_fit_whose_time_is_up_while_intervals_are_found_has_all_but_them(monkeypatch):
    def late(search, find=Search.derivatives):
        search.objective.residuals(0.9 * search.x)
        search.set_deadline(-math.inf)
        return find(search)
    monkeypatch.setattr(Search, 'derivatives', late)
    monkeypatch.setattr('timo_sim.fitting.problem._MAX_KEPT', 0)  # the last run alone is kept
    record = noisy(predicted({**ARM, **MOTOR}, {'voltage': (T, VOLTAGE)}, ['shaft']),
                   {'shaft': 1e-4})
    guess = {**ARM, **MOTOR, 'motor.viscous_friction': 0.02}
    with pytest.warns(timo_sim.ModelWarning, match='intervals are not known: its time was up'):
        found = timo_sim.fit(guess, record, ['motor.viscous_friction'], time=100.0, quick=True)
    assert found.values['motor.viscous_friction'] == pytest.approx(0.01, rel=0.01)
    assert found.errors['shaft'].rms < 2e-4


@pytest.mark.parametrize('phase, told', [
    ('start 1', 'best values so far.*it was interrupted'),
    ('derivatives', 'intervals are not known: it was interrupted')])
def test_an_interrupt_loses_only_what_was_not_begun(phase, told):
    record = noisy(predicted({**ARM, **MOTOR}, {'voltage': (T, VOLTAGE)}, ['shaft']),
                   {'shaft': 1e-4})

    def tell(text):
        if phase in text:
            raise KeyboardInterrupt

    guess = {**ARM, **MOTOR, 'motor.viscous_friction': 0.02}
    with pytest.warns(timo_sim.ModelWarning, match=told):
        found = timo_sim.fit(guess, record, ['motor.viscous_friction'], tell=tell)
    assert found.values['motor.viscous_friction'] == pytest.approx(0.01, rel=0.01)
    assert bool(found.stopped) == (phase == 'start 1') and 'not known' in found.report()


def test_an_estimate_near_the_limit_of_its_parameter_is_no_refusal():
    scene = {**ARM, **MOTOR, 'motor.coulomb_friction': 0.02, 'motor.coulomb_presliding': 0.004,
             'motor.coulomb_speed': 0.3, 'motor.coulomb_static': 0.995}
    record = noisy(predicted(scene, {'voltage': (T, VOLTAGE)}, ['shaft']), {'shaft': 1e-4})
    found = timo_sim.fit({**scene, 'motor.coulomb_static': 0.9}, record, ['motor.coulomb_static'])
    assert found.values['motor.coulomb_static'] > 0.99
    assert not any('refused' in each for each in found.warnings)


def test_estimates_far_from_their_guess_are_told():
    """As with a voltage in steps of a pulse width, 255 for 12 V."""
    scene, free = {**ARM, **MOTOR}, ['motor.viscous_friction']
    record = noisy(predicted(scene, {'voltage': (T, VOLTAGE)}, ['shaft']), {'shaft': 1e-3})
    unscaled = timo_sim.Record.of({'voltage': (T, 255.0 / 12.0 * VOLTAGE)}, record.outputs)
    assert not any('scale' in text for text in timo_sim.fit(scene, record, free).warnings)
    with pytest.warns(timo_sim.ModelWarning, match='motor.viscous_friction: more.*unit and scale'):
        timo_sim.fit(scene, unscaled, free, starts=1)


def test_coarse_steps_are_told():
    """A record of a fine run cannot be met with steps and modes that are too coarse."""
    fine = {**ARM, 'integrator.step': 0.0005}
    torque = 0.3 * np.sign(np.sin(2.0 * np.pi * 9.0 * T))
    record = predicted(fine, {'torque': (T, torque)}, ['tip_acceleration'])
    with pytest.warns(timo_sim.ModelWarning, match='tip_acceleration differs by .* more '
                                                   'model.modes or a smaller integrator.step'):
        timo_sim.fit({**ARM, 'integrator.step': 0.01, 'model.modes': 1}, record,
                     ['arm.young_modulus'], quick=True)


def test_intervals_with_correlated_residuals_hold_the_truth():
    """Of 100 regressions with errors of AR(1), for five parameters with scales of 1e-6 to 1e6."""
    random, n, rho = np.random.default_rng(11), 2000, 0.9
    t = np.linspace(0.0, 4.0, n)
    jacobian = np.column_stack([np.sin(3.0 * t), np.cos(3.0 * t), t * np.sin(3.0 * t), np.exp(-t),
                                t * np.sin(20.0 * t)]) * [1e6, 1.0, 1e-6, 1.0, 1e3]
    inverse = np.linalg.pinv(jacobian / np.linalg.norm(jacobian, axis=0)) / np.linalg.norm(
        jacobian, axis=0)[:, np.newaxis]
    errors = lfilter([1.0], [1.0, -rho], random.standard_normal((100, n + 200)))[:, 200:]
    wanted = np.sqrt(np.diag(inverse @ toeplitz(rho**np.arange(n)) @ inverse.T) / (1.0 - rho**2))
    held, ratios = np.zeros(5), []
    for each in errors:
        off = inverse @ each
        found, white = covariance([jacobian], [each - jacobian @ off])
        assert not white
        deviations = np.sqrt(np.diag(found))
        held += np.abs(off) < 1.96 * deviations
        ratios.append(deviations / wanted)
    # Of 100 intervals of 95 %, fewer than 88 hold it with a probability of 0.4 %; that the
    # residuals are smaller than the errors takes some 3 % of the widths.
    assert np.all(held >= 87) and np.median(ratios, axis=0) == pytest.approx(np.ones(5), abs=0.1)


def test_whiteness_is_a_probability():
    random = np.random.default_rng(6)
    found = [whiteness(random.standard_normal(400)) for _ in range(200)]
    assert np.mean(np.array(found) < 0.1) == pytest.approx(0.1, abs=0.06)
    assert whiteness(np.sin(np.arange(400) / 5.0)) < 1e-10


def test_correlated_residuals_do_not_tell_what_no_residual_depends_on():
    ramp, random = np.linspace(-1.0, 1.0, 500), np.random.default_rng(7)
    residuals = np.cumsum(random.standard_normal(500))
    found, white = covariance([np.column_stack([ramp, -ramp])], [residuals])
    assert not white and np.diag(found).min() > 1e6
    # Nor do errors of derivatives tell two parameters, however much residuals depend on them.
    found, _ = covariance([1e12 * np.column_stack([ramp, ramp])], [random.standard_normal(500)])
    assert np.diag(found).min() > 1.0
    # A width is all that is known of what nothing depends on; of the other it tells nothing more.
    found, _ = covariance([np.column_stack([ramp, 0.0 * ramp])], [random.standard_normal(500)],
                          [np.inf, 0.2])
    assert found == pytest.approx(np.diag([1.0 / (ramp @ ramp), 0.04]), rel=1e-6, abs=1e-9)
    found, _ = covariance([np.zeros((500, 1))], [residuals])
    assert np.isfinite(found).all() and found[0, 0] > 1e6


def test_loads_of_a_record_add_to_those_of_the_scene():
    scene = timo_sim.load_scene(ARM, {'load.torque.harmonic': {'amplitude': [1.0],
                                                               'frequency': [2.0]}})
    record = timo_sim.Record.of({'torque': ([0.0, 1.0], [0.5, 0.7])}, {'shaft': (T, T)})
    sensor = {'torque.gain': 2.0, 'torque.bias': 0.1}
    own = scene.load.stages(0, 10, scene.step)
    both = loads_of(record, scene, sensor).stages(0, 10, scene.step)
    assert (both - own)[..., 4] == pytest.approx(np.full((10, 4), 1.1))


BAD_ARGUMENTS = [
    (dict(free=['arm.lenght']), 'arm.lenght cannot be free: .*did you mean arm.length'),
    (dict(free=['model.modes']), 'model.modes cannot be free: it is no number of the physics'),
    (dict(free=['gravity[2]']), 'gravity has 2 elements'),
    (dict(free=['arm.length', 'arm.length']), 'arm.length is free twice'),
    (dict(free=['arm.damping_ratio', 'arm.damping_ratio[0]']), 'is free twice'),
    (dict(free=[]), 'at least one free parameter'),
    (dict(free=['~inf']), 'at least one free parameter'),
    (dict(free='arm.length'), 'free must be a list of names'),
    (dict(free=[5]), r'free must be a list of names, got .5.'),
    (dict(free=['motor.coulomb_friction']), 'motor.coulomb_friction must be > 0 N m in the'),
    (dict(free=['carrier.force_limit']), 'force_limit cannot be free: it is a limit of commands'),
    (dict(free=['arm.length'], bounds={'arm.length': (1.0, 2.0)}),
     'arm.length = 0.42 must be within its bounds, 1 to 2'),
    (dict(free=['arm.length'], bounds={'arm.length': (2.0, 1.0)}), 'two ascending numbers'),
    (dict(free=['arm.length=2'], bounds={'arm.length': (0.1, 1.0)}),
     'arm.length = 2 must be within its bounds, 0.1 to 1'),
    (dict(free=['arm.length'], bounds={'arm.length': (0.1, 0.2, 0.3)}), 'two ascending numbers'),
    (dict(free=['arm.length'], bounds={'arm.length': 0.1}), 'two ascending numbers'),
    (dict(free=['arm.length=0']), 'arm.length must be > 0 m in the'),
    (dict(free=['arm.length=l']), 'arm.length must be NAME, NAME=VALUE.*, got l'),
    (dict(free=['arm.length~-5%']), 'arm.length must be .* > 0, got -5%'),
    (dict(free=['initial.shaft~x3']), 'initial.shaft must be .*a factor.*, got x3'),
    (dict(free=['initial=0.3']), 'initial must be given without a value, since it .*, got 0.3'),
    (dict(free=['arm.length'], bounds={'arm.section.width': (1.0, 2.0)}), 'need it to be free'),
    (dict(free=['arm.length'], hold_out=1.0), 'hold_out must be .*<= 0.95, got 1'),
    (dict(free=['arm.length'], loss='squared'), 'loss must be one of linear, soft_l1')
]


def test_bad_arguments():
    for arguments, message in BAD_ARGUMENTS:
        record = timo_sim.Record.of({}, SHAFT)
        with pytest.raises(timo_sim.ParameterError, match=message):
            timo_sim.fit(ARM, record, **arguments)


BAD_RECORDS = [
    ({'torqe': (T, T)}, SHAFT, 'inputs of .*: torqe is not known: .*did you mean torque'),
    ({}, {'tip': (T, T)}, 'outputs of .*: tip is not known'),
    ({}, {}, 'a record must have an output'),
    ({}, {'shaft': (T, T[:-1])}, 'shaft must have as many times as values'),
    ({}, {'shaft': (T[::-1], T)}, 'times of shaft must ascend, got 3 s and then 2.998 s'),
    ({}, {'shaft': (T[:10], T[:10])}, 'shaft must have at least 20 finite samples, got 10'),
    ({}, {'shaft': (T, T + 1j)}, 'as many times as values, lists of real numbers'),
    ({'torque': Channel(T, T, hold='spline')}, SHAFT, 'hold of torque must be one of zero')
]


def test_bad_records():
    for inputs, outputs, message in BAD_RECORDS:
        with pytest.raises(timo_sim.ParameterError, match=message):
            timo_sim.Record.of(inputs, outputs)


UNFIT = [
    ({}, T, 'nothing moves the arm'),
    ({'voltage': (T, VOLTAGE)}, T, 'needs motor.dc.resistance > 0, got 0'),
    ({'torque': (T, 1e9 * np.ones_like(T))}, T, 'cannot be predicted with the first guess'),
    ({'drive': Channel(1e6 * T, T, knots=0.02)}, 1e6 * T,
     'the record lasts 3e.06 s, but at most 1e.07 steps of 0.002 s'),
    ({'drive': Channel(T, T, knots=1e-300)}, T, 'knots of drive must be further apart than its'),
    ({'drive': Channel(T + (T > 1.5), T, knots=0.1)}, T,
     'knots of drive must be further apart .*also where these have gaps')
]


def test_records_that_cannot_be_fitted():
    for inputs, t, message in UNFIT:
        record = timo_sim.Record.of(inputs, {'shaft': (t, T**2)})
        with pytest.raises(timo_sim.ParameterError, match=message):
            timo_sim.fit(ARM, record, ['arm.length'])
