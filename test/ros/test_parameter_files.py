# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A parameter file has the same meaning for `load_scene` and the node, or both refuse it."""

import pytest
import rclpy
from rclpy.node import Node

import timo_sim
from timo_sim.scene.files import read_parameter_file, read_sections
from timo_sim.scene.values import check

SAME = {
    'another namespace': '/other/timo_sim: {ros__parameters: {arm.length: 3.0}}\n'
                         '/timo_sim: {ros__parameters: {arm.width: 0.03}}',
    'another node': 'timo_sim_2: {ros__parameters: {arm.length: 3.0}}\n'
                    'timo_sim: {ros__parameters: {arm.width: 0.03}}',
    'nested namespaces': '/: {timo_sim: {ros__parameters: {arm.length: 3.0}}}\n'
                         'other: {timo_sim: {ros__parameters: {arm.length: 4.0}}}',
    'one star': '/*: {ros__parameters: {arm.length: 3.0}}',
    'one star more': '/*/timo_sim: {ros__parameters: {arm.length: 3.0}}\n'
                     '/**: {ros__parameters: {arm.width: 0.03}}',
    'stars and a name': '/**/timo_sim: {ros__parameters: {arm.length: 3.0}}',
    'stars, then a name': '/**: {timo_sim: {ros__parameters: {arm.length: 3.0}}}',
    'stars that come last': 'timo_sim: {ros__parameters: {arm.length: 3.0}}\n'
                            '/**: {ros__parameters: {arm: {length: 4.0}}}',
    'numbers': 'timo_sim: {ros__parameters: {arm.length: 010, arm.width: 2e-2, model.modes: 0x3}}',
    "rclpy's own": 'timo_sim: {ros__parameters: {use_sim_time: false, arm.length: 3.0, '
                   'qos_overrides: {/timo_sim/tip_pose: {publisher: {depth: 5}}}}}',
    'a mark of UTF-8': '\ufefftimo_sim: {ros__parameters: {arm.length: 3.0}}'}
TWICE = {
    'a name': 'timo_sim: {ros__parameters: {arm.length: 3.0, arm.length: 4.0}}',
    'a name, nested': 'timo_sim: {ros__parameters: {arm: {length: 3.0}, arm.length: 4.0}}',
    'a group': 'timo_sim: {ros__parameters: {arm: {length: 3.0}, arm: {width: 0.03}}}',
    'a node': 'timo_sim: {ros__parameters: {arm.length: 3.0}}\n'
              'timo_sim: {ros__parameters: {arm.width: 0.03}}',
    'a node, by two names': 'timo_sim: {ros__parameters: {arm.length: 3.0}}\n'
                            '/timo_sim: {ros__parameters: {arm.length: 4.0}}'}
OTHERWISE = {
    'a merge key': 'timo_sim: {ros__parameters: {arm: {<<: {length: 3.0}}}}',
    'an alias': 'timo_sim: {ros__parameters: {arm.width: &a 0.03, arm.height: *a}}',
    'something beside a node': 'timo_sim: {ros__parameters: {arm.length: 3.0}}\nversion: 3'}


def overrides(path, namespace='/'):
    """Return the parameters that rclpy gives a node `timo_sim` from a file."""
    context = rclpy.Context()
    rclpy.init(args=['--ros-args', '--params-file', str(path)], context=context)
    try:
        node = Node('timo_sim', context=context, namespace=namespace, enable_rosout=False,
                    start_parameter_services=False)
        found = {name: each.value for name, each in node._parameter_overrides.items()}
        node.destroy_node()
        return found
    finally:
        context.try_shutdown()


@pytest.mark.parametrize('name', SAME)
def test_scene_and_node_take_the_same_sections(tmp_path, name):
    path = tmp_path / 'scene.yaml'
    path.write_text(SAME[name])
    theirs = {name: value for name, value in overrides(path).items()
              if name not in ('use_sim_time', 'qos_overrides./timo_sim/tip_pose.publisher.depth')}
    assert theirs and check(read_parameter_file(path), 'scene') == check(theirs, 'node')
    timo_sim.load_scene(path)


@pytest.mark.parametrize('text', [*TWICE.values(), *OTHERWISE.values()],
                         ids=[*TWICE, *OTHERWISE])
def test_ambiguous_files_are_refused(tmp_path, text):
    path = tmp_path / 'scene.yaml'
    path.write_text(text)
    with pytest.raises(timo_sim.ParameterError) as caught:
        timo_sim.load_scene(path)
    assert '\n' not in str(caught.value) and str(path) in str(caught.value)
    assert ('is given twice' in str(caught.value)) == (text in TWICE.values())


def test_the_node_refuses_it_too(start, tmp_path):
    (tmp_path / 'twice.yaml').write_text(TWICE['a name, nested'])
    code, output = start('--params-file', 'twice.yaml').wait()
    assert (code, output) == (2, 'timo_sim: arm.length is given twice (twice.yaml)\n')


def test_a_file_without_a_parameter_for_the_node_is_said(start, tmp_path):
    """Its name has a namespace; the other file has a section for it."""
    (tmp_path / 'a.yaml').write_text('timo_sim: {ros__parameters: {arm.length: 3.0}}\n'
                                     '/left/timo_sim: {ros__parameters: {}}')
    (tmp_path / 'b.yaml').write_text('/**: {timo_sim: {ros__parameters: {duration: 0.1}}}')
    code, output = start('-r', '__ns:=/left', '--params-file', 'a.yaml', '--params-file',
                         'b.yaml', record=False).wait()
    assert code == 0 and output.count('has no parameter for') == 1
    assert 'a.yaml has no parameter for /left/timo_sim; it has those of /timo_sim' in output


def test_names_that_only_begin_like_those_of_rclpy_are_refused(tmp_path):
    path = tmp_path / 'scene.yaml'
    path.write_text('timo_sim: {ros__parameters: {use_sim_times: true}}')
    with pytest.raises(timo_sim.ParameterError, match='use_sim_times = True is not a parameter'):
        timo_sim.load_scene(path)


def test_a_file_for_other_nodes_sets_nothing_of_this_one(tmp_path):
    path = tmp_path / 'scene.yaml'
    path.write_text('/other/timo_sim: {ros__parameters: {arm.length: 3.0}}')
    assert overrides(path) == {} and [*read_sections(path)] == ['/other/timo_sim']
    assert overrides(path, '/other') == {'arm.length': 3.0}
    with pytest.raises(timo_sim.ParameterError, match='it has those of /other/timo_sim'):
        timo_sim.load_scene(path)
