"""The topics that carry the motion; a further one is two functions and a line in TOPICS."""

from functools import cached_property
import math
from typing import Any, Callable, NamedTuple

from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    Point, Pose, PoseStamped, Quaternion, Vector3, Vector3Stamped)
import numpy as np
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from timo_sim.log.recorder import Channel
from timo_sim.physics.formulation import FORCE_I, FORCE_II, FORCE_X, FORCE_Y, TORQUE

NANOSECONDS = 1000000000


class Snapshot:
    """
    The motion at one step, and what messages need of it, computed when asked for.

    Parameters
    ----------
    simulator : Simulator
    load : list of float, length 8
        What acted at the end of the last step, columns as in `physics.formulation`.

    Attributes
    ----------
    step : int
    nanoseconds : int
        Sim time [ns].
    time : tuple of int
        The same in [s] and [ns].

    """

    def __init__(self, simulator, load):
        self._formulation, self._load = simulator.formulation, load
        self.step = simulator.steps
        self.nanoseconds = simulator.nanoseconds
        self.time = divmod(self.nanoseconds, NANOSECONDS)
        self.motion = simulator.motion()
        self._values = self.motion.tolist()

    @property
    def joint_positions(self):
        """Carrier x, y [m] and shaft angle [rad]."""
        return self._values[:3]

    @property
    def joint_velocities(self):
        """Carrier x, y [m/s] and shaft speed [rad/s]."""
        half = len(self._values) // 2
        return self._values[half:half + 3]

    @property
    def effort(self):
        """Forces on the carrier in world axes [N] and torque on the shaft [N m]."""
        load, theta = self._load, self._values[2]
        cosine, sine = math.cos(theta), math.sin(theta)
        return (load[FORCE_X] + cosine * load[FORCE_I] - sine * load[FORCE_II],
                load[FORCE_Y] + sine * load[FORCE_I] + cosine * load[FORCE_II], load[TORQUE])

    @cached_property
    def tip(self):
        """Where the tip is in the arm frame [m], and its rotation relative to the shaft [rad]."""
        return self._formulation.tip(self.motion).tolist()

    @cached_property
    def energy(self):
        """Kinetic plus strain energy [J]."""
        return float(self._formulation.energy(self.motion[np.newaxis])[0])

    @property
    def length(self):
        """Length of the arm [m]."""
        return self._formulation.manipulator.arm.length


def _joint_state(time, *numbers):
    return JointState(
        header=Header(stamp=time), name=['carrier_x', 'carrier_y', 'shaft'],
        position=numbers[:3], velocity=numbers[3:6], effort=numbers[6:])


def _joints(snapshot):
    return *snapshot.joint_positions, *snapshot.joint_velocities, *snapshot.effort


def _vector_in_arm(time, x, y):
    return Vector3Stamped(header=Header(stamp=time, frame_id='arm'), vector=Vector3(x=x, y=y))


def _tip_deflection(snapshot):
    along, across, _ = snapshot.tip
    return along - snapshot.length, across


def _pose_in_world(time, x, y, z, w):
    return PoseStamped(
        header=Header(stamp=time, frame_id='world'),
        pose=Pose(position=Point(x=x, y=y), orientation=Quaternion(z=z, w=w)))


def _tip_pose(snapshot):
    x, y, theta = snapshot.joint_positions
    along, across, rotation = snapshot.tip
    cosine, sine = math.cos(theta), math.sin(theta)
    half = 0.5 * (theta + rotation)
    return (x + cosine * along - sine * across, y + sine * along + cosine * across,
            math.sin(half), math.cos(half))


def _carrier_pose(snapshot):
    return *snapshot.joint_positions[:2], 0.0, 1.0


class Topic(NamedTuple):
    """
    A topic.

    `message` builds a message from its time and numbers, `numbers` reads these off a snapshot,
    `size` is how many there are; `rate` names the parameter with the topic's rate.
    """

    name: str
    message_type: type
    message: Callable[..., Any]
    numbers: Callable[[Snapshot], tuple]
    size: int
    rate: str


TOPICS = [
    Topic('joint_states', JointState, _joint_state, _joints, 9, 'rate.joint_states'),
    Topic('~/tip_deflection', Vector3Stamped, _vector_in_arm, _tip_deflection, 2,
          'rate.tip_deflection'),
    Topic('~/tip_pose', PoseStamped, _pose_in_world, _tip_pose, 4, 'rate.tip_pose'),
    Topic('~/carrier_pose', PoseStamped, _pose_in_world, _carrier_pose, 4, 'rate.carrier_pose'),
    Topic('/clock', Clock, lambda time: Clock(clock=time), lambda snapshot: (), 0, 'rate.clock'),
]


class Serializer:
    """
    Writes the numbers of a message straight into its serialised form.

    Everything but time and numbers is the same in all messages of a topic. Where these are in the
    CDR is found once, from a message with marks in their places.

    Parameters
    ----------
    message : function(Time, *float) -> message
        Its first field must be the time, or a header.
    size : int
        Numbers that it takes.

    """

    def __init__(self, message, size):
        sec, nanosec, *numbers = marks = [1234567, 7654321] + [1.1 + n for n in range(size)]
        self._data = bytearray(serialize_message(
            message(Time(sec=sec, nanosec=nanosec), *numbers)))
        # After four bytes CDR aligns every number to its size.
        body = memoryview(self._data)[4:]
        self._time = body[:8].cast('I')
        self._numbers = body[:len(body) // 8 * 8].cast('d')
        found = self._numbers.tolist()
        self._places = [found.index(number) for number in numbers]
        if self._time.tolist() != marks[:2]:
            raise ValueError(f'{message} does not begin with the time')

    def __call__(self, time, numbers):
        """Return the message with this time ([s], [ns]) and these numbers, CDR."""
        self._time[0], self._time[1] = time
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
    channel : Channel
        Of the log.
    recorder : Recorder or None
    index : int
        Of the channel in the log.

    """

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
        return self._subscribed or self.recorder is not None and self.recorder.error is None

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

    """

    def __init__(self, node, topic):
        super().__init__(node, topic.name, topic.message_type)
        self._serialize = Serializer(topic.message, topic.size)
        self._numbers, self.rate = topic.numbers, topic.rate
        self.every = 1

    def publish(self, snapshot):
        """Send what a snapshot holds."""
        data = self._serialize(snapshot.time, self._numbers(snapshot))
        self.send(data, snapshot.step, snapshot.nanoseconds)
