# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
A ROS 2 node that estimates how an arm is bent from its encoder, strain gauge and motor torque.

Topics have the names of `sim_node`; a real arm has others, and other sensors. Each measurement is
followed by the deflection of the tip and its standard deviations, with the same stamp.
"""

import argparse

from geometry_msgs.msg import Vector3, Vector3Stamped
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

import timo_sim

SENSORS = {'encoder': '/timo_sim/encoder', 'root_strain': '/timo_sim/root_strain'}
LONGEST_GAP = 1.0  # [s] between stamps, forward or back, beyond which an estimate begins again
LARGEST_CONSISTENCY = 5.0  # beyond which it does so, too: the model is wrong, or the arm was moved


class Observe(Node):
    """Uses measurements in the order of their stamps; without an `observer` a new one begins."""

    def __init__(self, scene):
        super().__init__('observer')
        self.scene, self.observer, self.step, self.torque = scene, None, 0, 0.0
        first = timo_sim.observer(scene, [*SENSORS])  # compiles
        first.update({name: first.expected(name) for name in SENSORS}, dt=scene.step)
        self.tip = self.create_publisher(Vector3Stamped, '~/tip_deflection', 10)
        self.deviation = self.create_publisher(Vector3Stamped, '~/tip_deviation', 10)
        for name, topic in SENSORS.items():
            self.create_subscription(JointState, topic, lambda message, name=name: self.measure(
                name, message), 1000)
        # Of messages that wait together, a torque is taken last: it answers the measurements.
        self.create_subscription(Float64, '/timo_sim/motor_torque', self.command, 1000)
        self.get_logger().info(f'observing {", ".join(SENSORS)}')

    def command(self, message):
        """Keep a torque, which acts from the last measurement on."""
        self.torque = message.data

    def measure(self, name, message):
        """Use a measurement of a sensor, and publish the estimate."""
        value, stamp = message.position[0], message.header.stamp
        step = round((stamp.sec + 1e-9 * stamp.nanosec) / self.scene.step)
        if self.observer is None or abs(step - self.step) * self.scene.step > LONGEST_GAP:
            if name != 'encoder':
                return
            self.get_logger().info(f'an estimate begins at an angle of {value:.4g} rad')
            scene, self.step = self.scene.vary({'initial.shaft': value}), step
            self.observer = timo_sim.observer(scene, [*SENSORS])
        elif step < self.step:
            self.get_logger().warning(f'a measurement of {name} comes too late')
            return
        dt = (step - self.step) * self.scene.step
        self.observer.update({name: value}, {'torque': self.torque} if dt else {}, dt)
        self.step = step
        for publisher, (along, across) in (
                (self.tip, self.observer.deflection()),
                (self.deviation, self.observer.deflection_deviation)):
            publisher.publish(Vector3Stamped(header=message.header,
                                             vector=Vector3(x=float(along), y=float(across))))
        if self.observer.consistency > LARGEST_CONSISTENCY:
            self.get_logger().warning(self.observer.warning)
            self.observer = None


def main():
    """Read the arguments, and observe until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scene', help='parameter file of the arm, with noise of its sensors')
    rclpy.init()
    node = Observe(timo_sim.load_scene(parser.parse_args().scene))
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
