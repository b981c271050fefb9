# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""One command for a running node, sent by a process of its own."""

from collections.abc import Sequence
import math
import time

import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_full_topic_name import validate_full_topic_name

from timo_sim.ros.topics import message_class
from timo_sim.scene.parameters import did_you_mean, ParameterError, short
from timo_sim.topics.cdr import pack
from timo_sim.topics.commands import Command, COMMANDS, JOINTS

_VECTORS = 'force', 'torque'
_WRENCH = [f'{vector}.{axis}' for vector in _VECTORS for axis in 'xyz']


def _fields(command: Command) -> Sequence[str]:
    """Return the names of what a command can set, in order."""
    if command.type_name.endswith('WrenchStamped'):
        return [*(name for place, name in enumerate(_WRENCH) if place not in command.unused),
                'frame_id']
    if command.type_name.endswith('Vector3Stamped'):
        return 'x', 'y', 'frame_id'
    return ('data',) if command.type_name.endswith('Float64') else JOINTS


def _read(topic, command, words):
    """Return the values by field of words, each that of the next field or FIELD=VALUE."""
    fields, given = _fields(command), {}
    for place, word in enumerate(words):
        field, named, text = word.rpartition('=')
        if not named:
            field = fields[place] if place < len(fields) else word
        if field not in fields or field in given:
            raise ParameterError(f'{topic} has the fields {", ".join(fields)}, once each, got '
                                 f'{short(word, str)}{did_you_mean(field, fields)}')
        try:
            given[field] = text if field == 'frame_id' else float(text)
        except ValueError:
            given[field] = math.nan
        if field != 'frame_id' and not math.isfinite(given[field]):
            raise ParameterError(f'{field} of {topic} must be a finite number, got {short(text)}')
    return given


def _content(topic, command, given):
    """Return the message, by field."""
    kind = command.type_name.rpartition('/')[2]
    numbers = [field for field in _fields(command) if field != 'frame_id']
    missing = [field for field in numbers if field not in given]
    if kind.startswith('Float64') and missing or missing == numbers:
        either = ', ' if kind.startswith('Float64') else ' or '
        raise ParameterError(f'{topic} needs a value for {either.join(missing)}')
    if kind == 'Float64':
        return given
    if kind == 'Float64MultiArray':
        return {'data': [given[joint] for joint in JOINTS]}
    if kind == 'JointState':
        return {'name': [*given], 'effort': [*given.values()]}
    header = {'frame_id': given.pop('frame_id', '')}
    if kind == 'Vector3Stamped':
        return {'header': header, 'vector': given}
    wrench = {vector: {axis: given[name] for axis in 'xyz'
                       if (name := f'{vector}.{axis}') in given} for vector in _VECTORS}
    return {'header': header, 'wrench': wrench}


def send(topic: str, words: Sequence[str], node: str, patience: float) -> str:
    """
    Send one command to the node with a full name; return a line about it.

    `topic` is the name of a command topic, such as motor_torque; `words` are the values of its
    fields in order, or FIELD=VALUE [N, N m, V]. Raises ParameterError if they break their rules,
    TimeoutError if no subscriber has acknowledged it within `patience` [s].
    """
    commands = {command.name.removeprefix('~/'): command for command in COMMANDS}
    if topic not in commands:
        raise ParameterError(f'TOPIC must be one of {", ".join(commands)}, got '
                             f'{short(topic)}{did_you_mean(topic, commands)}')
    command, full = commands[topic], f'/{node.strip("/")}/{topic}'
    try:
        validate_full_topic_name(full)
    except NameValidationException:
        raise ParameterError(
            f'--node must be the full name of a node, got {short(node)}') from None
    message = pack(command.type_name, _content(topic, command, _read(topic, command, words)))
    end = time.monotonic() + patience
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        publisher = rclpy.create_node('send').create_publisher(
            message_class(command.type_name), full, 10)
        while not publisher.get_subscription_count():
            if time.monotonic() > end:
                raise TimeoutError(f'{full} has no subscriber: the node is not running, has '
                                   'another name (--node), or does not take this command')
            time.sleep(0.01)
        publisher.publish(message)
        if not publisher.wait_for_all_acked(Duration(seconds=patience)):
            raise TimeoutError(f'the subscriber of {full} does not acknowledge the command')
    finally:
        rclpy.try_shutdown()
    return f'sent to {full}'
