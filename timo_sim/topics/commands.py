# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The command topics: which inputs a message sets, and when it is refused."""

from collections.abc import Callable, Mapping, Sequence
import math
from typing import NamedTuple

import numpy as np

from timo_sim.model.layout import Input, INPUTS, LOADS

# Commanded values have the columns of a load, and two more: a force on the tip in the axes of the
# tip, which `simulation.loads.load_of_commands` turns into a load.
_COMMANDED = (
    *INPUTS,
    Input('tip_force_along_tip', 'N', 'force on the end effector along its axis', 'tip', 'tip'),
    Input('tip_force_across_tip', 'N', 'force on the end effector across it', 'tip', 'tip'),
)
COMMANDED, ALONG_TIP, ACROSS_TIP = len(_COMMANDED), LOADS, LOADS + 1
# The columns of each group of inputs. A group follows the latest message that set it; of messages
# that begin to act in the same step, the later entry of COMMANDS wins.
GROUPS = {name: [column for column, each in enumerate(_COMMANDED) if each.group == name]
          for name in dict.fromkeys(each.group for each in _COMMANDED) if name}
JOINTS = 'carrier_x', 'carrier_y', 'shaft'
_WRENCH = 'force.x', 'force.y', 'force.z', 'torque.x', 'torque.y', 'torque.z'


class RefusedError(ValueError):
    """A command is not applied; the text says why."""


def _check_finite(numbers):
    if wrong := [each for each in numbers if not math.isfinite(each)]:
        raise RefusedError(f'every component must be finite, got {wrong[0]}')


def _forces(texts, numbers, names):
    """Return (x, y) for each frame of `names`: the vector in the message's frame, else zeros."""
    _check_finite(numbers)
    frame = texts[0] or names[0]
    if frame not in names:
        raise RefusedError(f'frame_id must be {", ".join(["empty", *map(repr, names[:-1])])} or '
                           f'{names[-1]!r}, got {frame[:40]!r}')
    return [tuple(numbers[:2]) if frame == name else (0.0, 0.0) for name in names]


def _carrier_wrench(texts, lists, frames):
    world, arm = _forces(texts, lists[0], [frames['world'], frames['arm']])
    return {'carrier': (*world, *arm)}


def _tip_wrench(texts, lists, frames):
    world, arm, tip = _forces(texts, lists[0], [frames[name] for name in ('world', 'arm', 'tip')])
    return {'tip': (*world, *arm, lists[0][5], *tip)}


def _base_vector(texts, lists, frames):
    return {'base': _forces(texts, lists[0], [frames['world']])[0]}


def _scalar(lists):
    if not math.isfinite(lists[0][0]):
        raise RefusedError(f'data must be finite, got {lists[0][0]}')
    return lists[0][0]


def _joint_command(texts, lists, frames):
    names, efforts = texts[1:], lists[-1]
    if len(set(names)) < len(names) or not names:
        raise RefusedError(f'name must hold joints, once each, got {", ".join(names)[:80]!r}')
    if len(efforts) != len(names):
        raise RefusedError(f'effort must have one element for each of {len(names)} names, got '
                           f'{len(efforts)}')
    given = {name: effort for name, effort in zip(names, efforts) if name in JOINTS}
    # NaN is what ros2_control sends for a joint that no controller has claimed.
    claimed = {name for name, effort in given.items() if not math.isnan(effort)}
    _check_finite(given[name] for name in claimed)
    found: dict[str, tuple] = {}
    if claimed - {'shaft'}:
        found['carrier'] = given.get('carrier_x', 0.0), given.get('carrier_y', 0.0), 0.0, 0.0
    if 'shaft' in claimed:
        found['shaft'] = given['shaft'], 0.0
    return found


def _commands(texts, lists, frames):
    if len(lists[0]) != len(JOINTS):
        raise RefusedError(f'data must have {len(JOINTS)} elements, for {", ".join(JOINTS)}, got '
                           f'{len(lists[0])}')
    _check_finite(lists[0])
    return _joint_command(['', *JOINTS], lists, frames)


class Command(NamedTuple):
    """
    A command topic.

    `load` takes the texts and the lists of numbers of a message, see `cdr.Content`, and the names
    of frames, and returns the values of each group of inputs that it sets, or raises RefusedError.
    """

    name: str
    type_name: str
    load: Callable[..., dict]
    groups: tuple[str, ...]    # keys of GROUPS that it may set
    meaning: str               # of what it sets, for tables
    unused: tuple[int, ...] = ()  # numbers of a wrench without effect, of which the node warns

    @property
    def columns(self) -> list[int]:
        """Columns of the commanded values that it may set."""
        return [column for group in self.groups for column in GROUPS[group]]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of these columns, with units."""
        return tuple(_COMMANDED[column].column for column in self.columns)

    def row(self, texts: Sequence[str], lists: Sequence[Sequence[float]],
            frames: Mapping[str, str]) -> np.ndarray:
        """Return values for its columns [N, N m, V], NaN where it sets none; or RefusedError."""
        found = self.load(texts, lists, frames)
        return np.concatenate([found.get(group, [math.nan] * len(GROUPS[group]))
                               for group in self.groups])

    def no_effect(self, texts: Sequence[str], lists: Sequence[Sequence[float]]) -> str:
        """Return which part of a message has no effect, as text; '' if all of it has."""
        names = texts[1:] if self.load is _joint_command else []
        if names and {*names}.isdisjoint(JOINTS):
            return f'no effect: {names[0][:40]!r} is none of {JOINTS}'
        parts = ', '.join(_WRENCH[place] for place in self.unused if lists[0][place])
        return parts and (f'no effect of {parts}: the arm moves in a plane, the carrier without '
                          'turning')

    def apply(self, row: np.ndarray, commanded: np.ndarray) -> set[str]:
        """Write a row into commanded values, (COMMANDED,); return the groups that it sets."""
        given = np.flatnonzero(~np.isnan(row))
        columns = np.array(self.columns)[given]
        commanded[columns] = row[given]
        return {group for group in self.groups if not set(GROUPS[group]).isdisjoint(columns)}


# The motor's voltage is the last: a node without such a motor has all topics but this.
COMMANDS = [
    Command('~/carrier_wrench', 'geometry_msgs/msg/WrenchStamped', _carrier_wrench, ('carrier',),
            'force x, y on the carrier', unused=(2, 3, 4, 5)),
    Command('~/motor_torque', 'std_msgs/msg/Float64',
            lambda texts, lists, frames: {'shaft': (_scalar(lists), 0.0)}, ('shaft',),
            'torque on the shaft'),
    Command('~/tip_wrench', 'geometry_msgs/msg/WrenchStamped', _tip_wrench, ('tip',),
            'force x, y and torque z on the end effector', unused=(2, 3, 4)),
    Command('~/joint_command', 'sensor_msgs/msg/JointState', _joint_command,
            ('carrier', 'shaft'),
            'efforts of `carrier_x`, `carrier_y`, `shaft`, by name; other joints are ignored'),
    Command('~/commands', 'std_msgs/msg/Float64MultiArray', _commands, ('carrier', 'shaft'),
            'the same three, as an array'),
    Command('~/carrier_acceleration', 'geometry_msgs/msg/Vector3Stamped', _base_vector,
            ('base',), 'acceleration x, y of what holds the carrier along axes that are held'),
    Command('~/motor_voltage', 'std_msgs/msg/Float64',
            lambda texts, lists, frames: {'shaft': (0.0, _scalar(lists))}, ('shaft',),
            'voltage at a DC motor, with `motor.dc`'),
]


# A log shows a time-out of a group as a message of zeros on the first topic that sets it alone.
TIMED_OUT = {command.groups[0]: index for index, command in reversed([*enumerate(COMMANDS)])
             if len(command.groups) == 1}


def has_tip_force(commanded: np.ndarray) -> bool:
    """Return whether commanded values, (COMMANDED,), have a force in the axes of the tip."""
    return commanded[ALONG_TIP] != 0.0 or commanded[ACROSS_TIP] != 0.0
