# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A scene as hardware of ros2_control, without ROS: the bits of `Simulator`, its log, its URDF."""

import math
from pathlib import Path
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree

from command_line import call
import numpy as np
import pytest

import timo_sim
from timo_sim.log.read import recover
from timo_sim.log.tables import Recording
from timo_sim.model.layout import FORCE_X, FORCE_Y, LOADS, TORQUE, VOLTAGE
from timo_sim.runs.replay import replay
from timo_sim.scene.files import read_sections

ROOT = Path(__file__).resolve().parents[1]
CXX = shutil.which('g++')
pytestmark = pytest.mark.skipif(CXX is None or shutil.which('cc') is None,
                                reason='needs C and C++ compilers')
PERIOD = 2  # steps
SCENES = {
    'paper': ({}, {'force_x': FORCE_X, 'force_y': FORCE_Y, 'torque': TORQUE}),
    'voltage, weight': (
        {'motor.dc.resistance': 2.0, 'motor.dc.torque_constant': 0.5, 'gravity': [0.0, -3.0],
         'arm.material': 'titanium', 'frame_prefix': 'left/', 'record_file': 'its.mcap',
         'real_time_factor': 0.0, 'sensor.seed': 3, 'sensor.encoder.noise': 1e-3,
         'sensor.tip_acceleration.noise': 0.1},
        {'force_x': FORCE_X, 'voltage': VOLTAGE}),
}


@pytest.fixture(scope='module')
def program(tmp_path_factory):
    """Return the program of run_plant.cpp, built with all warnings as errors."""
    path = tmp_path_factory.mktemp('plant') / 'run_plant'
    source = ROOT / 'hardware/src'
    subprocess.run([CXX, '-std=c++17', '-Wall', '-Wextra', '-Wpedantic', '-Werror', f'-I{source}',
                    '-pthread',
                    '-o', path, ROOT / 'test/data/run_plant.cpp', source / 'plant.cpp',
                    source / 'log.cpp', '-ldl'],
                   check=True)
    return path


def export(folder, changes):
    """Return the shared object of the paper's scene, changed, and the URDF that names it."""
    library = folder / 'arm.so'
    settings = [text for name, value in changes.items() for text in ('--set', f'{name}={value}')]
    told, _, urdf = call('urdf', 'paper', *settings, '--ros2-control', library).partition('\n')
    assert told.startswith('compiling')  # this is on stderr
    return library, ElementTree.fromstring(urdf)


def run(program, lines, *arguments, code=0):
    """Return the lines that the program prints."""
    done = subprocess.run([program, *arguments], input='\n'.join(lines), text=True,
                          capture_output=True)
    assert done.returncode == code, (done.stdout, done.stderr)
    return done.stdout.splitlines()


@pytest.mark.parametrize('name', SCENES)
def test_bits_and_log(name, program, tmp_path):
    """The plant moves as a Simulator under the same commands; so does the replay of its log."""
    changes, inputs = SCENES[name]
    library, urdf = export(tmp_path, changes)
    block = urdf.find('ros2_control')
    sources = [each.text for each in block.iterfind('*/state_interface/param[@name="output"]')]
    simulator = timo_sim.Simulator(timo_sim.load_scene('paper', changes))
    random, commanded, lines, wanted = np.random.default_rng(3), np.zeros(LOADS), [], []
    for period in range(60):
        for title, column in inputs.items():
            if period % 3 == 0:  # the others repeat the one before
                commanded[column] = random.normal()
            lines.append(f'i {title} {commanded[column].hex()}')
        lines += [f's {PERIOD}', *(f'g {source}' for source in sources)]
        simulator.advance(PERIOD, commanded)
        now = simulator.snapshot()
        half = 0.5 * (now.joint_positions[2] + now.tip[2])
        wanted.append([*now.joint_positions, *now.joint_velocities, now.tip[1],
                       simulator.sensors.encoder, math.sin(half), math.cos(half),
                       *simulator.sensors.tip_acceleration])
    log = tmp_path / 'run.mcap'
    log.touch()  # not overwritten
    *found, step = run(program, lines, library, log)
    assert float.fromhex(step) == simulator.scene.step
    found = np.reshape([float.fromhex(each) for each in found], (60, -1))
    titles = ['carrier_x', 'carrier_y', 'shaft', 'carrier_x_velocity', 'carrier_y_velocity',
              'shaft_velocity', 'tip_transverse', 'encoder', 'sin_half(tip_rotation)',
              'cos_half(tip_rotation)', 'tip_acceleration_x', 'tip_acceleration_y']
    found, wanted = found[:, [sources.index(title) for title in titles]], np.array(wanted)
    assert np.ptp(found, axis=0).min() > 1e-6  # all of them move
    np.testing.assert_array_equal(found[:, :8], wanted[:, :8])
    # Accelerations are differences, good to some 1e-8.
    assert (np.abs(found - wanted).max(axis=0) < 1e-6 * np.abs(wanted).max(axis=0)).all()

    recover(tmp_path / 'run_1.mcap')
    told = []
    assert replay(tmp_path / 'run_1_recovered.mcap', show=told.append), told
    topics = 2 if 'voltage' in inputs else 1  # each has a message where it changes
    assert f'{20 * topics} commands and 0 resets in 0.12 s' in told[0]
    assert 'all are the same to the last bit' in told[1]
    recording = Recording(tmp_path / 'run_1_recovered.mcap')
    assert recording.topics['joint_states'].step.tolist() == [*range(0, 121, PERIOD)]
    assert recording.frames['tip'] == changes.get('frame_prefix', '') + 'tip'


def test_a_log_of_a_held_arm_with_loads_of_its_scene_replays(program, tmp_path):
    """Its first row has the scene's torque; reactions of the held axis are not compared."""
    library, _ = export(tmp_path, {
        'carrier.held': 'y', 'gravity': [0.0, -3.0], 'load.torque.piecewise.time': [0.0],
        'load.torque.piecewise.value': [1.0], **{
            f'load.torque.harmonic.{part}': [] for part in ('amplitude', 'frequency', 'phase')}})
    run(program, ['s 50', 'i torque 0.5', *5 * ['s 10']], library, tmp_path / 'run.mcap')
    recover(tmp_path / 'run.mcap')
    joints = Recording(tmp_path / 'run_recovered.mcap').topics['joint_states'].values
    assert joints[:2, 8] == pytest.approx(1.0) and joints[2:, 8] == pytest.approx(1.5)
    told = []
    assert replay(tmp_path / 'run_recovered.mcap', show=told.append), told


def test_urdf(program, tmp_path):
    """Interfaces are those of standard broadcasters; held joints and other motors have others."""
    changes, _ = SCENES['voltage, weight']
    library, urdf = export(tmp_path, {**changes, 'carrier.held': 'y'})
    assert [joint.get('name') for joint in urdf.iterfind('joint')
            if joint.get('type') != 'fixed'] == ['carrier_x', 'carrier_y', 'shaft']
    block, = urdf.findall('ros2_control')
    assert {each.get('name'): each.text for each in block.iterfind('hardware/param')} == {
        'scene_library': str(library), 'real_time_factor': '0.0', 'publish_clock': 'false',
        'record_file': 'its.mcap'}
    commands = {f'{joint.get("name")}/{each.get("name")}': each.find('param').text
                for joint in block.iterfind('joint') for each in joint.iterfind(
                    'command_interface')}
    assert commands == {'carrier_x/effort': 'force_x', 'shaft/voltage': 'voltage'}
    for joint in block.iterfind('joint'):
        assert [each.get('name') for each in joint.iterfind('state_interface')] == [
            'position', 'velocity', 'effort']
    plugin = ElementTree.parse(ROOT / 'hardware/timo_sim_hardware.xml').find('class').get('name')
    assert block.find('hardware/plugin').text == plugin
    turned = {f'orientation.{axis}' for axis in 'xyzw'}
    names = {sensor.get('name'): {each.get('name') for each in sensor} for sensor in
             block.iterfind('sensor')}
    assert names['tip_pose'] == {'position.x', 'position.y', 'position.z', *turned}
    assert names['tip_imu'] == turned | {f'{kind}.{axis}' for axis in 'xyz' for kind in (
        'angular_velocity', 'linear_acceleration')}
    up, = block.iterfind('sensor[@name="tip_imu"]/state_interface'
                         '[@name="linear_acceleration.z"]/param')
    assert float(up.text)**2 == pytest.approx(9.80665**2 - 3.0**2)


def test_controllers_of_the_launch_file_use_its_joints_and_interfaces(tmp_path):
    _, urdf = export(tmp_path, {'model.modes': 0})
    commands, states = ({f'{joint.get("name")}/{interface.get("name")}'
                         for joint in urdf.iterfind('ros2_control/joint')
                         for interface in joint.iterfind(f'{kind}_interface')}
                        for kind in ('command', 'state'))
    sections = read_sections(ROOT / 'hardware/config/controllers.yaml')
    effort, pid, follower = (sections[f'/{name}_controller'] for name in (
        'effort', 'pid', 'joint_trajectory'))
    (dof,), (claimed,) = pid['dof_names'], effort['joints']
    assert {f'{dof}/{name}' for name in follower['command_interfaces']} <= commands
    assert {f'{dof}/{name}' for name in follower['state_interfaces']} <= states
    assert {f'{claimed}/{effort["interface_name"]}', f'{dof}/{pid["command_interface"]}'} <= (
        commands)
    assert {f'{dof}/{name}' for name in pid['reference_and_state_interfaces']} <= states
    assert [name for name in pid if name.startswith('gains') and f'.{dof}.' not in name] == []
    # generate_parameter_library refuses whole numbers for doubles.
    assert all(type(value) is not int for each in (pid, follower) for value in each.values())


def test_a_trajectory_controller_follows_with_the_gains_of_its_file():
    sections = read_sections(ROOT / 'hardware/config/controllers.yaml')
    gains, period = sections['/joint_trajectory_controller'], 0.002
    assert sections['/controller_manager']['update_rate'] == 1.0 / period
    simulator = timo_sim.Simulator(timo_sim.load_scene({}, {'load.torque.harmonic.amplitude': []}))
    first, way, duration = simulator.motion.shaft, 0.7, 3.0
    for t in np.arange(0.0, 4.0, period):
        x = min(t / duration, 1.0)  # the cubic between two points at rest
        error = first + way * x * x * (3.0 - 2.0 * x) - simulator.motion.shaft
        assert abs(error) < gains['constraints.shaft.trajectory']
        rate = way / duration * 6.0 * x * (1.0 - x) - simulator.motion.shaft_velocity
        simulator.step(torque=gains['gains.shaft.p'] * error + gains['gains.shaft.d'] * rate,
                       duration=period)
    assert abs(error) < gains['constraints.shaft.goal']
    assert abs(simulator.motion.shaft_velocity) < gains['constraints.stopped_velocity_tolerance']


def test_refused(program, tmp_path):
    library, _ = export(tmp_path, {'model.modes': 0})
    told, = run(program, ['i angle 1.0'], library, code=1)
    assert told.startswith("input must be one of the scene's, force_x, force_y") and (
        told.endswith("; got 'angle'"))
    told, = run(program, ['g cos_half(elbow)'], library, code=1)
    assert told.startswith("output must be one of the scene's, time, ") and (
        told.endswith("; got 'elbow'"))
    assert run(program, ['i torque nan'], library, code=1) == ['a value is not finite']
    told, = run(program, [], 'none.so', code=1)
    assert told.startswith('scene_library must be a shared object') and 'none.so' in told
    subprocess.run(['cc', '-shared', '-o', tmp_path / 'other.so', '-x', 'c', '/dev/null'],
                   check=True)
    told, = run(program, [], tmp_path / 'other.so', code=1)
    assert told.endswith('other.so has no arm_scene')
    told, = run(program, [], library, tmp_path / 'none/run.mcap', code=1)
    assert told == f'record_file {tmp_path}/none/run.mcap: No such file or directory'


@pytest.fixture(scope='module', params=['address,undefined', 'thread'])
def system(request, tmp_path_factory):
    """Return run_system.cpp with stand-ins of ROS's headers, and what drives it on a scene."""
    folder, data = tmp_path_factory.mktemp('system'), ROOT / 'test/data'
    built = subprocess.run(
        [CXX, '-std=c++17', '-g1', '-Wall', '-Wextra', '-Wpedantic', '-Werror', '-pthread',
         f'-fsanitize={request.param}', '-fno-sanitize-recover=undefined',
         f'-I{ROOT}/hardware/src', f'-I{data}/ros2_control', '-o', folder / 'run_system',
         data / 'run_system.cpp', '-ldl'], capture_output=True, text=True)
    if 'cannot find' in built.stderr:
        pytest.skip('this compiler has no sanitizers')
    assert built.returncode == 0, built.stderr
    library, _ = export(folder, {'sensor.encoder.noise': 1e-3})
    # Some kernels place memory where ThreadSanitizer cannot have it, unless told not to.
    fixed = ['setarch', '-R'] if shutil.which('setarch') else []

    def drive(*lines, library=library):
        done = subprocess.run([*fixed, folder / 'run_system'], capture_output=True, text=True,
                              input='\n'.join([f'p scene_library {library}', *lines]))
        assert (done.returncode, done.stderr) == (0, '')
        return done.stdout.splitlines()
    return drive


def test_the_clock_never_leaves_the_arm(system, tmp_path):
    """The log knows their offset; a stalled loop is caught up, a row each period, and said."""
    log = tmp_path / 'run.mcap'
    _, before, said, after, _ = system(
        f'p record_file {log}', 'p real_time_factor 0', 'init 500', 'configure', 'activate',
        'loop 5', 'command 1.0', 'loop 10', 'times', 'stall 3', 'loop 2', 'times', 'deactivate',
        'activate', 'loop 3', 'command 1.0', 'loop 3', 'stop')
    (clock, arm), (later, further) = (map(float, each.split()) for each in (before, after))
    assert (later - clock) * 1e-9 == pytest.approx(further - arm, abs=1e-12)
    assert arm == pytest.approx(0.018) and further >= 0.028 and 'has not read for' in said
    recover(log)
    rows = Recording(tmp_path / 'run_recovered.mcap').topics['joint_states'].step
    assert set(np.diff(rows)) == {2}
    content = log.read_bytes()
    place = content.index(b'offset_ns') + len(b'offset_ns')
    size = int.from_bytes(content[place:place + 4], 'little')
    assert int(content[place + 4:place + 4 + size]) == clock - round(1e9 * arm)


def test_a_component_that_is_set_inactive_and_active_begins_anew(system):
    """It rests in between, whatever is commanded; a second run has the bits of the first."""
    run = ['activate', 'loop 3', 'command 1.0', 'loop 20', 'times', 'angle']
    (first, angle, between, second, again) = system(
        'p real_time_factor 0', 'init 500', 'configure', *run, 'deactivate', 'loop 5',
        'command 2.0', 'loop 5', 'times', *run)
    (clock, arm), (_, rest), (later, same) = (map(float, each.split()) for each in (
        first, between, second))
    assert later > clock and rest == 0.0 and same == arm == pytest.approx(0.038)
    assert again == angle and float.fromhex(angle) != math.pi / 4


def test_no_nanosecond_is_lost_at_300_hz(system):
    """A third of a nanosecond each period is 0.36 ms an hour."""
    clock = int(system('p real_time_factor 0', 'init 300', 'loop 3000', 'times')[0].split()[0])
    periods = round(300e-9 * clock)
    assert periods >= 3000 and clock == periods * 10**9 // 300


def test_a_full_disk_ends_the_log_and_not_the_run(system, tmp_path):
    log = tmp_path / 'run.mcap'
    _, *said, times = system(
        f'p record_file {log}', 'p real_time_factor 0', 'init 500', 'configure', 'activate',
        'room 40000', 'command 1.0', 'loop 3000', 'deactivate', 'times')
    assert said == [f'log {log} ends early: File too large']
    assert times.endswith(' 5.998000000')


@pytest.mark.parametrize('name, value, words', [
    ('real_time_factor', 'fast', "must be a number >= 0 and <= 1e6, got 'fast'"),
    ('real_time_factor', '1,5', "got '1,5'"), ('real_time_factor', '-1', "got '-1'"),
    ('publish_clock', 'True', 'publishes /clock'),
    ('publish_clock', 'yes', "publish_clock must be true or false, got 'yes'")])
def test_words_of_the_description(system, name, value, words):
    said, = system(f'p {name} {value}', 'init 500')
    assert words in said


def test_misuse(system, tmp_path, monkeypatch):
    monkeypatch.setenv('HOME', str(tmp_path))
    said = system('init 300', 'configure', 'activate')
    assert 'must be a whole multiple of the time step' in said[0]
    assert system('init 0') == ['error: rw_rate must be >= 1 Hz, got 0']
    log, clock = system('p record_file ~/run.mcap', 'p real_time_factor 0', 'init 500',
                        'configure', 'activate', 'loop 1', 'foreign', 'loop 1', 'deactivate',
                        'deactivate')
    assert log == f'log: {tmp_path}/run.mcap'
    assert 'another program sets the clock' in clock
