# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""One command for a running node, sent by a process of its own."""

from itertools import chain
import math
import time

import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_full_topic_name import validate_full_topic_name

from timo_sim.ros.topics import message_class
from timo_sim.scene.files import parse_yaml
from timo_sim.scene.parameters import did_you_mean, frame_names, ParameterError, short
from timo_sim.topics.cdr import pack, Reader
from timo_sim.topics.commands import COMMANDS
from timo_sim.topics.outputs import FRAMES


def _message(topic, command, text, frames):
    """Return the message of a text in YAML, serialised, its frame, and what has no effect."""
    content = parse_yaml(text, topic)
    try:
        message = pack(command.type_name,
                       content if isinstance(content, dict) else {'data': content})
        texts, lists, _ = Reader(command.type_name)(message)
        frame = (texts or [''])[0]
        command.row(texts, lists, frames or dict.fromkeys(FRAMES, frame))
        if any(map(math.isnan, lists[-1])):
            raise ValueError('effort must be finite, got nan, by which ros2_control skips a joint')
        return message, frame, command.no_effect(texts, lists)
    except ValueError as error:
        raise ParameterError(f'{topic} takes a {command.type_name}, in YAML as of ros2 topic pub, '
                             f'got {short(text)}: {error}') from None


def _frames(sender, node, patience):
    """Return the names of a node's frames, a dictionary with keys of FRAMES."""
    names = ['frame_prefix', *(f'frame.{name}' for name in FRAMES)]
    client = AsyncParameterClient(sender, node)
    if client.wait_for_services(patience):
        asked = client.get_parameters(names)
        rclpy.spin_until_future_complete(sender, asked, timeout_sec=patience)
        if asked.done():
            return frame_names({name: value.string_value
                                for name, value in zip(names, asked.result().values)})
    raise TimeoutError(f'{node} does not tell the names of its frames within {patience:g} s: send '
                       'the command again, or without a frame_id')


def _state(sender, node, reports, end):
    """Return what a node's next report of /diagnostics says about its time, as text."""
    while time.monotonic() < end:
        rclpy.spin_once(sender, timeout_sec=0.1)
        for status in chain.from_iterable(array.status for array in reports):
            if status.name == f'{node.removeprefix("/")}: simulation':
                state = {each.key: each.value for each in status.values}['state']
                if state != 'paused':
                    return f'the node is {state}'
                if status.level == status.ERROR:
                    return (f'the node is paused, {status.message}: ~/reset goes back to the '
                            'start and drops the command')
                return 'the node is paused: the command acts when it goes on, a reset drops it'
    return f'no /diagnostics of {node} came: it may be paused, or have another name (--node)'


def send(topic: str, text: str, node: str, patience: float) -> str:
    """
    Send one command to the node with a full name; return a line about it and the node's state.

    `topic` is the name of a command topic, such as motor_torque; `text` is the message in YAML, or
    its field `data` alone [N, N m, V]. Raises ParameterError if it breaks its rules, TimeoutError
    if no subscriber has acknowledged it within `patience` [s].
    """
    commands = {command.name.removeprefix('~/'): command for command in COMMANDS}
    if topic not in commands:
        raise ParameterError(f'TOPIC must be one of {", ".join(commands)}, got '
                             f'{short(topic)}{did_you_mean(topic, commands)}')
    command, node = commands[topic], f'/{node.strip("/")}'
    full = f'{node}/{topic}'
    try:
        validate_full_topic_name(full)
    except NameValidationException:
        raise ParameterError(
            f'--node must be the full name of a node, got {short(node)}') from None
    message, frame, idle = _message(topic, command, text, None)
    end, reports = time.monotonic() + patience, []
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        sender = rclpy.create_node('send')
        publisher = sender.create_publisher(message_class(command.type_name), full, 10)
        sender.create_subscription(message_class('diagnostic_msgs/msg/DiagnosticArray'),
                                   '/diagnostics', reports.append, 10)
        while not publisher.get_subscription_count():
            if time.monotonic() > end:
                raise TimeoutError(f'{full} has no subscriber: the node is not running, has '
                                   'another name (--node), or does not take this command')
            time.sleep(0.01)
        if frame:
            _message(topic, command, text, _frames(sender, node, patience))
        publisher.publish(message)
        if not publisher.wait_for_all_acked(Duration(seconds=patience)):
            raise TimeoutError(f'the subscriber of {full} does not acknowledge the command '
                               f'within {patience:g} s: send it again')
        state = _state(sender, node, reports, time.monotonic() + patience)
    finally:
        rclpy.try_shutdown()
    return '; '.join(filter(None, (f'sent to {full}', idle, state)))
