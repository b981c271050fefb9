"""What a command means: the columns of the load that it sets, and when it is refused."""

import math
from typing import Callable, NamedTuple

from timo_sim.physics.formulation import FORCE_I, FORCE_II, FORCE_X, FORCE_Y, TORQUE


class Refused(ValueError):
    """A command that is not applied; the text says why."""


def _wrench(frame, numbers):
    if not all(map(math.isfinite, numbers)):
        raise Refused('every component must be finite')
    x, y = numbers[:2]
    if frame in ('', 'world'):
        return x, y, 0.0, 0.0
    if frame == 'arm':
        return 0.0, 0.0, x, y
    raise Refused(f"frame_id must be empty, 'world' or 'arm', got {frame[:40]!r}")


def _torque(frame, numbers):
    if not math.isfinite(numbers[0]):
        raise Refused(f'data must be finite, got {numbers[0]}')
    return numbers


class Command(NamedTuple):
    """
    A command topic.

    `load` takes the frame and the numbers of a message and returns what it sets in `columns` of
    the load, which `names` names with units; it raises Refused.
    """

    name: str
    type_name: str
    load: Callable[[str, tuple], tuple]
    columns: list
    names: tuple


COMMANDS = [
    Command('~/carrier_wrench', 'geometry_msgs/msg/WrenchStamped', _wrench,
            [FORCE_X, FORCE_Y, FORCE_I, FORCE_II],
            ('force_x_N', 'force_y_N', 'force_along_arm_N', 'force_across_arm_N')),
    Command('~/motor_torque', 'std_msgs/msg/Float64', _torque, [TORQUE], ('torque_N_m',)),
]
