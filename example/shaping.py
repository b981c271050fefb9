# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Input shaping: the slew of a PD-controlled shaft in two or three parts whose vibrations cancel.

    ros2 run timo_sim sim_node --ros-args --params-file example/slew.yaml
    python example/shaping.py ZVD --plot shaping.png

ZV (zero vibration) makes a slew longer by half a period of the vibration; ZVD (zero vibration and
derivative) by a whole one, and tolerates errors of the frequency. Both shape a shorter slew, so
that the shaped one takes as long as the slew of the other examples.
N. C. Singer, W. P. Seering, J. Dyn. Syst. Meas. Control 112 (1990) 76-82.
"""

import numpy as np
from pd import DAMPING, PD, STIFFNESS
from slew import DURATION, GOAL, main, SCENE, smooth
import timo_sim


def vibration(scene):
    """Return the pole of the slowest vibration with the PD loop closed, upper half plane [1/s]."""
    model = timo_sim.linearize(scene).select(['torque_N_m'],
                                             ['shaft_rad', 'shaft_velocity_rad_per_s'])
    poles = np.linalg.eigvals(model.A - model.B @ [[STIFFNESS, DAMPING]] @ model.C)
    return min(poles[poles.imag > 0.0], key=abs)


def shaper(pole, kind):
    """
    Return times [s] and sizes, shape (n,), of the impulses after which a pole does not vibrate.

    Parameters
    ----------
    pole : complex
        [1/s].
    kind : str
        'none', 'ZV' or 'ZVD'.

    """
    half = np.pi / pole.imag
    step = np.array([1.0, np.exp(pole.real * half)])
    sizes = {'none': [1.0], 'ZV': step, 'ZVD': np.convolve(step, step)}[kind]
    return half * np.arange(len(sizes)), sizes / np.sum(sizes)


class Shaped:
    """A shaped slew, as a reference for PD: slews of some sizes that begin at some times [s]."""

    def __init__(self, times, sizes, duration):
        self.times, self.sizes, self.duration = times, sizes, duration

    def __call__(self, t):
        """Return angle [rad] and speed [rad/s] at a time [s]."""
        part, rate = smooth(t - self.times, self.duration)
        return GOAL[2] * self.sizes @ part, GOAL[2] * self.sizes @ rate


def shaped(scene, kind):
    """Return the PD controller of a slew that is shaped for a scene."""
    times, sizes = shaper(vibration(scene), kind)
    return PD(Shaped(times, sizes, DURATION - times[-1]))


if __name__ == '__main__':
    main(__doc__, timo_sim.load_scene(SCENE), {
        kind: lambda scene, kind=kind: shaped(scene, kind) for kind in ('none', 'ZV', 'ZVD')})
