# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Names of frames in messages, commands, logs and replays; forces in axes of the tip."""

import math

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Vector3Stamped, WrenchStamped
from mcap_ros2.reader import read_ros2_messages
import numpy as np
import pytest
from ros_process import facts, nanoseconds, replayed
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from scipy.integrate import solve_ivp
from sensor_msgs.msg import Imu, JointState

import timo_sim
from timo_sim.log.tables import Recording
from timo_sim.model.layout import LOADS, TIP_TORQUE, TIP_X, TIP_Y
from timo_sim.runs.replay import replay
from timo_sim.scene.parameters import frame_names, ParameterError
from timo_sim.simulation.loads import load_of_commands
from timo_sim.simulation.simulator import Simulator
from timo_sim.topics.commands import COMMANDED, COMMANDS
from timo_sim.topics.outputs import in_frames, TRANSFORMS

GIVEN = {'frame_prefix': 'left/', 'frame.world': 'map', 'frame.carrier': 'base_link'}
NAMES = {'world': 'map', 'carrier': 'left/base_link', 'arm': 'left/arm', 'tip': 'left/tip'}
CARRIER, _, TIP, *_ = COMMANDS
FORCE, DURATION = [60.0, 40.0, 0.0, 0.0, 0.0, 5.0], 0.32  # turns the tip by 0.03 rad


def wrench_in(frame, x):
    """Return a force along the x axis of a frame."""
    message = WrenchStamped()
    message.header.frame_id, message.wrench.force.x = frame, x
    return message


def test_frames_of_topics_commands_log_and_replay(start, client, tmp_path):
    node = start('-r', '__ns:=/left', record_sensors=True,
                 **{'initial.shaft': 0.5, 'initial.shaft_velocity': 1.0}, **GIVEN)
    for kind, topic, frame in (
            (Vector3Stamped, 'tip_deflection', 'arm'), (PoseStamped, 'tip_pose', 'world'),
            (PoseStamped, 'carrier_pose', 'world'), (Imu, 'tip_imu/data_raw', 'tip')):
        messages = client.collect(kind, f'/left/timo_sim/{topic}')
        client.wait(lambda: messages, topic)
        assert messages[-1].header.frame_id == NAMES[frame]
    states = client.collect(JointState, '/left/joint_states')
    push = client.command(WrenchStamped, '/left/timo_sim/carrier_wrench')
    for frame, turns in ('map', 0.0), ('left/arm', 1.0):
        push.publish(wrench_in(frame, 3.0))
        client.wait(lambda: states and abs(states[-1].effort[0] - 3.0 * math.cos(
            turns * states[-1].position[2])) < 1e-12, f'a force in {frame}')
    push.publish(wrench_in('arm', 1.0))
    health = client.collect(DiagnosticArray, '/diagnostics')
    client.wait(lambda: facts(health).get('refused_commands') == '1', 'what is refused')
    code, output = node.end()
    assert code == 0 and "frame_id must be empty, 'map' or 'left/arm', got 'arm'" in output
    assert len(Recording(node.log).topics['~/carrier_wrench'].step) == 2
    replayed(node.log)
    again = tmp_path / 'again.mcap'
    replayed(node.log, {'end_effector.mass': 1.0}, output=again)
    for path in node.log, again:
        headers = [message.ros_msg.header for message in read_ros2_messages(str(path))
                   if hasattr(message.ros_msg, 'header')]
        assert {header.frame_id for header in headers} == {'', 'map', 'left/arm', 'left/tip'}


def test_commands_of_a_bag_use_the_frame_names_of_the_scene(tmp_path):
    store, kind = get_typestore(Stores.ROS2_JAZZY), 'geometry_msgs/msg/WrenchStamped'
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        wrench = writer.add_connection('/timo_sim/carrier_wrench', kind, typestore=store)
        types = {name: store.types[f'geometry_msgs/msg/{name}'] for name in ('Vector3', 'Wrench')}
        header = store.types['std_msgs/msg/Header'](
            store.types['builtin_interfaces/msg/Time'](0, 0), 'left/arm')
        force, none = types['Vector3'](2.0, 0.0, 0.0), types['Vector3'](0.0, 0.0, 0.0)
        writer.write(wrench, 10**9, store.serialize_cdr(
            store.types[kind](header, types['Wrench'](force, none)), kind))
    scene = tmp_path / 'scene.yaml'
    scene.write_text('timo_sim: {ros__parameters: {frame_prefix: left/}}')
    found, lines = tmp_path / 'run.mcap', []
    replay(tmp_path / 'bag', {}, found, scene, duration=0.1, show=lines.append)
    assert '1 commands' in lines[0]
    assert Recording(found).topics['joint_states'].values[-1, 6:8].any()


def test_frames_of_tf_have_these_names_and_names_that_tf_would_refuse_are_refused():
    found = [(frame['header']['frame_id'], frame['child_frame_id'])
             for frame in in_frames(TRANSFORMS.template, frame_names(GIVEN))['transforms']]
    assert found[:6] == [
        ('map', 'left/base_link_rail'), ('left/base_link_rail', 'left/base_link'),
        ('left/base_link', 'left/arm'), ('left/arm', 'left/tip'), ('left/arm', 'left/arm_1'),
        ('left/arm_1', 'left/arm_2')]
    for given, words in (
            ({'frame.arm': '/arm'}, 'frame.arm must be a name without blanks that does not begin '
             "with /, got '/arm'"),
            ({'frame.tip': ''}, 'frame.tip must be a name'),
            ({'frame_prefix': 'my robot/'}, 'frame_prefix must be empty or a text without blanks'),
            ({'frame.tip': 'arm'}, "must differ, got 'world', 'carrier', 'arm', 'arm'")):
        with pytest.raises(ParameterError, match=words):
            frame_names(given)


def driven(scene, frame='tip'):
    """Return a simulator after DURATION under the force."""
    simulator, commanded = Simulator(scene), np.zeros(COMMANDED)
    TIP.apply(TIP.row([frame], [FORCE], frame_names({})), commanded)
    for _ in range(round(DURATION / scene.step)):
        simulator.advance(1, load_of_commands(commanded, simulator))
    return simulator


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_a_force_in_axes_of_the_tip_has_its_direction_to_second_order(formulation):
    """The reference integrates the same equations by another method with the exact direction."""
    scene = timo_sim.load_scene({'model.formulation': formulation, 'initial.shaft_velocity': 1.0})
    simulator = Simulator(scene)
    model, motion = simulator.model, simulator.integration.motion

    def rate(_, state):
        load = np.zeros(LOADS)
        _, _, theta, *q = motion(state, load)[:3 + scene.modal_count]
        turn = np.exp(1j * (theta + model.section_rotation(q, model.tip_point)[0]))
        force = turn * complex(*FORCE[:2])
        load[[TIP_X, TIP_Y, TIP_TORQUE]] = force.real, force.imag, FORCE[5]
        return model.rate(state, load)

    end = solve_ivp(rate, (0.0, DURATION), model.state(scene.initial_motion()), method='DOP853',
                    rtol=1e-11, atol=1e-12).y[:, -1]
    true = motion(end, np.zeros(LOADS))[:3 + scene.modal_count]

    def error(step):
        found = driven(scene.vary({'integrator.step': step})).motion.values[:len(true)]
        return np.abs(found - true).max()

    rough, fine, finest = map(error, (0.004, 0.002, 0.001))
    assert finest < 1e-6  # 2e-7
    for ratio in rough / fine, fine / finest:
        assert 1.8 < np.log2(ratio) < 2.2
    # The same force in axes of the shaft gives another motion, except of a rigid arm.
    assert np.abs(driven(scene, 'arm').motion.values[:len(true)] - true).max() > 1e-3
    rigid = scene.vary({'model.modes': 0})
    assert np.array_equal(driven(rigid).motion.values, driven(rigid, 'arm').motion.values)


def test_a_node_obeys_a_force_in_axes_of_the_tip_and_its_log_replays(start, client):
    node = start(frame_prefix='left/', command_timeout=0.3)
    push = client.command(WrenchStamped, '/timo_sim/tip_wrench')
    states = client.collect(JointState, '/joint_states')
    message = WrenchStamped()
    message.header.frame_id, message.wrench.force.y = 'left/tip', 30.0

    def moved():
        push.publish(message)
        return states and states[-1].position[2] > 1.0
    client.wait(moved, 'the shaft to turn')
    turned = nanoseconds(states[-1])
    client.wait(lambda: nanoseconds(states[-1]) >= turned + 400000000, 'the end of the command')
    assert node.end()[0] == 0
    recording = Recording(node.log)
    assert recording.topics['~/tip_wrench'].columns[-2:] == (
        'tip_force_along_tip_N', 'tip_force_across_tip_N')
    assert recording.topics['~/tip_wrench'].values[0].tolist() == [*6 * [0.0], 30.0]
    # More than one, if this process was stopped for 0.3 s while it pushed.
    assert recording.summary['stale_commands'] >= 1
    replayed(node.log)
