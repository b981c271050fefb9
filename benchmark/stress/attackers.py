# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The processes that attack a node; each runs until SIGTERM and prints what it counted.

    python -m benchmark.stress.attackers NAME [NAMESPACE]

`storm` sends commands of every kind, good and bad, as fast as it can; `bad` sends a hundred that
must be refused, slowly enough for each to arrive; `reader` subscribes to all topics and says so;
`setter` sets parameters, `caller` calls services; `clock` publishes a /clock of its own;
`controller` answers each state of a node in lock step with 1 N m, and before and after it sends
5 N m with stamps out of order; `rival` only sends the latter; `busy` keeps a core busy; `two` runs
two nodes in one process for two seconds.
"""

import itertools
import math
import random
import signal
import sys
import threading
import time

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, Vector3Stamped, WrenchStamped
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameterTypes, SetParameters
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import SetBool, Trigger

TOPICS = {'joint_states': JointState, 'timo_sim/modal_state': JointState,
          'timo_sim/tip_deflection': Vector3Stamped,
          'timo_sim/tip_pose': PoseStamped, 'timo_sim/carrier_pose': PoseStamped}
OUT_OF_ORDER = Time(nanosec=3), Time(sec=-1), Time(sec=2**31 - 1)  # which no state has
HUGE = 'x' * 1000000
BAD_NUMBERS = (math.nan, math.inf, -math.inf)
PARAMETERS = ('rate.joint_states', 'rate.tip_pose', 'real_time_factor', 'catch_up_limit',
              'command_timeout', 'steps_per_call', 'arm.length', 'use_sim_time', 'no.such', '')
VALUES = (
    [ParameterValue(type=3, double_value=value) for value in (
        0.0, 1.0, 500.0, 1e13, 1e300, -1.0, 1e-300, *BAD_NUMBERS)]
    + [ParameterValue(type=2, integer_value=value) for value in (0, 1, -1, 2**62)]
    + [ParameterValue(), ParameterValue(type=1, bool_value=True), ParameterValue(type=200),
       ParameterValue(type=4, string_value='1e3\n'),
       ParameterValue(type=4, string_value=f'[{"1," * 9999}1]'),
       ParameterValue(type=4, string_value='[0, 0.5]'), ParameterValue(type=6),
       ParameterValue(type=7, integer_array_value=[1]),
       ParameterValue(type=9, string_array_value=['a'] * 1000)])


def wrench(frame='', force=0.0, stamp=0):
    """Return a wrench command."""
    message = WrenchStamped()
    message.header.frame_id, message.header.stamp.sec = frame, stamp
    message.wrench.force.x = force
    return message


def bad_commands():
    """Return commands that must be refused: topic, type and message, or bytes in its place."""
    torque = ('timo_sim/motor_torque', Float64)
    push = ('timo_sim/carrier_wrench', WrenchStamped)
    tip = ('timo_sim/tip_wrench', WrenchStamped)
    joints = ('timo_sim/joint_command', JointState)
    array = ('timo_sim/commands', Float64MultiArray)
    good = serialize_message(wrench('world', 1.0))
    return [*((*torque, Float64(data=value)) for value in BAD_NUMBERS),
            *((*push, wrench(force=value)) for value in BAD_NUMBERS),
            *((*push, wrench(frame)) for frame in ('map', 'a\nb\x1b[2J', HUGE)),
            *((*torque, bytes(data)) for data in (b'\0\1\0\0', b'\0\1\0\0\1', b'\xff' * 7)),
            *((*push, good[:size]) for size in (4, 12, 20, len(good) - 9)),
            (*push, good[:12] + b'\xff' * 4 + good[16:]), (*push, b'\xff' * 100),
            (*tip, wrench('map')), (*tip, wrench(force=math.nan)),
            *((*array, Float64MultiArray(data=[0.0] * size)) for size in (0, 2, 4, 100000)),
            (*array, Float64MultiArray(data=[0.0, math.inf, 0.0])),
            *((*joints, JointState(name=names, effort=efforts)) for names, efforts in (
                ([], []), (['shaft'], []), (['elbow'], []), (['shaft'], [math.inf]),
                (['shaft'] * 2, [1.0, 1.0]), ([HUGE] * 2, [1.0] * 2), (['shaft'] * 10000, [])))]


def good_commands():
    """Return commands that must be accepted, whatever their stamps."""
    return [*(('timo_sim/carrier_wrench', WrenchStamped, wrench('arm', 0.1, stamp))
              for stamp in (0, 2**31 - 1, -2**31, int(time.time()))),
            ('timo_sim/motor_torque', Float64, Float64(data=0.1)),
            ('timo_sim/motor_torque', Float64, Float64(data=-0.1)),
            ('timo_sim/tip_wrench', WrenchStamped, wrench('world', 0.1)),
            ('timo_sim/commands', Float64MultiArray, Float64MultiArray(data=[0.1, 0.0, -0.1])),
            *(('timo_sim/joint_command', JointState, JointState(name=names, effort=efforts))
              for names, efforts in ((['shaft'], [0.1]), (['elbow', HUGE], [1.0, math.inf]),
                                     (['shaft', 'carrier_y'], [math.nan, 0.1])))]


class Attacker(Node):
    """A node whose publishers and clients are made when they are first used."""

    def __init__(self, namespace):
        super().__init__('attacker', namespace=namespace)
        self.publishers_by_topic = {}

    def send(self, topic, message_type, message):
        """Publish a message, or bytes in its place."""
        if topic not in self.publishers_by_topic:
            publisher = self.create_publisher(message_type, topic, 10)
            self.publishers_by_topic[topic] = publisher
            while publisher.get_subscription_count() == 0 and not END.is_set():
                time.sleep(0.01)
            self._wait_until_known()
        self.publishers_by_topic[topic].publish(message)

    def _wait_until_known(self):
        # A node that answers knows what this process has made before the question.
        client = self.create_client(GetParameterTypes, 'timo_sim/get_parameter_types')
        answer = None
        while not (answer and answer.done() or END.is_set()):
            answer = client.call_async(GetParameterTypes.Request())
            rclpy.spin_until_future_complete(self, answer, timeout_sec=0.5)
        self.destroy_client(client)


END = threading.Event()


def storm(node):
    """Send as fast as possible."""
    choices, count = bad_commands() + good_commands(), 0
    while not END.is_set():
        node.send(*random.choice(choices))
        count += 1
    print('sent', count)


def bad(node, number=100):
    """Send what must be refused, slowly enough for all of it to arrive: queues hold ten."""
    commands = bad_commands()
    random.Random(1).shuffle(commands)  # or a dozen in a row would be of one topic
    for command in itertools.islice(itertools.cycle(commands), number):
        node.send(*command)
        time.sleep(0.03)
    print('sent', number, flush=True)
    END.wait()


def reader(node):
    """Subscribe; whoever started this may stop it with SIGSTOP."""
    for topic, message_type in TOPICS.items():
        node.create_subscription(message_type, topic, lambda message: None, 10)
    rclpy.spin_once(node, timeout_sec=10.0)
    print('hearing', flush=True)
    END.wait()


def _call_all(node, calls, period):
    """Make calls until the end; each waits for its answer for a second at most."""
    executor, count, answers = SingleThreadedExecutor(), 0, 0
    executor.add_node(node)
    while not END.is_set():
        client, request = calls()
        if not client.wait_for_service(timeout_sec=0.5):
            continue
        future = client.call_async(request)
        executor.spin_until_future_complete(future, timeout_sec=1.0)
        count, answers = count + 1, answers + future.done()
        client.remove_pending_request(future)
        time.sleep(period)
    print('called', count, 'answered', answers)


def setter(node):
    """Set random parameters to random values, a hundred times a second."""
    client = node.create_client(SetParameters, 'timo_sim/set_parameters')
    _call_all(node, lambda: (client, SetParameters.Request(parameters=[
        Parameter(name=random.choice(PARAMETERS), value=random.choice(VALUES))])), 0.01)


def caller(node):
    """Call pause, reset and step in any order."""
    pause, reset, step = (
        node.create_client(kind, f'timo_sim/{name}')
        for kind, name in ((SetBool, 'pause'), (Trigger, 'reset'), (Trigger, 'step')))
    _call_all(node, lambda: random.choice((
        (pause, SetBool.Request(data=True)), (pause, SetBool.Request(data=False)),
        (reset, Trigger.Request()), (step, Trigger.Request()))), 0.0)


def clock(node):
    """Publish a time that jumps."""
    publisher = node.create_publisher(Clock, '/clock', 10)
    while not END.is_set():
        message = Clock()
        message.clock.sec = random.randrange(2**31)
        publisher.publish(message)
        time.sleep(0.01)


def controller(node, right=True):
    """Answer each state, and again after a while: other commands may push out an answer."""
    states = []
    node.create_subscription(JointState, 'joint_states', states.append, 10)
    while not END.is_set():
        rclpy.spin_once(node, timeout_sec=0.2)
        del states[:-2]
        if states:
            now, earlier = states[-1].header.stamp, states[0].header.stamp
            for stamp in (random.choice(OUT_OF_ORDER), *[now] * right, earlier):
                if right or stamp != now:
                    command = JointState(name=['shaft'], effort=[1.0 if stamp == now else 5.0])
                    command.header.stamp = stamp
                    node.send('timo_sim/joint_command', JointState, command)
            node.send('timo_sim/tip_wrench', WrenchStamped, wrench('world', 5.0, 2**31 - 1))


def busy(node):
    """Keep a core busy."""
    while not END.is_set():
        sum(range(10000))


def two(namespace):
    """Run two nodes in this process, each with its loop in a thread."""
    from timo_sim.cli.sim_node import StopRequest
    from timo_sim.ros.node import SimNode
    stop = StopRequest()
    stop.running = True
    nodes = [SimNode(stop, namespace=name, parameter_overrides=[
        rclpy.Parameter('record_file', value=f'{name}.mcap'),
        rclpy.Parameter('initial.shaft_velocity', value=speed)])
        for name, speed in (('left', 1.0), ('right', 2.0))]
    executor = SingleThreadedExecutor()
    threads = [threading.Thread(target=node.run) for node in nodes]
    for node, thread in zip(nodes, threads):
        executor.add_node(node)
        node.open()
        thread.start()
    while any(node.steps < 2000 for node in nodes):
        executor.spin_once(timeout_sec=0.1)
    stop.set = True
    for node, thread in zip(nodes, threads):
        thread.join()
        node.destroy_node()


def main(name, namespace='/'):
    """Run one of them."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: END.set())
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    if name == 'two':
        two(namespace)
    else:
        {'storm': storm, 'bad': bad, 'reader': reader, 'setter': setter, 'caller': caller,
         'clock': clock, 'controller': controller, 'busy': busy,
         'rival': lambda node: controller(node, right=False)}[name](Attacker(namespace))
    rclpy.shutdown()


if __name__ == '__main__':
    main(*sys.argv[1:])
