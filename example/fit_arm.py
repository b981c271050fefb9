# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Fit the model to an arm that was excited by a chirp, and slew the arm with the LQR of the fit.

The arm is a node whose parameters the model does not know; start it for each of the two commands:

    ros2 run timo_sim sim_node --ros-args --params-file example/slew.yaml \
        -p arm.young_modulus:=60.0e+9 -p motor.viscous_friction:=2.0 -p end_effector.mass:=3.0 \
        -p record_file:=arm.mcap     # and record_file:=fitted.mcap

    python example/fit_arm.py              # excites the arm
    python example/fit_arm.py arm.mcap     # fits the log and slews the arm

`python example/lqr.py` slews it with the LQR of the first guess, slew.yaml.
"""

from argparse import ArgumentParser
import math

from lock_step import with_the_node
from lqr import LQR
from slew import SCENE, score
import timo_sim

TORQUE, BEGIN, RISE = 3.0, 0.2, 1.2  # of the chirp [N m], its frequency at first [Hz], [Hz/s]
SENSORS = 'shaft', 'root_strain'     # encoder and strain gauge; the log also has the true motion
FREE = ('arm.young_modulus', 'motor.shaft_inertia', 'motor.viscous_friction', 'end_effector.mass',
        'end_effector.inertia')
GUESS = {'motor.viscous_friction': 1.0}  # a friction > 0 to begin with


class Chirp:
    """Excites the arm by a torque whose frequency rises through that of its first mode."""

    def effort(self, t, seen):
        """Return the torque on the shaft [N m] at t [s], whatever is seen."""
        return {'shaft': TORQUE * math.sin(2.0 * math.pi * (BEGIN + 0.5 * RISE * t) * t)}


def fit(log):
    """Return the Fit of the first guess to torque, encoder and strain gauge in a log."""
    record = timo_sim.read_record(log).select(*SENSORS)
    return timo_sim.fit(timo_sim.load_scene(SCENE, GUESS), record, FREE)


if __name__ == '__main__':
    parser = ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('log', nargs='?', help='to be fitted; without it, the arm is excited')
    log = parser.parse_args().log
    if log:
        found = fit(log)
        print(found.report())
        print(score(with_the_node(LQR(found.scene))))
    else:
        print(f'{len(with_the_node(Chirp()))} states answered')
