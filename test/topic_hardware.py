# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A stand-in of ros2_control_node with JointStateTopicSystem as its hardware."""

import math

from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

JOINTS = ['carrier_x', 'carrier_y', 'shaft']


class ControllerManager:
    """
    Does what ros2_control_node does on sim time, with JointStateTopicSystem as its hardware.

    Cycle, order, messages and QoS are those of ros2_control_node.cpp of ros2_control (jazzy) and
    of joint_state_topic_hardware_interface.cpp (topic_based_hardware_interfaces): after the clock
    has started it sleeps for a period, then reads, updates and writes at each. One controller has
    claimed the shaft's effort: joints that nobody has claimed are NaN.
    """

    def __init__(self, client, period, law, threshold=-1.0, states='/joint_states'):
        self._client, self._law, self._threshold = client, law, threshold
        self._period, self._until = round(1e9 * period), None
        self._latest, self._states = JointState(), dict.fromkeys(JOINTS, (0.0, 0.0, 0.0))
        self.publisher = client.create_publisher(JointState, '/timo_sim/joint_command', 1)
        self._subscriptions = [client.create_subscription(kind, topic, take, qos) for (
            kind, topic, take, qos) in (
                (JointState, states, self._take, qos_profile_sensor_data),
                (Clock, '/clock', self._wake, qos_profile_sensor_data))]

    def _take(self, message):
        self._latest = message

    def _wake(self, message):
        now = 10**9 * message.clock.sec + message.clock.nanosec
        if self._until is None and now > 0:
            self._until = now + self._period
        elif self._until is not None and now >= self._until:
            self._until = now + self._period
            self._read()
            self._write(message.clock, [math.nan, math.nan, self._law(*self._states['shaft'][:2])])

    def _read(self):
        message = self._latest
        for name, *found in zip(message.name, message.position, message.velocity, message.effort):
            self._states[name] = [new if math.isfinite(new) else old
                                  for new, old in zip(found, self._states[name])]

    def _write(self, stamp, commands):
        if sum(abs(self._states[name][2] - command) for name, command in zip(
                JOINTS, commands)) <= self._threshold:
            return
        message = JointState(name=JOINTS, effort=commands)
        message.header.stamp = stamp
        self.publisher.publish(message)

    def close(self):
        """Leave."""
        for subscription in self._subscriptions:
            self._client.destroy_subscription(subscription)
        self._client.destroy_publisher(self.publisher)
