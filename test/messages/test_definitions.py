# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Definitions and hashes are those of ROS 2."""

import json
import os
from pathlib import Path
import sys

import pytest
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

from timo_sim.topics.cdr import DEFINITIONS, Field, fields, schema_text, TYPE_HASHES
from timo_sim.topics.commands import COMMANDS
from timo_sim.topics.outputs import outputs, TRANSFORMS


def share(type_name, suffix):
    """Return the text of a file of an installed message package, or skip the test."""
    package, _, name = type_name.split('/')
    for prefix in [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]:
        path = Path(prefix, 'share', package, 'msg', name + suffix)
        if prefix and path.exists():
            return path.read_text(encoding='utf-8')
    if package != 'tf2_msgs':
        raise ModuleNotFoundError(f'{type_name} is not installed', name=package)
    # This package has no wheel on PyPI; test_hashes_follow_from_the_definitions covers it.
    pytest.skip(f'{package} is not installed')


@pytest.mark.parametrize('type_name', DEFINITIONS)
def test_definitions_are_those_of_ros(type_name):
    lines = [line.split('#')[0].split() for line in share(type_name, '.msg').splitlines()]
    assert [line.split() for line in DEFINITIONS[type_name]] == [line for line in lines if line]


@pytest.mark.parametrize('type_name', TYPE_HASHES)
def test_hashes_are_those_of_ros(type_name):
    hashes = {entry['type_name']: entry['hash_string']
              for entry in json.loads(share(type_name, '.json'))['type_hashes']}
    assert TYPE_HASHES[type_name] == hashes[type_name]


@pytest.mark.parametrize('type_name', TYPE_HASHES)
def test_hashes_follow_from_the_definitions(type_name):
    """Rosbags reads the schema and computes the hash by REP-2011."""
    store = get_typestore(Stores.EMPTY)
    types = get_types_from_msg(schema_text(type_name), type_name)
    store.register(types)
    assert TYPE_HASHES[type_name] == store.hash_rihs01(type_name)
    assert types.keys() <= DEFINITIONS.keys()


def test_every_topic_has_a_hash():
    topics = [*outputs(1), TRANSFORMS, *COMMANDS]
    assert {topic.type_name for topic in topics} <= TYPE_HASHES.keys() <= DEFINITIONS.keys()


def test_fields_know_lengths_packages_and_defaults():
    assert fields('diagnostic_msgs/msg/DiagnosticStatus') == (  # without the constants
        Field('level', 'byte', None, 0), Field('name', 'string', None, ''),
        Field('message', 'string', None, ''), Field('hardware_id', 'string', None, ''),
        Field('values', 'diagnostic_msgs/msg/KeyValue', 0, ()))
    assert fields('geometry_msgs/msg/Quaternion')[3] == Field('w', 'float64', None, 1)
    assert fields('sensor_msgs/msg/Imu')[1:3] == (
        Field('orientation', 'geometry_msgs/msg/Quaternion', None, {}),
        Field('orientation_covariance', 'float64', 9, 9 * (0,)))


def test_a_schema_holds_each_definition_once():
    assert schema_text('rosgraph_msgs/msg/Clock') == (
        f'builtin_interfaces/Time clock\n{80 * "="}\nMSG: builtin_interfaces/Time\n'
        'int32 sec\nuint32 nanosec\n')
    text = schema_text('sensor_msgs/msg/Imu')  # two of its fields are a Vector3
    assert [line for line in text.splitlines() if line.startswith('MSG:')] == [
        'MSG: std_msgs/Header', 'MSG: geometry_msgs/Quaternion', 'MSG: geometry_msgs/Vector3',
        'MSG: builtin_interfaces/Time']
