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

from rosbags.typesys import get_types_from_msg, get_typestore, Stores

from timo_sim.topics.cdr import DEFINITIONS, schema_text, TYPE_HASHES
from timo_sim.topics.commands import COMMANDS
from timo_sim.topics.outputs import outputs, TRANSFORMS


def share(type_name, suffix):
    """Return the text of a file of a message package, None where tf2_msgs is not installed."""
    package, _, name = type_name.split('/')
    for prefix in [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]:
        path = Path(prefix, 'share', package, 'msg', name + suffix)
        if prefix and path.exists():
            return path.read_text(encoding='utf-8')
    if package != 'tf2_msgs':  # which has no wheel on PyPI
        raise ModuleNotFoundError(f'{type_name} is not installed', name=package)


def test_definitions_and_hashes_are_those_of_ros():
    for type_name, lines in DEFINITIONS.items():
        definition, description = (share(type_name, suffix) for suffix in ('.msg', '.json'))
        if definition:
            theirs = [line.split('#')[0].split() for line in definition.splitlines()]
            assert [line.split() for line in lines] == [line for line in theirs if line], type_name
        if description and type_name in TYPE_HASHES:
            hashes = {entry['type_name']: entry['hash_string']
                      for entry in json.loads(description)['type_hashes']}
            assert TYPE_HASHES[type_name] == hashes[type_name]


def test_hashes_follow_from_the_definitions():
    """Rosbags reads the schema, which has each definition once, and computes it by REP-2011."""
    assert {topic.type_name for topic in [*outputs(1), TRANSFORMS, *COMMANDS]} <= {*TYPE_HASHES}
    for type_name in TYPE_HASHES:
        store = get_typestore(Stores.EMPTY)
        types = get_types_from_msg(schema_text(type_name), type_name)
        store.register(types)
        assert TYPE_HASHES[type_name] == store.hash_rihs01(type_name)
        assert types.keys() <= DEFINITIONS.keys()
