# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The observer: its covariance against its errors, a textbook's filter, larger motions."""

import warnings

import numpy as np
from oracles.observed import observe
import pytest
from scipy.linalg import block_diag

import timo_sim
from timo_sim import ModelWarning, ParameterError

PERIOD = 0.02  # of updates [s]
ARM = {'carrier.held': 'both', 'arm.damping_ratio': [0.01], 'sensor.root_strain.noise': 2e-6,
       'sensor.encoder.noise': 1e-4, 'sensor.encoder.resolution': 2e-4}
IMU = {'sensor.gyro.noise': 2e-3, 'sensor.tip_acceleration.noise': 0.05,
       'sensor.root_strain.noise': 0.0}
SIZE, TIME = 0.5, 0.3  # of the disturbance: deviation [N m], correlation time [s]


class Runs:
    """
    Observed arms whose first motion and disturbance are drawn from what the observer expects.

    For each seed and update: error of the tip in its deviation, normalised innovations, and
    whether the error is one of the whole state; `squares` has that of the state at the end.
    """

    def __init__(self, scene, seeds, updates):
        places = timo_sim.linearize(scene).places
        self.tips, self.innovations, self.squares = [], [], []
        for seed in range(seeds):
            for observer, arm, disturbance in observe(scene, seed, (SIZE, TIME), PERIOD, updates):
                error = observer.deflection()[1] - arm.deflection()[1]
                self.tips.append(error / observer.deflection_deviation[1])
                self.innovations.append(observer.normalised_innovation)
            off = np.append((observer.motion.values - arm.motion.values)[places],
                            observer.disturbance - disturbance)
            self.squares.append(off @ np.linalg.solve(observer.covariance, off))
        self.observer, self.tips = observer, np.array(self.tips)
        self.innovations = np.array(self.innovations).reshape(seeds, updates + 1, -1)


def test_tip_is_within_three_deviations_in_99_percent_of_the_samples_of_50_seeds():
    runs = Runs(timo_sim.load_scene({}, ARM), 50, 25)
    assert runs.observer.sensors == ('root_strain', 'encoder')
    assert (abs(runs.tips) < 3.0).mean() > 0.99  # of normal numbers 99.7 % are
    # Errors of a run are correlated: four standard errors of some 500 independent ones.
    assert (abs(runs.tips) < 1.0).mean() == pytest.approx(0.683, abs=4.0 * np.sqrt(0.217 / 500))
    # Innovations are white and normal: four standard errors, and 2 % for the linearisation.
    found, count = runs.innovations, runs.innovations.size
    assert (found**2).mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / count) + 0.02)
    for lag in (1, 2):
        assert (found[:, lag:] * found[:, :-lag]).mean() == pytest.approx(
            0.0, abs=4.0 / np.sqrt(count))
    # So are errors of all states and of the disturbance together.
    states = len(runs.observer.states)
    assert np.mean(runs.squares) == pytest.approx(states, abs=4.0 * np.sqrt(2.0 * states / 50))


def test_imu_on_a_free_carrier():
    runs = Runs(timo_sim.load_scene({}, {**ARM, **IMU, 'carrier.held': 'none'}), 20, 30)
    assert runs.observer.sensors == ('tip_acceleration', 'gyro', 'encoder')
    assert (abs(runs.tips) < 3.0).mean() > 0.99
    squares = runs.innovations**2
    # The accelerometer is nonlinear where the first motion is hardly known.
    assert squares[:, 5:].mean() == pytest.approx(
        1.0, abs=4.0 * np.sqrt(2.0 / squares[:, 5:].size) + 0.02)


def textbook(model, noise, measured, torques, first):
    """Yield state and covariance of a Kalman filter for a discrete model with a disturbance."""
    fade, size = np.exp(-model.dt / TIME), len(model.A) + 1
    b = np.append(model.B, [[0.0]], axis=0)
    # The disturbance acts with its new value.
    entry = np.append(model.B, [[1.0]], axis=0)
    a = block_diag(model.A, 0.0) + fade * entry @ np.eye(size)[[-1]]
    process, c = entry * SIZE**2 * (1.0 - fade**2) @ entry.T, np.hstack([model.C, model.D])
    x, p = np.zeros((size, 1)), first
    for y, torque in zip(measured, torques):
        x, p = a @ x + b * torque, a @ p @ a.T + process
        gain = p @ c.T @ np.linalg.inv(c @ p @ c.T + noise)
        x = x + gain @ (y[:, np.newaxis] - c @ x - model.D * torque)
        p = (np.eye(size) - gain @ c) @ p
        yield x[:, 0], p


def test_small_motions_are_those_of_a_textbooks_filter():
    """Of the linear model, covariance form; some strains are not measured."""
    scene = timo_sim.load_scene({}, {**ARM, 'sensor.encoder.resolution': 0.0})
    observer = timo_sim.observer(scene, disturbance={'torque': (SIZE, TIME)})
    model = timo_sim.linearize(scene).select(
        ['torque_N_m'], ['shaft_rad', 'root_strain']).to_discrete(0.003)
    random, noise = np.random.default_rng(1), np.diag([1e-8, 4e-12])
    small = 1e-3  # of what the filter expects: the model is linear in its own motion, not in P
    measured = small * random.standard_normal((60, 2)) @ np.sqrt(noise)
    torques = small * random.standard_normal(60)
    expected = textbook(model, noise, measured, torques, observer.covariance)
    for (shaft, strain), torque, (x, p) in zip(measured, torques, expected):
        shown = {'encoder': observer.simulator.scene.values['initial.shaft'] + shaft,
                 'root_strain': strain}
        observer.update(shown, {'torque': torque}, 0.003)
        found = np.append(model.state(observer.motion), observer.disturbance)
        scale = np.sqrt(np.diag(p))
        # Measured: 5e-9 in the state, 4e-6 in the covariance, of the differences of the strain.
        assert found / scale == pytest.approx(x / scale, abs=2e-8)
        assert observer.covariance / scale / scale[:, np.newaxis] == pytest.approx(
            p / scale / scale[:, np.newaxis], abs=1e-5)


def test_arm_that_swings_in_gravity_needs_the_nonlinear_model():
    """An arm that hangs at rest swings up by half a turn; the linear filter has the same noise."""
    scene = timo_sim.load_scene({}, {
        **ARM, 'gravity': [0.0, -9.81], 'initial.shaft': -np.pi / 2})
    arm = timo_sim.Simulator(scene)
    observer = timo_sim.observer(scene, disturbance={'torque': (SIZE, TIME)})
    linear = timo_sim.linearize(scene)
    model = linear.select(['torque_N_m'], ['shaft_rad', 'root_strain']).to_discrete(PERIOD)
    torques = np.where(np.arange(75) < 40, 80.0, 20.0)
    seen, errors, tips = [], [], []
    for torque in torques:
        arm.step(torque=torque, duration=PERIOD)
        seen.append([arm.sensors.encoder + np.pi / 2, arm.sensors.root_strain])
        observer.update({'encoder': arm.sensors.encoder, 'root_strain': seen[-1][1]},
                        {'torque': torque}, PERIOD)
        tips.append(arm.deflection()[1])
        errors.append(observer.deflection()[1] - tips[-1])
    assert arm.motion.shaft > 0.5 * np.pi and np.ptp(tips) > 0.2
    first = timo_sim.observer(scene, disturbance={'torque': (SIZE, TIME)}).covariance
    across, = linear.select([], ['tip_transverse_m']).C
    simple = [across @ x[:-1] for x, _ in textbook(
        model, np.diag([1e-8 + 4e-8 / 12.0, 4e-12]), np.array(seen), torques, first)]
    of_linear = np.std(np.array(simple) - tips)
    assert np.std(errors) < 2e-4 and of_linear > 20.0 * np.std(errors)


def test_deviation_of_the_deflection_is_that_of_motions_drawn_from_the_covariance():
    observer = timo_sim.observer(timo_sim.load_scene({}, ARM), ['encoder'])
    observer.update({'encoder': np.pi / 4})
    model, places = observer.model, timo_sim.linearize(timo_sim.load_scene({}, ARM)).places
    drawn = np.tile(observer.motion.values, (20000, 1))
    drawn[:, places] = np.random.default_rng(0).multivariate_normal(
        drawn[0, places], observer.covariance[:-1, :-1], len(drawn))
    assert model.tips(drawn)[:, 1].std() == pytest.approx(
        observer.deflection_deviation[1], rel=4.0 / np.sqrt(2.0 * len(drawn)) + 1e-3)


def test_sensors_that_are_not_measured_are_expected():
    scene = timo_sim.load_scene({}, {**ARM, 'sensor.root_strain.bias': 1e-5})
    arm, observer = timo_sim.Simulator(scene), timo_sim.observer(scene, ['encoder'])
    quiet, shown = timo_sim.Simulator(scene.vary({'sensor.root_strain.noise': 0.0})), []
    for k in range(100):
        torque = 10.0 * np.sin(12.0 * k * PERIOD)
        for each in (arm, quiet):
            each.step(torque=torque, duration=PERIOD)
        observer.update({'encoder': arm.sensors.encoder}, {'torque': torque}, PERIOD)
        shown.append([quiet.sensors.root_strain, *observer.expected('root_strain')])
    true, found = np.array(shown[20:]).T
    assert np.std(true) > 5e-5 and np.std(found - true) < 0.08 * np.std(true)
    assert observer.position() == pytest.approx(arm.position(), abs=2e-3)
    assert len(observer.innovation) == 1


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_gauge_and_imu_within_the_arm_are_expected_as_they_read(formulation):
    scene = timo_sim.load_scene({}, {
        **ARM, **IMU, 'sensor.root_strain.noise': 2e-6, 'sensor.root_strain.position': 0.6,
        'sensor.tip_imu.position': 0.9, 'model.formulation': formulation,
        'initial.modal_coordinates': [0.1, 0.01, 0.0], 'initial.shaft_velocity': 2.0})
    quiet = timo_sim.Simulator(scene.vary({
        name: 0.0 for name in scene.values if name.endswith(('.noise', '.resolution'))}))
    names = 'root_strain', 'tip_acceleration', 'gyro'
    shown = {name: getattr(quiet.sensors, name) for name in names}
    observer = timo_sim.observer(scene, names)
    observer.update(shown, dt=0.0)
    assert observer.innovation == pytest.approx(0.0, abs=1e-10)
    assert min(map(np.max, map(np.abs, shown.values()))) > 1e-4


def test_a_wrong_model_is_a_warning():
    scene = timo_sim.load_scene({}, ARM)
    observer = timo_sim.observer(scene.vary({'arm.young_modulus': 40e9}),
                                 disturbance={'torque': (0.01, 0.1)})
    arm = timo_sim.Simulator(scene)
    with pytest.warns(ModelWarning, match='times as much from expected ones as the covariance'):
        for k in range(100):
            arm.step(torque=5.0 * (k < 10), duration=PERIOD)
            observer.update({'root_strain': arm.sensors.root_strain,
                             'encoder': arm.sensors.encoder}, {'torque': 5.0 * (k < 10)}, PERIOD)
    assert observer.consistency > 2.0


@pytest.mark.parametrize('changes, options, text', [
    ({}, {'sensors': ['gyro']}, r'sensor.NAME.noise or .resolution is > 0, here .*, got .*gyro'),
    ({f'sensor.{name}.{kind}': 0.0 for name in ('encoder', 'root_strain')
      for kind in ('noise', 'resolution')}, {}, 'here none, got .none'),
    ({}, {'sensors': ['encode']}, "sensors must be one of .*, encoder, rotor, got 'encode'"),
    ({'motor.shaft': 'locked'}, {}, 'where only the arm moves it must be given'),
    ({}, {'disturbance': {'torqu': (1.0, 1.0)}}, 'disturbance has torqu, .* you mean torque'),
    ({}, {'disturbance': {'torque': 1.0}}, 'time of a disturbance must be a list of'),
    ({}, {'disturbance': {'torque': (1.0,)}}, 'disturbance must be such as'),
    ({}, {'disturbance': {'torque': (-1.0, 1.0)}}, 'time of a disturbance .* >= 0'),
    ({}, {'disturbance': {'voltage': (1.0, 1.0)}}, 'voltage needs motor.dc.resistance > 0'),
])
def test_what_has_no_observer_is_refused(changes, options, text):
    with pytest.raises(ParameterError, match=text):
        timo_sim.observer(timo_sim.load_scene({}, {**ARM, **changes}), **options)


@pytest.mark.parametrize('matrix', [
    np.eye(8), -np.eye(9), np.full((9, 9), np.nan), np.triu(np.ones((9, 9)))])
def test_bad_covariances_are_refused(matrix):
    observer = timo_sim.observer(timo_sim.load_scene({}, ARM))
    with pytest.raises(ParameterError, match='symmetric and positive definite matrix of 9'):
        observer.covariance = matrix
    observer.covariance = np.diag(np.arange(1.0, 10.0))
    assert observer.covariance == pytest.approx(np.diag(np.arange(1.0, 10.0)))


@pytest.mark.parametrize('measured, command, dt, text', [
    ({'gyro': 0.0}, {}, 0.0, "measured must be one of root_strain, encoder, got 'gyro'"),
    ({'encoder': np.nan}, {}, 0.0, 'or a list of them, got nan'),
    ({'encoder': [0.0, 0.0]}, {}, 0.0, r'must have 1 number\(s\), got \[0.0, 0.0\]'),
    ({'encoder': 'x'}, {}, 0.0, "must be a finite number, .* got 'x'"),
    ({'encoder': 0.7}, {'torqu': 1.0}, 0.002, 'did you mean torque'),
    ({'encoder': 0.7}, {}, 0.0015, 'dt = 0.0015 must be a whole multiple of integrator.step'),
    ({'encoder': 0.7}, {}, -0.001, 'dt must be a finite number >= 0'),
])
def test_bad_updates_are_refused_and_change_nothing(measured, command, dt, text):
    observer = timo_sim.observer(timo_sim.load_scene({}, ARM))
    before = observer.motion.values, observer.covariance, observer.simulator.steps
    with pytest.raises(ParameterError, match=text):
        observer.update(measured, command, dt)
    after = observer.motion.values, observer.covariance, observer.simulator.steps
    assert all(np.array_equal(*pair) for pair in zip(before, after))


@pytest.mark.parametrize('dt', [0.0, 0.005])
def test_the_estimate_goes_on_after_a_sample_that_makes_it_diverge(dt):
    """As a counter of an encoder that jumps; a DivergenceError leaves no part of it behind."""
    scene = timo_sim.load_scene({}, {**ARM, 'initial.shaft': 0.0})
    observer, arm = timo_sim.observer(scene), timo_sim.Simulator(scene)
    for k in range(200):
        arm.step(torque=np.sin(0.1 * k), duration=0.005)
        shown = {'encoder': arm.sensors.encoder + 1e4 * (k == 100),
                 'root_strain': arm.sensors.root_strain}
        if k == 100:
            with pytest.raises(timo_sim.DivergenceError, match='what was measured'):
                observer.update(shown, {'torque': np.sin(0.1 * k)}, dt)
        if k != 100 or not dt:
            observer.update({} if k == 100 else shown, {'torque': np.sin(0.1 * k)}, 0.005)
    off = observer.deflection()[1] - arm.deflection()[1]
    assert abs(off) < 4.0 * observer.deflection_deviation[1] and observer.consistency < 1.2


def test_without_measurements_the_model_goes_on():
    """Also with a torque that is limited, over a long time, and other disturbances."""
    scene = timo_sim.load_scene({}, {**ARM, 'motor.torque_limit': 2.0})
    observer = timo_sim.observer(scene, disturbance={'tip_force': (0.1, 0.0), 'torque': (0.0, 1)})
    arm = timo_sim.Simulator(scene)
    assert observer.states[-3:] == ('disturbance_tip_force_x_N', 'disturbance_tip_force_y_N',
                                    'disturbance_torque_N_m')
    known = observer.deflection_deviation[1]
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        for _ in range(20):
            observer.update({}, {'torque': 3.0}, 0.1)
            arm.step(torque=3.0, duration=0.1)
    assert observer.motion.values == pytest.approx(arm.motion.values, abs=1e-9)
    assert observer.deflection_deviation[1] != known and not len(observer.innovation)
    assert observer.covariance[-3:, -3:] == pytest.approx(np.diag([0.01, 0.01, 0.0]), abs=1e-15)
