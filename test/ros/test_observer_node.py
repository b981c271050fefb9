# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The node `observer` beside a `sim_node`: its estimates against the motion, bad messages."""

from itertools import count
from math import inf, nan, sin
import subprocess
import sys

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3Stamped
import numpy as np
import pytest
from ros_process import nanoseconds
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64, Float64MultiArray, Header

ARM = {'carrier.held': 'both', 'arm.damping_ratio': '[0.01]', 'sensor.encoder.noise': 1e-4,
       'sensor.encoder.resolution': 2e-4, 'sensor.root_strain.noise': 2e-6}
NAME = '/timo_sim/observer/'
START = 1795685525 * 10**9  # a time of the wall clock [ns]


def test_estimates_of_a_moving_arm(start, client):
    """In lock step, so that all know when a torque acts; how the arm is bent at first is not."""
    node = start(record=False, sync='wait', sync_period=0.01, **ARM,
                 **{'initial.modal_coordinates': '[0.05, 0.0, 0.0]'})
    true = client.collect(Vector3Stamped, '/timo_sim/tip_deflection')
    modes = client.collect(JointState, '/timo_sim/modal_state')
    observer = start(main='observer', **ARM)
    found = client.collect(Vector3Stamped, f'{NAME}tip_deflection')
    deviations = client.collect(Vector3Stamped, f'{NAME}tip_deviation')
    estimated = client.collect(JointState, f'{NAME}modal_state')
    matrices = client.collect(Float64MultiArray, f'{NAME}covariance')
    torque = client.create_publisher(Float64, '/timo_sim/motor_torque', 10)
    client.wait(lambda: torque.get_subscription_count() == 2, 'both nodes')
    client.create_subscription(JointState, '/joint_states', lambda state: torque.publish(
        Float64(data=5.0 * sin(6e-9 * nanoseconds(state)))), 10)
    client.wait(lambda: min(map(len, (found, deviations, estimated, matrices))) > 250, 'estimates')
    assert observer.end()[0] == node.end()[0] == 0

    at = {nanoseconds(message): message.vector.y for message in true}
    modes = {nanoseconds(message): message for message in modes}
    wide = {nanoseconds(message): message.vector.y for message in deviations}
    errors = np.array([(message.vector.y - at[stamp]) / wide[stamp] for message in found
                       if (stamp := nanoseconds(message)) in at and stamp in wide])
    assert len(errors) > 100 and np.ptp([*at.values()]) > 5e-3
    # Errors are correlated over some ten samples.
    assert (abs(errors) < 3.0).mean() > 0.97

    # The covariance is that of the modes, too.
    layout, names = matrices[-1].layout, matrices[-1].layout.dim[0].label.split(', ')
    assert [each.size for each in layout.dim] == [9, 9] and layout.data_offset == 1
    assert names[1] == 'mode_1_m_sqrt_kg' and names[-1] == 'disturbance_torque_N_m'
    covariance = {round(1e9 * each.data[0], -5): np.reshape(each.data[1:], (9, 9))
                  for each in matrices}
    squares = [(message.position[0] - modes[stamp].position[0])**2
               / covariance[round(stamp, -5)][1, 1] for message in estimated
               if (stamp := nanoseconds(message)) in modes and round(stamp, -5) in covariance]
    assert len(squares) > 100 and np.mean(np.array(squares) < 9.0) > 0.97
    assert estimated[-1].name == ['mode_1', 'mode_2', 'mode_3']


def test_bad_messages_are_counted_and_do_not_stop_it(start, client):
    """A real arm: stamps of the wall clock, an IMU, and much that cannot be used."""
    node = start(main='observer', **{**ARM, 'sensor.gyro.noise': 1e-3, 'initial.shaft': 0.0})
    found = client.collect(Vector3Stamped, f'{NAME}tip_deflection')
    encoder = client.create_publisher(JointState, '/timo_sim/encoder', 10)
    imu = client.create_publisher(Imu, '/timo_sim/tip_imu/data_raw', 10)
    torque = client.create_publisher(Float64, '/timo_sim/motor_torque', 10)
    client.wait(lambda: encoder.get_subscription_count() and imu.get_subscription_count()
                and torque.get_subscription_count(), 'subscriptions')

    def send(step, position=(0.3,), names=('shaft',), start=START):
        message = JointState(name=[*names], position=[*position])
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(
            start + round(10**7 * step), 10**9)
        encoder.publish(message)

    # Which messages come first, while nodes discover each other, is not known: an estimate that
    # nobody hears is not told again, so each try has a stamp of its own.
    tries = count()
    client.wait(lambda: send(0.1 * next(tries)) or found, 'an estimate')
    begin = START + 10**6 * next(tries)
    send(1, (nan,), start=begin)
    send(1, (0.3,), ('elbow',))
    send(1, ())
    torque.publish(Float64(data=inf))
    for _ in range(20):  # a state that is shown again, as while time stands, is nothing new
        send(3, start=begin)
    client.wait(lambda: nanoseconds(found[-1]) == begin + 3 * 10**7, 'the third')
    assert found[-1].vector.y == pytest.approx(0.0, abs=1e-3)
    send(2, start=begin)
    imu.publish(Imu(header=Header(stamp=Time(sec=START // 10**9))))
    send(4, start=begin)
    client.wait(lambda: nanoseconds(found[-1]) == begin + 4 * 10**7, 'the fourth')
    # A simulation with time from 0 on takes the place of the arm.
    for step in range(12):
        send(step, (1.0,), start=0)
    client.wait(lambda: nanoseconds(found[-1]) == 11 * 10**7, 'the other clock')
    code, output = node.end()
    assert code == 0 and 'command refused, data must be finite, got inf' in output
    assert int(output.splitlines()[-1].split("'repeated': ")[1].split(',')[0]) > 0
    assert "'late': 2, 'refused': 3, 'begun again': 1}" in output.splitlines()[-1]


READY = """
import sys
import rclpy
from timo_sim.compiled import machine
from timo_sim.ros.observer import ObserverNode
rclpy.init()
node = ObserverNode(None)
loaded = {*machine._ADDRESSES}
assert loaded
node._observer.update({'encoder': 0.0}, {'torque': 1.0}, 0.01)
sys.exit({*machine._ADDRESSES} != loaded)
"""


def test_all_is_compiled_before_it_says_that_it_observes():
    subprocess.run([sys.executable, '-c', READY, '--ros-args', '-p', 'sensor.encoder.noise:=1e-4'],
                   check=True)


@pytest.mark.parametrize('parameters, text', [
    ({}, 'an observer needs sensors whose sensor.NAME.noise or .resolution is > 0, here none'),
    ({**ARM, 'disturbance': '[0.02]'}, 'disturbance must be [N m, s], got [0.02]'),
    ({**ARM, 'disturbance': '[-1.0, 0.1]'}, 'disturbance must be a list of finite numbers >= 0'),
    ({**ARM, 'sensor.encoder.delay': 0.01}, 'sensor.encoder.delay must be 0 s for the node'),
    ({**ARM, 'sensor.encoder.nois': 1.0}, 'did you mean sensor.encoder.noise'),
])
def test_parameters_that_it_cannot_use_end_it(parameters, text, start):
    code, output = start(main='observer', **parameters).wait()
    assert code == 2 and text in output
