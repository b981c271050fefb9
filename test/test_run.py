# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Runs: shapes, kinematics, energy, samples, refusals."""

import os
import re
import signal
import subprocess
import sys

from command_line import call
import numpy as np
import pandas
import pytest

from oracles.energy import balance, work
import timo_sim
from timo_sim.runs.simulate import enough_samples


def test_rates_are_derivatives_of_the_coordinates(paper):
    run = timo_sim.simulate(timo_sim.load_scene(paper), 1.0)
    h = run.t[1]
    half = run.values.shape[1] // 2
    x = run.values[:, :half]
    # Five points: error h^4/30 times the fifth derivative, below 1e-3 x (190 rad/s)^5 in mode 3.
    slope = (x[:-4] - 8 * x[1:-3] + 8 * x[3:-1] - x[4:]) / (12 * h)
    assert np.abs(slope - run.values[2:-2, half:]).max() < 1e-5


def test_zero_steps_have_the_start_as_their_sample():
    scene = timo_sim.load_scene({}, {'initial.shaft': 0.3, 'initial.modal_rates': [0.5, 0.0, 0.0]})
    simulator = timo_sim.Simulator(scene)
    for _ in range(3):  # memory that is never written differs from time to time
        motions, _ = simulator.advance(0, sample_every=1)
        for sample in timo_sim.simulate(scene, 0.0).values, motions:
            # Rates go through the momenta of the state and back: some units of round-off.
            assert np.abs(sample - scene.initial_motion()).max() < 1e-14


def test_energy_is_balanced_and_samples_that_are_too_few_for_that_warn(tmp_path):
    scene = timo_sim.load_scene({}, {
        'model.modes': 5, 'arm.damping_ratio': [0.02], 'motor.viscous_friction': 0.5,
        'load.torque.harmonic.amplitude': [5.0], 'load.torque.harmonic.frequency': [1.5],
        'initial.modal_rates': [0.0, 1.0, 0.3, 0.0, 0.0]})
    dense = timo_sim.simulate(scene, 5.0)
    done = work(np.rint(1e9 * dense.t), dense.values[:, 2:3],
                dense.shaft_velocity[:, np.newaxis], dense.effort[:, 2:])
    done = np.append(0.0, np.cumsum(done))
    for run in dense, timo_sim.open_log(dense.save(tmp_path / 'run.mcap')):
        left = run.energy() - run.energy()[0] + run.dissipated() - done
        # Measured: 6e-7 J, by modes of up to 470 rad/s.
        assert np.abs(left).max() < 2e-6 and run.dissipated()[-1] > 0.5
    thin = timo_sim.simulate(scene, 5.0, sample_every=50)
    with pytest.warns(timo_sim.ModelWarning, match='samples are too far apart: take more'):
        thin.dissipated()
    slow = timo_sim.Run(scene, thin.model, thin.t, 0.0 * thin.values, thin.friction_heat)
    assert not slow.dissipated().any()


def test_energy_balance_closes(paper):
    def worst(*scene):
        run = timo_sim.simulate(*scene, estimate=False)
        return np.abs(balance(run)).max() / run.energy().max()

    # Simpson's rule at 500 Hz under loads of 4 Hz has a relative error of (0.05)^4 / 2880.
    assert worst(timo_sim.load_scene(paper), 3.0, 2) < 1e-6
    driven = timo_sim.load_scene('spin_up')
    assert worst(driven, 10.0) < 1e-6
    # The torque acts on the rotor of an elastic gear, which turns ahead of the shaft.
    assert worst(timo_sim.load_scene(paper, {
        'motor.gear.stiffness': 500.0, 'motor.gear.damping': 1.0, 'motor.rotor.inertia': 0.5,
        'motor.rotor.viscous_friction': 0.1, 'arm.damping_ratio': [0.02]}), 3.0) < 1e-6
    # Loads that jump at a sample, with a harmonic one, and one that makes the drive's torque jump.
    for values in ({'load.force_x.table.time': [0.0, 0.5, 0.5, 1.5],
                    'load.force_x.table.value': [0.0, 20.0, -10.0, 5.0],
                    'load.torque.piecewise.time': [0.0, 0.5, 1.0, 1.005],
                    'load.torque.piecewise.value': [5.0, -15.0, 10.0, -10.0],
                    'load.torque.harmonic.amplitude': [5.0],
                    'load.torque.harmonic.frequency': [2.0]},
                   {**driven.values, 'load.force_x.piecewise.time': [0.0, 0.5],
                    'load.force_x.piecewise.value': [5.0, -35.0]}):
        for every in 1, 5:
            assert worst(values, 2.0, every) < 2e-6 * every**4


def test_work_is_exact_for_a_constant_force_and_zero_at_a_reset():
    t = np.array([0.0, 0.1, 0.25, 0.25, 0.4, 0.5])
    x = np.column_stack([t**3, 2.0 * t])
    speed = np.column_stack([3.0 * t**2, 2.0 + 0.0 * t])
    done = work(np.rint(t * 1e9), x, speed, np.tile([2.0, 3.0], (6, 1)))
    assert np.allclose(done, np.diff(2.0 * t**3 + 6.0 * t), rtol=1e-12, atol=0.0)
    x[3:] += 7.0  # a jump at the same time
    assert work(np.rint(t * 1e9), x, speed, np.tile([2.0, 3.0], (6, 1)))[2] == 0.0


def test_projection_gives_back_a_mode():
    scene = timo_sim.load_scene({'model.modes': 3})
    modes = scene.build().modes
    q = timo_sim.project_on_modes(scene, lambda xi: 0.2 * modes.deflection(xi)[:, 1],
                                  lambda xi: 0.2 * modes.rotation(xi)[:, 1])
    assert q == pytest.approx([0.0, 0.2, 0.0], abs=1e-13)


def test_duration_and_sampling_must_fit_the_step(paper):
    scene = timo_sim.load_scene(paper, {'integrator.step': 0.01})
    with pytest.raises(timo_sim.ParameterError, match='duration = 0.125.*the ratio is 12.5'):
        timo_sim.simulate(scene, 0.125)
    with pytest.raises(timo_sim.ParameterError, match='sample_every = 3 must divide.*10'):
        timo_sim.simulate(scene, 0.1, sample_every=3)


def test_xi_must_be_on_the_arm(paper):
    run = timo_sim.simulate(timo_sim.load_scene(paper), 0.01)
    for xi in (2.5, -0.1, np.nan, [0.0, 2.5]):
        with pytest.raises(ValueError, match=re.escape(
                f'xi must be between 0 and arm.length = 2.0 m, got {np.ravel(xi)[-1]}')):
            run.position(xi)


def test_points_are_spelt_alike_and_are_the_tip_by_default(paper):
    run, simulator = timo_sim.simulate(paper, 0.5), timo_sim.Simulator(paper)
    simulator.advance(500)
    for field in 'position', 'deflection', 'rotation':
        of_run, now = getattr(run, field), getattr(simulator, field)
        assert of_run() == pytest.approx(of_run(2.0), abs=1e-14)
        assert np.abs(of_run()[-1]).max() > 0.0
        for xi in (None, 1.3, [0.0, 2.0]):
            assert now(xi) == pytest.approx(of_run(xi)[-1], abs=1e-15)
    # The tip's place by hand.
    turn = np.array([[np.cos(run.shaft), -np.sin(run.shaft)],
                     [np.sin(run.shaft), np.cos(run.shaft)]])
    place = run.carrier + np.einsum('ijn,nj->ni', turn, run.deflection() + [2.0, 0.0])
    assert run.position() == pytest.approx(place, abs=1e-14)
    # Differences of the world's velocity, in axes of the tip.
    h, motions = 1e-3, run.model.velocities(run.values, run.model.tip_point)[0][:, 0]
    rate, angle = (motions[400] - motions[398]) / (2.0 * h), (run.shaft + run.rotation())[399]
    axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    simulator.reset()
    simulator.advance(399)
    seen = simulator.sensors.tip_acceleration
    assert seen == pytest.approx(axes @ rate, abs=2e-3)
    assert seen == pytest.approx(run.tip_acceleration()[399], abs=1e-9)


def test_a_motion_prints_its_parts_with_units(paper):
    run = timo_sim.simulate(paper, 0.1)
    one, text = run.motion[-1], str(run.motion[-1])
    assert f'shaft            {run.shaft[-1]} rad\n' in text
    assert [line.split()[0] for line in text.splitlines()[1:]] == [
        'carrier', 'shaft', 'q', 'carrier_velocity', 'shaft_velocity', 'qdot']
    for unit in ('m', 'rad', 'm sqrt(kg)', 'm/s', 'rad/s', 'm sqrt(kg)/s'):
        assert f' {unit}\n' in text + '\n'
    assert 'q                (101, 3) m sqrt(kg)' in repr(run.motion)
    assert np.array_equal(one, run.values[-1])
    assert np.array_equal(run.motion[10:20].q, run.q[10:20])
    with pytest.raises(IndexError):
        run.motion[:, :3]  # no motions, but columns


REFUSED = [
    (['papr'], 'did you mean paper?'),
    (['.'], 'Is a directory'),
    (['paper', '--set', 'model.mode=2'], 'did you mean model.modes?'),
    (['paper', '--duration', '0.1', '-o', 'run.txt'], 'must end with .mcap, .parquet or .csv'),
    (['paper', '--duration', '0.1', '-o', 'old.csv'], 'old.csv exists')
]


def test_the_command_refuses(tmp_path, monkeypatch):
    for arguments, words in REFUSED:
        monkeypatch.chdir(tmp_path)
        (tmp_path / 'old.csv').touch()
        told = call('simulate', *arguments, code=2)
        # It is refused before the run, which may take minutes.
        assert words in told and 'samples' not in told


@pytest.mark.parametrize('option', ['-o=run.csv', '-o=run.mcap', '--png=run.png', '--gif=run.gif'])
def test_a_place_that_cannot_be_written_is_refused_before_the_run(option, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, 'access', lambda path, mode: path != tmp_path)
    told = call('simulate', 'paper', '--duration=0.01', *option.split('='), code=1)
    assert 'ermission denied' in told and 'samples' not in told and not os.listdir()
    name, path = option.replace('=', '=none/').split('=')
    if path != 'none/run.mcap':  # a log makes its folder
        told = call('simulate', 'paper', '--duration=0.01', name, path, code=2)
        assert told == f'timo_sim: {path} cannot be written: its folder does not exist\n'


def test_several_values_may_follow_set(tmp_path):
    path = tmp_path / 'run.mcap'
    call('simulate', '--duration=0.01', '--set=model.modes=2', 'arm.length=1.5', '--set',
         'motor.mass=1', 'paper', '-o', path)
    values = timo_sim.open_log(path).scene.values
    assert (values['model.modes'], values['arm.length']) == (2, 1.5)


def test_a_command_whose_reader_has_left_ends_as_other_programs_do():
    """As with `| head`: quietly, with the code of a program that SIGPIPE ends."""
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run([sys.executable, '-m', 'timo_sim', 'urdf', 'paper'], stdout=writer,
                          stderr=subprocess.PIPE)
    os.close(writer)
    assert (done.returncode, done.stderr) == (128 + signal.SIGPIPE, b'')


def test_the_command_shows_a_warning_as_one_line():
    command = ['simulate', 'paper', '--duration', '0.01', '--set', 'initial.shaft=45']
    done = subprocess.run([sys.executable, '-m', 'timo_sim', *command], capture_output=True,
                          text=True)
    told, = [line for line in done.stderr.splitlines() if 'compiling' not in line]
    assert told.startswith('timo_sim: is this meant? initial.shaft = 45 rad is more than a turn')


def test_the_command_takes_samples_of_a_long_run_at_even_distances(tmp_path):
    shown = {}
    for steps in (20_000, 60_000):
        shown[steps] = 'samples a second' in call(
            'simulate', 'paper', '--duration', 1e-4 * steps, '-o', tmp_path / f'{steps}.csv',
            '--no-estimate', '--set', 'model.modes=0', 'integrator.step=0.0001')
        found = pandas.read_csv(tmp_path / f'{steps}.csv')['time_s']
        assert len(found) == 20_001 and np.ptp(np.diff(found)) < 1e-9
    assert shown == {20_000: False, 60_000: True}
    assert enough_samples(2 * 40_009) == 2  # 40 009 is prime
