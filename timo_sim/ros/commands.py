"""The commands: held from the first whole step after receipt until the next one."""

import math
from typing import Any, Callable, NamedTuple

from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Float64

from timo_sim.log.recorder import Channel
from timo_sim.physics.formulation import FORCE_I, FORCE_II, FORCE_X, FORCE_Y, TORQUE
from timo_sim.ros.topics import type_name


QUEUE = 10  # commands that may wait on a topic


class _Refused(ValueError):
    """A command that is not applied; the text says why."""


def _decode(data, message_type):
    try:
        return deserialize_message(data, message_type)
    except RuntimeError:  # what rclpy raises
        raise _Refused(f'it is not a serialised {type_name(message_type)}') from None


def _read_wrench(message):
    force, torque, frame = message.wrench.force, message.wrench.torque, message.header.frame_id
    if not all(map(math.isfinite, (force.x, force.y, force.z, torque.x, torque.y, torque.z))):
        raise _Refused('every component must be finite')
    columns = {'': (FORCE_X, FORCE_Y), 'world': (FORCE_X, FORCE_Y), 'arm': (FORCE_I, FORCE_II)}
    if frame not in columns:
        raise _Refused(f"frame_id must be empty, 'world' or 'arm', got {frame[:40]!r}")
    return dict(zip(columns[frame], (force.x, force.y)))


def _read_torque(message):
    if not math.isfinite(message.data):
        raise _Refused(f'data must be finite, got {message.data}')
    return {TORQUE: message.data}


class Command(NamedTuple):
    """A command topic, what reads its messages, and the columns of the load that it sets."""

    name: str
    message_type: type
    read: Callable[[Any], dict]
    columns: list


COMMANDS = [
    Command('~/carrier_wrench', WrenchStamped, _read_wrench,
            [FORCE_X, FORCE_Y, FORCE_I, FORCE_II]),
    Command('~/motor_torque', Float64, _read_torque, [TORQUE]),
]


class Inlet:
    """
    The subscription to a command topic, read under the node's lock by whoever does steps.

    No executor serves it: its queue of messages would have no end, that of the middleware has.

    Attributes
    ----------
    channel : Channel
        Of the log.
    refused, stale : int
        Commands not applied; commands that fell to zero.

    """

    def __init__(self, node, command):
        self._command = command
        # A logger of its own: warnings are throttled for each.
        self._logger = node.get_logger().get_child(command.name.removeprefix('~/'))
        self._subscription = node.create_subscription(
            command.message_type, command.name, self._receive, QUEUE, raw=True)
        self.channel = Channel(self._subscription.topic_name, type_name(command.message_type))
        self._pending = None
        self._since = None  # step from which the command in force has acted
        self.refused = 0
        self.stale = 0

    def _receive(self, data):
        try:
            values = self._command.read(_decode(data, self._command.message_type))
        except _Refused as reason:
            self.refused += 1
            self._logger.warning(
                f'command refused, {reason}; the last one stays in force',
                throttle_duration_sec=5.0)
            return
        self._pending = values, data

    def poll(self):
        """Receive what has arrived."""
        handle = self._subscription.handle
        with handle:
            # No more than waited at first: a fast publisher would keep this up for ever.
            for _ in range(QUEUE):
                taken = handle.take_message(self._command.message_type, True)
                if taken is None:
                    break
                self._receive(taken[0])

    def apply(self, step, timeout_steps, held):
        """
        Let what was received act from this step on, or what is too old end.

        Parameters
        ----------
        step : int
        timeout_steps : int
            Steps after which a command falls to zero; 0: never.
        held : ndarray, shape (5,)
            The load in force, updated in place.

        Returns
        -------
        bytes or None
            The command that starts to act, CDR.

        """
        pending, self._pending = self._pending, None
        if pending is not None:
            values, data = pending
            held[self._command.columns] = 0.0
            for column, value in values.items():
                held[column] = value
            self._since = step
            return data
        end = self.end(timeout_steps)
        if end is None or step < end:
            return None
        self.stale += 1
        self._logger.warning(
            f'no command for {timeout_steps} steps, the input falls to zero',
            throttle_duration_sec=5.0)
        self.clear(held)
        return serialize_message(self._command.message_type())

    def end(self, timeout_steps):
        """Return the step at which the command in force falls to zero, or None."""
        return self._since + timeout_steps if timeout_steps and self._since is not None else None

    def clear(self, held):
        """Drop what is in force and what waits."""
        held[self._command.columns] = 0.0
        self._since = self._pending = None
