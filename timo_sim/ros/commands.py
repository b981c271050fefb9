"""The subscriptions to commands: held from the first whole step after receipt until the next."""

from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Float64

from timo_sim.commands import Refused
from timo_sim.log.recorder import Channel

QUEUE = 10  # commands that may wait on a topic


def _wrench(message):
    force, torque = message.wrench.force, message.wrench.torque
    return message.header.frame_id, (force.x, force.y, force.z, torque.x, torque.y, torque.z)


# Type of the messages of a command, and what returns frame and numbers of one.
_MESSAGES = {
    '~/carrier_wrench': (WrenchStamped, _wrench),
    '~/motor_torque': (Float64, lambda message: ('', (message.data,))),
}


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
        self._type, self._read = _MESSAGES[command.name]
        # A logger of its own: warnings are throttled for each.
        self._logger = node.get_logger().get_child(command.name.removeprefix('~/'))
        self._subscription = node.create_subscription(
            self._type, command.name, self._receive, QUEUE, raw=True)
        self.channel = Channel(self._subscription.topic_name, command.type_name)
        self._pending = None
        self._since = None  # step from which the command in force has acted
        self.refused = 0
        self.stale = 0

    def _receive(self, data):
        try:
            values = self._command.load(*self._read(self._decoded(data)))
        except Refused as reason:
            self.refused += 1
            self._logger.warning(
                f'command refused, {reason}; the last one stays in force',
                throttle_duration_sec=5.0)
            return
        self._pending = values, data

    def _decoded(self, data):
        try:
            return deserialize_message(data, self._type)
        except RuntimeError:  # what rclpy raises
            raise Refused(f'it is not a serialised {self._command.type_name}') from None

    def poll(self):
        """Receive what has arrived."""
        handle = self._subscription.handle
        with handle:
            # No more than waited at first: a fast publisher would keep this up for ever.
            for _ in range(QUEUE):
                taken = handle.take_message(self._type, True)
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
            held[self._command.columns] = values
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
        return serialize_message(self._type())

    def end(self, timeout_steps):
        """Return the step at which the command in force falls to zero, or None."""
        return self._since + timeout_steps if timeout_steps and self._since is not None else None

    def clear(self, held):
        """Drop what is in force and what waits."""
        held[self._command.columns] = 0.0
        self._since = self._pending = None
