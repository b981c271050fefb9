"""Scenes from files, dictionaries and overrides; what is refused, and in which words."""

import math

import pytest

import timo_sim
from timo_sim.parameters import PARAMETERS
from timo_sim.scene import read_parameter_file


def test_paper_file_gives_the_defaults_and_the_papers_loads(paper):
    values = read_parameter_file(paper)
    loads = {name: value for name, value in values.items() if name.startswith('load.')}
    rest = {name: value for name, value in values.items() if name not in loads}
    assert rest == {name: parameter.default for name, parameter in PARAMETERS.items()
                    if not name.startswith('load.') and parameter.default != ()}
    assert {name: value for name, value in loads.items() if 'phase' not in name} == {
        'load.force_x.harmonic.amplitude': [5.0], 'load.force_x.harmonic.frequency': [2.0],
        'load.force_y.harmonic.amplitude': [5.0], 'load.force_y.harmonic.frequency': [3.0],
        'load.torque.harmonic.amplitude': [5.0], 'load.torque.harmonic.frequency': [4.0]}


def test_every_parameter_is_in_the_paper_file_with_unit_and_meaning(paper):
    text = paper.read_text()
    for name, parameter in PARAMETERS.items():
        assert f'{name.rpartition(".")[2]}:' in text
        assert parameter.meaning


def test_overrides_win_by_dotted_or_nested_name(paper):
    scene = timo_sim.load_scene(paper, {'model.modes': 5, 'integrator': {'step': 0.005}})
    assert (scene.values['model.modes'], scene.step) == (5, 0.005)
    assert scene.manipulator.arm.bending_stiffness == pytest.approx(70.5e9 * 0.02**4 / 12)


def test_a_dictionary_has_no_loads_of_its_own():
    assert not timo_sim.load_scene({}).load
    assert timo_sim.load_scene({'load.torque.harmonic.amplitude': [1.0],
                                'load.torque.harmonic.frequency': [1.0]}).load


def test_a_scene_made_of_another_scenes_values_is_the_same(paper):
    scene = timo_sim.load_scene(paper, {'arm.damping_ratio': [0.01]})
    assert timo_sim.load_scene(scene.values) == scene


def test_numbers_that_yaml_reads_as_text_or_whole_numbers_are_accepted(tmp_path):
    path = tmp_path / 'scene.yaml'
    path.write_text('timo_sim:\n  ros__parameters:\n    arm:\n      young_modulus: 70.5e9\n'
                    '      length: 2\n    load.torque.harmonic.amplitude: [1, 2e1]\n'
                    '    load.torque.harmonic.frequency: [1, 2]\n')
    scene = timo_sim.load_scene(path)
    assert scene.manipulator.arm.young_modulus == 70.5e9
    assert isinstance(scene.values['arm.length'], float)
    assert scene.values['load.torque.harmonic.amplitude'] == (1.0, 20.0)


@pytest.mark.parametrize('name, value, words', [
    ('arm.length', -2.0, 'arm.length must be a finite number > 0 m, got -2.0'),
    ('arm.length', 0, 'arm.length must be a finite number > 0 m, got 0'),
    ('arm.length', math.nan, 'got nan'),
    ('arm.length', math.inf, 'got inf'),
    ('arm.length', True, 'got True'),
    ('arm.length', 'two', "got 'two'"),
    ('arm.length', [2.0], r'got \[2.0\]'),
    ('arm.length', None, 'got None'),
    ('carrier.mass', 0.0, 'carrier.mass must be a finite number > 0 kg'),
    ('end_effector.mass', -1e-9, 'must be a finite number >= 0 kg'),
    ('model.modes', 41, 'model.modes must be a whole number >= 0 and <= 40, got 41'),
    ('model.modes', 3.0, 'got 3.0'),
    ('model.formulation', 'fancy', "must be one of exact, newton, got 'fancy'"),
    ('initial.modal_rates', [1.0], 'must have 0 or 3 elements for model.modes = 3, got 1'),
    ('initial.modal_rates', [1.0, math.nan, 0.0], 'must be a list of finite numbers'),
    ('arm.damping_ratio', [1.5], 'must be a list of finite numbers >= 0 and <= 1'),
    ('arm.lenght', 2.0, 'arm.lenght = 2.0 is not a parameter of timo_sim'),
    ('arm', {'length': {'x': 1}}, 'arm.length.x = 1 is not a parameter'),
    ('record', 1, 'record must be true or false, got 1'),
    ('record_file', 3, 'record_file must be a text, got 3'),
])
def test_what_is_refused(name, value, words):
    with pytest.raises(timo_sim.ParameterError, match=words):
        timo_sim.load_scene({}, {name: value})


def test_too_many_modes_for_a_thick_arm_are_refused_with_the_number_it_has():
    with pytest.raises(timo_sim.ParameterError, match='model.modes = 9 is too many.*has 8 modes'):
        timo_sim.load_scene({'arm.length': 0.1, 'model.modes': 9})


@pytest.mark.parametrize('text, words', [
    ('{', 'is not a YAML file'),
    ('- 1', 'must have parameters under timo_sim: ros__parameters:'),
    ('other_node: {ros__parameters: {arm.length: 1.0}}', 'must have parameters under timo_sim'),
])
def test_files_that_are_refused(tmp_path, text, words):
    path = tmp_path / 'scene.yaml'
    path.write_text(text)
    with pytest.raises(timo_sim.ParameterError, match=words):
        timo_sim.load_scene(path)


def test_a_missing_file_is_an_os_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        timo_sim.load_scene(tmp_path / 'none.yaml')
