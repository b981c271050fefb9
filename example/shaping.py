# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Input shaping: the slew of a PD-controlled shaft in two or three parts whose vibrations cancel.

    ros2 run timo_sim sim_node --ros-args --params-file example/slew.yaml
    python example/shaping.py ZVD --plot shaping.png

ZV, ZVD and EI shape a shorter slew, so that the shaped one takes as long as the slew of the other
examples.
"""

import numpy as np
from pd import DAMPING, PD, STIFFNESS, turn
from slew import DURATION, main, SCENE
import timo_sim


def vibration(scene):
    """Return the pole of the slowest vibration with the PD loop closed, upper half plane [1/s]."""
    model = timo_sim.linearize(scene, inputs=['torque_N_m'],
                               outputs=['shaft_rad', 'shaft_velocity_rad_per_s'])
    poles = np.linalg.eigvals(model.A - model.B @ [[STIFFNESS, DAMPING]] @ model.C)
    return min(poles[poles.imag > 0.0], key=abs)


def shaped(scene, kind):
    """Return the PD controller of a slew that is shaped for a scene."""
    shaper = timo_sim.shaper([vibration(scene)], kind)
    return PD(shaper.shape(lambda t: turn(t, DURATION - shaper.times[-1])))


if __name__ == '__main__':
    main(__doc__, timo_sim.load_scene(SCENE), {
        kind: lambda scene, kind=kind: shaped(scene, kind) for kind in ('ZV', 'EI', 'ZVD')})
