# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The start of the node: imports, the moment it appears in the graph, its first steps."""

import subprocess
import sys

from mcap_ros2.reader import read_ros2_messages
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from ros_process import PATIENCE
import timo_sim


def test_the_node_imports_only_what_it_needs(tmp_path):
    code = (
        'import sys; sys.modules["simulation_interfaces"] = None; '  # not installed
        'from timo_sim.cli.sim_node import main; '
        'assert main(["--ros-args", "-p", "duration:=0.05", "-p", "record_file:=run.mcap"]) == 0; '
        'needless = {"rerun", "rclpy.action", "matplotlib", "tqdm", "pandas", "scipy.integrate", '
        '"scipy.interpolate", "scipy.signal", "scipy.stats"} & set(sys.modules); '
        'assert not needless, needless')
    result = subprocess.run([sys.executable, '-c', code], cwd=tmp_path, capture_output=True,
                            text=True)
    assert result.returncode == 0, result.stderr


BUILDING = """
import sys
import time
import rclpy
from timo_sim.cli.sim_node import main
from timo_sim.simulation.simulator import Simulator
warm_up = Simulator.warm_up
def wait(simulator, *arguments, **options):
    time.sleep(0.5)  # for whatever else of this process might be seen
    marker = rclpy.create_node('marker')  # shares what the graph is told with the node
    sys.stdin.readline()
    warm_up(simulator, *arguments, **options)
    marker.destroy_node()
Simulator.warm_up = wait
main()
"""


def test_the_node_is_in_the_graph_when_it_can_answer(client, tmp_path):
    """It does not appear while it compiles; afterwards one line says what it does."""
    node = subprocess.Popen(
        [sys.executable, '-c', BUILDING, '--ros-args', '-r', '__ns:=/late', '-p', 'record:=false',
         '-p', 'end_effector.mass:=2.5'], cwd=tmp_path, stdin=subprocess.PIPE,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        client.wait(lambda: 'marker' in client.get_node_names(), 'the node that is built')
        assert ('timo_sim', '/late') not in client.get_node_names_and_namespaces()
        node.stdin.write('\n')
        node.stdin.flush()
        client.wait(lambda: ('timo_sim', '/late') in client.get_node_names_and_namespaces(),
                    'the node')
        mass, = client.service(GetParameters, '/late/timo_sim/get_parameters')(
            names=['end_effector.mass']).values
        assert mass.double_value == 2.5
    finally:
        node.terminate()
        output, _ = node.communicate(timeout=PATIENCE)
    line, = [line for line in output.splitlines() if 'running: ' in line]
    assert node.returncode == 0 and line.endswith(
        '[late.timo_sim]: running: 3 modes, step 0.001 s, waiting for commands')


def test_each_topic_has_its_rate_in_one_run(start):
    rates = {'joint_states': 500.0, 'modal_state': 250.0, 'tip_deflection': 200.0,
             'tip_pose': 1000.0, 'carrier_pose': 8.0, 'clock': 40.0}
    node = start(real_time_factor=0.0, duration=1.0, publish_clock=True,
                 **{f'rate.{topic}': rate for topic, rate in rates.items()})
    assert node.wait()[0] == 0
    steps = {topic: [] for topic in rates}
    for message in read_ros2_messages(str(node.log)):
        topic = message.channel.topic.rpartition('/')[2]
        if topic in steps:
            steps[topic].append(message.sequence_count)
    assert steps == {topic: list(range(0, 1001, round(1000 / rate)))
                     for topic, rate in rates.items()}


def test_a_command_to_a_manipulator_at_rest_acts_at_its_step(start, client):
    node = start(start_paused=True, steps_per_call=20)
    states = client.collect(JointState, '/joint_states')
    torque = client.command(Float64, '/timo_sim/motor_torque')
    step = client.service(Trigger, '/timo_sim/step')
    acting = []
    while not acting:  # a publisher discovers its subscriber before the reverse
        torque.publish(Float64(data=2.0))
        end = int(step().message.removeprefix('at step '))
        client.wait(lambda: states and stamp(states[-1]) == end, 'the state after a step')
        acting = [state for state in states if state.effort[2] == 2.0]
    for _ in range(10):
        end = int(step().message.removeprefix('at step '))
    client.wait(lambda: stamp(states[-1]) == end, 'the state after a step')
    assert node.end()[0] == 0

    command, = [message for message in read_ros2_messages(str(node.log))
                if message.channel.topic.endswith('motor_torque')][:1]
    begin = command.sequence_count
    assert begin % 20 == 0
    scene = timo_sim.load_scene({'load.torque.piecewise.time': [begin * 0.001],
                                 'load.torque.piecewise.value': [2.0]})
    run = timo_sim.simulate(scene, end * 0.001)
    for state in states:
        k = stamp(state)
        assert state.position.tolist() == run.motion[k, :3].tolist()
        assert state.effort.tolist() == [0.0, 0.0, 2.0 if k > begin else 0.0]


def stamp(message):
    """Return the step of a message."""
    return message.header.stamp.sec * 1000 + message.header.stamp.nanosec // 1000000
