# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The process of a node: its start, signals, streams, what it refuses, attacks by others."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, ExitStack
import os
import re
import signal
import subprocess
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages
import numpy as np
import platformdirs
from rcl_interfaces.srv import GetParameters
from ros_process import facts, nanoseconds, PATIENCE
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

import timo_sim
from timo_sim.log.info import info
from timo_sim.ros.process import use_profiles

TWICE = 'timo_sim: {ros__parameters: {arm: {length: 3.0}, arm.length: 4.0}}'
TAG = 'timo_sim: {ros__parameters: {arm.length: !!python/object/apply:os.system [touch tag]}}'
# Arguments of a node, and words of the line with which it ends.
REFUSED = [
    (['-p', argument], words) for argument, words in (
        ('arm.length:=-2.0', 'arm.length must be a finite number > 0 m, got -2.0'),
        ('arm.lenght:=2.0', 'arm.lenght = 2.0 is not a parameter of timo_sim'),
        ('rate.tip_pose:=300.0', 'rate.tip_pose = 300, the ratio is 3.33333'),
        ('load.torque.piecewise.time:=[1.0, 2]', 'load.torque.piecewise.time'),
        ('carrier.held:=false', 'carrier.held must be one of none, x, y, both, got False'),
        ('use_sim_time:=1', "'use_sim_time' to '1' of type 'INTEGER', expecting type 'BOOL'"),
        ('arm.length:=1.0e+300', 'too large or too small together'),
        ('frame.arm:=a\udcff', "'utf-8' codec can't"),
        ('qos_overrides./joint_states.publisher.depth:=5', 'is not a parameter of timo_sim'))
] + [
    (['--params-file', 'invalid.yaml'], 'invalid.yaml'),
    (['--params-file', 'tag.yaml'], 'tag'),
    (['--params-file', 'twice.yaml'], 'arm.length is given twice (twice.yaml)'),
    (['--', 'duration:=1.0'], "'duration:=1.0' must be inside of --ros-args")]


def test_what_is_refused_ends_a_node_with_one_line_and_code_2(start, tmp_path):
    for name, text in (('twice', TWICE), ('tag', TAG),
                       ('invalid', 'timo_sim: {ros__parameters: {arm: [')):
        (tmp_path / f'{name}.yaml').write_text(text)
    for node, words in [(start(*arguments), words) for arguments, words in REFUSED]:
        code, output = node.wait()
        ours = [line for line in output.splitlines() if line.startswith('timo_sim: ')]
        assert code == 2 and len(ours) == 1 and words in ours[0], (words, output)
        assert 'Traceback' not in output
    assert not (tmp_path / 'tag').exists() and not [*tmp_path.glob('*.mcap')]


def test_a_parameter_file_with_an_arm_has_no_number_of_the_papers(start, tmp_path):
    path = tmp_path / 'short.yaml'
    path.write_text('timo_sim: {ros__parameters: {arm: {length: 0.5, material: steel, section: '
                    '{width: 0.02}}, carrier.held: both, motor.shaft_inertia: 0.01}}')
    ends = '-p', 'duration:=0.01', '-p', 'real_time_factor:=0.0', '-p', 'record:=false'
    code, output = start('--ros-args', '--params-file', str(path), *ends).wait()
    assert code == 2 and 'arm.section.height must be given' in output
    code, output = start('--ros-args', '--params-file', str(path), *ends,
                         '-p', 'arm.section.height:=0.002').wait()
    assert code == 0 and 'end_effector.mass = 0 (was 2)' in output
    code, output = start('--ros-args', '-p', 'arm.length:=1.9', *ends).wait()
    assert code == 0 and 'no longer' not in output  # the paper's arm, but for its length


WITHOUT_DOCSTRINGS = """
import sys
from importlib.machinery import SourceFileLoader
get_code = SourceFileLoader.get_code
def optimized(self, name):  # as python -OO, which would compile all libraries anew, too
    return (self.source_to_code(self.get_data(self.path), self.path, _optimize=2)
            if name.startswith('timo_sim') else get_code(self, name))
SourceFileLoader.get_code = optimized
sys.modules['simulation_interfaces'] = None  # not installed
from timo_sim.cli.sim_node import main
assert main.__doc__ is None
assert main(['--ros-args', '-p', 'duration:=0.05', '-p', 'record_file:=run.mcap']) == 0
needless = {'rerun', 'timo_sim.view', 'tf2_msgs', 'rclpy.action',
            'matplotlib', 'tqdm', 'pandas', 'scipy.integrate', 'scipy.interpolate',
            'scipy.signal', 'scipy.stats'} & {*sys.modules}
assert not needless, needless
"""


def test_the_node_imports_only_what_it_needs_and_runs_without_docstrings(tmp_path):
    result = subprocess.run([sys.executable, '-c', WITHOUT_DOCSTRINGS], cwd=tmp_path,
                            capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


BUILDING = """
import sys
import time
import rclpy
from timo_sim.cli.sim_node import main
from timo_sim.simulation.simulator import Simulator
warm_up = Simulator.warm_up
def wait(simulator, *arguments, **options):
    Simulator.warm_up = warm_up  # the finer run beside it does not wait
    time.sleep(0.2)  # for whatever else of this process might be seen
    marker = rclpy.create_node('marker')  # shares what the graph is told with the node
    sys.stdin.readline()
    warm_up(simulator, *arguments, **options)
    marker.destroy_node()
Simulator.warm_up = wait
main()
"""


def test_services_and_topics_come_when_the_node_can_answer(client, tmp_path):
    """It offers nothing of its own while it compiles; afterwards one line says what it does."""
    node = subprocess.Popen(
        [sys.executable, '-c', BUILDING, '--ros-args', '-r', '__ns:=/late', '-p', 'record:=false',
         '-p', 'end_effector.mass:=2.5'], cwd=tmp_path, stdin=subprocess.PIPE,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        client.wait(lambda: 'marker' in client.get_node_names(), 'the node that is built')
        offered = {name for name, _ in client.get_service_names_and_types_by_node(
            'timo_sim', '/late')}
        assert offered <= {'/late/timo_sim/get_type_description'}
        assert not client.get_publishers_info_by_topic('/late/joint_states')
        node.stdin.write('\n')
        node.stdin.flush()
        mass, = client.service(GetParameters, '/late/timo_sim/get_parameters')(
            names=['end_effector.mass']).values
        assert mass.double_value == 2.5
    finally:
        node.terminate()
        output, _ = node.communicate(timeout=PATIENCE)
    line, = [line for line in output.splitlines() if 'running: ' in line]
    assert node.returncode == 0 and line.endswith(
        '[late.timo_sim]: running: 3 modes, step 0.001 s, ready for commands')


def test_hints_are_given_and_the_node_goes_on(start, tmp_path):
    """Odd numbers and implausible values, a file that names another node, a log nowhere."""
    (tmp_path / 'a.yaml').write_text('timo_sim: {ros__parameters: {arm.length: 3.0}}\n'
                                     '/left/timo_sim: {ros__parameters: {}}')
    (tmp_path / 'b.yaml').write_text('/**: {timo_sim: {ros__parameters: {duration: 0.1}}}')
    without_log = start('-r', '__ns:=/left', '--params-file', 'a.yaml', '--params-file', 'b.yaml',
                        record=False, **{'initial.shaft': 45.0, 'arm.length': '2',
                                         'arm.section.width': '2.0e-2',
                                         'arm.young_modulus': '70.5e9'})
    impossible = start(duration=0.01, record_file='/')
    code, output = without_log.wait()
    assert code == 0 and 'is this meant? initial.shaft = 45 rad is more than a turn' in output
    assert output.count('has no parameter for') == 1
    assert 'a.yaml has no parameter for /left/timo_sim; it has those of /timo_sim' in output
    assert not list(tmp_path.rglob('*.mcap'))
    code, output = impossible.wait()
    assert code == 0 and 'Traceback' not in output and 'no log is written to /' in output


def test_nohup_closed_streams_and_a_log_in_the_home(start, tmp_path, monkeypatch):
    def detach():
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        for number in range(3):
            os.close(number)

    monkeypatch.setenv('XDG_CACHE_HOME', platformdirs.user_cache_dir())  # of compiled code
    monkeypatch.setenv('HOME', str(tmp_path / 'home'))
    node = start(preexec_fn=detach, real_time_factor=0.0, duration=2.0,
                 record_file='~/logs/run.mcap')
    node.wait_for_handlers()
    node.send(signal.SIGHUP)
    assert node.wait()[0] == 0 and not (tmp_path / '~').exists()
    with open(tmp_path / 'home/logs/run.mcap', 'rb') as stream:
        last = make_reader(stream, validate_crcs=True).get_summary().statistics.message_end_time
    assert last == 2 * 10**9


def test_an_error_of_the_middleware_ends_with_one_line_and_code_1(start, tmp_path, monkeypatch):
    """Security is on, but keys are missing, or Fast DDS was built without security."""
    (tmp_path / 'enclaves' / 'timo_sim').mkdir(parents=True)
    for name, value in (('KEYSTORE', tmp_path), ('ENABLE', 'true'), ('STRATEGY', 'Enforce')):
        monkeypatch.setenv(f'ROS_SECURITY_{name}', str(value))
    code, output = start('--enclave', '/timo_sim').wait()
    assert code == 1 and 'timo_sim: error creating node' in output and 'Traceback' not in output


def test_tf_without_its_messages_ends_with_one_line_and_code_2(start, tmp_path, monkeypatch):
    (tmp_path / 'tf2_msgs.py').write_text(
        'raise ModuleNotFoundError("not here", name="tf2_msgs")')
    monkeypatch.setenv('PYTHONPATH', str(tmp_path), prepend=os.pathsep)
    code, output = start(fresh=True, publish_tf=True, record=False).wait()
    assert code == 2 and 'Traceback' not in output
    assert ('timo_sim: publish_tf needs tf2_msgs, which is not installed: apt-get install '
            'ros-$ROS_DISTRO-tf2-msgs\n') in output


def test_signals_end_the_process_cleanly(start, tmp_path):
    """Two signals at any time during and after the start, once Python can handle them."""
    sent = [(0.0, signal.SIGINT), (0.5, signal.SIGTERM), (1.0, signal.SIGINT),
            (2.0, signal.SIGHUP)]
    nodes = [start('-r', f'__ns:=/node_{number}', fresh=True,
                   record_file=str(tmp_path / f'{number}.mcap')) for number in range(len(sent))]

    def end(node, delay_and_signal):
        delay, number = delay_and_signal
        node.wait_for_handlers()
        time.sleep(delay)
        node.send(number)
        time.sleep(0.02)
        return node.end(number)
    with ThreadPoolExecutor(len(sent)) as executor:
        ends = [*executor.map(end, nodes, sent)]
    for node, (code, output) in zip(nodes, ends):
        assert code == 0 and 'Traceback' not in output, output
        if node.log.exists():
            with open(node.log, 'rb') as stream:
                assert make_reader(stream).get_summary().statistics is not None


def test_profiles_of_the_user_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(os, 'environ', {})
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'DEFAULT_FASTRTPS_PROFILES.xml').touch()
    use_profiles()
    assert not os.environ
    (tmp_path / 'DEFAULT_FASTRTPS_PROFILES.xml').unlink()
    use_profiles()
    assert os.path.exists(os.environ.pop('FASTRTPS_DEFAULT_PROFILES_FILE')) and os.environ
    before = dict(os.environ)
    use_profiles()
    assert os.environ == before


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
        client.wait(lambda: any('/clock' in message.status[0].message for message in health),
                    'a warning of the other clock')
    pause = client.service(SetBool, '/timo_sim/pause')
    assert pause(data=True).success and step().success
    code, output = node.end()
    assert code == 0
    assert output.count('/clock has another publisher') == 1
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
            client.wait(lambda: len(states) > count + 5, 'joint states')
            node.send(signal.SIGSTOP)
            time.sleep(0.2)
            node.send(signal.SIGCONT)
        client.wait(lambda: float(facts(health).get('dropped_time_s', 0)) > 0.3, 'drops')
        reader.kill()  # it may not go on
    assert int(facts(health)['overruns']) >= 3
    assert 's of sim time were lost' in facts(health)['timing']
    code, output = node.end()
    words = re.search(r'[0-9.]+ s of sim time were lost to delays beyond catch_up_limit', output)
    assert code == 0 and words[0] in '\n'.join(info(node.log))

    steps = [nanoseconds(state) // 1000000 for state in states]
    assert np.array_equal(np.diff(steps), [10] * (len(steps) - 1))
    run = timo_sim.simulate(timo_sim.load_scene(paper), 0.01 * np.ceil(0.1 * steps[-1]))
    assert np.array_equal([state.position for state in states], run.values[steps, :3])
    assert np.array_equal([state.velocity for state in states], run.values[steps, 6:9])


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
