# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The processes that `node` and `latency` measure; each runs until SIGTERM.

    python -m benchmark.speed.node_processes NAME ARGUMENT [ROS arguments]

`node` is sim_node itself. `bare` has the same loop and publishes the same messages at 1 kHz,
without a simulation; `timer` does so from an rclpy timer in a SingleThreadedExecutor. They write
to the file ARGUMENT when each tick began and ended, and its steps. `listener` subscribes to all
topics, says so, and says when it has heard all of them. `echo` answers each torque with a joint
state that says when it came. `server` sends the next state for each command: a node in lock step
without a simulation. `controller` answers each state for two seconds and prints its rate. The
last two take the name of an executor.
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
from std_msgs.msg import Float64

PERIOD, CATCH_UP = 1e-3, 0.1  # [s]
SETTLE, COUNTED = 1.0, 2.0    # of a controller [s]
TOPICS = {'/joint_states': JointState, '/timo_sim/modal_state': JointState,
          '/timo_sim/tip_deflection': Vector3Stamped, '/timo_sim/tip_pose': PoseStamped,
          '/timo_sim/carrier_pose': PoseStamped, '/clock': Clock}
EXECUTORS = {'rclpy.spin': SingleThreadedExecutor, 'EventsExecutor': EventsExecutor}
END = threading.Event()


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
        value = 1e-6 * self.count

        numbers = [value, value, value]
        self._joints.publish(self._stamped(JointState(
            name=['carrier_x', 'carrier_y', 'shaft'], position=numbers, velocity=numbers,
            effort=numbers)))
        self._modes.publish(self._stamped(JointState(
            name=['mode_1', 'mode_2', 'mode_3'], position=numbers, velocity=numbers)))
        deflection = self._stamped(Vector3Stamped())
        deflection.header.frame_id = 'arm'
        deflection.vector.x, deflection.vector.y = value, value
        self._deflection.publish(deflection)
        for publisher in self._tip, self._carrier:
            pose = self._stamped(PoseStamped())
            pose.header.frame_id = 'world'
            pose.pose.position.x, pose.pose.position.y = value, value
            pose.pose.orientation.z, pose.pose.orientation.w = value, value
            publisher.publish(pose)
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = divmod(self.count * 1000000, 1000000000)
        self._time.publish(clock)

    def _stamped(self, message):
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(self.count * 1000000, 1000000000)
        return message


class Echo(Node):
    """Answers each torque with a joint state, and says when it came."""

    def __init__(self):
        super().__init__('echo')
        self._publisher = self.create_publisher(JointState, '/echo/joint_states', 10)
        self.create_subscription(Float64, '/echo/motor_torque', self._answer, 10)

    def _answer(self, command):
        self._publisher.publish(JointState(
            position=[time.monotonic(), 0.0, 0.0], effort=[0.0, 0.0, command.data]))


class Server(Node):
    """Sends the next state for each command."""

    def __init__(self):
        super().__init__('timo_sim')
        self._count = 0
        self._publisher = self.create_publisher(JointState, '/joint_states', 10)
        self.create_subscription(JointState, '/timo_sim/joint_command', self._next, 10)
        self.create_timer(0.2, lambda: self._count or self._next(None))

    def _next(self, command):
        self._count += command is not None
        state = JointState(name=['carrier_x', 'carrier_y', 'shaft'], position=3 * [0.0],
                           velocity=3 * [0.0], effort=3 * [0.0])
        state.header.stamp.sec, state.header.stamp.nanosec = divmod(
            1000000 * self._count, 1000000000)
        self._publisher.publish(state)


class Controller(Node):
    """Answers each state; prints how many a second, and ends the process."""

    def __init__(self):
        super().__init__('controller')
        self._publisher = self.create_publisher(JointState, '/timo_sim/joint_command', 10)
        self.create_subscription(JointState, '/joint_states', self._answer, 10)
        self._begin, self._count = None, 0

    def _answer(self, state):
        command = JointState(name=['shaft'], effort=[0.1 - 0.1 * state.velocity[2]])
        command.header.stamp = state.header.stamp
        self._publisher.publish(command)
        now = time.monotonic()
        self._begin = self._begin or now + SETTLE
        self._count += now >= self._begin
        if now >= self._begin + COUNTED and not END.is_set():
            print('rate', self._count / (now - self._begin), flush=True)
            END.set()


def bare(path):
    """Tick at absolute deadlines, with the executor in a second thread, as `timo_sim` does."""
    ticks, node = Ticks(), Bare()
    thread = threading.Thread(target=spin, args=(node, EventsExecutor()))
    thread.start()
    base, count = time.monotonic(), 0
    while not END.is_set():
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
    ticks, node = Ticks(), Bare()
    node.create_timer(PERIOD, lambda: ticks.time(node.tick, lambda: node.count))
    spin(node, SingleThreadedExecutor())
    ticks.save(path)


def sim_node(path, extra):
    """Run `sim_node` with a command line, its ticks timed."""
    from timo_sim.cli.sim_node import StopRequest
    from timo_sim.ros.node import SimNode
    from timo_sim.ros.process import run
    ticks, tick = Ticks(), SimNode._tick
    SimNode._tick = lambda node: ticks.time(lambda: tick(node), lambda: node._simulator.steps)
    code = run(StopRequest(), extra)
    ticks.save(path)
    return code


def listener(_):
    """Take messages as they come, without looking into them."""
    node, executor, missing = Node('listener'), EventsExecutor(), set(TOPICS)
    for topic, kind in TOPICS.items():
        node.create_subscription(kind, topic, lambda _, topic=topic: missing.discard(topic), 10,
                                 raw=True)
    print('listening', flush=True)
    spin(node, executor, lambda: not missing)
    print('hearing', flush=True)
    spin(node, executor)


def spin(node, executor, done=lambda: False):
    """Serve a node until the end, or until something is done."""
    executor.add_node(node)
    while not END.is_set() and not done():
        executor.spin_once(timeout_sec=0.1)


def main(name, argument, *extra):
    """Run one of them."""
    if name == 'node':
        sys.exit(sim_node(argument, list(extra)))
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: END.set())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    nodes = {'echo': Echo, 'server': Server, 'controller': Controller}
    if name in nodes:
        spin(nodes[name](), EXECUTORS[argument]())
    else:
        {'bare': bare, 'timer': timer, 'listener': listener}[name](argument)


if __name__ == '__main__':
    main(*sys.argv[1:])
