# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Fits that start far from the truth, fits to several records, and the record to take next."""

import re

from command_line import call
import numpy as np
import pytest
import yaml

import timo_sim
from timo_sim.fitting import auto

PERIOD, DURATION = 0.004, 2.0
T = PERIOD * np.arange(round(DURATION / PERIOD) + 1)
TRUTH = {'arm.young_modulus': 200e9, 'end_effector.mass': 0.05, 'motor.viscous_friction': 0.05,
         'motor.shaft_inertia': 2e-3}
SCENE = timo_sim.load_scene({}, {
    'arm.length': 0.42, 'arm.section.height': 0.001, 'arm.density': 7800.0,
    'arm.shear_modulus': 77e9,
    'arm.damping_ratio': [0.02], 'carrier.held': 'both', 'end_effector.inertia': 1e-5,
    'initial.shaft': 0.0, 'integrator.step': PERIOD, **TRUTH})
NOISE = {'shaft': 1e-3, 'tip_transverse': 5e-4}  # standard deviations [rad, m]
SQUARE, CHIRP = 0.1 * np.sign(np.sin(6.0 * T + 0.3)), 0.1 * np.sin((6.0 + 8.0 * T) * T)


def made(torque, seed, shaft=0.0, bias=0.0, size=1.0):
    """Return a Record of the true scene, from a run with the torque as a load."""
    random = np.random.default_rng(seed)
    run = timo_sim.simulate(SCENE.vary({
        'initial.shaft': shaft, 'load.torque.piecewise.time': T,
        'load.torque.piecewise.value': torque}), DURATION, estimate=False)
    clean = {'shaft': run.shaft, 'tip_transverse': run.deflection(0.42)[:, 1] + bias}
    return timo_sim.Record.of({'torque': (T, torque)}, {
        name: (T, values + size * NOISE[name] * random.standard_normal(len(T)))
        for name, values in clean.items()})


def wrong(*factors):
    """Return the scene with guesses that are wrong by factors."""
    return SCENE.vary({name: factor * value
                       for factor, (name, value) in zip(factors, TRUTH.items())})


def distances(found, truth=TRUTH):
    """Return how far estimates are from the truth, in their standard deviations."""
    return np.array([abs(found.estimates[name].value - value) / found.estimates[name].deviation
                     for name, value in truth.items()])


def test_a_fit_finds_the_truth_from_a_wrong_guess():
    """The record begins quietly, and stiffness is wrong by a factor of 9."""
    record = made(np.where(T > 0.8, 0.1 * np.sin((6.0 + 20.0 * T) * T), 0.0), 3)
    guess = wrong(9.0, 1 / 3.0, 3.0, 1 / 3.0)
    with pytest.warns(timo_sim.ModelWarning):
        alone = timo_sim.fit(guess, record, [*TRUTH], starts=1, quick=True)
    assert not alone.white
    told = []
    found = timo_sim.fit(guess, record, [*TRUTH], tell=told.append, quick=True)
    assert distances(found).max() < 4.0
    assert found.white
    assert 1 < found.starts <= 16
    assert f'{found.starts} starts were tried' in found.report()
    # It says what it expects, then each start with the residuals before and behind it.
    assert 'a run of the records takes' in told[0] and ' 4 parameters' in told[0]
    starts = [re.fullmatch(r'.* s: start (\d+) of up to 16: rms residual (\S+) -> (\S+) deviations'
                           r' in the first part(, \S+ in all)?', text) for text in told]
    starts = [each.groups() for each in starts if each]
    assert [int(number) for number, *_ in starts] == [*range(1, found.starts + 1)]
    assert all(float(after) <= float(before) for _, before, after, _ in starts)
    times = [float(text.partition(' s: ')[0]) for text in told]
    assert times == sorted(times)


def test_another_set_of_parameters_that_fits_as_well_is_told():
    """Too few samples a second show a frequency and its aliases alike."""
    period, scene = 0.2, SCENE.vary({
        'motor.shaft': 'locked', 'model.modes': 1, 'arm.damping_ratio': [0.0],
        'initial.modal_coordinates': [0.002]})
    run = timo_sim.simulate(scene, 10.0, estimate=False)
    every, random = round(period / PERIOD), np.random.default_rng(1)
    record = timo_sim.Record.of({}, {'tip_transverse': (
        run.t[::every], run.deflection(0.42)[::every, 1] + 1e-5 * random.standard_normal(51))})
    found = timo_sim.fit(scene.vary({'arm.young_modulus': 210e9}), record, [
        'arm.young_modulus~inf'], starts=16)
    assert found.starts == 16
    assert distances(found, {'arm.young_modulus': 200e9}) < 4.0
    truth = timo_sim.modes(scene).frequency[0]
    others = [timo_sim.modes(scene.vary(values)).frequency[0] for values in found.others]
    assert others
    for each in others:
        aliases = np.abs(np.arange(-9, 10) / period + truth)
        assert np.abs(aliases / each - 1.0).min() < 1e-3
    assert 'another set of parameters fits as well: arm.young_modulus = ' in found.report()


def test_records_share_the_physics_and_have_states_and_biases_of_their_own():
    records = [made(SQUARE, 1, 0.3, 0.02), made(CHIRP, 2, -0.2, -0.01, size=3.0)]
    found = timo_sim.fit(wrong(1.2, 0.8, 1.3, 0.9), records,
                         [*TRUTH, 'initial.shaft', 'tip_transverse.bias'],
                         hold_out_records=[made(SQUARE, 5, 0.9)], quick=True)
    own = {'initial.shaft (record 1)': 0.3, 'initial.shaft (record 2)': -0.2,
           'tip_transverse.bias (record 1)': 0.02, 'tip_transverse.bias (record 2)': -0.01}
    assert distances(found, {**TRUTH, **own}).max() < 4.0
    # Each record has its own noise, by which it weighs; the third was predicted alone.
    assert [each.errors['tip_transverse'].rms for each in (found, *found.more)] == (
        pytest.approx([NOISE['tip_transverse'], 3.0 * NOISE['tip_transverse'], np.nan], rel=0.1,
                      nan_ok=True))
    assert found.more[1].until == 0.0
    # The picture has all records, a column for each; the third was held out whole.
    titles = np.reshape([axes.get_title('left') for axes in found.plot().axes], (3, 3))
    assert [title.partition(',')[0] for title in titles[0]] == ['record 1', 'record 2', 'record 3']
    assert [['fitted' in title, 'held out' in title] for title in titles[1]] == [
        [True, False], [True, False], [False, True]]
    assert not any('nan' in title for title in titles.ravel())
    assert found.more[1].errors['tip_transverse'].hold_out_r_squared > 0.99
    assert found.more[1].errors['shaft'].hold_out_r_squared > 0.999


def test_an_offset_of_an_input_is_the_drives_in_all_records():
    """An amplifier keeps its offset, and a record that is held out is predicted with it."""
    records = []
    for seed, torque in ((1, SQUARE), (2, CHIRP), (3, SQUARE[::-1])):
        pushed = made(torque + 0.03, seed)
        records.append(timo_sim.Record.of({'torque': (T, torque)}, {
            name: (T, channel.values) for name, channel in pushed.outputs.items()}))
    found = timo_sim.fit(wrong(1.1, 0.9, 1.1, 0.9), records[:2], [*TRUTH, 'torque.bias'],
                         hold_out_records=records[2:], quick=True)
    assert [name for name in found.estimates if 'bias' in name] == ['torque.bias']
    assert distances(found, {**TRUTH, 'torque.bias': 0.03}).max() < 4.0
    assert [each.hold_out_rms for each in found.more[1].errors.values()] == pytest.approx(
        list(NOISE.values()), rel=0.1)


def test_a_delay_is_the_sensors_in_all_records():
    """The samples of the second record are twice as far apart; the third is predicted."""
    delay = 5 * PERIOD
    records = []
    for seed, torque, every in ((1, SQUARE, 1), (2, CHIRP, 2), (3, SQUARE[::-1], 1)):
        record = made(torque[::every].repeat(every)[:len(T)], seed)
        records.append(timo_sim.Record.of({'torque': (T[::every], torque[::every])}, {
            name: (T[::every] + late, record.outputs[name].values[::every])
            for name, late in {'shaft': 0.0, 'tip_transverse': delay}.items()}))
    found = timo_sim.fit(wrong(1.1, 0.9, 1.1, 0.9), records[:2], [*TRUTH, 'tip_transverse.delay'],
                         hold_out_records=records[2:], quick=True)
    assert [name for name in found.estimates if 'delay' in name] == ['tip_transverse.delay']
    assert distances(found, {**TRUTH, 'tip_transverse.delay': delay}).max() < 4.0
    # A record that is held out is predicted to its noise.
    assert [each.hold_out_rms for each in found.more[1].errors.values()] == pytest.approx(
        [*NOISE.values()], rel=0.1)


def test_the_command_takes_several_records(tmp_path):
    for name, torque in {'a': SQUARE, 'b': CHIRP, 'c': SQUARE[::-1]}.items():
        record = made(torque, 3)
        np.savetxt(tmp_path / f'{name}.csv', np.stack(
            [T, torque, *(each.values for each in record.outputs.values())], axis=1),
            delimiter=',', header='t,torque,shaft,tip_transverse', comments='')
    (tmp_path / 'map.yaml').write_text(yaml.safe_dump({
        'time': {'column': 't'},
        'columns': {name: name for name in ('torque', 'shaft', 'tip_transverse')}}))
    (tmp_path / 'arm.yaml').write_text(yaml.safe_dump({'/**': {'ros__parameters': {
        name: [*value] if isinstance(value, tuple) else value
        for name, value in wrong(2.0, 0.5, 2.0, 0.5).values.items()}}}))
    a, b, c, mapping, arm, fitted = (str(tmp_path / name) for name in (
        'a.csv', 'b.csv', 'c.csv', 'map.yaml', 'arm.yaml', 'fitted.yaml'))
    options = ['--mapping', mapping, '--scene', arm, '--free', ','.join(TRUTH)]
    assert 'record 3, ' in call('fit', a, b, '--hold-out-record', c, *options, '-o', fitted)
    for name, value in TRUTH.items():
        assert timo_sim.load_scene(fitted).values[name] == pytest.approx(value, rel=0.05)
    assert 'one mapping for all or one for each' in call(
        'fit', a, b, '--mapping', mapping, '--mapping', mapping, *options, code=2)


RIGID = SCENE.vary({'model.modes': 0})


def turned(torque=SQUARE, gain=1.0, seed=1, **changes):
    """Return times and angles of the rigid arm under a torque, with noise, times a gain."""
    run = timo_sim.simulate(RIGID.vary({
        'load.torque.piecewise.time': T, 'load.torque.piecewise.value': torque,
        **{name.replace('__', '.'): value for name, value in changes.items()}}),
        DURATION, estimate=False)
    noise = NOISE['shaft'] * np.random.default_rng(seed).standard_normal(len(T))
    return T, gain * run.shaft + noise


def errors_held_out(held, free, fitted=None, **options):
    """Return the errors of the shaft in a record that a fit of the friction has held out."""
    found = timo_sim.fit(
        RIGID.vary({'motor.viscous_friction': 0.06}),
        fitted or timo_sim.Record.of({'torque': (T, SQUARE)}, {'shaft': turned()}),
        free, hold_out_records=[held], quick=True, **options)
    assert found.more[-1].until == 0.0
    return found.more[-1].errors['shaft']


def test_a_record_that_is_held_out_begins_at_its_angle_over_the_gain_of_the_sensor():
    fitted, held = (timo_sim.Record.of({'torque': (T, SQUARE)}, {
        'shaft': turned(gain=1.2, seed=seed, initial__shaft=angle)})
        for seed, angle in ((1, 0.5), (2, 1.0)))
    for free in (['initial.shaft'], []):  # without, it is seen that it begins elsewhere
        errors = errors_held_out(held, ['motor.viscous_friction', 'shaft.gain', *free], fitted)
        assert errors.hold_out_rms == pytest.approx(NOISE['shaft'], rel=0.5)


def test_a_record_that_is_held_out_has_not_the_first_motion_of_the_fitted_one():
    """Also with `auto`, whose scene has the motion with which the fitted record begins."""
    fitted = timo_sim.Record.of({'torque': (T, SQUARE)}, {
        'shaft': turned(initial__shaft_velocity=1.5)})
    held = timo_sim.Record.of({'torque': (T, SQUARE)}, {'shaft': turned(seed=2)})
    errors = errors_held_out(held, ['motor.viscous_friction', 'initial.shaft_velocity'], fitted,
                             auto=True)
    assert errors.hold_out_rms == pytest.approx(NOISE['shaft'], rel=0.1)


def test_what_is_measured_late_does_not_say_how_a_record_that_is_held_out_begins():
    t, angle = turned()
    late = t > 0.5
    held = timo_sim.Record.of({'torque': (T, SQUARE)}, {'shaft': (t[late], angle[late])})
    for free in ['motor.viscous_friction'], ['motor.viscous_friction', 'initial.shaft']:
        assert errors_held_out(held, free).hold_out_rms == pytest.approx(NOISE['shaft'], rel=0.1)
    # In a record that is fitted it is a guess, and the search finds where the shaft began.
    found = timo_sim.fit(RIGID.vary({'motor.viscous_friction': 0.06}), held,
                         ['motor.viscous_friction'], quick=True)
    assert found.estimates['initial.shaft'].value == pytest.approx(0.0, abs=0.01)
    assert not found.warnings


def test_a_guess_in_place_of_a_value_of_0_does_for_a_record_that_is_held_out():
    held = timo_sim.Record.of({'torque': (T, SQUARE)}, {'shaft': turned(seed=2)})
    found = timo_sim.fit(RIGID.vary({'motor.viscous_friction': 0.0}), timo_sim.Record.of(
        {'torque': (T, SQUARE)}, {'shaft': turned()}), ['motor.viscous_friction=0.06'],
        hold_out_records=[held], quick=True)
    assert found.more[0].errors['shaft'].hold_out_rms == pytest.approx(NOISE['shaft'], rel=0.1)


def test_an_output_that_begins_after_the_first_part_of_the_motion_is_fitted_from_there():
    record = made(SQUARE, 1)
    late = T > 1.2
    tip = record.outputs['tip_transverse'].values[late]
    found = timo_sim.fit(wrong(1.1, 0.9, 1.1, 0.9), timo_sim.Record.of(record.inputs, {
        'shaft': record.outputs['shaft'], 'tip_transverse': (T[late], tip)}), [*TRUTH], quick=True)
    assert distances(found).max() < 4.0 and not found.warnings


def test_an_input_of_the_second_record_alone_has_its_gain_in_the_warnings():
    ring = timo_sim.Record.of({}, {'shaft': turned(0.0 * T, initial__shaft_velocity=3.0)})
    driven = timo_sim.Record.of({'torque': (T, 0.05 * SQUARE)}, {'shaft': turned()})
    with pytest.warns(timo_sim.ModelWarning, match=(
            r'does not hold torque\.gain = (19\.9|20)\d*: .*torque\.gain: more than 10 times')):
        found = timo_sim.fit(RIGID.vary({'initial.shaft_velocity': 1e-3}), [ring, driven],
                             ['motor.viscous_friction', 'torque.gain=1~inf'], quick=True)
    assert found.values['torque.gain'] == pytest.approx(20.0, rel=0.01)


def test_a_known_noise_holds_again_when_the_model_is_right():
    """With `auto` the arm without its spring is far off; the intervals are those of the end."""
    t, angle = turned(motor__spring__stiffness=0.05, motor__spring__rest=0.0)
    record = timo_sim.Record.of({'torque': (T, SQUARE)}, {'shaft': (t, angle, NOISE['shaft'])})
    found = timo_sim.fit(RIGID.vary({'motor.viscous_friction': 0.06}), record,
                         ['motor.viscous_friction'], auto=True, quick=True)
    again = timo_sim.fit(found.scene, record, [*found.estimates], quick=True)
    assert len(found.estimates) > 1
    assert [each.deviation for each in found.estimates.values()] == pytest.approx(
        [each.deviation for each in again.estimates.values()], rel=0.1)


def test_an_output_that_does_not_vary_has_no_r_squared():
    """The mean of equal numbers differs from them by round-off: R^2 was -1e30."""
    still = np.full(len(T), 0.017)
    assert np.std(still) > 0.0
    record = timo_sim.Record.of({'torque': (T, SQUARE)}, {
        'shaft': turned(), 'carrier_x': (T, still)})
    scene = RIGID.vary({'motor.viscous_friction': 0.06, 'carrier.held': 'none',
                        'initial.carrier_x': 0.017})
    found = timo_sim.fit(scene, record, ['motor.viscous_friction', 'carrier_x.bias'],
                         hold_out=0.3, quick=True)
    errors = found.errors['carrier_x']
    assert np.isnan([errors.r_squared, errors.hold_out_r_squared]).all()


@pytest.mark.parametrize('error', [
    np.linalg.LinAlgError('SVD did not converge'), FloatingPointError('0/0')])
def test_effects_that_cannot_be_tried_do_not_cost_the_fit(monkeypatch, error):
    def fails(*_):
        raise error
    monkeypatch.setattr(auto, 'suspects', fails)
    record = timo_sim.Record.of({'torque': (T, SQUARE)}, {'shaft': turned()})
    found = timo_sim.fit(RIGID.vary({'motor.viscous_friction': 0.06}), record,
                         ['motor.viscous_friction'], auto=True, quick=True)
    assert found.estimates['motor.viscous_friction'].value == pytest.approx(0.05, rel=0.01)
    assert found.ladder[-1] == f'no more effects were tried: {error}'


def test_a_record_that_is_held_out_and_cannot_be_run_is_not_said_to_be_missing():
    record = timo_sim.Record.of({'torque': (T, SQUARE)}, {'shaft': turned()})
    held = timo_sim.Record.of({'torque': (T, 1e7 * SQUARE)}, record.outputs)
    with pytest.warns(timo_sim.ModelWarning, match=r'one run of the whole record \(record 2\) is'):
        found = timo_sim.fit(SCENE.vary({'motor.viscous_friction': 0.06}), record,
                             ['motor.viscous_friction'], hold_out_records=[held], quick=True)
    assert found.verdict.startswith('nothing that can be compared was held out')
