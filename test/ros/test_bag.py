# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Bags of a node's topics, recorded over DDS: they are replayed by themselves, as logs are."""

from functools import partial

from mcap.writer import Writer
import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from ros_process import replayed
from rosgraph_msgs.msg import Clock
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from timo_sim.log.read import LogError
from timo_sim.log.tables import Recording
from timo_sim.runs.replay import open_log, replay

TORQUE, EFFORT = '/timo_sim/motor_torque', '/timo_sim/joint_command'
STATES, SCENE = '/joint_states', '/timo_sim/scene'
TOPICS = {TORQUE: Float64, EFFORT: JointState, STATES: JointState, SCENE: String,
          '/timo_sim/modal_state': JointState, '/clock': Clock}
STORE = get_typestore(Stores.ROS2_JAZZY)


class Recorder:
    """Records topics with the times of the middleware, as `ros2 bag record` of Jazzy does."""

    def __init__(self, client):
        self.messages = []
        for topic, kind in TOPICS.items():
            latched = DurabilityPolicy.TRANSIENT_LOCAL if topic == SCENE else (
                DurabilityPolicy.VOLATILE)
            # In the callback of one argument rclpy would give no times.
            client.create_subscription(
                kind, topic, partial(self._keep, topic),
                QoSProfile(depth=1000, durability=latched), raw=True)

    def _keep(self, topic, data, info):
        self.messages.append((info['received_timestamp'], info['source_timestamp'], topic, data))

    def write(self, path, leave_out=()):
        with open(path, 'wb') as stream:
            writer = Writer(stream)
            writer.start('ros2')
            channels = {}
            for topic, kind in TOPICS.items():
                name = f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
                text, _ = STORE.generate_msgdef(name, ros_version=2)
                schema = writer.register_schema(name, 'ros2msg', text.encode())
                channels[topic] = writer.register_channel(topic, 'cdr', schema)
            for logged, sent, topic, data in sorted(self.messages):
                if topic not in leave_out:
                    writer.add_message(channels[topic], logged, data, sent)
            writer.finish()
        return path


def stamp(state):
    return state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec


def step_of(data):
    """Return the time step [ms] of a serialised state."""
    return round(1000.0 * stamp(STORE.deserialize_cdr(data, 'sensor_msgs/msg/JointState')))


def test_a_bag_in_lock_step_is_replayed_to_the_last_bit_with_its_reset_and_settings(
        start, client, tmp_path):
    """A controller answers each state; the bag has scene, commands, a reset and a heavier tip."""
    node = start(sync='wait', sync_period=0.002, **{'rate.modal_state': 500.0})
    recorder, seen = Recorder(client), []
    command = client.command(JointState, EFFORT)
    reset = client.service(Trigger, '/timo_sim/reset')
    change = client.service(SetParameters, '/timo_sim/set_parameters')

    def control(state):
        seen.append(state)
        command.publish(JointState(
            header=state.header, name=['shaft', 'carrier_x'],
            effort=[3.0 * np.cos(40.0 * stamp(state)) - state.velocity[2], -state.velocity[0]]))

    client.create_subscription(JointState, STATES, control, 100)
    client.wait(lambda: len(seen) > 100, 'states')
    assert change(parameters=[Parameter('end_effector.mass', value=4.0).to_parameter_msg()])
    client.wait(lambda: len(seen) > 200, 'states with a heavier tip')
    assert reset().success
    client.wait(lambda: len(seen) > 300, 'states after the reset')
    assert node.end()[0] == 0

    bag, lines = recorder.write(tmp_path / 'bag.mcap'), []
    assert replay(bag, show=lines.append), lines
    assert '1 resets' in lines[0] and any('all are the same to the last bit' in line
                                          for line in lines), lines
    # The log of the node says which commands acted, and from which step on.
    ours, theirs = Recording(bag), Recording(node.log)
    acting, sent = ({tuple(each): value for *each, value in zip(
        series.step, series.resets, series.data)} for series in (
            theirs.topics['~/joint_command'], ours.topics['~/joint_command']))
    assert len(acting) > 250 and acting.items() <= sent.items()
    assert ours.changes == theirs.changes and ours.changes[0][2] == {'end_effector.mass': 4.0}
    assert ours.resets.tolist() == theirs.resets.tolist()
    assert open_log(bag).scene == theirs.scene

    # A recorder that discovers a topic late misses its first messages.
    for missed in [each for each in recorder.messages if each[2] == STATES][:40]:
        recorder.messages.remove(missed)
    assert replay(recorder.write(tmp_path / 'late.mcap'), show=lines.append), lines

    # Another simulator, such as a second robot, publishes a clock that runs ahead.
    clock = Clock()
    clock.clock.sec, clock.clock.nanosec = 1000, 500000
    recorder.messages.append((*recorder.messages[-1][:2], '/clock', serialize_message(clock)))
    lines.clear()
    assert replay(recorder.write(tmp_path / 'clock.mcap'), show=lines.append), lines
    assert ' in 1000' not in lines[0]

    without = recorder.write(tmp_path / 'without.mcap', [STATES, '/timo_sim/modal_state'])
    with pytest.raises(LogError, match='has no states of /timo_sim, between which its commands'):
        replay(without, show=lines.append)
    recorder.messages += [(logged, sent + 1, *rest) for logged, sent, *rest in recorder.messages
                          if rest[0] == SCENE]
    with pytest.raises(LogError, match='has 2 runs of /timo_sim: cut the bag'):
        Recording(recorder.write(tmp_path / 'twice.mcap'))


def test_a_bag_of_a_free_run_has_its_commands_and_their_time_outs(start, client, tmp_path):
    """They act within some milliseconds of the step at which they did; no message says which."""
    node = start(command_timeout=0.2)
    recorder, seen = Recorder(client), []
    torque = client.command(Float64, TORQUE)
    client.create_subscription(JointState, STATES, seen.append, 100)
    client.wait(lambda: seen, 'states')
    change = client.service(SetParameters, '/timo_sim/set_parameters')

    def set_timeout(value):
        assert change(parameters=[Parameter(
            'command_timeout', value=value).to_parameter_msg()]).results[0].successful

    # The last command is in force for longer than the time-out that ends it.
    for force, timeout, later in (2.0, 0.2, 0.2), (3.0, 0.1, 0.1), (4.0, 0.0, 0.05):
        set_timeout(timeout)
        torque.publish(Float64(data=force))
        client.wait(lambda: seen[-1].effort[2] == force, 'the torque')
        if not timeout:
            until = stamp(seen[-1]) + 0.3
            client.wait(lambda: stamp(seen[-1]) > until, 'a command that is held')
        set_timeout(later)
        client.wait(lambda: seen[-1].effort[2] == 0.0, 'the time-out')
    assert node.end()[0] == 0
    bag, lines = recorder.write(tmp_path / 'bag.mcap'), []
    assert replay(bag, output=tmp_path / 'again.mcap', show=lines.append), lines
    assert '6 commands and 0 resets' in lines[0] and 'compared' in lines[1], lines
    begin, end = Recording(tmp_path / 'again.mcap').topics['~/motor_torque'].step.reshape(3, 2).T
    ours, ended = Recording(node.log).topics['~/motor_torque'].step.reshape(3, 2).T
    assert (end - begin).tolist()[:2] == [200, 100] and end[2] == ended[2]
    # On a busy machine the message may come late; the states around it bound its time.
    assert (abs(begin - ours) < 100).all()
    replay(bag, {'integrator.step': 0.0005}, tmp_path / 'finer.mcap', show=lines.append)
    finer = Recording(tmp_path / 'finer.mcap').topics['~/motor_torque'].step.reshape(3, 2).T
    assert (finer[1] - finer[0]).tolist()[:2] == [400, 200] and finer[1, 2] == 2 * ended[2]

    assert any('same to the last bit' in line for line in replayed(node.log))
