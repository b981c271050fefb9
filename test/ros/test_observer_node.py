# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The example of an observer beside a `sim_node`: its estimates against the motion."""

from itertools import pairwise
from math import sin
from pathlib import Path
import signal
import subprocess
import sys

from geometry_msgs.msg import Vector3Stamped
import numpy as np
from ros_process import nanoseconds, PATIENCE
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

import timo_sim

EXAMPLE = Path(__file__).resolve().parents[2] / 'example/observe.py'
ARM = {'carrier.held': 'both', 'sensor.encoder.noise': 1e-4, 'sensor.encoder.resolution': 2e-4,
       'sensor.root_strain.noise': 2e-6}
SENSORS = 'encoder', 'root_strain'


def answer(stamp):
    """Return the torque [N m] that answers the state with a stamp [ns]."""
    return 5.0 * sin(6e-9 * stamp)


def test_estimates_of_a_moving_arm(start, client, tmp_path):
    """
    In lock step; how the arm is bent at first is not known.

    The node uses each measurement once, with the torque that acted until then: so does an observer
    here, which knows the commands.
    """
    node = start(record=False, sync='wait', sync_period=0.01, **ARM,
                 **{'initial.modal_coordinates': '[0.05, 0.0, 0.0]'})
    true = client.collect(Vector3Stamped, '/timo_sim/tip_deflection')
    measured = {name: client.collect(JointState, f'/timo_sim/{name}') for name in SENSORS}
    scene = tmp_path / 'arm.yaml'
    scene.write_text('timo_sim: {ros__parameters: {' + ', '.join(
        f'{name}: {value}' for name, value in ARM.items()) + '}}')
    observer = subprocess.Popen([sys.executable, EXAMPLE, scene])
    found = client.collect(Vector3Stamped, '/observer/tip_deflection')
    deviations = client.collect(Vector3Stamped, '/observer/tip_deviation')
    torque = client.create_publisher(Float64, '/timo_sim/motor_torque', 10)
    try:
        client.wait(lambda: torque.get_subscription_count() and client.count_publishers(
            '/observer/tip_deflection'), 'both nodes')
        client.create_subscription(JointState, '/joint_states', lambda state: torque.publish(
            Float64(data=answer(nanoseconds(state)))), 10)
        client.wait(lambda: min(map(len, (found, deviations))) > 250, 'estimates')
    finally:
        observer.send_signal(signal.SIGINT)
    assert observer.wait(PATIENCE) == node.end()[0] == 0
    at, wide, found = ({nanoseconds(message): message.vector.y for message in messages}
                       for messages in (true, deviations, found))
    errors = np.array([(found[stamp] - at[stamp]) / wide[stamp]
                       for stamp in found if stamp in at and stamp in wide])
    assert len(errors) > 100 and np.ptp([*at.values()]) > 5e-3
    # Errors are correlated over some ten samples.
    assert (abs(errors) < 3.0).mean() > 0.97
    shown = {name: {nanoseconds(message): message.position[0] for message in messages}
             for name, messages in measured.items()}
    first, *stamps = (stamp for stamp in found if all(stamp in shown[name] for name in SENSORS))
    again = timo_sim.observer(
        timo_sim.load_scene(scene, {'initial.shaft': shown['encoder'][first]}), [*SENSORS])
    again.update({name: shown[name][first] for name in SENSORS}, dt=0.0)
    for before, stamp in pairwise([first, *stamps]):  # the first state is stamped 1 ns late
        again.update({name: shown[name][stamp] for name in SENSORS}, {'torque': answer(before)},
                     1e-8 * round(0.1 * (stamp - before)))
        assert abs(again.deflection()[1] - found[stamp]) < 1e-9 * np.ptp([*at.values()])
