# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Records in files and logs, and the command `timo_sim fit`."""

import os
from pathlib import Path
import re
import signal
import subprocess
import sys

from command_line import call
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
import yaml

import timo_sim
from timo_sim.fitting.logs import read_log
from timo_sim.fitting.problem import Driven
from timo_sim.fitting.record import Channel
from timo_sim.log.columns import read_table

T = 0.01 * np.arange(200)
ANGLE, TORQUE = np.sin(T), np.cos(3.0 * T)
MAPPING = {'time': {'column': 'clock', 'unit': 'ms'},
           'columns': {'hub': {'quantity': 'shaft', 'unit': 'deg', 'noise': 0.5},
                       'u': {'quantity': 'torque', 'scale': -0.5, 'offset': 0.1}}}


def written(folder, kind):
    """Write the table of a kind, with times in ms that begin at 7 s; return its path."""
    table = {'clock': 7000.0 + 1e3 * T, 'hub': np.degrees(ANGLE), 'u': (0.1 - TORQUE) / 0.5}
    path = folder / f'table.{kind}'
    if kind == 'parquet':
        pytest.importorskip('pyarrow')
        import pyarrow.parquet
        pyarrow.parquet.write_table(pyarrow.table(table), path)
    elif kind == 'mat':
        from scipy.io import savemat
        savemat(path, {name: values[:, np.newaxis] for name, values in table.items()})
    else:
        separator = {'csv': ',', 'tsv': '\t', 'txt': ' '}[kind]
        np.savetxt(path, np.column_stack([*table.values()]), delimiter=separator,
                   header=separator.join(table), fmt='%.12g')
    return path


def test_a_column_of_times_replaces_a_common_period(tmp_path):
    """And a period a common column; the shaft was read with the period of the torque."""
    path, hub = written(tmp_path, 'csv'), {'quantity': 'shaft', 'unit': 'deg'}
    for common, own in ({'period': 0.005}, {'column': 'clock', 'unit': 'ms'}), (
            {'column': 'clock', 'unit': 'ms'}, {'period': 0.005}):
        record = timo_sim.read_record(path, {'time': common, 'columns': {
            'u': 'torque', 'hub': {**hub, 'time': own}}})
        ends = [record.inputs['torque'].t[-1], record.outputs['shaft'].t[-1]]
        assert ends == pytest.approx([0.995, 1.99] if 'period' in common else [1.99, 0.995])


@pytest.mark.parametrize('kind', ['csv', 'tsv', 'txt', 'parquet', 'mat'])
def test_tables_are_read_in_their_units(tmp_path, kind):
    record = timo_sim.read_record(written(tmp_path, kind), MAPPING)
    shaft, torque = record.outputs['shaft'], record.inputs['torque']
    assert shaft.values == pytest.approx(ANGLE, abs=1e-9)
    assert torque.values == pytest.approx(TORQUE, abs=1e-9)
    assert shaft.t == pytest.approx(T, abs=1e-9) and record.duration == pytest.approx(1.99)
    assert shaft.noise == pytest.approx(np.radians(0.5))


@pytest.mark.parametrize('time', ['clock', 0])
def test_times_by_the_name_or_number_of_their_column(tmp_path, time):
    path, own = written(tmp_path, 'csv'), {'u': {'quantity': 'torque', 'time': time}}
    record = timo_sim.read_record(path, {'time': time, 'columns': {'hub': 'shaft', **own}})
    for each in record.outputs['shaft'], record.inputs['torque']:
        assert each.t == pytest.approx(1e3 * T, abs=1e-6)  # of ms, taken for seconds


def test_columns_by_number_and_of_a_matrix(tmp_path):
    from scipy.io import savemat
    savemat(tmp_path / 'a.mat', {'data': np.column_stack([T, ANGLE])})
    savemat(tmp_path / 'b.mat', {'u': TORQUE})
    record = timo_sim.read_record(tmp_path / 'a.mat', {'time': {'column': 'data:0'}, 'columns': {
        'data:1': 'shaft', 'u': {'quantity': 'torque', 'file': 'b.mat',
                                 'time': {'file': 'a.mat'}}}})
    assert np.array_equal(record.outputs['shaft'].values, ANGLE)
    assert np.array_equal(record.inputs['torque'].values, TORQUE)
    np.savetxt(tmp_path / 'c.csv', np.column_stack([ANGLE, TORQUE]), header='made by a rig')
    record = timo_sim.read_record(tmp_path / 'c.csv', {
        'time': {'period': 0.01}, 'columns': {0: 'shaft', 1: 'torque'}, 'start': 0.5, 'end': 1.5})
    assert np.array_equal(record.outputs['shaft'].values, ANGLE[50:151])
    assert record.outputs['shaft'].t == pytest.approx(T[:101], abs=1e-12)


def test_a_part_that_begins_between_samples_begins_with_the_values_there():
    t = np.arange(200) * 0.01
    whole = timo_sim.Record.of({
        'drive': (t, np.sin(2.0 * t)), 'torque': (t, t), 'force_x': Channel(t, t, hold='linear'),
    }, {'root_strain': (t, t)})
    record = whole.cut(0.8747)
    assert record.inputs['torque'].values[0] == pytest.approx(0.87)
    assert record.inputs['force_x'].values[0] == pytest.approx(0.8747)
    # The driven shaft's acceleration, twice the third of a piece's coefficients.
    rows = Driven(record.inputs['drive'], 1.0, 0.0, 0.0).rows(0.001)[1:-1]
    assert 2.0 * rows[:, 3] == pytest.approx(-4.0 * np.sin(2.0 * (rows[:, 0] + 0.8747)), abs=1e-3)
    # A sample that round-off puts behind the start is at the start.
    for start in np.nextafter(t[7], [0.0, 1.0]):
        assert np.diff(whole.cut(start).inputs['drive'].t).min() > 0.009


def test_rows_without_a_number_are_left_out(tmp_path):
    (tmp_path / 'a.csv').write_text('t,theta,u\n' + ''.join(
        f'{t},{"" if k % 3 else angle},{torque}\n'
        for k, (t, angle, torque) in enumerate(zip(T, ANGLE, TORQUE))))
    record = timo_sim.read_record(tmp_path / 'a.csv', NAMED)
    assert np.array_equal(record.outputs['shaft'].values, ANGLE[::3])
    assert len(record.inputs['torque'].t) == 200


NAMED = {'time': {'column': 't'}, 'columns': {'u': 'torque', 'theta': 'shaft'}}
ROWS = np.column_stack([T, TORQUE, ANGLE])


def lines(rows, separator=',', end='', decimal='.'):
    """Return rows of numbers as text."""
    return ''.join(separator.join(repr(float(each)).replace('.', decimal) for each in row)
                   + end + '\n' for row in rows)


TEXTS = [
    '\ufefft,u,theta\n' + lines(ROWS),                              # Excel's CSV
    't;u;theta\n' + lines(ROWS, ';', decimal=','),
    't\tu\ttheta\n' + lines(ROWS, '\t', decimal=','),
    't u theta\n' + lines(ROWS, '  ', decimal=','),
    't,u,theta\n[s],[N m],[rad]\n' + lines(ROWS),
    'Run 3, 1 May, rig A\nt,u,theta\ns,Nm,rad\n' + lines(ROWS),
    't,u,theta\n' + lines(ROWS, end=','), 't,u,theta,\n' + lines(ROWS, end=','),
    't,u,theta,\n' + lines(ROWS), '"t", "u","theta"\n' + lines(ROWS),
    '"time,\nof day",t,"u",theta\n' + lines(np.column_stack([T, ROWS])),
    '# t [s] u [V] theta [deg] w\n' + lines(np.column_stack([ROWS, T]), ' '),
    't,u,theta,w\n' + lines(np.column_stack([ROWS, np.nan * T])).replace('nan', 'N/A')
]


def test_columns_of_texts_have_their_names(tmp_path):
    """What spreadsheets and rigs write: the numbers are those of NumPy, digit by digit."""
    for text in TEXTS:
        for encoding in ('utf-8', 'utf-16'):
            (tmp_path / 'a.csv').write_text(text, encoding=encoding)
            record = timo_sim.read_record(tmp_path / 'a.csv', NAMED)
            assert np.array_equal(record.inputs['torque'].values, TORQUE)
            assert np.array_equal(record.outputs['shaft'].values, ANGLE)
            assert np.array_equal(record.outputs['shaft'].t, T)


AMBIGUOUS = [
    ('# time of u and theta\n' + lines(ROWS, ' '), 'u is no column .* 5 names for 3 columns'),
    ('"time, s",u\n' + lines(ROWS), 'u is no column .* 2 names for 3 columns'),
    ('t,u,theta,u\n' + lines(np.column_stack([ROWS, T])), 'u is the name of the columns 1, 3'),
    ('t;u;theta\n' + lines(ROWS, ';').replace('.', ',', 1), 'must have decimal points, or'),
    ('t,u,theta\n' + ''.join(f'{k},"{k},000",1\n' for k in range(30)), 'must have decimal point'),
    ('t,u,theta\n' + lines(ROWS).replace('1.0', '1+2j'), 'numbers alone: .*1\\+2j'),
    ('t,u,theta\n' + ''.join(f'12:{line}\n' for line in lines(ROWS).split()), 'no line of number'),
    ('1,2\n3\n', 'row 2 of numbers has 1 columns, the first has 2'),
    ('1,2\n3,x\n', 'must have numbers alone')
]


def test_columns_that_cannot_be_told_are_refused(tmp_path):
    for text, message in AMBIGUOUS:
        (tmp_path / 'a.csv').write_text(text)
        with pytest.raises(timo_sim.ParameterError, match=message):
            timo_sim.read_record(tmp_path / 'a.csv', NAMED)
    (tmp_path / 'a.csv').write_text('1,2\n3,4\n')
    with pytest.raises(timo_sim.ParameterError, match='mapping must be given with .*a.csv'):
        timo_sim.read_record(tmp_path / 'a.csv')


def test_records_in_rows(tmp_path):
    from scipy.io import savemat
    savemat(tmp_path / 'a.mat', {'data': ROWS.T})
    record = timo_sim.read_record(tmp_path / 'a.mat', {
        'time': 'data:0', 'columns': {'data:1': 'torque', 'data:2': 'shaft'}})
    assert np.array_equal(record.inputs['torque'].values, TORQUE)
    assert np.array_equal(record.outputs['shaft'].values, ANGLE)
    assert np.array_equal(record.outputs['shaft'].t, T)


def test_structures_of_simulink(tmp_path):
    """A 'structure with time' has signals of one or more columns; a struct has fields."""
    from scipy.io import savemat
    signals = np.zeros(2, dtype=[('values', object), ('label', object)])
    signals['values'] = [TORQUE[:, np.newaxis], np.column_stack([TORQUE, ANGLE])]
    signals['label'] = ['u', 'both']
    savemat(tmp_path / 'a.mat', {
        'out': {'time': T[:, np.newaxis], 'signals': signals, 'blockName': 'scope'},
        'one': {'signals': {'values': TORQUE[:, np.newaxis]}}})
    for torque in ('out.signals[0].values', 'one.signals.values'):
        record = timo_sim.read_record(tmp_path / 'a.mat', {
            'time': {'column': 'out.time'},
            'columns': {torque: 'torque', 'out.signals[1].values:1': 'shaft'}})
        assert np.array_equal(record.inputs['torque'].values, TORQUE)
        assert np.array_equal(record.outputs['shaft'].values, ANGLE)
    savemat(tmp_path / 'b.mat', {'name': 'timeseries'})
    with pytest.raises(timo_sim.ParameterError, match='b.mat has no arrays of numbers'):
        timo_sim.read_record(tmp_path / 'b.mat', NAMED)


def test_a_damaged_mat_file_does_not_end_the_process(tmp_path):
    """SciPy crashes at some of these bits."""
    from scipy.io import savemat
    path = tmp_path / 'arm.mat'
    savemat(path, {'t': T[:40], 's': {'a': ANGLE[:40], 'b': [1, 2, 3]}, 'name': 'text',
                   'c': np.array([T[:40], 'x'], dtype=object)})
    intact = path.read_bytes()
    for bit in (1163, 1408, 1412):
        damaged = bytearray(intact)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        try:
            read_table(path)
        except timo_sim.ParameterError as error:
            assert 'cannot be read' in str(error)


def test_mappings_of_the_page(tmp_path):
    """Each mapping of doc/fit.md reads the rig that its text describes."""
    from scipy.io import savemat
    degrees, bend = np.degrees(ANGLE), 0.01 * TORQUE
    page = (Path(__file__).resolve().parents[1] / 'doc/fit.md').read_text(encoding='utf-8')
    rows = np.column_stack([1e3 * T, 255.0 / 12.0 * TORQUE, ANGLE * 4 * 1024 * 70 / (2.0 * np.pi),
                            bend / 9.80665])
    np.savetxt(tmp_path / 'rig.csv', rows, delimiter=',', header='ms,pwm,counts,acc', comments='')
    savemat(tmp_path / 'rig.mat', {'data': np.column_stack([T, TORQUE, degrees, bend / 1.35e-4])})
    signals = np.zeros(2, dtype=[('values', object)])
    signals['values'] = [degrees[:, np.newaxis], np.degrees(bend)[:, np.newaxis]]
    savemat(tmp_path / 'rig_simulink.mat', {
        'u': {'time': T[:, np.newaxis], 'signals': {'values': TORQUE[:, np.newaxis]}},
        'scope': {'time': T[:, np.newaxis], 'signals': signals}})
    mappings = dict(re.findall(r'```yaml\n# (\S+): .*\n((?:.*\n)*?)```', page))
    assert mappings.pop('response.csv')  # test_fit_responses.py
    assert list(mappings) == ['rig.csv', 'rig.mat', 'rig_simulink.mat']
    for name, text in mappings.items():
        record = timo_sim.read_record(tmp_path / name, yaml.safe_load(text))
        shaft, tip = record.outputs.values()
        # Factors of the page have five digits or more.
        np.testing.assert_allclose(record.inputs['voltage'].values, TORQUE, rtol=2e-5)
        np.testing.assert_allclose(shaft.values, ANGLE, rtol=2e-5)
        np.testing.assert_allclose(tip.values, bend, rtol=1e-9)
        np.testing.assert_allclose(shaft.t, T, atol=1e-12)


def test_a_bag_of_a_rig(tmp_path):
    """A bag whose topics are named as those of the node, by another writer, as doc/fit.md says."""
    store = get_typestore(Stores.ROS2_JAZZY)
    float64, states = 'std_msgs/msg/Float64', 'sensor_msgs/msg/JointState'
    stamp, header = (store.types[f'{name}'] for name in (
        'builtin_interfaces/msg/Time', 'std_msgs/msg/Header'))
    with Writer(tmp_path / 'rig', version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topics = {name: bag.add_connection(f'/timo_sim/{name}', kind, typestore=store)
                  for name, kind in (('motor_torque', float64), ('encoder', states))}
        for t, torque, angle in zip(T, TORQUE, ANGLE):
            ns = 10**9 + round(1e9 * t)
            for name, kind, message in (
                    ('motor_torque', float64, store.types[float64](torque)),
                    ('encoder', states, store.types[states](
                        header(stamp(*divmod(ns, 10**9)), ''), ['shaft'], np.array([angle]),
                        np.zeros(0), np.zeros(0)))):
                bag.write(topics[name], ns, store.serialize_cdr(message, kind))
    scene = timo_sim.load_scene('paper')
    record = read_log(tmp_path / 'rig', scene)[1]
    assert np.array_equal(record.outputs['shaft'].values, ANGLE)
    # The last command comes with the last angle, and so acts on none.
    assert np.array_equal(record.inputs['torque'].values, TORQUE[:-1])
    np.testing.assert_allclose(record.inputs['torque'].t, T[:-1], atol=scene.step)


@pytest.mark.parametrize('unit', ['s', 'ms', 'us', 'ns'])
def test_stamps_have_units_of_their_own(tmp_path, unit):
    """Dates, durations and whole numbers of ns since 1970, which floats would round to 256 ns."""
    pytest.importorskip('pyarrow')
    import pyarrow.parquet
    ticks = {'s': 1, 'ms': 10, 'us': 10_001, 'ns': 10_000_001}[unit]
    since = ticks * np.arange(200)
    dates = np.datetime64('2026-11-25T12:00:00', unit) + since.astype(f'timedelta64[{unit}]')
    pyarrow.parquet.write_table(pyarrow.table({
        'date': dates, 'lasted': since.astype(f'timedelta64[{unit}]'),
        'count': dates.astype(np.int64), 'u': TORQUE, 'theta': ANGLE}), tmp_path / 'a.parquet')
    for time in ({'column': 'date'}, {'column': 'lasted'}, {'column': 'count', 'unit': unit}):
        record = timo_sim.read_record(tmp_path / 'a.parquet', {**NAMED, 'time': time})
        wanted = since / {'s': 1, 'ms': 10**3, 'us': 10**6, 'ns': 10**9}[unit]
        assert record.outputs['shaft'].t == pytest.approx(wanted, rel=1e-15)
    with pytest.raises(timo_sim.ParameterError, match="unit must be left out, .*got 'ms'"):
        timo_sim.read_record(tmp_path / 'a.parquet', {
            **NAMED, 'time': {'column': 'date', 'unit': 'ms'}})
    with pytest.raises(timo_sim.ParameterError, match='date must have real numbers: it has stam'):
        timo_sim.read_record(tmp_path / 'a.parquet', {**NAMED, 'columns': {'date': 'shaft'}})


NOT_REAL = [
    ('mat', ANGLE + 0.1j), ('mat', ['on'] * 200), ('mat', np.zeros((2, 3))),
    ('parquet', [[1.0, 2.0]] * 200), ('parquet', ['on'] * 200), ('parquet', [])
]


def test_columns_without_real_numbers_are_refused(tmp_path):
    for kind, values in NOT_REAL:
        if kind == 'parquet':
            pytest.importorskip('pyarrow')
            import pyarrow.parquet
            pyarrow.parquet.write_table(pyarrow.table({'t': T[:len(values)], 'theta': values}),
                                        tmp_path / 'a.parquet')
        else:
            from scipy.io import savemat
            savemat(tmp_path / 'a.mat', {'t': T, 'theta': values})
        with pytest.raises(timo_sim.ParameterError, match='theta .*(real numbers|is no col)'):
            timo_sim.read_record(tmp_path / f'a.{kind}', {**NAMED, 'columns': {'theta': 'shaft'}})


BAD_MAPPINGS = [
    ({'columns': {'hub': 'shaf'}}, 'columns: hub: quantity must be one of .*did you mean shaft'),
    ({'columns': {'hab': 'shaft'}}, 'hab.* is no column of the table; it has clock, hub, u'),
    ({'columns': {'hub': {'quantity': 'shaft', 'unit': 'm'}}}, 'hub: unit must be one of rad,'),
    ({'columns': {'hub': {'quantity': 'shaft', 'gain': 2}}}, 'hub: gain is not known'),
    ({'columns': {'hub': 'shaft', 'u': 'shaft'}}, 'shaft is given twice'),
    ({'columns': {}}, 'columns must say which columns'),
    ({'time': {}}, 'time must have a column or a period'),
    ({'time': {'column': 'clock', 'unit': 'h'}}, 'time: unit must be one of s, ms, us, ns'),
    ({'colums': {}}, 'colums is not known: .*did you mean columns'),
    ({'time': 't'}, 't is no column of the table; it has clock, hub, u'),
    ({'time': 0.5}, 'time must have some of column, unit, file, period, got 0.5'),
    ({'time': {'column': 'clock', 'file': 5}}, 'file must be a text, got 5'),
    ({'time': {'period': 1e308}}, 'at least 20 finite samples, got 2'),
    ({'columns': {'hub': {'quantity': 'shaft', 'time': 't'}}}, 't is no column'),
    ({'columns': {'hub': {'quantity': 'shaft', 'scale': 1e308}}}, 'at least 20 finite samples'),
    ({'columns': {'hub': {'quantity': 'shaft', 'noise': 1e-308}}}, 'at least 1e-12 of the larg'),
    ({'columns': {'hub': {'quantity': 'shaft', 'file': '..'}}}, 'is not a file'),
    ({'start': 500.0}, 'shaft must .* 20 finite samples, got 0 .from 500 s to inf s of 1.99 s'),
    ({'start': 1.0, 'end': 0.5}, 'start and end must be 0 <= start < end, got 1 and 0.5')
]


def test_bad_mappings(tmp_path):
    for change, message in BAD_MAPPINGS:
        path = written(tmp_path, 'csv')
        with pytest.raises(timo_sim.ParameterError, match=message):
            timo_sim.read_record(path, {**MAPPING, **change})


def test_a_log_is_fitted_with_its_own_scene(tmp_path):
    """The scene's own loads act; the first guess differs in one parameter."""
    path = timo_sim.simulate('paper', 2.0, 10, estimate=False).save(tmp_path / 'run.mcap')
    scene, record = read_log(path)
    assert not record.inputs and {'shaft', 'tip_transverse', 'carrier_x'} <= record.outputs.keys()
    found = timo_sim.fit(scene.vary({'end_effector.mass': 2.4}), record, ['end_effector.mass'])
    assert found.values['end_effector.mass'] == pytest.approx(2.0, rel=1e-6)
    assert timo_sim.fit(None, path, ['end_effector.mass']).values['end_effector.mass'] == (
        pytest.approx(2.0, rel=1e-6))


def test_the_command_fits_and_writes_a_scene(tmp_path):
    run = timo_sim.simulate('paper', 2.0, sample_every=10, estimate=False)
    run.save(tmp_path / 'run.csv')
    (tmp_path / 'map.yaml').write_text(yaml.safe_dump({
        'time': {'column': 'time_s'}, 'columns': {
            'shaft_rad': 'shaft', 'tip_deflection_transverse_m': 'tip_transverse'}}))
    fitted, picture = tmp_path / 'fitted.yaml', tmp_path / 'fit.png'
    arguments = ['fit', str(tmp_path / 'run.csv'), '--mapping', str(tmp_path / 'map.yaml'),
                 '--scene', 'paper', '--set', 'end_effector.mass=2.5', '--free',
                 'end_effector.mass,arm.young_modulus', '--bounds', 'end_effector.mass=1:4',
                 'arm.young_modulus=1e10:1e12',
                 '--hold-out', '0.4', '-o', str(fitted), '--png', str(picture)]
    told = call(*arguments)
    assert 'end_effector.mass' in told and 'R^2' in told and 'start 1 of up to 16' in told
    assert fitted.read_text().startswith(f'# Fitted to {tmp_path / "run.csv"} by timo_sim fit.')
    scene = timo_sim.load_scene(fitted)
    assert scene.values['end_effector.mass'] == pytest.approx(2.0, rel=1e-5)
    assert scene.values['load.torque.harmonic.amplitude'] == (5.0,)
    assert picture.read_bytes()[:4] == b'\x89PNG'
    assert f'{fitted} exists' in call(*arguments, code=2)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_command_with_the_best_so_far(tmp_path, number):
    timo_sim.simulate('paper', 4.0, sample_every=10, estimate=False).save(tmp_path / 'run.mcap')
    fitted = tmp_path / 'fitted.yaml'
    command = subprocess.Popen(
        [sys.executable, '-m', 'timo_sim', 'fit', tmp_path / 'run.mcap', '--scene', 'paper',
         '--set', 'end_effector.mass=2.5', '--free', 'end_effector.mass,arm.young_modulus',
         '--free', 'motor.shaft_inertia', '--starts', '16', '-o', fitted],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while 'start 1 of 16' not in command.stderr.readline():
        pass
    command.send_signal(number)
    told = command.communicate()
    assert command.returncode == 1 and 'it was interrupted' in told[0], told
    assert '# parameter            best so far' in fitted.read_text()
    assert timo_sim.load_scene(fitted).values['end_effector.mass'] > 0.0


def test_a_step_that_is_too_long_is_a_message(tmp_path):
    told = call('simulate', 'paper', '--set', 'motor.coulomb_friction=50',
                'motor.coulomb_speed=1e-6', code=2)
    assert 'integrator.step' in told and len(told.splitlines()) == 1


def test_a_new_scene_is_not_written_to_a_pipe(tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    assert 'pipe exists' in call('new', tmp_path / 'pipe', code=2)


def test_a_new_scene_may_have_a_name_that_is_no_text(tmp_path):
    path = os.fsdecode(os.fsencode(tmp_path) + b'/a\xff.yaml')
    call('new', path)
    assert timo_sim.load_scene(path).values == timo_sim.load_scene('arm').values


BAD_ARGUMENTS = [
    (['--free', 'arm.length', '--bounds', 'arm.length=a:b'], '--bounds takes NAME=LOW:HIGH'),
    (['--free', 'arm.length', '--bounds', 'arm.length'], '--bounds takes NAME=LOW:HIGH'),
    (['--free', 'arm.length', '--scene', 'papre'], 'did you mean paper'),
    (['--free', 'arm.length=0.1:0.2', '--scene', 'paper'], 'must be NAME, NAME=VALUE'),
    (['--scene', 'paper'], 'at least one free parameter'),
    (['--free', 'arm.lenght', '--scene', 'paper'], 'did you mean arm.length'),
    (['--free', 'arm.length', '--mapping', 'm.yaml'], 'scene must be given with'),
    (['--free', 'arm.length', 'gone.mcap', '--scene', 'paper'], 'gone.mcap'),
    (['--free', 'initial,arm.lenght', '--scene', 'paper'], 'did you mean arm.length')
]


def test_bad_arguments_of_the_command(tmp_path):
    timo_sim.simulate('paper', 1.0, 10, estimate=False).save(tmp_path / 'run.mcap')
    for arguments, message in BAD_ARGUMENTS:
        told = call('fit', tmp_path / 'run.mcap', *arguments, code=2)
        assert message in ' '.join(told.split()) and len(told.splitlines()) == 1
