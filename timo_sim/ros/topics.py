"""The topics that carry the simulated motion; a further one is a function and a line in TOPICS."""

from array import array
from functools import cached_property
import math
from typing import Any, Callable, NamedTuple

from geometry_msgs.msg import PoseStamped, Vector3Stamped
import numpy as np
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from timo_sim.log.recorder import Channel

NANOSECONDS = 1000000000


class Snapshot:
    """
    The motion at one step, and what messages need of it, computed when asked for.

    Parameters
    ----------
    simulator : Simulator
    tip : Points
        The tip of the arm, see `Formulation.at`.
    effort : ndarray, shape (3,)
        Forces on the carrier in world axes [N] and torque on the shaft [N m].

    """

    def __init__(self, simulator, tip, effort):
        self._formulation, self._tip, self.effort = simulator.formulation, tip, effort
        self.step = simulator.steps
        self.nanoseconds = simulator.nanoseconds
        self.motion = simulator.motion()

    @cached_property
    def _q(self):
        return self.motion[np.newaxis, 3:len(self.motion) // 2]

    @cached_property
    def joint_positions(self):
        """Carrier x, y [m] and shaft angle [rad]."""
        return array('d', self.motion[:3])

    @cached_property
    def joint_velocities(self):
        """Carrier x, y [m/s] and shaft speed [rad/s]."""
        half = len(self.motion) // 2
        return array('d', self.motion[half:half + 3])

    @cached_property
    def tip_in_arm(self):
        """Where the tip is in the arm frame [m]."""
        return self._formulation.centre_line(self._q, self._tip)[0, 0].tolist()

    @cached_property
    def tip_rotation(self):
        """Rotation of the tip section relative to the shaft [rad]."""
        return float(self._formulation.section_rotation(self._q, self._tip)[0, 0])

    @cached_property
    def energy(self):
        """Kinetic plus strain energy [J]."""
        return float(self._formulation.energy(self.motion[np.newaxis])[0])

    @property
    def length(self):
        """Length of the arm [m]."""
        return float(self._tip.xi[0])

    def stamp(self, time):
        """Write sim time into a builtin_interfaces/Time."""
        time.sec, time.nanosec = divmod(self.nanoseconds, NANOSECONDS)


def _joint_states(snapshot, message):
    snapshot.stamp(message.header.stamp)
    message.name = ['carrier_x', 'carrier_y', 'shaft']
    message.position = snapshot.joint_positions
    message.velocity = snapshot.joint_velocities
    message.effort = array('d', snapshot.effort)


def _tip_deflection(snapshot, message):
    snapshot.stamp(message.header.stamp)
    message.header.frame_id = 'arm'
    along, across = snapshot.tip_in_arm
    message.vector.x = along - snapshot.length
    message.vector.y = across


def _tip_pose(snapshot, message):
    snapshot.stamp(message.header.stamp)
    message.header.frame_id = 'world'
    x, y, theta = snapshot.joint_positions
    along, across = snapshot.tip_in_arm
    cosine, sine = math.cos(theta), math.sin(theta)
    message.pose.position.x = x + cosine * along - sine * across
    message.pose.position.y = y + sine * along + cosine * across
    half = 0.5 * (theta + snapshot.tip_rotation)
    message.pose.orientation.z = math.sin(half)
    message.pose.orientation.w = math.cos(half)


def _carrier_pose(snapshot, message):
    snapshot.stamp(message.header.stamp)
    message.header.frame_id = 'world'
    message.pose.position.x, message.pose.position.y = snapshot.joint_positions[:2]
    message.pose.orientation.w = 1.0


def _clock(snapshot, message):
    snapshot.stamp(message.clock)


class Topic(NamedTuple):
    """A topic, what fills its messages from a snapshot, and the parameter with its rate."""

    name: str
    message_type: type
    fill: Callable[[Snapshot, Any], None]
    rate: str


TOPICS = [
    Topic('joint_states', JointState, _joint_states, 'rate.joint_states'),
    Topic('~/tip_deflection', Vector3Stamped, _tip_deflection, 'rate.tip_deflection'),
    Topic('~/tip_pose', PoseStamped, _tip_pose, 'rate.tip_pose'),
    Topic('~/carrier_pose', PoseStamped, _carrier_pose, 'rate.carrier_pose'),
    Topic('/clock', Clock, _clock, 'rate.clock'),
]


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
        self._publisher = node.create_publisher(message_type, topic, 10)
        self.channel = Channel(self._publisher.topic_name, type_name(message_type))
        self.recorder, self.index = None, None

    @property
    def wanted(self):
        """Whether a message would reach anybody."""
        recording = self.recorder is not None and self.recorder.error is None
        return recording or self._publisher.get_subscription_count() > 0

    def send(self, message, step, nanoseconds):
        """Serialise a message once, for subscribers and for the log."""
        data = serialize_message(message)
        if self._publisher.get_subscription_count() > 0:
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
        self._message_type, self._fill, self.rate = topic.message_type, topic.fill, topic.rate
        self.every = 1

    def publish(self, snapshot):
        """Send what a snapshot holds."""
        message = self._message_type()
        self._fill(snapshot, message)
        self.send(message, snapshot.step, snapshot.nanoseconds)
