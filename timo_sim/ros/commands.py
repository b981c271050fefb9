# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Subscriptions to commands; each acts from the first whole step after receipt until the next."""

from rclpy.serialization import deserialize_message, serialize_message

from timo_sim.messages.commands import COMMANDS, INPUTS, JOINTS, LARGEST, Refused
from timo_sim.messages.outputs import NANOSECONDS
from timo_sim.ros.topics import channel_of, message_class

QUEUE = 10  # commands that may wait on a topic, by default


def _wrench(message):
    force, torque = message.wrench.force, message.wrench.torque
    return [message.header.frame_id], [
        (force.x, force.y, force.z, torque.x, torque.y, torque.z)]


def _joints(message):
    return [message.header.frame_id, *message.name], [
        message.position, message.velocity, message.effort]


# By type of a command: the function that returns texts and lists of numbers of a message.
# `messages.cdr` could do this, too, but would need 20 ms for a hostile message of 64 kB.
_READ = {
    'geometry_msgs/msg/WrenchStamped': _wrench,
    'std_msgs/msg/Float64': lambda message: ([], [(message.data,)]),
    'sensor_msgs/msg/JointState': _joints,
    'std_msgs/msg/Float64MultiArray': lambda message: ([], [message.data]),
}
_WRENCH = 'force.x', 'force.y', 'force.z', 'torque.x', 'torque.y', 'torque.z'
# By command: the parts of its wrench that have no effect.
_WITHOUT_EFFECT = {'~/carrier_wrench': (2, 3, 4, 5), '~/tip_wrench': (2, 3, 4)}


class Inlet:
    """
    The subscription to a command topic; the loop polls it under the node's lock.

    No executor serves it: the EventsExecutor's queue is unbounded, the middleware's is not.

    Attributes
    ----------
    pending : tuple or None
        The command that will act next: its row and its message, serialised.
    refused, mismatched : int
        Number of commands refused, and of those dropped because they answer another state.
    foreign : int
        Number of names in commands that are no joints here, such as those of other robots.

    """

    def __init__(self, node, command, frames):
        self.command, self._frames = command, frames
        self.type = message_class(command.type_name)
        # A logger for each topic, so that the warnings of each are throttled separately.
        self.logger = node.get_logger().get_child(command.name.removeprefix('~/'))
        self._subscription = node.create_subscription(
            self.type, command.name, lambda data: None, QUEUE, raw=True)
        self.publishers = self._subscription.get_publisher_count
        self.channel = channel_of(self._subscription, command.type_name, command.name)
        self.pending = None
        self.refused = self.mismatched = self.foreign = 0

    def _receive(self, data, answered):
        """Make a message pending, unless it is refused; return whether it is now."""
        try:
            message = self._decoded(data)
            texts, lists = _READ[self.command.type_name](message)
            row = self.command.row(texts, lists, self._frames)
        except Refused as reason:
            self.refused += 1
            self.logger.warning(
                f'command refused, {reason}; the last one stays in force',
                throttle_duration_sec=5.0)
            return False
        time = message.header.stamp if hasattr(message, 'header') else None
        stamp = time and NANOSECONDS * time.sec + time.nanosec
        if stamp and answered is not None and stamp != answered:
            self.mismatched += 1
            self.logger.warning(
                f'command dropped, its stamp is {stamp} ns, that of the state {answered} ns; '
                'controllers that do not copy it, as ros2_control, need sync: any_command',
                once=True)
            return False
        self.foreign += sum(name not in JOINTS for name in texts[1:])
        ignored = [_WRENCH[place] for place in _WITHOUT_EFFECT.get(self.command.name, ())
                   if lists[0][place]]
        if ignored:
            self.logger.warning(f'no effect of {", ".join(ignored)}: the arm moves in a plane, '
                                'the carrier without turning', once=True)
        self.pending = row, data
        return True

    def _decoded(self, data):
        if len(data) > LARGEST:
            raise Refused(f'it has {len(data)} bytes, more than {LARGEST}')
        try:
            return deserialize_message(data, self.type)
        except RuntimeError:  # rclpy's error for bytes that are no such message
            raise Refused(f'it is not a serialised {self.command.type_name}') from None

    def poll(self, answered):
        """Receive what has arrived, see `Commands.poll`; return whether a command is in it."""
        handle, received = self._subscription.handle, False
        with handle:
            # At most a full queue: a fast publisher could keep an endless loop busy for ever.
            for _ in range(self._subscription.qos_profile.depth):
                taken = handle.take_message(self.type, True)
                if taken is None:
                    break
                received |= self._receive(taken[0], answered)
        return received


class Commands:
    """
    All command topics of a node, and which of them each input follows.

    `voltage` says whether there is a motor that takes one, `frames` names each frame.

    Attributes
    ----------
    channels : list of Channel
        Of the log, in the order of COMMANDS.
    stale : int
        How often an input fell to zero because its command was too old.
    received : bool
        Whether a command has come since the last call of `apply`, or since this was set to False.

    """

    def __init__(self, node, voltage, frames):
        self._inlets = [Inlet(node, command, frames) for command in COMMANDS
                        if voltage or command.name != '~/motor_voltage']
        self.channels = [inlet.channel for inlet in self._inlets]
        self.stale, self.received = 0, False
        # Of each input that follows a command: the command's inlet, and the step when it began.
        self._followed = {}

    @property
    def refused(self):
        """Number of commands refused."""
        return sum(inlet.refused for inlet in self._inlets)

    @property
    def mismatched(self):
        """Number of commands dropped in lock step, because they answer another state."""
        return sum(inlet.mismatched for inlet in self._inlets)

    @property
    def foreign(self):
        """Number of names in commands that are no joints here."""
        return sum(inlet.foreign for inlet in self._inlets)

    def expected(self):
        """Return whether anybody publishes commands."""
        return any(inlet.publishers() for inlet in self._inlets)

    def poll(self, answered):
        """
        Receive what has arrived.

        In lock step `answered` is the stamp of the state that commands answer [ns], else None. A
        command with another stamp is dropped at once, so that it replaces no pending one.
        """
        for inlet in self._inlets:
            self.received |= inlet.poll(answered)

    def apply(self, step, timeout_steps, commanded):
        """
        Let pending commands act from this step on, and set inputs to zero that have timed out.

        `commanded`, shape (16,), is updated in place; with `timeout_steps` 0 nothing times out.
        Return the index in COMMANDS and the serialised message of each command that begins to
        act; a time-out counts as a message of zeros.
        """
        started, self.received = [], False
        for index, inlet in enumerate(self._inlets):
            if inlet.pending is not None:
                row, data = inlet.pending
                inlet.pending = None
                for key in inlet.command.apply(row, commanded):
                    self._followed[key] = inlet, step
                started.append((index, data))
        if timeout_steps:
            for key, (inlet, since) in list(self._followed.items()):
                if step >= since + timeout_steps:
                    del self._followed[key]
                    self.stale += 1
                    inlet.logger.warning(
                        f'no command for {timeout_steps} steps, the {key} input falls to zero',
                        throttle_duration_sec=5.0)
                    commanded[list(INPUTS[key])] = 0.0
                    index = list(INPUTS).index(key)  # see the order of COMMANDS
                    started.append((index, serialize_message(self._inlets[index].type())))
        return started

    def end(self, timeout_steps):
        """Return the list of steps at which inputs will time out."""
        return [since + timeout_steps for _, since in self._followed.values()
                ] if timeout_steps else []

    def clear(self, commanded):
        """Set all commanded values, (16,), to zero and drop pending commands."""
        commanded[:] = 0.0
        self._followed, self.received = {}, False
        for inlet in self._inlets:
            inlet.pending = None
