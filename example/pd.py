# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
PD control of the shaft by its encoder: the arm goes on vibrating after the slew.

    ros2 run timo_sim sim_node --ros-args --params-file example/slew.yaml -p record_file:=pd.mcap
    python example/pd.py --plot pd.png

The run is the same to the last bit however busy the machine is, and ends with the node. `timo_sim
view pd.mcap` shows it. `--loop` does the same without ROS.
"""

from loop import PERIOD
from slew import DURATION, GOAL, main, SCENE, smooth
import timo_sim

STIFFNESS, DAMPING = 1000.0, 100.0  # [N m/rad], [N m s/rad]


class PD:
    """
    Turns the shaft along a reference.

    Parameters
    ----------
    reference : function(float) -> (float, float)
        Angle [rad] and speed [rad/s] at a time [s].

    """

    def __init__(self, reference):
        self.reference, self.last = reference, None

    def effort(self, t, seen):
        """Return the torque on the shaft [N m] that answers what is seen."""
        turned = 0.0 if self.last is None else seen.encoder - self.last
        self.last = seen.encoder
        angle, speed = self.reference(t)
        return {'shaft': STIFFNESS * (angle - seen.encoder)
                + DAMPING * (speed - turned / PERIOD)}


def turn(t, duration=DURATION):
    """Return angle [rad] and speed [rad/s] of a smooth slew at a time [s]."""
    part, rate = smooth(t, duration)
    return GOAL[2] * part, GOAL[2] * rate


if __name__ == '__main__':
    main(__doc__, timo_sim.load_scene(SCENE), {'PD': lambda scene: PD(turn)})
