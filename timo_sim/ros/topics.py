"""The topics that carry the motion, as messages; a further one is an Output and a line here."""

import math

from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    Point, Pose, PoseStamped, Quaternion, Vector3, Vector3Stamped)
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Header

from timo_sim.log.cdr import layout
from timo_sim.log.recorder import Channel

_GRAVITY = 9.80665  # [m/s2]


def _joint_state(time, *numbers):
    return JointState(
        header=Header(stamp=time), name=['carrier_x', 'carrier_y', 'shaft'],
        position=numbers[:3], velocity=numbers[3:6], effort=numbers[6:])


def _modal_state(time, *numbers):
    half = len(numbers) // 2
    return JointState(
        header=Header(stamp=time), name=[f'mode_{n + 1}' for n in range(half)],
        position=numbers[:half], velocity=numbers[half:])


def _vector_in_arm(time, x, y):
    return Vector3Stamped(header=Header(stamp=time, frame_id='arm'), vector=Vector3(x=x, y=y))


def _pose_in_world(time, x, y, z, w):
    return PoseStamped(
        header=Header(stamp=time, frame_id='world'),
        pose=Pose(position=Point(x=x, y=y), orientation=Quaternion(z=z, w=w)))


def _one_joint(name):
    return lambda time, position: JointState(
        header=Header(stamp=time), name=[name], position=[position])


def _imu_at_tip(time, x, y, turning):
    return Imu(
        header=Header(stamp=time, frame_id='tip'),
        orientation_covariance=[-1.0] + 8 * [0.0],  # REP-145: there is no orientation
        angular_velocity=Vector3(z=turning),
        # The plane of motion is horizontal, and a sensor at rest shows what holds it up.
        linear_acceleration=Vector3(x=x, y=y, z=_GRAVITY))


def _clock(time):
    return Clock(clock=time)


# Type of the messages of an output, and what builds one from its time and numbers.
MESSAGES = {
    'joint_states': (JointState, _joint_state),
    '~/modal_state': (JointState, _modal_state),
    '~/tip_deflection': (Vector3Stamped, _vector_in_arm),
    '~/tip_pose': (PoseStamped, _pose_in_world),
    '~/carrier_pose': (PoseStamped, _pose_in_world),
    '~/root_strain': (JointState, _one_joint('root_strain')),
    '~/tip_imu': (Imu, _imu_at_tip),
    '~/encoder': (JointState, _one_joint('shaft')),
    '/clock': (Clock, _clock),
}


class Serializer:
    """
    Writes the numbers of a message straight into its serialised form.

    Everything but time and numbers is the same in all messages of a topic. Where these are in the
    CDR is found once, from a message with marks in their places.

    Parameters
    ----------
    message : function(Time, *float) -> message
        It must hold the time; all its times are the same.
    size : int
        Numbers that it takes.

    """

    def __init__(self, message, size):
        numbers = [1.1 + n for n in range(size)]
        first = message(Time(), *numbers)
        data = serialize_message(first)
        found = layout(type_name(type(first)), data)
        # Without what rclpy puts between fields and at the end: whatever was in memory there.
        self._data = bytearray(found.size)
        for place in found.meant():
            self._data[place] = data[place]
        # After four bytes CDR aligns every number to its size.
        body = memoryview(self._data)[4:]
        self._words = body[:len(body) // 4 * 4].cast('I')
        self._times = [(place - 4) // 4 for place in found.stamps]
        self._numbers = body[:len(body) // 8 * 8].cast('d')
        inside = self._numbers.tolist()
        self._places = [inside.index(number) for number in numbers]
        if not self._times:
            raise ValueError(f'{message} has no time')

    def __call__(self, time, numbers):
        """Return the message with this time ([s], [ns]) and these numbers, CDR."""
        for place in self._times:
            self._words[place], self._words[place + 1] = time
        view = self._numbers
        for place, number in zip(self._places, numbers):
            view[place] = number
        return bytes(self._data)


def type_name(message_type):
    """Return the name of a message class, as in 'sensor_msgs/msg/JointState'."""
    return f'{message_type.__module__.split(".")[0]}/msg/{message_type.__name__}'


class Outlet:
    """
    A publisher that also hands its messages to the log, and knows whether anybody wants them.

    Attributes
    ----------
    logged : bool
        Whether its messages are for the log, too.
    asks : bool
        Whether the log wants messages that nobody else receives.
    channel : Channel
        Of the log.
    recorder : Recorder or None
    index : int
        Of the channel in the log.

    """

    logged = asks = True

    def __init__(self, node, topic, message_type):
        self._subscribed = False
        self._publisher = node.create_publisher(
            message_type, topic, 10,
            event_callbacks=PublisherEventCallbacks(matched=lambda event: self.look()))
        self.channel = Channel(self._publisher.topic_name, type_name(message_type))
        self.recorder, self.index = None, None

    def look(self):
        """Find out whether anybody subscribes; the executor does so on every change."""
        self._subscribed = self._publisher.get_subscription_count() > 0

    @property
    def wanted(self):
        """Whether a message would reach anybody."""
        return self._subscribed or (
            self.asks and self.recorder is not None and self.recorder.error is None)

    def send(self, data, step, nanoseconds):
        """Hand a message, CDR, to subscribers and to the log."""
        if self._subscribed:
            self._publisher.publish(data)
        if self.recorder is not None:
            self.recorder.write(self.index, step, nanoseconds, data)


class MotionOutlet(Outlet):
    """
    The outlet of a topic that carries the simulated motion.

    Attributes
    ----------
    every : int
        Steps between messages.
    watch : function(tuple, int) or None
        Sees numbers and time [ns] of what is sent.

    """

    def __init__(self, node, output, message_type, message):
        super().__init__(node, output.name, message_type)
        self._serialize = Serializer(message, len(output.columns))
        self._numbers, self.rate = output.numbers, output.rate
        self.name, self.every, self.watch = output.name, 1, None

    def publish(self, snapshot):
        """Send what a snapshot holds."""
        numbers = self._numbers(snapshot)
        self.send(self._serialize(snapshot.time, numbers), snapshot.step, snapshot.nanoseconds)
        if self.watch is not None:
            self.watch(numbers, snapshot.nanoseconds)


class LateOutlet(MotionOutlet):
    """
    The outlet of a sensor whose messages come some time after the measurement.

    Their header and their step in the log are those of the measurement.

    Parameters
    ----------
    delay : int
        Steps.

    """

    def __init__(self, node, output, message_type, message, delay):
        super().__init__(node, output, message_type, message)
        self._delay, self._under_way = delay, {}

    def publish(self, snapshot):
        """Measure; a second look at the same step takes the place of the first."""
        self._under_way[snapshot.step] = self._serialize(snapshot.time, self._numbers(snapshot))

    @property
    def arrival(self):
        """The step at which the next message comes, or infinity."""
        return next(iter(self._under_way), math.inf) + self._delay

    def deliver(self, step, nanoseconds):
        """Send what arrives until a step, at this sim time [ns]."""
        while self.arrival <= step:
            measured = next(iter(self._under_way))
            self.send(self._under_way.pop(measured), measured, nanoseconds)

    def drop(self):
        """Lose what is under way."""
        self._under_way.clear()
