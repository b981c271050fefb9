# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Scenes from random names, values and YAML either run or are refused in one line."""

import math

from hypothesis import example, given, HealthCheck, settings, strategies as st
import numpy as np
import pytest

import timo_sim
from timo_sim.scene.parameters import PARAMETERS, SCENE, short

# No deadline, because durations mean nothing on a busy machine.
fuzzed = settings(deadline=None, derandomize=True, max_examples=150,
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
@example({'arm.height': 1e300})
@example({'arm.height': 5e-324})
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
            assert np.isfinite(run.motion).all()


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
    (BOMB + 'arm: *a20}}', 'an alias, which ROS does not take'),
    (LISTS + 'arm.profile.width: *a40}}', 'an alias, which ROS does not take'),
    ('timo_sim: {ros__parameters: &a {arm: *a}}', 'an alias, which ROS does not take'),
    ('timo_sim: {ros__parameters: {arm.length: ' + '[' * 20000 + ']' * 20000, 'not a YAML file'),
    ('timo_sim: {ros__parameters: ' + '{a: ' * 20000, 'is not a YAML file'),
    ('timo_sim: {ros__parameters: {arm.length: 2001-13-45}}', 'is not a YAML file: month must'),
    ('timo_sim: {ros__parameters: {arm.length: 1\0}}', 'is not a YAML file'),
    ('timo_sim: {ros__parameters: {arm.length: 0x' + 'f' * 9000 + '}}', 'got a huge int'),
    ('timo_sim: {ros__parameters: {record_file: "a\\0b"}}', 'record_file must be a text'),
    ('', 'must have parameters under')
]


def test_files_made_to_break_their_reader(tmp_path):
    for text, words in HOSTILE:
        path = tmp_path / 'scene.yaml'
        path.write_text(text)
        with pytest.raises(timo_sim.ParameterError, match=words) as caught:
            timo_sim.load_scene(path)
        assert len(str(caught.value)) < 600 and '\n' not in str(caught.value)


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
    assert timo_sim.simulate(scene, 0.01).motion[-1, 2] > 0.0
    with pytest.raises(timo_sim.ParameterError, match=r'time\[77777\] = 77.7775 must be'):
        times[77777] += 0.0005
        timo_sim.load_scene({'load.torque.piecewise.time': times,
                             'load.torque.piecewise.value': np.ones(len(times))})


EXTREME = [
    ({'rate.joint_states': 1e13}, 'ratio'), ({'duration': 1e-13}, 'ratio'),
    ({'duration': 1e308}, 'must be a finite number >= 0 and <= 2.14748e.09 s'),
    ({'real_time_factor': 1e300}, '<= 1e.06'), ({'command_timeout': 1e300}, '<= 2.147')
]


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
