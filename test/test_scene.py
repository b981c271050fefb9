# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Scenes from files, dictionaries and overrides, also random ones: they run or are refused."""

import math
import os
from pathlib import Path
import pickle
import warnings

from command_line import call
from hypothesis import example, given, HealthCheck, settings, strategies as st
import numpy as np
import pytest
import yaml

from oracles import elastica
import timo_sim
from timo_sim.scene import files
from timo_sim.scene.files import parse_yaml, read_parameter_file, scene_text
from timo_sim.scene.parameters import PARAMETERS, SCENE, short


def test_paper_file_gives_the_defaults_and_the_papers_loads(paper):
    values = read_parameter_file(paper)
    loads = {name: value for name, value in values.items() if name.startswith('load.')}
    rest = {name: value for name, value in values.items() if name not in loads}
    defaults = {name: parameter.default for name, parameter in PARAMETERS.items()
                if not name.startswith('load.') and parameter.default != ()}
    lacking = sorted(defaults.keys() - rest.keys())
    assert not lacking, f'config/paper.yaml lacks {", ".join(lacking)}'
    assert rest == {name: [*default] if isinstance(default, tuple) else default
                    for name, default in defaults.items()}
    assert {name: value for name, value in loads.items() if 'phase' not in name} == {
        'load.force_x.harmonic.amplitude': [5.0], 'load.force_x.harmonic.frequency': [2.0],
        'load.force_y.harmonic.amplitude': [5.0], 'load.force_y.harmonic.frequency': [3.0],
        'load.torque.harmonic.amplitude': [5.0], 'load.torque.harmonic.frequency': [4.0]}


def test_overrides_win_by_dotted_or_nested_name(paper):
    scene = timo_sim.load_scene(paper, {'model.modes': 5, 'integrator': {'step': 0.005}})
    assert (scene.values['model.modes'], scene.step) == (5, 0.005)
    assert scene.manipulator.arm.section.bending_stiffness == pytest.approx(70.5e9 * 0.02**4 / 12)


# What a scene of its own needs beside a length and Young's modulus.
REST = {'arm.section.width': 0.02, 'arm.section.height': 0.02, 'arm.density': 2710.0,
        'arm.shear_modulus': 27e9, 'motor.shaft_inertia': 0.1, 'carrier.mass': 1.0}


def test_numbers_that_yaml_reads_as_text_or_whole_numbers_are_accepted(tmp_path):
    path = tmp_path / 'scene.yaml'
    path.write_text('timo_sim:\n  ros__parameters:\n    arm:\n      young_modulus: 70.5e9\n'
                    '      length: 2\n      damping_ratio: 1e-2\n'
                    '    load.torque.harmonic.amplitude: [1, 2e1]\n'
                    '    load.torque.harmonic.frequency: [1, 2]\n')
    scene = timo_sim.load_scene(path, REST)
    assert scene.manipulator.arm.section.young_modulus == 70.5e9
    assert isinstance(scene.values['arm.length'], float)
    assert scene.values['arm.damping_ratio'] == (0.01,)  # a number is for all modes
    assert scene.values['load.torque.harmonic.amplitude'] == (1.0, 20.0)


# What the parser of ROS parameter files, `rcl_yaml_param_parser`, reads as numbers (strtol with
# prefixes, then strtod), and what it leaves a text.
@pytest.mark.parametrize('text, value', [
    ('1e-3', 0.001), ('1E30', 1e30), ('-2e+1', -20.0), ('.5', 0.5), ('5.', 5.0), ('+1', 1),
    ('0x10', 16), ('08', 8.0), ('-.inf', -math.inf), ('1e400', math.inf), ('+', '+'),
    ('1_000', '1_000'), ('1:30', '1:30'), ('0b11', '0b11'), ('1e', '1e'), ('"0.5"', '0.5'),
    ('1.5.2', '1.5.2'), ('2026-11-28', '2026-11-28'), ('yes', True)])
def test_yaml_is_read_with_the_numbers_of_ros(text, value):
    found = parse_yaml(f'[{text}]', 'here')
    assert found == [value] and type(found[0]) is type(value)


def test_a_number_that_yaml_reads_as_octal_is_refused():
    """The parser of ROS reads 010 as 8."""
    for text in '010', '-017':
        with pytest.raises(timo_sim.ParameterError, match=f'{text}, which ROS reads as octal'):
            parse_yaml(f'arm: {{length: {text}}}', 'here')
    assert parse_yaml("{a: '010', b: 0, c: 0.10, d: 10, e: !!str 010}", 'here') == {
        'a': '010', 'b': 0, 'c': 0.1, 'd': 10, 'e': '010'}


REFUSED = [
    ('arm.length', -2.0, 'arm.length must be a finite number > 0 m, got -2.0'),
    ('arm.length', math.nan, 'got nan'),
    ('arm.length', math.inf, 'got inf'),
    ('arm.length', True, 'got True'),
    ('arm.length', 'two', "got 'two'"),
    ('carrier.mass', 0.0, 'carrier.mass must be > 0 kg with carrier.held = none, got 0'),
    ('model.modes', 41, 'model.modes must be a whole number >= 0 and <= 40, got 41'),
    ('model.formulation', 'fancy', "must be one of exact, newton, .*got 'fancy'"),
    ('initial.modal_rates', [1.0], 'must have 0 or 3 elements for model.modes = 3, got 1'),
    ('initial.modal_rates', [1.0, math.nan, 0.0], 'must be a list of finite numbers'),
    ('arm.damping_ratio', [1.5], 'must be a finite number, or a list of them, >= 0 and <= 1'),
    ('arm.lenght', 2.0, 'arm.lenght = 2.0 is not a parameter .*did you mean arm.length'),
    ('motor.dc.gear', 2.0, 'did you mean motor.dc.gear_ratio'),
    ('load', {'torqe': {'harmonic': {'phase': [0.0]}}}, 'did you mean load.torque.harmonic'),
    ('motor.torque_limit', 0.0, 'must be a number > 0 N m, .inf for no limit, got 0.0'),
    ('arm', {'length': {'x': 1}}, 'arm.length.x = 1 is not a parameter'),
    ('record', 1, 'record must be true or false, got 1'),
    ('record_file', 3, 'record_file must be a text, got 3')
]


def test_values_that_are_refused():
    for name, value, words in REFUSED:
        with pytest.raises(timo_sim.ParameterError, match=words):
            timo_sim.load_scene({}, {name: value})


PROFILE = {'arm.profile.position': [0.0, 1.0, 2.0], 'arm.profile.height': [0.03, 0.02, 0.01]}
DRIVE = {'motor.shaft': 'driven', 'motor.drive.time': [0.0, 1.0], 'motor.drive.angle': [0.0, 1.0],
         'motor.drive.speed': [0.0, 0.0], 'motor.drive.acceleration': [0.0, 0.0]}
PICKED = {'payload.time': [0.3], 'payload.mass': [4.0], 'payload.inertia': [0.6]}

CONTRADICTIONS = [
    ({'arm.profile.height': [0.03, 0.02]}, r'arm.profile.position must ascend from 0 to arm.len'),
    ({**PROFILE, 'arm.profile.position': [0.0, 1.0, 1.9]}, r'got \[0.0, 1.0, 1.9\]'),
    ({**PROFILE, 'arm.profile.width': [0.02]}, 'must have the same length, got .*width: 1'),
    ({**PROFILE, 'arm.profile.height': [0.03, 0.0, 0.01]}, 'arm.profile.height must be .*> 0 m'),
    ({'carrier.held': 'x', 'initial.carrier_x_velocity': 0.1},
     'initial.carrier_x_velocity must be 0 with carrier.held = x, got 0.1'),
    ({'motor.shaft': 'locked', 'initial.shaft_velocity': 1.0},
     'initial.shaft_velocity must be 0 with motor.shaft = locked'),
    ({'motor.shaft': 'driven'}, 'motor.drive must be given with motor.shaft = driven'),
    ({**DRIVE, 'motor.shaft': 'free'}, 'got 2 points with motor.shaft = free'),
    ({**DRIVE, 'motor.drive.time': [0.5, 1.0]}, 'motor.drive.time must ascend from 0'),
    ({**DRIVE, 'motor.drive.acceleration': [0.0, 1.0]}, 'must end with 0'),
    ({'model.modes': 0, 'carrier.held': 'both', 'motor.shaft': 'locked'}, 'nothing can move'),
    ({'model.formulation': 'newton', 'model.axial_modes': 1},
     'model.axial_modes must be 0 with model.formulation = newton, got 1'),
    ({**PICKED, 'payload.mass': []}, 'must have the same length'),
    ({**PICKED, 'payload.time': [0.3005]}, 'whole multiple'),
    ({**PICKED, 'payload.time': [0.0]}, 'payload.time must be'),
    ({name: 2 * value for name, value in PICKED.items()}, 'payload.time must ascend'),
    ({'load.push_x.piecewise': {'time': [0.0], 'value': [1.0]}},
     'load.push_x.piecewise.time needs push.position > 0, got 0'),
    ({'motor.dc.resistance': 1.0}, 'motor.dc.torque_constant must be > 0'),
    ({'load.torque.piecewise': {'time': [0.0, 0.2], 'value': [1.0]}}, 'time: 2.*value: 1'),
    ({'load.torque.table': {'time': [0.2, 0.1], 'value': [0.0, 0.0]}}, 'time must ascend'),
    ({'push.position': 2.5}, 'push.position must be at most arm.length = 2 m, got 2.5'),
    ({'sensor.tip_imu.position': 2.5}, 'sensor.tip_imu.position must be at most arm.length = 2 m')
]


def test_values_that_do_not_fit_together_are_refused():
    for values, words in CONTRADICTIONS:
        with pytest.raises(timo_sim.ParameterError, match=words):
            timo_sim.load_scene({}, values)


def test_a_tapered_arm_and_a_driven_shaft_are_read():
    scene = timo_sim.load_scene({}, {**PROFILE, **DRIVE})
    assert scene.manipulator.arm.at([0.5]).height == pytest.approx([0.025])
    assert scene.manipulator.arm.at([0.5]).width == 0.02
    assert scene == timo_sim.load_scene(scene.values)
    assert scene.initial_motion()[2] == 0.0  # the drive's, not initial.shaft
    assert scene.constraints.driven


ROOT = Path(__file__).parents[1]
# All that a scene of its own has to give, here with a shaft and a carrier that move.
OWN = {'arm.length': 0.5, 'arm.section.width': 0.02, 'arm.section.height': 0.002,
       'arm.density': 2700.0, 'arm.young_modulus': 7e10, 'arm.shear_modulus': 2.6e10,
       'motor.shaft_inertia': 0.01, 'carrier.mass': 1.0}


def test_a_scene_that_gives_an_arm_has_no_number_of_the_papers():
    values = timo_sim.load_scene(OWN).values
    paper = timo_sim.load_scene({}).values
    for name in ('motor.mass', 'end_effector.mass', 'end_effector.inertia', 'initial.shaft'):
        assert values[name] == 0.0 < paper[name]
    assert values['integrator.step'] == paper['integrator.step']
    assert timo_sim.load_scene({}, OWN).values['initial.shaft'] == paper['initial.shaft']
    assert timo_sim.load_scene({'hub.radius': 0.1}).values['arm.length'] == 2.0


@pytest.mark.parametrize('name', OWN)
def test_what_nobody_can_assume_of_an_arm_is_asked_for_by_name(name):
    rest = {each: value for each, value in OWN.items() if each != name}
    with pytest.raises(timo_sim.ParameterError, match=f'^{name} must be given'):
        timo_sim.load_scene(rest)
    assert timo_sim.load_scene(rest, {name: OWN[name]}) == timo_sim.load_scene(OWN)


def test_what_stands_for_a_section_a_material_or_a_joint_that_moves_is_enough():
    fixed = {'arm.length': 0.5, 'motor.shaft': 'locked', 'carrier.held': 'both'}
    section = {'arm.section.width': 0.02, 'arm.section.height': 0.002}
    measured = {'arm.section.bending_stiffness': 1.0, 'arm.section.mass_per_length': 0.1}
    for values in ({**section, 'arm.material': 'steel'}, measured):
        assert timo_sim.load_scene({**fixed, **values}).values['carrier.mass'] == 0.0


@pytest.mark.parametrize('path', sorted(
    path for path in [*ROOT.glob('config/*.yaml'), *ROOT.glob('example/**/*.yaml')]
    if '\n/**:\n' in path.read_text()), ids=lambda path: path.stem)
def test_scenes_that_are_saved_and_loaded_are_the_same(path, tmp_path):
    with warnings.catch_warnings():
        warnings.filterwarnings('error', 'values that this scene leaves out')
        scene = timo_sim.load_scene(path)
        saved = tmp_path / 'saved.yaml'
        saved.write_text(scene_text(scene.values))
        assert timo_sim.load_scene(saved).values == scene.values
    given = read_parameter_file(saved)
    assert {'scene_version', 'arm.density', *OWN, 'motor.mass', 'initial.shaft'} <= {*given}


def test_a_file_without_version_tells_which_numbers_are_no_longer_the_papers(tmp_path):
    path = tmp_path / 'scene.yaml'
    path.write_text(yaml.safe_dump({**OWN, 'end_effector.mass': 0.1, 'motor.mass': 1.0,
                                    'end_effector.inertia': 1e-5}))
    with pytest.warns(timo_sim.ModelWarning, match=r'initial.shaft = 0 \(was 0.785398\); give'):
        timo_sim.load_scene(path)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        timo_sim.load_scene(path, {'scene_version': 1})


@pytest.mark.parametrize('make', [os.mkfifo, lambda path: path.symlink_to('/dev/zero')])
def test_a_scene_that_is_no_file_is_refused(tmp_path, make):
    make(tmp_path / 'scene.yaml')
    with pytest.raises(timo_sim.ParameterError, match='scene.yaml is not a file'):
        timo_sim.load_scene(tmp_path / 'scene.yaml')


def test_the_standing_scene_rests_until_its_torque_ends():
    scene = timo_sim.load_scene('standing')
    run = timo_sim.simulate(scene, 3.0)
    rest = run.t <= 1.0
    assert np.abs(run.values[rest] - run.values[0]).max() < 1e-10
    assert math.degrees(run.shaft[0]) == pytest.approx(-30.0, abs=0.1)
    # The weight turns the shaft as much as the torque, and the falling arm does not come back.
    model = scene.build()
    place = model.world(run.values[:1], model.points)[0]
    assert 9.81 * model.point_mass @ place[:, 0] == pytest.approx(51.5, abs=1e-6)
    assert math.degrees(run.shaft.min()) < -145.0 and 'no warnings' in run.message


def test_the_shape_of_the_weight_is_worth_modes():
    """The numbers of doc/scene.md, against the elastica."""
    found = {}
    for static, modes in (('none', 3), ('weight', 2)):
        scene = timo_sim.load_scene({
            'model.modes': modes, 'gravity': [0.0, -9.81], 'carrier.held': 'both',
            'motor.shaft': 'locked', 'initial.shaft': 0.0, 'initial.equilibrium': True,
            'model.static_modes': static})
        found[static] = scene.build().tip(scene.initial_motion())[:2]
    section, tip = scene.manipulator.arm.section, scene.manipulator.end_effector_mass
    _, across, short = elastica.boundary_value(section, -9.81 * tip,
                                               -9.81 * section.mass_per_length)
    true = [2.0 - 2.0 * short, 2.0 * across]
    assert true[1] == pytest.approx(-0.078, abs=5e-4)
    assert np.hypot(*(found['none'] - np.array(true))) == pytest.approx(2.3e-6, rel=0.03)
    assert np.hypot(*(found['weight'] - np.array(true))) == pytest.approx(1.2e-8, rel=0.1)


def test_a_scene_cannot_be_changed():
    """Its bodies and loads would not follow; `vary` makes another scene."""
    scene = timo_sim.load_scene({}, {'arm.damping_ratio': [0.1]})
    for each in (scene, pickle.loads(pickle.dumps(scene)), scene.vary({})):
        with pytest.raises(TypeError):
            each.values['end_effector.mass'] = 3.0
        with pytest.raises(TypeError):
            each.values['arm.damping_ratio'][0] = 0.2
        assert each.values == scene.values and hash(each.values['arm.damping_ratio'])


# No deadline, because durations mean nothing on a busy machine.
fuzzed = settings(deadline=None, derandomize=True, max_examples=100,
                  suppress_health_check=list(HealthCheck))

NUMBERS = st.one_of(
    st.sampled_from([0.0, 5e-324, 1e-300, 1e-100, 1e-9, 1e-3, 1.0, 1e3, 1e9, 1e100, 1e300,
                     -1e300, -1.0, math.inf, -math.inf, math.nan, 10**400, -1, 2**63]),
    st.floats(1e-3, 1e3), st.floats(), st.integers())
ANYTHING = st.recursive(
    st.one_of(NUMBERS, st.none(), st.booleans(), st.text(max_size=8), st.binary(max_size=8),
              st.sampled_from(['1e3', 'nan', 'exact', 'newton', 'both', 'driven', '\0'])),
    lambda inner: st.one_of(st.lists(inner, max_size=4),
                            st.dictionaries(st.text(max_size=3), inner, max_size=3)),
    max_leaves=6)


def value_of(parameter):
    """Return a strategy for values that a parameter is likely to accept."""
    if parameter.name == 'model.modes':  # each size is compiled
        return st.sampled_from([0, 3])
    if parameter.name == 'model.formulation':
        return st.just('exact')
    if parameter.choices:
        return st.sampled_from(parameter.choices)
    if isinstance(parameter.default, tuple):
        return st.lists(NUMBERS, max_size=3)
    return NUMBERS if isinstance(parameter.default, float) else ANYTHING


# A stated accuracy makes many runs with up to twelve modes.
SENSIBLE = {name: value_of(parameter) for name, parameter in PARAMETERS.items()
            if parameter.scope == SCENE and name != 'model.accuracy'}


@st.composite
def likely_scenes(draw):
    """Draw values of the right type for a few parameters."""
    names = draw(st.lists(st.sampled_from(sorted(SENSIBLE)), max_size=3, unique=True))
    return {name: draw(SENSIBLE[name]) for name in names}


def outcome(make, *arguments):
    """Return the scene, or None if it is refused; check that the error is one short line."""
    try:
        return make(*arguments)
    except timo_sim.ParameterError as error:
        assert str(error).isprintable() and len(str(error)) < 600
        return None


@fuzzed
@given(likely_scenes())
@example({'rate.tip_pose': 1e300})
@example({'arm.section.height': 1e300})
@example({'arm.section.height': 5e-324})
@example({'arm.length': 1e-308})
@example({'initial.carrier_x_velocity': 1e300})
@example({'initial.shaft': 1e100})
@example({'integrator.step': 1e-320})
def test_an_accepted_scene_runs(values):
    scene = outcome(timo_sim.load_scene, values)
    if scene is not None:
        with np.errstate(all='ignore'):
            try:
                run = timo_sim.simulate(scene, 5 * scene.step)
            except timo_sim.DivergenceError:
                return
            assert np.isfinite(run.values).all()


@fuzzed
@given(st.dictionaries(st.sampled_from([*PARAMETERS, 'arm', 'load', 'nonsense', '']), ANYTHING,
                       max_size=3))
def test_values_of_any_type_are_taken_or_refused(values):
    values.pop('model.modes', None), values.pop('model.formulation', None)
    outcome(timo_sim.load_scene, values)


@fuzzed
@given(st.one_of(
    st.binary(max_size=60),
    st.text(alphabet='{}[]:,-!&*#|>?\'"%@` \n\t.0123456789eaxn', max_size=60).map(str.encode),
    st.sampled_from(['int', 'float', 'bool', 'timestamp', 'binary', 'set', 'omap', 'pairs', 'str',
                     'null', 'python/name:os.system', 'python/object/apply:os.abort']).flatmap(
        lambda tag: st.sampled_from(["''", 'x', '[]', '{}', '0x', '[[1, 2]]', '2001-13-45']).map(
            lambda text: f'!!{tag} {text}'.encode()))))
def test_files_of_any_content_are_taken_or_refused(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / 'any.yaml'
    path.write_bytes(content)
    outcome(timo_sim.load_scene, path)
    path.write_bytes(b'timo_sim: {ros__parameters: {arm.length: ' + content + b'}}')
    outcome(timo_sim.load_scene, path)


BOMB = 'a0: &a0 {length: 2.0}\n' + ''.join(
    f'a{n + 1}: &a{n + 1} {{' + ', '.join(f'{key}: *a{n}' for key in 'pqrstuvw') + '}\n'
    for n in range(20)) + 'timo_sim: {ros__parameters: {'
LISTS = 'a0: &a0 [1.0, 1.0]\n' + ''.join(
    f'a{n + 1}: &a{n + 1} [*a{n}, *a{n}, *a{n}]\n' for n in range(40)
) + 'timo_sim: {ros__parameters: {'


HOSTILE = [
    ('{', 'is not a YAML file'), ('- 1', 'is not a scene'),
    ('other_node: {ros__parameters: {arm.length: 1.0}}', 'must have parameters under timo_sim'),
    (BOMB + 'arm: *a20}}', 'an alias, which ROS does not take'),
    (LISTS + 'arm.profile.width: *a40}}', 'an alias, which ROS does not take'),
    ('timo_sim: {ros__parameters: &a {arm: *a}}', 'an alias, which ROS does not take'),
    ('timo_sim: {ros__parameters: {arm.length: ' + '[' * 20000 + ']' * 20000, 'not a YAML file'),
    ('timo_sim: {ros__parameters: ' + '{a: ' * 20000, 'is not a YAML file'),
    ('timo_sim: {ros__parameters: {arm.length: 2001-13-45}}', "got '2001-13-45'"),
    ('timo_sim: {ros__parameters: {arm.length: 1\0}}', 'is not a YAML file'),
    ('timo_sim: {ros__parameters: {arm.length: 0x' + 'f' * 9000 + '}}', 'got (a huge |<)int'),
    ('timo_sim: {ros__parameters: {record_file: "a\\0b"}}', 'record_file must be a text'),
    ('', 'is not a scene'), ('{"world": {"bodies": [1]}}', 'is not a scene, it has world.bodies')
]


@pytest.mark.parametrize('text', [
    'arm: {length: 0.7}', 'arm.length: 0.7\nuse_sim_time: true', '{"arm": {"length": 0.7}}'])
def test_values_alone_are_a_scene(tmp_path, text):
    path = tmp_path / 'scene.yaml'
    path.write_text(text)
    rest = {**REST, 'arm.young_modulus': 7e10}
    assert timo_sim.load_scene(path, rest) == timo_sim.load_scene({'arm.length': 0.7}, rest)


@pytest.mark.parametrize('text', [
    '<?xml version="1.0"?>\n<robot name="a">\n  <link name="b"/>\n</robot>\n',
    '<mujoco model="a: b">\n\t<worldbody/>\n</mujoco>', '[1, 2]', '{"length": 0.7}'])
def test_what_is_no_scene_is_told_what_one_looks_like(tmp_path, text):
    path = tmp_path / 'arm.urdf'
    path.write_text(text)
    with pytest.raises(timo_sim.ParameterError, match='a scene is YAML, such as "arm: {length: '):
        timo_sim.load_scene(path)


def test_a_new_scene_is_an_arm_on_a_bench(tmp_path):
    path = tmp_path / 'my arm.yaml'
    assert f"timo_sim simulate '{path}'" in call('new', path)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        scene = timo_sim.load_scene(path)
        run = timo_sim.simulate(scene, 1.0, estimate=False)
    assert run.shaft[0] == 0.0 and np.abs(run.deflection(0.8)[:, 1]).max() > 0.01
    # Whatever of the paper's manipulator would matter is replaced.
    default = timo_sim.load_scene({}).manipulator
    for name in ('arm', 'shaft_inertia', 'end_effector_mass', 'end_effector_inertia'):
        assert getattr(scene.manipulator, name) != getattr(default, name)
    assert scene.values['carrier.held'] == 'both'
    written = path.read_text()
    assert "timo_sim simulate 'my arm.yaml'" in written
    assert 'exists' in call('new', path, code=2) and path.read_text() == written


def test_files_that_are_wrong_or_made_to_break_their_reader(tmp_path):
    for text, words in HOSTILE:
        path = tmp_path / 'scene.yaml'
        path.write_text(text)
        with pytest.raises(timo_sim.ParameterError, match=words) as caught:
            timo_sim.load_scene(path)
        assert len(str(caught.value)) < 600 and '\n' not in str(caught.value)


BROKEN = ['a: 1\n\na: 2', '{a: 1, b: 2, a: 3}', 'a:\n  b: 1\n  <<: {b: 2}', 'a: [1, 2', 'a: *b',
          'b: @', 'a: "b', 'a: 1\n b: 2', '- a\nb: 1', '%a', 'a: 1\n--- \nb: 2',
          '!!int a: 1', 'a: \x07', '- ' * 20000]


def test_broken_yaml_is_refused_with_its_line_and_what_pyyaml_reads_alone_is_read_alike():
    for text in BROKEN:
        with pytest.raises(timo_sim.ParameterError, match='scene is not a YAML file: '):
            files.parse_yaml(text, 'scene')
    with pytest.raises(timo_sim.ParameterError, match='a is given twice .*line 3'):
        files.parse_yaml('a: 1\n\na: 2', 'scene')
    for path in (ROOT / 'config').glob('*.yaml'):
        assert files.read_yaml(path) == yaml.load(path.read_text(), yaml.SafeLoader)


def test_a_folder_is_an_os_error_and_a_file_of_other_bytes_is_refused(tmp_path):
    with pytest.raises(IsADirectoryError):
        timo_sim.load_scene(tmp_path)
    (tmp_path / 'latin.yaml').write_bytes(b'timo_sim: {ros__parameters: {record_file: \xe9}}')
    with pytest.raises(timo_sim.ParameterError, match='is not a YAML file'):
        timo_sim.load_scene(tmp_path / 'latin.yaml')


def test_a_load_of_a_hundred_thousand_pieces_is_read(tmp_path):
    """A search among all pieces for each of them would take minutes."""
    times = np.arange(100000) * 0.001
    scene = timo_sim.load_scene({'load.torque.piecewise.time': times,
                                 'load.torque.piecewise.value': np.ones(len(times))})
    assert timo_sim.simulate(scene, 0.01).values[-1, 2] > 0.0
    with pytest.raises(timo_sim.ParameterError, match=r'time\[77777\] = 77.7775 must be'):
        times[77777] += 0.0005
        timo_sim.load_scene({'load.torque.piecewise.time': times,
                             'load.torque.piecewise.value': np.ones(len(times))})


EXTREME = [
    ({'rate.joint_states': 1e13}, 'ratio'), ({'duration': 1e-13}, 'ratio'),
    ({'duration': 1e308}, 'must be a finite number >= 0 and <= 2.14748e.09 s'),
    ({'real_time_factor': 1e300}, '<= 1e.06'), ({'command_timeout': 1e300}, '<= 2.147')
]


@pytest.mark.parametrize('values, said', [
    ({'arm.length': 1e300}, 'too large or too small together'),
    ({'frame_prefix': 'a\ud800'}, 'frame_prefix must be')])
def test_what_no_number_or_text_can_be_made_of_is_refused(values, said):
    with pytest.raises(timo_sim.ParameterError, match=said) as error:
        timo_sim.load_scene('paper', values)
    assert str(error.value).isprintable()


def test_numbers_that_would_round_to_zero_or_overflow():
    for value, words in EXTREME:
        from timo_sim.ros.parameters import steps_between_messages
        from timo_sim.scene.parameters import check, whole_ratio
        with pytest.raises(timo_sim.ParameterError, match=words):
            values = {**{name: parameter.default for name, parameter in PARAMETERS.items()},
                      **check(value, 'test')}
            steps_between_messages(values, 0.001)
            whole_ratio('duration', values['duration'], 'integrator.step', 0.001)


@fuzzed
@given(ANYTHING)
def test_any_value_is_shown_in_one_short_line(value):
    assert len(short(value)) <= 60 and '\n' not in short(value)
