# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""What rings after a stop: made records of known answers, and moves that leave less of it."""

from click.testing import CliRunner
import numpy as np
import pytest

import timo_sim
from timo_sim.cli import main
from timo_sim.control.moves import read_move, shape_move, write_move

TIME = np.arange(1000) * 0.005
STOP = 1.2


def made(frequencies=(4.0, 13.0), dampings=(0.02, 0.01), noise=0.02, seed=0):
    """Return a record of a move until STOP, and what then rings, of amplitudes 1, 1/3, ..."""
    random, after = np.random.default_rng(seed), TIME - STOP
    values = 9.8 + noise * random.normal(size=len(TIME)) + np.where(
        after < 0.0, 5.0 * np.sin(2.0 * np.pi * TIME / STOP), 0.0)
    for k, (hertz, ratio) in enumerate(zip(frequencies, dampings)):
        omega = 2.0 * np.pi * hertz
        values += (after >= 0.0) * 3.0**-k * np.exp(-ratio * omega * after) * np.cos(
            omega * np.sqrt(1.0 - ratio**2) * after + random.uniform(0.0, 6.0))
    return values


def test_errors_cover_the_truth_of_two_modes_in_noise():
    """Of 4 numbers in 10 records, 38 of 40 are expected within their intervals."""
    inside = 0
    for seed in range(10):
        found = timo_sim.ringdown(TIME, made(seed=seed), STOP, TIME[-1])
        assert len(found.frequency) == 2
        inside += np.sum(np.abs(found.frequency - [4.0, 13.0]) < found.frequency_error)
        inside += np.sum(np.abs(found.damping - [0.02, 0.01]) < found.damping_error)
    assert inside >= 34  # three deviations of a binomial distribution
    assert (found.frequency_error < 2e-3 * found.frequency).all()


def test_the_stop_is_found_also_with_uneven_samples():
    values, jitter = made(), np.random.default_rng(1).uniform(-2e-3, 2e-3, len(TIME))
    found = timo_sim.ringdown(TIME + jitter, np.interp(TIME + jitter, TIME, values))
    assert STOP - 0.02 < found.t[0] < STOP + 0.25  # a period of the slower one
    assert found.frequency == pytest.approx([4.0, 13.0], rel=2e-3)
    assert found.damping == pytest.approx([0.02, 0.01], abs=2e-3)
    assert not found.remarks


@pytest.mark.parametrize('hertz, ratio, rate, end', [
    (20.0, 2e-3, 400.0, None), (60.0, 5e-4, 1000.0, 20.0), (8.0, 5e-3, 1000.0, 60.0)])
def test_a_long_record_of_a_fast_vibration_has_its_frequency_and_amplitude(
        hertz, ratio, rate, end):
    t, omega = np.arange(0.0, end or 120.0, 1.0 / rate), 2.0 * np.pi * hertz
    values = np.exp(-ratio * omega * t) * np.cos(omega * np.sqrt(1.0 - ratio**2) * t)
    values += 0.01 * np.random.default_rng(0).normal(size=len(t))
    found = timo_sim.ringdown(t, values, *((0.0, end) if end else ()))
    assert found.frequency == pytest.approx([hertz], rel=1e-4)
    assert found.damping == pytest.approx([ratio], rel=0.01)
    # At the first sample of the fit.
    assert found.amplitude == pytest.approx(np.exp(-ratio * omega * found.t[:1]), rel=2e-3)
    assert not found.remarks


def test_a_faster_vibration_is_not_seen_as_a_slow_one():
    t = np.arange(0.0, 60.0, 1.0 / 2000.0)
    values = np.exp(-0.004 * np.pi * t) * np.cos(2.0 * np.pi * t)
    values += 0.9 * np.exp(-1.6 * t) * np.cos(2.0 * np.pi * 26.0 * t)
    found = timo_sim.ringdown(t, values, 0.0, 60.0)
    assert np.abs(found.frequency[:, np.newaxis] - [1.0, 26.0]).min(axis=1).max() < 0.01


def test_a_sensor_that_saturates_is_told_and_one_of_eight_bits_is_not():
    """Damping is wrong by half where what is measured is cut at half of its amplitude."""
    ring = made((4.0,), (0.01,), 0.005)[TIME >= STOP] - 9.8
    for values, remarks in (np.clip(ring, -0.4, 0.4), 2), (np.rint(60.0 * ring), 0):
        found = timo_sim.ringdown(TIME[TIME >= STOP], values, STOP, TIME[-1])
        assert (abs(found.damping[0] - 0.01) > 0.003) == (remarks > 0)
        assert sum('a sensor that saturates' in each for each in found.remarks) == remarks


def test_times_with_seven_digits_and_no_noise_at_all():
    """What the pencil then takes for noise may grow by more than a number holds."""
    t = np.arange(1200) * 0.005
    values = sum(size * np.exp(-rate * t) * np.cos(omega * t + phase) for size, rate, omega, phase
                 in ((1.0, 0.14, 14.0, 0.3), (0.4, 0.5, 86.0, 1.0)))
    found = timo_sim.ringdown(t.astype(np.float32), values)
    assert 2.0 * np.pi * found.frequency == pytest.approx([14.0, 86.0], rel=1e-4)


@pytest.mark.parametrize('values, said', [
    (0.1 * np.random.default_rng(5).normal(size=1000), 'no frequency with 3 periods'),
    (np.sin(30.0 * TIME) + 0.01 * np.random.default_rng(5).normal(size=1000), '4.775 Hz goes on'),
    (np.arange(999.0), 't must ascend and have as many numbers as values.* got 1000 and 999')])
def test_a_record_without_vibration_that_dies_out_is_refused(values, said):
    with pytest.raises(timo_sim.ParameterError, match=said):
        timo_sim.ringdown(TIME, values, end=3.0)


def test_dry_friction_is_told_by_the_straight_line_of_its_decay():
    """The amplitude falls by 4 mu in a period; viscous damping of the same size is not that."""
    said = {}
    for name, envelope in (('dry', np.maximum(1.0 - TIME / 4.0, 0.0)), ('viscous', np.exp(-TIME))):
        noise = 0.01 * np.random.default_rng(2).normal(size=len(TIME))
        found = timo_sim.ringdown(TIME, envelope * np.cos(20.0 * TIME) + noise, start=0.0)
        said[name] = 'dry friction' in found.report()
        assert len(found.frequency) == 1
        assert found.frequency[0] == pytest.approx(20.0 / (2.0 * np.pi), rel=3e-3)
    assert said == {'dry': True, 'viscous': False}


def test_a_shaped_move_of_the_arm_leaves_what_the_formula_says(tmp_path):
    """The shaft is driven along a move; the ring-down of the tip gives the shaper."""
    scene = timo_sim.load_scene({}, {
        'carrier.held': 'both', 'model.modes': 1, 'arm.damping_ratio': 0.01, 'initial.shaft': 0.0})
    rise = np.linspace(0.0, 1.0, 51)
    rise = np.stack([0.3 * rise, 0.2 * rise**2 * (3.0 - 2.0 * rise)], 1)
    np.savetxt(tmp_path / 'move.csv', rise, delimiter=',', header='t,shaft', comments='')
    move = read_move(tmp_path / 'move.csv')

    def vibrating(move):
        run = timo_sim.simulate(scene.vary({
            'motor.shaft': 'driven', 'motor.drive.time': move.t,
            'motor.drive.angle': move.positions[:, 0],
            'motor.drive.speed': np.gradient(move.positions[:, 0], move.t),
            'motor.drive.acceleration': 0.0 * move.t}), 3.0, estimate=False)
        after = (run.t > move.t[-1]) & (run.t < move.t[-1] + 1.0 / own.frequency[0])
        return run, np.ptp(run.deflection()[after, 1])

    own = timo_sim.modes(scene, 0.0)
    run, before = vibrating(move)
    found = timo_sim.ringdown(run.t, run.deflection()[:, 1])
    assert found.frequency[0] == pytest.approx(own.frequency[0], rel=1e-3)
    assert found.damping[0] == pytest.approx(0.01, rel=0.02)
    for error in (1.0, 0.9):
        made = timo_sim.shaper(error * found.poles, 'ZV')
        write_move(shape_move(move, made), tmp_path / f'shaped_{error}.yaml')
        left = vibrating(read_move(tmp_path / f'shaped_{error}.yaml'))[1] / before
        # Both are from the end of their move on, until which the first one dies out as well.
        assert left == pytest.approx(made.residual(own.frequency[0]), abs=0.01)


def test_the_command_takes_a_table_and_shapes_a_trajectory_of_ros(tmp_path):
    np.savetxt(tmp_path / 'phone.csv', np.stack([TIME, made(), 0.0 * TIME], 1), delimiter=',',
               header='Time (s),x (m/s^2),y (m/s^2)', comments='')
    (tmp_path / 'move.yaml').write_text(
        'joint_names: [lift, turn]\npoints:\n'
        '- {positions: [0, 1], velocities: [0, 0], time_from_start: {sec: 0}}\n'
        '- {positions: [1, 3], velocities: [0, 0], time_from_start: {sec: 0, nanosec: 500000000}}')

    def run(*options):
        return CliRunner().invoke(main, ['ringdown', str(tmp_path / 'phone.csv'), *options])

    assert run().exit_code == 2  # it does not say which column
    done = run('--column', 'x (m/s^2)', '--from', str(STOP), '--to', '4', '--move',
               str(tmp_path / 'move.yaml'), '--modes', '2', '--png', str(tmp_path / 'rings.png'))
    assert done.exit_code == 0, done.output
    assert 'ZVD, 2 modes' in done.output and (tmp_path / 'rings.png').exists()
    shaped = read_move(tmp_path / 'move_shaped.yaml')
    assert shaped.joints == ['lift', 'turn']
    assert shaped.positions[[0, -1]] == pytest.approx(np.array([[0.0, 1.0], [1.0, 3.0]]))
    assert shaped.t[-1] == pytest.approx(0.5 + 0.25 + 1.0 / 13.0, abs=0.01)  # a period of each
