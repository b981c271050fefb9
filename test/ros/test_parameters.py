# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Parameters as `ros2 param` gets and sets them.

The tests use rclpy's AsyncParameterClient and `get_parameter_value`, as `ros2 param` does.
"""

import math
from pathlib import Path
import re
import sys

import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import get_parameter_value, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
import yaml

from timo_sim.log.recording import Recording
from timo_sim.scene.files import flatten
from timo_sim.scene.parameters import PARAMETERS
from timo_sim.scene.values import check

CONTROL = Path(__file__).resolve().parents[2] / 'doc' / 'control.md'
TYPES = {bool: ParameterType.PARAMETER_BOOL, int: ParameterType.PARAMETER_INTEGER,
         float: ParameterType.PARAMETER_DOUBLE, str: ParameterType.PARAMETER_STRING,
         tuple: ParameterType.PARAMETER_DOUBLE_ARRAY}
TIME, VALUE = 'load.torque.piecewise.time', 'load.torque.piecewise.value'


@pytest.fixture
def namespace(request):
    """Return a namespace for this test, because killed nodes stay in the graph for a while."""
    return f'/{request.node.name}'


@pytest.fixture
def parameters(client, namespace):
    """Return a function that calls a method of a parameter client of the running node."""
    remote = AsyncParameterClient(client, f'{namespace}/timo_sim')

    def call(method, *arguments):
        client.wait(remote.services_are_ready, 'the services of parameters')
        return client.answer(lambda: getattr(remote, method)(*arguments), method)
    call.wait_for_end = lambda: client.wait(lambda: not remote.services_are_ready(), 'the end')
    return call


def dump(call, node):
    """Return what `ros2 param dump NODE` prints."""
    names = sorted(call('list_parameters').result.names)
    values = [parameter_value_to_python(value) for value in call('get_parameters', names).values]
    inside = {}
    for name, value in zip(names, values):
        *groups, last = name.split('.')
        place = inside
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = value
    return yaml.dump({node: {'ros__parameters': inside}}, default_flow_style=False)


def set_one(call, name, text):
    """Do what `ros2 param set /timo_sim NAME TEXT` does."""
    parameter = Parameter(name=name, value=get_parameter_value(string_value=text))
    return call('set_parameters', [parameter]).results[0]


def value_of(call, name):
    """Return type and value of a parameter."""
    value, = call('get_parameters', [name]).values
    return value.type, parameter_value_to_python(value)


def test_a_dump_starts_an_equal_node(start, client, parameters, namespace, tmp_path):
    """Its log has the same values, also modes and step that were chosen, and the same bits."""
    first = {'model.accuracy': 1e-3, 'initial.shaft_velocity': 1.0 / 3.0, 'duration': 1.0,
             'carrier.force_limit': '1e-300', 'carrier.mass': 5, 'start_paused': True,
             'carrier.held': 'y', 'arm.damping_ratio': '[0]', 'load.torque.table.time': '[]',
             'real_time_factor': 0.0, 'initial.carrier_x': '-0.0',
             f'qos_overrides.{namespace}/timo_sim/tip_pose.publisher.depth': 5}
    name, dumped, states = f'{namespace}/timo_sim', [], []
    for number, arguments, values in ((1, (), first), (2, ('--params-file', 'dump.yaml'), {})):
        log = tmp_path / f'{number}.mcap'
        node = start(*arguments, '-r', f'__ns:={namespace}', record_file=str(log), **values)
        shown = dump(parameters, name)
        (tmp_path / 'dump.yaml').write_text(shown)
        shown = flatten(yaml.safe_load(shown)[name]['ros__parameters'])
        assert shown[f'qos_overrides.{name}/tip_pose.publisher.depth'] == 5
        shown = {name: shown[name] for name in PARAMETERS}  # none is missing
        assert client.service(SetBool, f'{name}/pause')(data=False).success
        assert node.wait()[0] == 0
        parameters.wait_for_end()
        recording = Recording(log)
        states.append(recording.topics['~/modal_state'])
        # Different doubles have a different repr.
        assert repr(check(shown, 'dump')) == repr(check(
            {name: recording.parameters[name] for name in PARAMETERS}, 'log'))
        assert shown.pop('record_file') == str(log)
        dumped.append(repr(shown))
    assert dumped[0] == dumped[1]
    assert (shown['model.accuracy'], shown['integrator.step']) == (0.0, 0.01)
    assert len(states[0].step) > 50 and np.array_equal(states[0].step, states[1].step)
    assert states[0].values.tobytes() == states[1].values.tobytes()


def test_types_and_ranges_are_those_of_the_rules(start, parameters, namespace):
    """Read back over the service."""
    start('-r', f'__ns:={namespace}', record=False)
    found = parameters('describe_parameters', [*PARAMETERS]).descriptors
    assert [descriptor.name for descriptor in found] == [*PARAMETERS]
    for descriptor, rule in zip(found, PARAMETERS.values()):
        kind = type(rule.default)
        assert descriptor.type == TYPES[kind] and not descriptor.dynamic_typing
        assert descriptor.read_only is not rule.runtime
        assert rule.meaning in descriptor.description
        ranges = [(each.from_value, each.to_value) for each in (
            *descriptor.floating_point_range, *descriptor.integer_range)]
        if kind in (int, float) and rule.low > -math.inf:
            highest = min(rule.high, sys.float_info.max) if rule.finite else math.inf
            assert ranges == [(rule.low, highest)], rule.name
        else:
            assert ranges == []


def test_lists_that_belong_together_are_loaded_and_set(
        start, client, parameters, namespace, tmp_path):
    """`ros2 param` passes numbers such as 1 and 1.0e-05 as whole numbers and texts."""
    start('-r', f'__ns:={namespace}', record=False)
    states = client.collect(JointState, f'{namespace}/joint_states')
    assert value_of(parameters, TIME) == (ParameterType.PARAMETER_DOUBLE_ARRAY, [])
    (tmp_path / 'load.yaml').write_text(
        f'/timo_sim: {{ros__parameters: {{{VALUE}: [1, 1.0e-05], carrier.viscous_friction: 1.0e-05'
        f', {TIME}: [0, 1000.5], arm.length: 3.0, load.force_x.table.time: [1, 2], '
        'command_timeout: -1, arm.lenght: 1.0}}')
    results = parameters('load_parameter_file', tmp_path / 'load.yaml').results
    reasons = [each.reason for each in results]
    assert [each.successful for each in results] == [True] * 3 + [False] * 4, reasons
    for reason, words in zip(reasons[3:], (
            'read-only', r'same length, got load.force_x.table.time: 2, load.force_x.table.value: '
            r'0', r'command_timeout must be .*>= 0 .* s, got -1', 'did you mean arm.length?')):
        assert re.search(words, reason)
    assert value_of(parameters, TIME)[1] == [0.0, 1000.5]
    assert value_of(parameters, VALUE) == (ParameterType.PARAMETER_DOUBLE_ARRAY, [1.0, 1e-5])
    assert value_of(parameters, 'carrier.viscous_friction')[1] == 1e-5
    client.wait(lambda: states and states[-1].effort[2] == 1.0, 'the torque')

    for text, value in (('0.1', [0.1]), ('[1]', [1.0]), ('[0, 0.5, 1]', [0.0, 0.5, 1.0]),
                        ('[]', [])):
        assert set_one(parameters, 'arm.damping_ratio', text).successful
        assert value_of(parameters, 'arm.damping_ratio') == (
            ParameterType.PARAMETER_DOUBLE_ARRAY, value)
    for name, text, words in (
            ('arm.damping_ratio', '[2]', 'arm.damping_ratio must be .* a list of .*, got'),
            ('arm.damping_ratio', '2.0', 'arm.damping_ratio must be .* a list of .*, got 2.0'),
            ('arm.damping_ratio', '[', 'arm.damping_ratio'), (TIME, '[]', 'the same length')):
        refused = set_one(parameters, name, text)
        assert not refused.successful and re.search(words, refused.reason)
        assert '\n' not in refused.reason
    # `ros2 param delete` of a parameter that always has a value is refused.
    deleted, = parameters('delete_parameters', ['arm.damping_ratio']).results
    assert not deleted.successful and value_of(parameters, 'arm.damping_ratio')[1] == []


def test_the_line_of_the_page_sets_two_lists_at_once(start, client, parameters, namespace):
    start('-r', f'__ns:={namespace}', record=False)
    states = client.collect(JointState, f'{namespace}/joint_states')
    line, = re.findall(r'set_parameters_atomically rcl_interfaces/srv/SetParametersAtomically \\\n'
                       r' *"(.*)"$', CONTROL.read_text(), re.MULTILINE)
    together = client.service(
        SetParametersAtomically, f'{namespace}/timo_sim/set_parameters_atomically')
    given = [Parameter(name=each['name'], value=ParameterValue(**each['value']))
             for each in yaml.safe_load(line)['parameters']]
    assert together(parameters=given).result.successful
    assert [each.name for each in given] == [TIME, VALUE]
    assert value_of(parameters, VALUE)[1] == [*given[1].value.double_array_value]
    client.wait(lambda: states and states[-1].effort[2] != 0.0, 'the torque')
    assert not together(parameters=given[:1] + [Parameter(
        name=VALUE, value=get_parameter_value('[]'))]).result.successful
    assert together(parameters=[Parameter(name=name, value=get_parameter_value('[]'))
                                for name in (TIME, VALUE)]).result.successful
    client.wait(lambda: states[-1].effort[2] == 0.0, 'no torque')
