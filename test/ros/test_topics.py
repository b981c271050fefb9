# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Topics: the physics and sensor readings that they carry, their rates and QoS, their replay."""

from geometry_msgs.msg import PoseStamped, Vector3Stamped
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages
import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from ros_process import nanoseconds, Process, replayed
from sensor_msgs.msg import Imu, JointState
from std_srvs.srv import Trigger

import timo_sim
from timo_sim.log.tables import Recording
from timo_sim.ros.topics import message_class
from timo_sim.runs.replay import replay
from timo_sim.simulation.snapshot import reading
from timo_sim.topics.outputs import outputs


def test_topics_carry_the_physics(start, client, paper):
    node = start('--params-file', str(paper), record=False)
    joints = client.collect(JointState, '/joint_states')
    modes = client.collect(JointState, '/timo_sim/modal_state')
    deflections = client.collect(Vector3Stamped, '/timo_sim/tip_deflection')
    tips = client.collect(PoseStamped, '/timo_sim/tip_pose')
    carriers = client.collect(PoseStamped, '/timo_sim/carrier_pose')
    for received in (joints, modes, deflections, tips, carriers):
        client.wait(lambda: len(received) >= 30, 'messages')
    assert node.end()[0] == 0

    run = timo_sim.simulate(timo_sim.load_scene(paper), 1.0 + 1e-9 * nanoseconds(joints[-1]),
                            sample_every=10)

    def at(message):
        return round(1e-7 * nanoseconds(message))

    for joint in joints:
        k = at(joint)
        assert joint.name == ['carrier_x', 'carrier_y', 'shaft']
        assert np.array_equal(joint.position, run.values[k, :3])
        assert np.array_equal(joint.velocity, run.values[k, 6:9])
        assert joint.effort == pytest.approx(
            5 * np.sin(2 * np.pi * np.array([2, 3, 4]) * run.t[k]), abs=1e-12)
    for mode in modes:
        assert mode.name == ['mode_1', 'mode_2', 'mode_3'] and not mode.effort
        assert np.array_equal(mode.position, run.q[at(mode)])
        assert np.array_equal(mode.velocity, run.qdot[at(mode)])
    across, rotation, position = run.deflection(2.0), run.rotation(2.0), run.position(2.0)
    for deflection in deflections:
        assert deflection.header.frame_id == 'arm'
        assert (deflection.vector.x, deflection.vector.y) == pytest.approx(
            across[at(deflection)], abs=1e-14)
    for tip in tips:
        k, z, w = at(tip), tip.pose.orientation.z, tip.pose.orientation.w
        assert tip.header.frame_id == 'world'
        assert (tip.pose.position.x, tip.pose.position.y) == pytest.approx(position[k], abs=1e-14)
        assert 2 * np.arctan2(z, w) == pytest.approx(run.shaft[k] + rotation[k], abs=1e-14)
    for carrier in carriers:
        place = carrier.pose.position
        assert (place.x, place.y) == tuple(run.carrier[at(carrier)])
        assert carrier.pose.orientation.w == 1.0
    stamps = [at(joint) for joint in joints]
    assert stamps == list(range(stamps[0], stamps[0] + len(stamps)))


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


def test_subscribers_of_sensor_data_receive_every_topic(start, client):
    start(record=False, publish_clock=True)
    heard, topics = {}, {output.name: output.type_name for output in outputs(3, gear=False)}
    assert len(topics) >= 9
    for topic, type_name in topics.items():
        full = topic.replace('~', '/timo_sim') if topic[0] in '~/' else f'/{topic}'
        heard[topic] = []
        client.create_subscription(message_class(type_name), full, heard[topic].append,
                                   qos_profile_sensor_data)
    client.wait(lambda: all(heard.values()), 'a message of each topic')


WRONG = {'sensor.seed': 7, 'sensor.encoder.noise': 1e-3, 'sensor.encoder.resolution': 1e-4,
         'sensor.root_strain.noise': 1e-6, 'sensor.gyro.bias': 0.01, 'sensor.gyro.noise': 2e-3,
         'sensor.gyro.resolution': 5e-3, 'sensor.tip_acceleration.noise': 0.05}
LATE = {'sensor.encoder.delay': 0.005, 'sensor.tip_imu.delay': 0.003}
MOVING = {'initial.shaft_velocity': 2.0, 'initial.modal_rates': [2.0, 0.5, 0.1]}


def step_of(message):
    """Return the time step, of 1 ms, that the stamp of a message names."""
    return nanoseconds(message) // 1000000


def lateness(log, topic):
    """Return the delays of logged messages, in steps after the step that they name."""
    with open(log, 'rb') as stream:
        return {message.log_time // 1000000 - message.sequence
                for _, _, message in make_reader(stream).iter_messages([topic])}


def test_a_delayed_message_comes_later_with_the_time_of_measurement(start, client):
    """Every message comes at its step; a reset drops those that have not come yet."""
    node = start(start_paused=True, **WRONG, **LATE, **MOVING, **{
        'rate.encoder': 500.0, 'rate.joint_states': 1000.0, 'rate.tip_imu': 250.0})
    states = client.collect(JointState, '/joint_states')
    angles = client.collect(JointState, '/timo_sim/encoder')
    motions = client.collect(Imu, '/timo_sim/tip_imu/data_raw')
    step, reset = (client.service(Trigger, f'/timo_sim/{name}') for name in ('step', 'reset'))
    first = 0

    def advance(until):
        for now in range(step_of(states[-1]) + 1 if states else 1, until + 1):
            assert step().success
            client.wait(lambda: states and step_of(states[-1]) == now, f'step {now}')
            for received, every, delay in ((angles, 2, 5), (motions, 4, 3)):
                expected = [at for at in range(first, now - delay + 1) if at % every == 0]
                client.wait(lambda: len(received) >= len(expected), f'messages by step {now}')
                assert [step_of(message) for message in received] == expected

    assert reset().success  # the node knows all subscribers, and measures at step 0
    advance(12)
    assert reset().success
    angles.clear(), motions.clear()
    first = 12
    advance(30)
    assert client.service(SetParameters, '/timo_sim/set_parameters')(parameters=[
        Parameter('sensor.gyro.noise', value=0.0).to_parameter_msg()]).results[0].successful
    advance(35)  # one more message is measured with the new noise
    assert node.end()[0] == 0

    # A reading is that of the true angle at the time of the header.
    truth = {step_of(state): state.position[2] for state in states}
    scene = timo_sim.load_scene(WRONG)
    for message in angles:
        assert message.name == ['shaft'] and not message.velocity and not message.effort
        assert tuple(message.position) == reading(
            scene, 'encoder', step_of(message), (truth[step_of(message)],))
    assert motions[0].header.frame_id == 'tip' and motions[0].orientation_covariance[0] == -1.0
    assert motions[0].linear_acceleration.z == 9.80665
    assert [message.angular_velocity_covariance[8] for message in motions] == pytest.approx(
        5 * [2e-3**2 + 5e-3**2 / 12.0] + [5e-3**2 / 12.0], rel=1e-15)

    recording = Recording(node.log)
    found = {name: series.step.tolist() for name, series in recording.topics.items()}
    assert found['~/encoder'] == [0, 2, 4, 6, *range(12, 32, 2)]
    assert found['~/tip_imu/data_raw'] == [0, 4, 8, *range(12, 36, 4)]
    assert lateness(node.log, '/timo_sim/encoder') == {5}
    assert lateness(node.log, '/timo_sim/tip_imu/data_raw') == {3}
    # Nobody subscribed to the strain; a replay can compute it.
    assert found['~/root_strain'] == []
    replayed(node.log)
    again = node.log.with_name('again.mcap')
    replay(node.log, {'record_sensors': True}, output=again, show=lambda line: None)
    strain = Recording(again).topics['~/root_strain']
    assert strain.step.tolist() == found['joint_states'] and np.abs(strain.values).max() > 1e-4


@pytest.fixture(scope='module')
def log(tmp_path_factory):
    """Log half a second of all sensors, without subscribers."""
    node = Process(tmp_path_factory.mktemp('sensors'), record_sensors=True, duration=0.503,
                   real_time_factor=0.0, **WRONG, **LATE, **MOVING, **{'rate.tip_imu': 500.0})
    assert node.wait()[0] == 0
    return node.log


def test_sensors_are_logged_without_subscribers_and_replayed_to_the_last_bit(log, tmp_path):
    topics = Recording(log).topics
    # The log lacks messages whose delay was not over at the end.
    assert topics['~/tip_imu/data_raw'].step.tolist() == list(range(0, 502, 2))
    assert topics['~/encoder'].step.tolist() == list(range(0, 500, 10))
    assert topics['~/root_strain'].step.tolist() == list(range(0, 501, 10))
    count = sum(series.values.size for series in topics.values())
    assert f'{count} of {count} logged numbers' in '\n'.join(
        replayed(log, output=tmp_path / 'again.mcap'))
    again = Recording(tmp_path / 'again.mcap')
    for name, series in topics.items():
        assert np.array_equal(series.values, again.topics[name].values)
        assert np.array_equal(series.log_ns, again.topics[name].log_ns)
    # Another seed gives other numbers; with a longer delay fewer messages come before the end.
    lines = []
    replay(log, {'sensor.seed': 8, 'sensor.tip_imu.delay': 0.013}, output=tmp_path / 'other.mcap',
           show=lines.append)
    other = Recording(tmp_path / 'other.mcap').topics['~/tip_imu/data_raw']
    assert other.step.tolist() == list(range(0, 492, 2)) and other.log_ns[-1] == 503000000
    assert not any('same to the last bit' in line for line in lines)
    assert any(line.startswith('tip_imu turning_rad_per_s') for line in lines)


@pytest.fixture(scope='module')
def exact(log):
    """Replay the log with perfect sensors."""
    path = log.with_name('exact.mcap')
    replayed(log, {name: 0.0 for name in WRONG if name != 'sensor.seed'}, output=path)
    return path


def imu_of(path):
    """Return vectors (2, n, 3) and covariances (2, n, 9) of acceleration and turning rate."""
    found = [message.ros_msg
             for message in read_ros2_messages(str(path), ['/timo_sim/tip_imu/data_raw'])]
    vectors, covariances = ([[getattr(message, name + kind) for message in found] for name in (
        'linear_acceleration', 'angular_velocity')] for kind in ('', '_covariance'))
    return (np.array([[(each.x, each.y, each.z) for each in part] for part in vectors]),
            np.array(covariances))


def test_covariances_of_the_imu_are_those_of_its_errors(log, exact):
    """REP 145: known covariances are given; all zeros mean that they are unknown."""
    (read, told), (truth, silent) = imu_of(log), imu_of(exact)
    assert read.shape == truth.shape == (2, 251, 3) and not silent.any()
    for errors, matrices in zip(read - truth, told):
        assert (matrices == matrices[0]).all()
        covariance, variance = matrices[0].reshape(3, 3), errors.var(axis=0)
        assert (covariance == np.diag(np.diag(covariance))).all()
        assert ((np.diag(covariance) == 0.0) == (variance == 0.0)).all()
        noisy = variance > 0.0
        # The variance of 251 values is off by sqrt(2 / 250) = 9 %, three times that at most.
        assert np.diag(covariance)[noisy] == pytest.approx(variance[noisy], rel=0.27)
