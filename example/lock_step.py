# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Lock step with the node: a controller answers each state by a command with the same stamp."""

from geometry_msgs.msg import Vector3Stamped
from loop import Seen
import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState

TOPICS = (  # in the order of Seen: type, name, function that reads a message
    (JointState, '/timo_sim/encoder', lambda message: message.position[0]),
    (JointState, '/timo_sim/root_strain', lambda message: message.position[0]),
    (JointState, '/joint_states',
     lambda message: (*message.position, *message.velocity, *message.effort)),
    (Vector3Stamped, '/timo_sim/tip_deflection',
     lambda message: (message.vector.x, message.vector.y)))
QUIET = 2.0  # [s] of wall time without a state: the node has ended


class LockStep(Node):
    """
    Answers a state when all topics with its stamp have arrived; sensors must have no delay.

    Attributes
    ----------
    rows : list
        The record, see `loop.Seen.row`.

    """

    def __init__(self, controller):
        super().__init__('controller')
        self.controller, self.rows, self.looked = controller, [], 0
        self.stamp, self.answered, self.parts = -1, -1, {}
        self.publisher = self.create_publisher(JointState, '/timo_sim/joint_command', 10)
        for place, (kind, name, _) in enumerate(TOPICS):
            self.create_subscription(
                kind, name, lambda message, place=place: self.arrive(place, message), 10)
        self.clock = self.create_timer(QUIET, self.look)
        self.get_logger().info('waiting for a node that shows its states on /joint_states')

    def arrive(self, place, message):
        """Keep a message; answer if it is the last one of its stamp."""
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        # The node repeats the first state until it is answered.
        if stamp < self.stamp or stamp == self.answered:
            return
        if stamp > self.stamp:
            self.stamp, self.parts = stamp, {}
        self.parts[place] = TOPICS[place][2](message)
        if len(self.parts) < len(TOPICS) or not self.publisher.get_subscription_count():
            return
        seen = Seen(*(self.parts[place] for place in range(len(TOPICS))))
        t = stamp // 1000 / 1e6  # the stamp of the first state is 1 ns after its time
        self.rows.append(seen.row(t))
        efforts = self.controller.effort(t, seen)
        command = JointState(name=list(efforts), effort=list(efforts.values()))
        command.header.stamp = message.header.stamp
        self.publisher.publish(command)
        self.answered = stamp

    def look(self):
        """End if no state has come since the last call: the node has ended."""
        if self.rows and len(self.rows) == self.looked:
            raise ExternalShutdownException
        self.looked = len(self.rows)


def with_the_node(controller):
    """Control until the node ends; return the record, shape (n, 12), see `loop.Seen.row`."""
    rclpy.init()
    node = LockStep(controller)
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        return np.array(node.rows)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
