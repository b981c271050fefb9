# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The processes that benchmark/speed/node.py compares; each runs until SIGTERM.

    python -m benchmark.speed.node_processes NAME FILE [ROS arguments]

`node` is sim_node itself. `bare` has the same loop and publishes the same messages at 1 kHz,
without a simulation; `timer` does so from an rclpy timer in a SingleThreadedExecutor. They write
to FILE when each tick began and ended, and its steps. `listener` subscribes to all topics, says
so, and says when it has heard all of them.
"""

from array import array
import signal
import sys
import threading
import time

from geometry_msgs.msg import PoseStamped, Vector3Stamped
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

PERIOD, CATCH_UP = 1e-3, 0.1  # [s]
TOPICS = {'/joint_states': JointState, '/timo_sim/modal_state': JointState,
          '/timo_sim/tip_deflection': Vector3Stamped, '/timo_sim/tip_pose': PoseStamped,
          '/timo_sim/carrier_pose': PoseStamped, '/clock': Clock}


class Ticks:
    """When ticks began and ended, on the clock that all processes share [s], and their steps."""

    def __init__(self):
        self._values = array('d')

    def time(self, tick, steps):
        """Call a tick; `steps` tells how many steps have been done in all."""
        before, begin = steps(), time.monotonic()
        result = tick()
        self._values.extend((begin, time.monotonic(), steps() - before))
        return result

    def save(self, path):
        """Write them to disk, shape (n, 3)."""
        np.save(path, np.reshape(self._values, (-1, 3)))


class Bare(Node):
    """Publishes the messages that `timo_sim` publishes, in plain rclpy."""

    def __init__(self):
        super().__init__('timo_sim')
        (self._joints, self._modes, self._deflection, self._tip, self._carrier, self._time) = (
            self.create_publisher(kind, topic, 10) for topic, kind in TOPICS.items())
        self.count = 0

    def tick(self):
        """Publish one message on each topic."""
        self.count += 1
        sec, nanosec = divmod(self.count * 1000000, 1000000000)
        value = 1e-6 * self.count

        joints = JointState()
        joints.header.stamp.sec, joints.header.stamp.nanosec = sec, nanosec
        joints.name = ['carrier_x', 'carrier_y', 'shaft']
        joints.position = [value, value, value]
        joints.velocity = [value, value, value]
        joints.effort = [value, value, value]
        self._joints.publish(joints)

        modes = JointState()
        modes.header.stamp.sec, modes.header.stamp.nanosec = sec, nanosec
        modes.name = ['mode_1', 'mode_2', 'mode_3']
        modes.position = [value, value, value]
        modes.velocity = [value, value, value]
        self._modes.publish(modes)

        deflection = Vector3Stamped()
        deflection.header.stamp.sec, deflection.header.stamp.nanosec = sec, nanosec
        deflection.header.frame_id = 'arm'
        deflection.vector.x, deflection.vector.y = value, value
        self._deflection.publish(deflection)

        tip = PoseStamped()
        tip.header.stamp.sec, tip.header.stamp.nanosec = sec, nanosec
        tip.header.frame_id = 'world'
        tip.pose.position.x, tip.pose.position.y = value, value
        tip.pose.orientation.z, tip.pose.orientation.w = value, value
        self._tip.publish(tip)

        carrier = PoseStamped()
        carrier.header.stamp.sec, carrier.header.stamp.nanosec = sec, nanosec
        carrier.header.frame_id = 'world'
        carrier.pose.position.x, carrier.pose.position.y = value, value
        carrier.pose.orientation.w = 1.0
        self._carrier.publish(carrier)

        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = sec, nanosec
        self._time.publish(clock)


def _until_terminated():
    end = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: end.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    return end


def bare(path):
    """Tick at absolute deadlines, with the executor in a second thread, as `timo_sim` does."""
    end, ticks = _until_terminated(), Ticks()
    node, executor = Bare(), EventsExecutor()
    executor.add_node(node)

    def spin():
        while not end.is_set():
            executor.spin_once(timeout_sec=0.1)

    thread = threading.Thread(target=spin)
    thread.start()
    base, count = time.monotonic(), 0
    while not end.is_set():
        ticks.time(node.tick, lambda: node.count)
        count += 1
        wait = base + count * PERIOD - time.monotonic()
        if wait < -CATCH_UP:
            base, count = time.monotonic(), 0
        time.sleep(max(0.0, wait))
    thread.join()
    ticks.save(path)


def timer(path):
    """Tick in a timer's callback."""
    end, ticks = _until_terminated(), Ticks()
    node, executor = Bare(), SingleThreadedExecutor()
    executor.add_node(node)

    node.create_timer(PERIOD, lambda: ticks.time(node.tick, lambda: node.count))
    while not end.is_set():
        executor.spin_once(timeout_sec=0.1)
    ticks.save(path)


def node(path):
    """Run `sim_node`, its ticks timed."""
    from timo_sim.cli.sim_node import StopRequest
    from timo_sim.ros import process
    ticks = Ticks()

    class Timed(process.SimNode):
        def _tick(self):
            return ticks.time(super()._tick, lambda: self._simulator.steps)

    process.SimNode = Timed
    process.run(StopRequest(), None)
    ticks.save(path)


def listener(_):
    """Take messages as they come, without looking into them."""
    end = _until_terminated()
    node, executor, missing = Node('listener'), EventsExecutor(), set(TOPICS)
    for topic, kind in TOPICS.items():
        node.create_subscription(kind, topic, lambda _, topic=topic: missing.discard(topic), 10,
                                 raw=True)
    executor.add_node(node)
    print('listening', flush=True)
    while not end.is_set() and missing:
        executor.spin_once(timeout_sec=0.1)
    print('hearing', flush=True)
    while not end.is_set():
        executor.spin_once(timeout_sec=0.1)


if __name__ == '__main__':
    {'bare': bare, 'timer': timer, 'node': node, 'listener': listener}[sys.argv[1]](sys.argv[2])
