# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Carrier feed-forward: the carrier moves by 0.5 m across the arm, which should stay calm.

    ros2 run timo_sim sim_node --ros-args --params-file example/slew.yaml -p carrier.held:=none
    python example/carrier.py flexible --plot carrier.png

PD control of carrier and shaft leaves a vibration, also if the forces that a rigid arm needs are
fed forward. If the forces that bring the flexible arm to rest are fed forward, and the reference
is the motion that they cause, almost no vibration is left.
"""

from loop import PERIOD
import numpy as np
from slew import DURATION, main, SCENE
import timo_sim

GOAL = 0.0, 0.5, 0.0                            # carrier x, y [m], shaft [rad]
JOINTS = 'carrier_x', 'carrier_y', 'shaft'
INPUTS = 'force_x_N', 'force_y_N', 'torque_N_m'
SEEN = ('carrier_x_m', 'carrier_y_m', 'shaft_rad', 'carrier_x_velocity_m_per_s',
        'carrier_y_velocity_m_per_s', 'shaft_velocity_rad_per_s')
STIFFNESS = np.array([2000.0, 2000.0, 1000.0])  # [N/m], [N m/rad]
DAMPING = np.array([600.0, 600.0, 100.0])       # [N s/m], [N m s/rad]


class Follower:
    """
    Moves carrier and shaft along a plan.

    Parameters
    ----------
    scene : timo_sim.Scene
        For which the motion is planned.
    feed_forward : bool
        Whether the plan's forces are fed forward.

    """

    def __init__(self, scene, feed_forward=True):
        model = timo_sim.linearize(scene, inputs=INPUTS, outputs=SEEN).to_discrete(PERIOD)
        self.plan = timo_sim.feedforward(model, dict(zip(SEEN, GOAL)), DURATION)
        self.feed_forward = feed_forward

    def effort(self, t, seen):
        """Return the forces on the carrier [N] and the torque on the shaft [N m]."""
        plan = self.plan.at(t)
        off = plan.y - seen.joints[:6]
        forces = self.feed_forward * plan.u + STIFFNESS * off[:3] + DAMPING * off[3:]
        return dict(zip(JOINTS, forces.tolist()))


def rigid(scene):
    """Return the scene with an arm that does not bend."""
    return scene.vary({'model.modes': 0})


if __name__ == '__main__':
    main(__doc__, timo_sim.load_scene(SCENE, {'carrier.held': 'none'}), {
        'PD': lambda scene: Follower(rigid(scene), False),
        'rigid': lambda scene: Follower(rigid(scene)),
        'flexible': Follower}, goal=GOAL)
