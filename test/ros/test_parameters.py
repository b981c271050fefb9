# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Parameters of the node: from files, over its services as `ros2 param` does, while it runs.

The tests use rclpy's AsyncParameterClient and `get_parameter_value`, as `ros2 param` does.
"""

import math
import re
import subprocess
import sys

import numpy as np
import pytest
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters, GetParameters, ListParameters, SetParameters, SetParametersAtomically)
import rclpy
from rclpy.node import Node
from rclpy.parameter import get_parameter_value, Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from ros_process import nanoseconds, replayed, shared_node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger
import yaml

import timo_sim
from timo_sim.log.info import info
from timo_sim.log.tables import Recording
from timo_sim.scene.files import flatten, read_parameter_file, read_sections
from timo_sim.scene.parameters import check, PARAMETERS

TYPES = {bool: ParameterType.PARAMETER_BOOL, int: ParameterType.PARAMETER_INTEGER,
         float: ParameterType.PARAMETER_DOUBLE, str: ParameterType.PARAMETER_STRING,
         tuple: ParameterType.PARAMETER_DOUBLE_ARRAY}
TIME, VALUE = 'load.torque.piecewise.time', 'load.torque.piecewise.value'
MOTOR = {'motor.dc.resistance': 0.5, 'motor.dc.torque_constant': 0.06, 'motor.dc.gear_ratio': 50.0}

SAME = {
    'another namespace': '/other/timo_sim: {ros__parameters: {arm.length: 3.0}}\n'
                         '/timo_sim: {ros__parameters: {arm.section.width: 0.03}}',
    'another node': 'timo_sim_2: {ros__parameters: {arm.length: 3.0}}\n'
                    'timo_sim: {ros__parameters: {arm.section.width: 0.03}}',
    'nested namespaces': '/: {timo_sim: {ros__parameters: {arm.length: 3.0}}}\n'
                         'other: {timo_sim: {ros__parameters: {arm.length: 4.0}}}',
    'one star': '/*: {ros__parameters: {arm.length: 3.0}}',
    'one star more': '/*/timo_sim: {ros__parameters: {arm.length: 3.0}}\n'
                     '/**: {ros__parameters: {arm.section.width: 0.03}}',
    'stars and a name': '/**/timo_sim: {ros__parameters: {arm.length: 3.0}}',
    'stars, then a name': '/**: {timo_sim: {ros__parameters: {arm.length: 3.0}}}',
    'stars that come last': 'timo_sim: {ros__parameters: {arm.length: 3.0}}\n'
                            '/**: {ros__parameters: {arm: {length: 4.0}}}',
    'numbers': 'timo_sim: {ros__parameters: {arm.length: 08, arm.section.width: 2e-2, '
               'arm.section.height: .5, motor.viscous_friction: +1, initial.shaft: -1_0, '
               'model.modes: 0x3}}',
    "rclpy's own": 'timo_sim: {ros__parameters: {use_sim_time: false, arm.length: 3.0}}',
    'a mark of UTF-8': '\ufefftimo_sim: {ros__parameters: {arm.length: 3.0}}'}
# What load_scene says of files, which also refuse names that only begin like those of rclpy.
REFUSED = {
    'is given twice': (
        'timo_sim: {ros__parameters: {arm.length: 3.0, arm.length: 4.0}}',
        'timo_sim: {ros__parameters: {arm: {length: 3.0}, arm.length: 4.0}}',
        'timo_sim: {ros__parameters: {arm: {length: 3.0}, arm: {width: 0.03}}}',
        'timo_sim: {ros__parameters: {arm.length: 3.0}}\n'
        'timo_sim: {ros__parameters: {arm.section.width: 0.03}}',
        'timo_sim: {ros__parameters: {arm.length: 3.0}}\n'
        '/timo_sim: {ros__parameters: {arm.length: 4.0}}'),
    '^(?!.*is given twice)': (
        'timo_sim: {ros__parameters: {arm: {<<: {length: 3.0}}}}',
        'timo_sim: {ros__parameters: {arm.section.width: &a 0.03, arm.section.height: *a}}',
        'timo_sim: {ros__parameters: {arm.length: 3.0}}\nversion: 3'),
    'must be .*, got .(1:30|0b11|2026-11-28).': (
        'timo_sim: {ros__parameters: {arm.length: 1:30}}',
        'timo_sim: {ros__parameters: {model.modes: 0b11}}',
        'timo_sim: {ros__parameters: {initial.shaft: 2026-11-28}}'),
    '010, which ROS reads as octal': ('timo_sim: {ros__parameters: {arm.length: 010}}',),
    'use_sim_times = True is not a parameter': (
        'timo_sim: {ros__parameters: {use_sim_times: true}}',)}


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


def test_scene_and_node_take_the_same_sections(tmp_path):
    path = tmp_path / 'scene.yaml'
    for name, text in SAME.items():
        path.write_text(text)
        theirs = {name: value for name, value in overrides(path).items() if name != 'use_sim_time'}
        ours = read_parameter_file(path)
        assert theirs and ours == theirs and check(ours, 'scene') == check(theirs, 'node'), name
        timo_sim.load_scene({}, read_parameter_file(path))


def test_files_that_are_ambiguous_or_for_others_are_refused(tmp_path):
    path = tmp_path / 'scene.yaml'
    for words, texts in REFUSED.items():
        for text in texts:
            path.write_text(text)
            with pytest.raises(timo_sim.ParameterError, match=words) as caught:
                timo_sim.load_scene(path)
            assert '\n' not in str(caught.value) and str(path) in str(caught.value)
    path.write_text('/other/timo_sim: {ros__parameters: {arm.length: 3.0}}')
    assert overrides(path) == {} and [*read_sections(path)] == ['/other/timo_sim']
    assert overrides(path, '/other') == {'arm.length': 3.0}
    with pytest.raises(timo_sim.ParameterError, match='it has those of /other/timo_sim'):
        timo_sim.load_scene(path)


class Parameters:
    """Does with the parameters of a node what `ros2 param` does."""

    def __init__(self, client, node):
        self._client, self.node = client, node
        self._remote = AsyncParameterClient(client, node)
        client.wait(self._remote.services_are_ready, 'the services of parameters')
        client.wait_until_known_to(node)

    def __call__(self, method, *arguments):
        return self._client.answer(lambda: getattr(self._remote, method)(*arguments), method)

    def wait_for_end(self):
        self._client.wait(lambda: not self._remote.services_are_ready(), 'the end')

    def dump(self):
        """Return what `ros2 param dump` prints."""
        names = sorted(self('list_parameters').result.names)
        inside = {}
        for name, value in zip(names, self('get_parameters', names).values):
            *groups, last = name.split('.')
            place = inside
            for group in groups:
                place = place.setdefault(group, {})
            place[last] = parameter_value_to_python(value)
        return yaml.dump({self.node: {'ros__parameters': inside}}, default_flow_style=False)

    def set_text(self, name, text):
        """Do what `ros2 param set NODE NAME TEXT` does."""
        parameter = ParameterMessage(name=name, value=get_parameter_value(string_value=text))
        return self('set_parameters', [parameter]).results[0]

    def set_each(self, values):
        return self('set_parameters', [
            Parameter(name, value=value) for name, value in values.items()]).results

    def value(self, name):
        value, = self('get_parameters', [name]).values
        return value.type, parameter_value_to_python(value)


@pytest.fixture(scope='module')
def running(ros, tmp_path_factory):
    """Return a client of a running node, its states and its parameters."""
    with shared_node(tmp_path_factory.mktemp('running'), '-r', '__ns:=/running', '-r',
                     '/diagnostics:=/running/diagnostics', record=False) as (_, client):
        yield (client, client.collect(JointState, '/running/joint_states'),
               Parameters(client, '/running/timo_sim'))


def test_a_dump_starts_an_equal_node(start, client, tmp_path):
    """Its log has the same values, also modes and step that were chosen, and the same bits."""
    name, dumped, states = '/dumped/timo_sim', [], []
    first = {'model.accuracy': 1e-3, 'initial.shaft_velocity': 1.0 / 3.0, 'duration': 1.0,
             'carrier.force_limit': '1e-300', 'carrier.mass': 5, 'start_paused': True,
             'carrier.held': 'y', 'arm.damping_ratio': '[0]', 'load.torque.table.time': '[]',
             'real_time_factor': 0.0, 'initial.carrier_x': '-0.0'}
    for number, arguments, values in ((1, (), first), (2, ('--params-file', 'dump.yaml'), {})):
        log = tmp_path / f'{number}.mcap'
        node = start(*arguments, '-r', '__ns:=/dumped', record_file=str(log), **values)
        parameters = Parameters(client, name)
        shown = parameters.dump()
        (tmp_path / 'dump.yaml').write_text(shown)
        shown = flatten(yaml.safe_load(shown)[name]['ros__parameters'])
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
    assert shown['model.accuracy'] == 0.0
    assert len(states[0].step) > 50 and np.array_equal(states[0].step, states[1].step)
    assert states[0].values.tobytes() == states[1].values.tobytes()


def test_types_and_meanings_are_those_of_the_rules(running):
    """Read back over the service."""
    _, _, parameters = running
    found = parameters('describe_parameters', [*PARAMETERS]).descriptors
    assert [descriptor.name for descriptor in found] == [*PARAMETERS]
    for descriptor, rule in zip(found, PARAMETERS.values()):
        kind = type(rule.default)
        assert descriptor.type == TYPES[kind] and not descriptor.dynamic_typing
        assert descriptor.read_only is not rule.runtime
        assert rule.meaning in descriptor.description
        assert descriptor.additional_constraints == rule.rule


def test_lists_that_belong_together_are_loaded_and_set(running, tmp_path):
    """`ros2 param` passes numbers such as 1 and 1.0e-05 as whole numbers and texts."""
    client, states, parameters = running
    doubles = ParameterType.PARAMETER_DOUBLE_ARRAY
    assert parameters.value(TIME) == (doubles, [])
    load = tmp_path / 'load.yaml'

    def loaded(more):
        load.write_text(f'/timo_sim: {{ros__parameters: {{{VALUE}: [1, 1.0e-05], {TIME}: '
                        f'[0, 1000.5], carrier.viscous_friction: 1.0e-05{more}}}}}')
        return parameters('load_parameter_file', load).results
    for more, words in (
            ('arm.length: 3.0', 'read-only'),
            ('load.force_x.table.time: [1, 2]', 'same length, got load.force_x.table.time: 2, '),
            ('command_timeout: -1', r'command_timeout must be .*>= 0 .* s, got -1'),
            ('arm.lenght: 1.0', 'did you mean arm.length?')):
        for result in loaded(f', {more}'):
            assert not result.successful and re.search(words, result.reason)
    assert parameters.value(TIME) == (doubles, [])
    assert all(result.successful for result in loaded(''))
    assert parameters.value(TIME)[1] == [0.0, 1000.5]
    assert parameters.value(VALUE) == (doubles, [1.0, 1e-5])
    assert parameters.value('carrier.viscous_friction')[1] == 1e-5
    client.wait(lambda: states and states[-1].effort[2] == 1.0, 'the torque')

    for text, value in (('0.1', [0.1]), ('[1]', [1.0]), ('[0, 0.5, 1]', [0.0, 0.5, 1.0]),
                        ('[]', [])):
        assert parameters.set_text('arm.damping_ratio', text).successful
        assert parameters.value('arm.damping_ratio') == (doubles, value)
    for name, text, words in (
            ('arm.damping_ratio', '[2]', 'arm.damping_ratio must be .* a list of .*, got'),
            ('arm.damping_ratio', '2.0', 'arm.damping_ratio must be .* a list of .*, got 2.0'),
            ('arm.damping_ratio', '[', 'arm.damping_ratio'), (TIME, '[]', 'the same length')):
        refused = parameters.set_text(name, text)
        assert not refused.successful and re.search(words, refused.reason)
        assert '\n' not in refused.reason
    # `ros2 param delete` of a parameter that always has a value is refused.
    deleted, = parameters('delete_parameters', ['arm.damping_ratio']).results
    assert not deleted.successful and parameters.value('arm.damping_ratio')[1] == []


def test_rates_and_pace_are_set_at_run_time(running):
    client, states, parameters = running
    rate, pace = parameters.set_each({'rate.joint_states': 500, 'real_time_factor': 5.0})
    assert rate.successful and pace.successful  # a whole number for a float, too
    client.wait(lambda: len(states) > 1 and nanoseconds(states[-1]) - nanoseconds(states[-2])
                == 2000000, 'the new rate')
    refused, = parameters.set_each({'rate.joint_states': 300.0})
    assert not refused.successful and 'the ratio is 3.33333' in refused.reason
    assert not any(result.successful for result in parameters.set_each(
        {'command_timeout': math.nan, 'steps_per_call': 0, 'real_time_factor': 'fast'}))


def test_loads_damping_and_limits_are_set_at_run_time(start, client):
    """Also in the log, with a reset in between; replay gives the same bits."""
    node = start(**MOTOR)
    states = client.collect(JointState, '/joint_states')
    parameters = Parameters(client, '/timo_sim')

    def shows(effort):
        client.wait(lambda: states and states[-1].effort[2] == effort, f'a torque of {effort}')

    load = {TIME: [0.0], VALUE: [3.0]}
    refused, = parameters.set_each({TIME: [0.0]})
    assert not refused.successful and 'must have the same length' in refused.reason
    assert parameters('set_parameters_atomically', [
        Parameter(name, value=value) for name, value in load.items()]).result.successful
    shows(3.0)
    assert all(result.successful for result in parameters.set_each({
        'arm.damping_ratio': [0.02], 'motor.viscous_friction': 2.0,
        'motor.dc.voltage_limit': 10.0}))
    client.command(Float64, '/timo_sim/motor_voltage').publish(Float64(data=12.0))
    shows(3.0 + 50.0 * 0.06 / 0.5 * 10.0)
    client.command(Float64, '/timo_sim/motor_torque').publish(Float64(data=4.0))
    shows(7.0)
    assert parameters.set_each({'motor.torque_limit': 1.0})[0].successful
    shows(4.0)
    assert client.service(Trigger, '/timo_sim/reset')().success
    shows(3.0)
    assert node.end()[0] == 0

    changes = Recording(node.log).changes
    assert [list(values) for _, _, values in changes] == [
        list(load), ['arm.damping_ratio', 'motor.viscous_friction', 'motor.dc.voltage_limit'],
        ['motor.torque_limit']]
    assert f'at step {changes[0][0]}: {VALUE} = [3.0]' in '\n'.join(info(node.log))
    replayed(node.log)


SET = """
import os, sys
import rclpy
from rclpy.parameter import Parameter
from timo_sim.compiled import machine
from timo_sim.ros.node import SimNode
rclpy.init()
node = SimNode(None)
node.open()
loaded, opened = {*machine.ADDRESSES}, []
sys.addaudithook(lambda event, given: event in ('open', 'import') and opened.append(given))
torque = [f'load.tip_torque.harmonic.{name}' for name in ('amplitude', 'frequency', 'phase')]
for values in ({'end_effector.mass': 0.0, 'end_effector.inertia': 0.0},
               dict.fromkeys(torque, [1.0]), {'arm.damping_ratio': [0.1]}):
    assert node.set_parameters_atomically(
        [Parameter(name, value=value) for name, value in values.items()]).successful
node.reset()
os._exit(opened != [] or {*machine.ADDRESSES} != loaded)
"""


def test_setting_parameters_reads_no_file_and_compiles_nothing(tmp_path):
    """It would hold up who else calls the node: also a tip that needs other static shapes."""
    subprocess.run([sys.executable, '-c', SET, '--ros-args', '-p', 'record:=false'], check=True,
                   cwd=tmp_path)


ODD_NAMES = ['', 'use_sim_time', 'start_type_description_service', 'arm', 'a' * 10000,
             'no\n\x1b[1m', 'motor.torque_limit', TIME]


def test_each_question_about_parameters_is_answered(running):
    """Also with types that ROS does not have, huge numbers and strange names."""
    client, _, _ = running
    values = [ParameterValue(type=kind) for kind in (*range(11), 77, 255)] + [
        ParameterValue(type=2, integer_value=2**63 - 1), ParameterValue(type=3, double_value=-1e9),
        ParameterValue(type=4, string_value='[' * 10000),
        ParameterValue(type=5, byte_array_value=[b'\xff'])]
    odd = [ParameterMessage(name=name, value=value) for name in ODD_NAMES for value in values
           if name != 'use_sim_time' or value.type != ParameterType.PARAMETER_BOOL]
    call = {kind: client.service(kind, f'/running/timo_sim/{name}') for kind, name in (
        (SetParameters, 'set_parameters'), (ListParameters, 'list_parameters'),
        (SetParametersAtomically, 'set_parameters_atomically'),
        (GetParameters, 'get_parameters'), (DescribeParameters, 'describe_parameters'))}
    results = call[SetParameters](parameters=odd).results
    assert len(results) == len(odd)
    for parameter in odd:
        result = call[SetParametersAtomically](parameters=[parameter]).result
        assert result.successful or result.reason.isprintable() and result.reason, parameter
    for kind in (GetParameters, DescribeParameters):
        assert call[kind](names=ODD_NAMES)
    assert call[ListParameters](prefixes=ODD_NAMES, depth=2**64 - 1)
