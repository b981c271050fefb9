# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
A ROS 2 node that estimates how an arm is bent from its encoder, strain gauge and motor torque.

Topics have the names of `sim_node`; a real arm has others, and other sensors. Messages that have
one stamp are used together; the deflection of the tip and its standard deviations follow, with
the same stamp.
"""

import argparse
import signal
from threading import Event

from geometry_msgs.msg import Vector3, Vector3Stamped
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

import timo_sim

SENSORS = {'encoder': '/timo_sim/encoder', 'root_strain': '/timo_sim/root_strain'}
STATES = '/joint_states'  # whose effort of the joint `shaft` is the torque until their stamp
LONGEST_GAP = 1.0  # [s] between stamps, forward or back, beyond which an estimate begins again
LARGEST_CONSISTENCY = 5.0  # beyond which it does so, too: the model is wrong, or the arm was moved
MOST_WAITING = 1000  # stamps of which not all topics have come


class Observe(Node):
    """Joins the messages of each stamp, and estimates; without an `observer` a new one begins."""

    def __init__(self, scene):
        super().__init__('observer')
        # The effort includes loads on the shaft, which would count twice.
        self.scene = scene.vary({name: [] for name in scene.values
                                 if name.startswith('load.torque.')})
        self.observer, self.step = None, 0
        self.waiting = {}  # by time step, the messages with that stamp by topic
        first = timo_sim.observer(self.scene, [*SENSORS])  # compiles
        first.update({name: first.expected(name) for name in SENSORS}, dt=scene.step)
        self.tip = self.create_publisher(Vector3Stamped, '~/tip_deflection', 10)
        self.deviation = self.create_publisher(Vector3Stamped, '~/tip_deviation', 10)
        self.topics = {STATES, *SENSORS.values()}
        for topic in self.topics:
            self.create_subscription(JointState, topic, lambda message, topic=topic: self.join(
                topic, message), 1000)
        self.get_logger().info(f'observing {", ".join(SENSORS)}')

    def join(self, topic, message):
        """Keep a message until those of all topics with its stamp have come, then use them."""
        stamp = message.header.stamp
        step = round((stamp.sec + 1e-9 * stamp.nanosec) / self.scene.step)
        together = self.waiting.setdefault(step, {})
        together[topic] = message
        if together.keys() == self.topics:
            # What began to wait before lacks a message that will not come any more.
            while next(iter(self.waiting)) != step:
                del self.waiting[next(iter(self.waiting))]
            self.estimate(step, self.waiting.pop(step))
        elif len(self.waiting) > MOST_WAITING:
            self.get_logger().warning(f'{", ".join(self.topics)} have no common stamps',
                                      throttle_duration_sec=10.0)
            del self.waiting[next(iter(self.waiting))]

    def estimate(self, step, messages):
        """Use the messages of a step, and publish the estimate."""
        states = messages[STATES]
        measured = {name: messages[topic].position[0] for name, topic in SENSORS.items()}
        if self.observer is None or abs(step - self.step) * self.scene.step > LONGEST_GAP:
            angle = measured['encoder']
            self.get_logger().info(f'an estimate begins at an angle of {angle:.4g} rad')
            self.observer = timo_sim.observer(
                self.scene.vary({'initial.shaft': angle}), [*SENSORS])
            self.observer.update(measured, dt=0.0)
        elif step <= self.step:  # a state that is repeated while time stands
            return
        else:
            torque = states.effort[states.name.index('shaft')]
            self.observer.update(measured, {'torque': torque},
                                 (step - self.step) * self.scene.step)
        self.step = step
        for publisher, (along, across) in (
                (self.tip, self.observer.deflection()),
                (self.deviation, self.observer.deflection_deviation)):
            publisher.publish(Vector3Stamped(header=states.header,
                                             vector=Vector3(x=float(along), y=float(across))))
        if self.observer.consistency > LARGEST_CONSISTENCY:
            self.get_logger().warning(self.observer.warning)
            self.observer = None


def main():
    """Read the arguments, and observe until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scene', help='parameter file of the arm, with noise of its sensors')
    # Ctrl-C ends the loop between two callbacks; rclpy's handler would end the context within one.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    ended = Event()
    signal.signal(signal.SIGINT, lambda number, frame: ended.set())
    node = Observe(timo_sim.load_scene(parser.parse_args().scene))
    while not ended.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == '__main__':
    main()
