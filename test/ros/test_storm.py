# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The node under attack by other processes goes on, counts, answers; its log is readable."""

from contextlib import contextmanager, ExitStack
import os
import signal
import subprocess
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from mcap_ros2.reader import read_ros2_messages
import numpy as np
from ros_process import facts, nanoseconds, PATIENCE
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from benchmark.stress.node_process import growth, LEAK, WINDOWS
import timo_sim

ATTACKER = [sys.executable, '-m', 'benchmark.stress.attackers']


def environment():
    """Return the environment of this process with its module search path."""
    return {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)}


@contextmanager
def attack(name):
    """Run one of the attacking processes; it is killed at the end."""
    process = subprocess.Popen([*ATTACKER, name], stdout=subprocess.PIPE, text=True,
                               env=environment())
    try:
        yield process
    finally:
        process.send_signal(signal.SIGCONT)
        process.terminate()
        process.communicate()


def test_refusals_are_counted_and_the_log_is_readable(start, client):
    """First every kind of bad command, then all attackers at once, one of which is killed."""
    node = start(publish_clock=True)
    health = client.collect(DiagnosticArray, '/diagnostics')
    with attack('bad') as bad:
        assert 'sent 100\n' in bad.stdout  # the middleware may print errors of its own
        client.wait(lambda: facts(health).get('refused_commands') == '100', '100 refusals')
    assert facts(health)['failed_calls'] == '0'

    step = client.service(Trigger, '/timo_sim/step')
    with ExitStack() as stack:
        storms = [stack.enter_context(attack('storm')) for _ in range(2)]
        for name in ('setter', 'caller', 'clock'):
            stack.enter_context(attack(name))
        # Pools of the middleware fill at first; that of used messages once grew by 25 MB/s.
        for _ in range(2):
            memory, count = node.memory(), int(facts(health)['refused_commands'])
            client.wait(lambda: int(facts(health)['refused_commands']) > count + 100, 'a storm')
        assert node.memory() - memory < 20e6
        storms[0].kill()
        client.wait(lambda: 'failed_calls' in facts(health)
                    and int(facts(health)['failed_calls']) > 0, 'a request without sense')
        client.wait(lambda: any('/clock' in message.status[0].message for message in health),
                    'a warning of the other clock')
    pause = client.service(SetBool, '/timo_sim/pause')
    assert pause(data=True).success and step().success
    code, output = node.end()
    assert code == 0
    assert output.count('somebody else publishes /clock') == 1
    # Errors of failed callbacks contain text of rclpy, which must stay short and printable.
    assert '\x1b' not in output and len(max(output.splitlines(), key=len)) < 1000
    assert sum(1 for _ in read_ros2_messages(str(node.log))) > 100


def test_dropped_time_is_counted_and_the_motion_stays_the_same(start, client, paper):
    """Stopping the process simulates a busy machine."""
    node = start('--params-file', str(paper), catch_up_limit=0.05)
    with attack('reader') as reader:
        assert 'hearing\n' in reader.stdout
        reader.send_signal(signal.SIGSTOP)  # a reliable subscriber that never reads
        states = client.collect(JointState, '/joint_states')
        health = client.collect(DiagnosticArray, '/diagnostics')
        for _ in range(3):
            count = len(states)
            client.wait(lambda: len(states) > count + 20, 'joint states')
            node.send(signal.SIGSTOP)
            time.sleep(0.5)
            node.send(signal.SIGCONT)
        client.wait(lambda: float(facts(health).get('dropped_time_s', 0)) > 1.0, 'drops')
    assert int(facts(health)['overruns']) >= 3
    assert node.end()[0] == 0

    steps = [nanoseconds(state) // 1000000 for state in states]
    assert np.array_equal(np.diff(steps), [10] * (len(steps) - 1))
    run = timo_sim.simulate(timo_sim.load_scene(paper), 0.01 * np.ceil(0.1 * steps[-1]))
    assert np.array_equal([state.position for state in states], run.motion[steps, :3])
    assert np.array_equal([state.velocity for state in states], run.motion[steps, 6:9])


def test_two_nodes_in_one_process(tmp_path):
    subprocess.run([*ATTACKER, 'two'], cwd=tmp_path, check=True, timeout=PATIENCE,
                   env=environment())
    for name, speed in (('left', 1.0), ('right', 2.0)):
        messages = list(read_ros2_messages(str(tmp_path / f'{name}.mcap')))
        states = [message for message in messages
                  if message.channel.topic == f'/{name}/joint_states']
        assert abs(states[0].ros_msg.velocity[2] - speed) < 1e-12 and len(states) > 1
        statuses = {message.ros_msg.status[0].name for message in messages
                    if message.channel.topic == '/diagnostics'}
        assert statuses <= {f'{name}/timo_sim: simulation'}


def test_a_log_that_is_moved_then_deleted_is_reported_and_the_simulation_goes_on(start, client):
    node = start()
    health = client.collect(DiagnosticArray, '/diagnostics')
    states = client.collect(JointState, '/joint_states')

    def told(words):
        client.wait(lambda: health and words in health[-1].status[0].message, words)
        assert health[-1].status[0].level == DiagnosticStatus.ERROR
    client.wait(lambda: health and node.log.exists(), 'a log')
    moved = node.log.rename(node.log.with_stem('moved'))
    told('was moved')
    moved.unlink()
    told('the log ends early')
    count = len(states)
    client.wait(lambda: len(states) > count, 'joint states')
    code, output = node.end()
    assert code == 0 and 'Traceback' not in output
    assert output.count('run.mcap was moved') == output.count('it was deleted') == 1
    assert list(node.log.parent.iterdir()) == []


def test_the_stress_test_distinguishes_a_leak_from_pools_that_fill():
    """Data: memory of a node in a storm, and in one with parameters and services [MB]."""
    for lows in ([218.4, 225.4, 230.0, 232.8, 232.5, 232.5, 232.5, 232.5, 234.5, 234.5, 234.0],
                 [218.1, 226.9, 231.9, 232.1, 230.7, 231.3, 231.4, 234.0, 234.9, 234.1, 234.0]):
        lows = 1e6 * np.array(lows)
        leaking = lows + 3e6 * np.arange(len(lows))
        for number in range(WINDOWS + 2, len(lows) + 1):
            assert growth(lows[:number]) < LEAK < growth(leaking[:number])
