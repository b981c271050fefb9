# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""One command for a running node, sent by a process of its own."""

import struct
import time

import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_full_topic_name import validate_full_topic_name

from timo_sim.ros.topics import message_class
from timo_sim.scene.files import parse_yaml
from timo_sim.scene.parameters import did_you_mean, ParameterError, short
from timo_sim.topics.cdr import pack, Reader
from timo_sim.topics.commands import COMMANDS
from timo_sim.topics.outputs import FRAMES


def _message(topic, command, text):
    """Return the message of a text in YAML, serialised, if the node would take it."""
    content = parse_yaml(text, topic)
    try:
        message = pack(command.type_name,
                       content if isinstance(content, dict) else {'data': content})
        texts, lists, _ = Reader(command.type_name)(message)
        # Any frame: the node knows the names of its own.
        command.row(texts, lists, dict.fromkeys(FRAMES, (texts or [''])[0]))
    except (AttributeError, TypeError, ValueError, struct.error) as error:
        raise ParameterError(f'{topic} takes a {command.type_name}, in YAML as of ros2 topic pub, '
                             f'got {short(text)}: {error}') from None
    return message


def send(topic: str, text: str, node: str, patience: float) -> str:
    """
    Send one command to the node with a full name; return a line about it.

    `topic` is the name of a command topic, such as motor_torque; `text` is the message in YAML, or
    its field `data` alone [N, N m, V]. Raises ParameterError if it breaks its rules, TimeoutError
    if no subscriber has acknowledged it within `patience` [s].
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
    message = _message(topic, command, text)
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
            raise TimeoutError(f'the subscriber of {full} does not acknowledge the command '
                               f'within {patience:g} s: send it again')
    finally:
        rclpy.try_shutdown()
    return f'sent to {full}'
