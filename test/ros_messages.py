# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Random messages of rclpy for tests, each with its content as plain values."""

from functools import cache
from importlib import import_module
from importlib.util import find_spec
import re

_TEXTS = 'world', 'ärm', '', 'carrier_x', 'mode_12'


def installed(type_name):
    """Return whether the package of a message type is installed."""
    return find_spec(type_name.split('/')[0]) is not None


@cache
def message_class(type_name):
    """Return the class of a message, by a name as in 'sensor_msgs/msg/JointState'."""
    package, _, name = type_name.split('/')
    return getattr(import_module(f'{package}.msg'), name)


def random_message(type_name, random, most=3):
    """
    Return a message and its values.

    The fields come from rclpy's classes, not from `topics.cdr`.

    Parameters
    ----------
    type_name : str
    random : numpy.random.Generator
    most : int
        Largest number of elements of an array of any length.

    Returns
    -------
    message, dict

    """
    message, values = message_class(type_name)(), {}
    for name, kind in message.get_fields_and_field_types().items():
        element, sequence, length = re.fullmatch(
            r'(?:sequence<)?([\w/]+)(>?)(?:\[(\d+)\])?', kind).groups()
        if sequence or length:
            size = int(length or random.integers(most + 1))
            pairs = [_random(element, random, most) for _ in range(size)]
            content, values[name] = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
        else:
            content, values[name] = _random(element, random, most)
        setattr(message, name, content)
    return message, values


def _random(kind, random, most):
    if '/' in kind:
        return random_message(kind.replace('/', '/msg/'), random, most)
    if kind == 'octet':
        value = int(random.integers(256))
        return bytes([value]), value
    value = {'string': lambda: str(random.choice(_TEXTS)),
             'double': lambda: float(random.normal()),
             'int32': lambda: int(random.integers(-2**31, 2**31)),
             'uint32': lambda: int(random.integers(2**32))}[kind]()
    return value, value
