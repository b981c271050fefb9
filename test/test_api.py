# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The public interface: names, annotations, examples, summaries, messages and refusals."""

import doctest
import importlib
import re
import warnings

import numpy as np
import pytest
import yaml

import timo_sim

NAMES = [name for name in timo_sim.__all__ if not name.startswith('__')]
FUNCTIONS = [name for name in NAMES if name.islower()]
CLASSES = ['LinearModel', 'Run', 'Scene', 'Simulator']


@pytest.fixture(scope='module')
def scene():
    """Return the paper's scene, by its name."""
    return timo_sim.load_scene('paper')


@pytest.fixture(scope='module')
def run(scene):
    """Return a run of that scene over 1 s."""
    return timo_sim.simulate(scene, 1.0)


@pytest.mark.parametrize('name', [name for name in NAMES if name in FUNCTIONS + CLASSES])
def test_examples_in_docstrings(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    thing = getattr(timo_sim, name)
    module = importlib.import_module(thing.__module__)
    tests = [test for test in doctest.DocTestFinder(recurse=False).find(
        thing, name, module, globs=vars(module)) if test.examples]
    assert tests, f'{name} has no example'
    runner = doctest.DocTestRunner()
    for test in tests:
        assert runner.run(test).failed == 0


def test_a_simulator_does_what_simulate_does(scene, run):
    simulator = timo_sim.Simulator(scene)
    for _ in range(10):
        motion = simulator.step(duration=0.1)
    assert np.array_equal(motion.values, run.values[-1]) and simulator.t == 1.0
    assert np.array_equal(motion.q, run.q[-1]) and motion.shaft == run.shaft[-1]
    assert simulator.sensors.encoder == run.shaft[-1]
    with pytest.raises(AttributeError, match='no sensor .*root_strain'):
        simulator.sensors.rootstrain
    simulator.reset()
    assert np.array_equal(simulator.motion.values, run.values[0])


BAD_COMMANDS = [
    ({'torque': np.nan}, 'torque must be a finite number, got nan'),
    ({'force': 1.0}, 'force must be two finite numbers, got 1.0'),
    ({'voltage': 5.0}, 'voltage = 5 V needs motor.dc.resistance > 0'),
    ({'carrier_acceleration': [0.0, 2.0]}, 'needs a carrier that is held along y'),
    ({'torqe': 1.0}, 'step has torqe, which is none of .*; did you mean torque'),
    ({'duration': 0.0015}, 'duration = 0.0015 must be a whole multiple')
]


def test_commands_that_are_refused_change_nothing(scene):
    for commands, words in BAD_COMMANDS:
        simulator = timo_sim.Simulator(scene)
        with pytest.raises(timo_sim.ParameterError, match=words):
            simulator.step(**commands)
        assert simulator.steps == 0
        other = timo_sim.Simulator(scene)
        assert np.array_equal(simulator.step(torque=1.0).values, other.step(torque=1.0).values)


def test_the_motion_and_load_of_a_step_stay_as_they_are(scene):
    simulator = timo_sim.Simulator(scene)
    kept = simulator.step(torque=20.0, duration=0.1), simulator.load
    assert np.array_equal(kept[0].values, simulator.motion.values)
    before = kept[0].values.tolist(), kept[1].tolist()
    for count in (1, 3):
        later = simulator.step(torque=-20.0, duration=count * scene.step)
        assert np.array_equal(later.values, simulator.motion.values)
    assert (kept[0].values.tolist(), kept[1].tolist()) == before
    assert later.values.tolist() != before[0] and simulator.load.tolist() != before[1]
    assert np.array_equal(simulator.step(duration=0.0).values, later.values)


def test_sensors_are_those_of_their_step(scene):
    simulator = timo_sim.Simulator(scene.vary({'motor.coulomb_friction': 1.0}))
    simulator.step(torque=20.0, duration=0.1)
    kept, now = simulator.sensors, simulator.sensors.tip_acceleration
    simulator.step(torque=-20.0, duration=0.1)
    assert np.array_equal(kept.tip_acceleration, now)
    assert not np.array_equal(simulator.sensors.tip_acceleration, now)


@pytest.mark.parametrize('name, value', [
    ('motor.coulomb_friction', 1.0), ('model.modes', 20), ('integrator.step', 0.002)])
def test_parameters_that_cannot_change_while_a_simulation_runs(scene, name, value):
    simulator = timo_sim.Simulator(scene)
    with pytest.raises(timo_sim.ParameterError, match=f'{name} = {value} cannot be set while'):
        simulator.change(scene.vary({name: value}))
    simulator.step()


def test_a_simulator_goes_on_from_a_state_of_a_run():
    """The second half of a motion without loads is that from its middle on."""
    scene = timo_sim.load_scene({'initial.shaft_velocity': 2.0,
                                 'initial.modal_coordinates': [0.05, 0.0, 0.0]})
    whole, simulator = timo_sim.simulate(scene, 1.0), timo_sim.Simulator(scene)
    simulator.set_motion(whole.motion[500])
    # Rates become momenta and rates again; half a second does not amplify that round-off much.
    assert np.abs(simulator.step(duration=0.5).values - whole.values[-1]).max() < 1e-11


def test_a_run_is_saved_and_opened(run, tmp_path):
    path = run.save(tmp_path / 'run.mcap')
    assert run.save(tmp_path / 'run.mcap') == tmp_path / 'run_1.mcap'
    again = timo_sim.open_log(path)
    assert again.values.tobytes() == run.values.tobytes()
    assert 'does not say whether there were warnings' in again.message
    assert again.t == pytest.approx(run.t, abs=1e-9) and again.scene == run.scene
    assert again.stats == run.stats and type(again.stats['steps']) is int
    assert ', estimated ' in again.message
    assert np.array_equal(again.effort, run.effort)
    frame = run.to_pandas()
    assert np.array_equal(frame['shaft_rad'], run.shaft) and frame.index.name == 'time_s'
    path = run.save(tmp_path / 'run.parquet')
    with pytest.raises(FileExistsError) as error:
        run.save(path)
    assert str(error.value) == f'{path} exists: remove it or choose another name'


def test_the_message_of_a_run(run):
    assert 'no warnings' in run.message and run.warning is None
    assert run.stats['steps'] == 1000 and 0.0 < run.stats['estimated_tip_error_m'] < 1e-5
    with pytest.warns(timo_sim.ModelWarning, match='too high for integrator.step') as caught:
        fast = timo_sim.simulate(timo_sim.load_scene(
            {'load.torque.harmonic.amplitude': [1.0], 'load.torque.harmonic.frequency': [300.0]}),
            0.1, estimate=False)
    assert fast.message == str(caught[0].message)


def test_a_divergent_run_is_kept_until_it_diverges():
    scene = timo_sim.load_scene({'integrator.step': 0.01, 'initial.shaft_velocity': 100.0,
                                 'initial.modal_rates': [10.0, 0.0, 0.0]})
    with pytest.raises(timo_sim.DivergenceError, match='after t = ') as caught:
        timo_sim.simulate(scene, 100.0, sample_every=2)
    run = caught.value.run
    assert len(run.t) == len(run.values) and np.isfinite(run.values).all()
    last = int(re.search(r'\(step (\d+)\)', str(caught.value))[1])
    assert last % 1024 > 1 and run.t[-1] == pytest.approx(0.01 * (last - last % 2))


def test_a_scene_may_be_given_as_load_scene_takes_it(tmp_path):
    values = {'model.modes': 3, 'initial.shaft_velocity': 1.0}
    path = tmp_path / 'scene.yaml'
    path.write_text(yaml.dump({'/**': {'ros__parameters': values}}))
    scene = timo_sim.load_scene({}, values)
    assert timo_sim.load_scene(scene) is scene
    assert timo_sim.load_scene(scene, {'arm.length': 1.0}).values['arm.length'] == 1.0
    wanted = timo_sim.simulate(scene, 0.01).values.tobytes()
    for given in values, str(path), path:
        assert timo_sim.simulate(given, '0.01').values.tobytes() == wanted
        assert timo_sim.Simulator(given).scene.values == scene.values
    for call in (lambda: timo_sim.choose_resolution('paper'),
                 lambda: timo_sim.choose_resolution(scene)):
        with pytest.raises(timo_sim.ParameterError, match='model.accuracy must be > 0 m'):
            call()
    assert timo_sim.linearize('paper').poles().shape == (12,)
    with pytest.raises(MemoryError, match='1000000000001 samples .* take sample_every > 1'):
        timo_sim.simulate(scene, 1e9)


def test_names_of_scenes(tmp_path, monkeypatch):
    (tmp_path / 'paper').mkdir()  # a folder of this name does not hide the scene
    monkeypatch.chdir(tmp_path)
    assert timo_sim.load_scene('paper').load
    assert timo_sim.load_scene('spin_up').values['motor.shaft'] == 'driven'
    with pytest.raises(FileNotFoundError,
                       match='scenes arm, paper, pick_and_place, spin_up, standing; did you mean'):
        timo_sim.load_scene('papr')


IMPLAUSIBLE = [
    ({'arm.young_modulus': 70.5}, '70.5 Pa is outside the range of real solids'),
    ({'arm.shear_modulus': 100e9}, 'above arm.young_modulus'),
    ({'arm.density': 2.71}, 'arm.density = 2.71'),
    ({'initial.shaft': 45.0}, '45 rad is more than a turn; in degrees it would be 0.7854 rad'),
    ({'arm.length': 0.03, 'end_effector.inertia': 0.0}, 'less than 3 times arm.section.height'),
    ({'arm.length': 500.0, 'arm.section.width': 30.0, 'arm.section.height': 1.0},
     'metres, not in millimetres'),
    ({'arm.length': 0.8, 'arm.section.width': 0.03, 'arm.section.height': 0.002,
      'end_effector.mass': 0.3},
     r'inertia = 0.5 kg m2 \(the default\) is that of end_effector.mass = 0.3 kg at more than '
     'half of arm.length = 0.8 m from'),
    ({'end_effector.mass': 0.0}, 'end_effector.mass = 0 kg at more than half'),
    ({'arm.profile.position': [0.0, 2.0], 'arm.profile.young_modulus': [1e11, 1e9],
      'arm.profile.shear_modulus': [5e10, 2e9]}, 'shear_modulus = 2e.09 Pa is above'),
    ({'hub.radius': 40.0}, 'a length of 40 m is more than 30 m'),
    ({'arm.section': {'shape': 'tube', 'width': 0.016, 'wall': 0.0015}},
     r'width = 0.016 m is not used: the diameter is .*height = 0.02 m \(the default\)'),
    ({'motor.coulomb_friction': 1.0, 'motor.coulomb_speed': 0.5, 'motor.coulomb_presliding': 0.2},
     'motor.coulomb_speed = 0.5 is not used, since motor.coulomb_static = 1')
]


def test_implausible_values_give_one_warning():
    for given, words in IMPLAUSIBLE:
        with pytest.warns(timo_sim.ModelWarning, match=words) as caught:
            timo_sim.load_scene({}, given)
        assert len(caught) == 1


@pytest.mark.parametrize('call', [
    timo_sim.load_scene, timo_sim.linearize, timo_sim.Simulator,
    lambda given: timo_sim.simulate(given, 0.01).save('run.mcap')])
def test_a_warning_names_the_line_of_the_caller(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.warns(timo_sim.ModelWarning) as caught:
        call({'initial.shaft': 45.0})
        for path in tmp_path.iterdir():
            timo_sim.open_log(path)
    assert {each.filename for each in caught} == {__file__}


def test_plausible_values_give_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        timo_sim.load_scene({}, {'arm.profile.position': [0.0, 2.0],
                                 'arm.profile.young_modulus': [2e11, 2e9],
                                 'arm.profile.shear_modulus': [8e10, 8e8]})
        timo_sim.load_scene({'end_effector.mass': 0.0, 'end_effector.inertia': 0.01})
        for name in ('arm', 'paper', 'pick_and_place', 'spin_up', 'standing'):
            timo_sim.load_scene(name)


def test_a_model_for_python_control():
    model = timo_sim.linearize(timo_sim.load_scene({}, {'arm.damping_ratio': [0.01]}))
    ours = model.select(['torque_N_m'], ['shaft_rad', 'tip_transverse_m'])
    theirs = ours.to_control()
    assert theirs.input_labels == ['torque_N_m'] and theirs.isctime()
    frequency = np.geomspace(0.3, 20.0, 50)
    response = theirs(2j * np.pi * frequency, squeeze=False)
    scale = np.abs(response).max(axis=2)[:, 0]
    error = np.abs(np.moveaxis(response, 2, 0) - ours.frequency_response(frequency))
    assert (error.max(axis=0)[:, 0] < 1e-9 * scale).all()


def test_a_discrete_model_knows_its_period():
    """Poles are those of continuous time up to half the sampling rate; the response is in z."""
    model = timo_sim.linearize(timo_sim.load_scene({}, {'arm.damping_ratio': [0.01]})).select(
        ['torque_N_m'], ['tip_transverse_m'])
    sampled = model.to_discrete(0.002)
    assert sampled.dt == 0.002 and sampled.to_control().dt == 0.002
    ours, theirs = sampled.poles(), model.poles()
    assert ours[ours.imag > 1.0] == pytest.approx(theirs[theirs.imag > 1.0], rel=1e-6)
    # A zero-order hold delays by half a period: 1e-3 s of phase at low frequencies.
    frequency = np.array([0.5, 1.0])
    ratio = (sampled.frequency_response(frequency) / model.frequency_response(frequency))[:, 0, 0]
    assert np.angle(ratio) == pytest.approx(-2.0 * np.pi * frequency * 0.001, rel=1e-2)
    with pytest.raises(timo_sim.ParameterError, match='needs a model of continuous time'):
        sampled.to_discrete(0.001)
