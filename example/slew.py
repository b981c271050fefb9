# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
What the examples share: slew, score, picture, command line.

The arm turns by 45 degrees within 2 s, on a carrier with its brakes on; then it should be at rest.
"""

from argparse import ArgumentParser
import math
from pathlib import Path
from typing import NamedTuple

from loop import in_a_loop
import numpy as np

SCENE = Path(__file__).with_name('slew.yaml')
LENGTH = 2.0                  # of the arm [m]
DURATION = 2.0                # of the motion [s]
GOAL = 0.0, 0.0, math.pi / 4  # carrier x, y [m], shaft [rad]; all start at 0
NEAR = 1e-3                   # distance from its goal within which a tip has settled [m]
WINDOW = 1.0                  # time after the motion in which its vibration is measured [s]


def smooth(t, duration=DURATION):
    """Return the share of the way that a minimum-jerk motion has done at t [s], its rate [1/s]."""
    s = np.clip(t / duration, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 30.0 * (s * (1.0 - s))**2 / duration


class Score(NamedTuple):
    """Settling time [s], residual vibration and peak deflection of the tip [m]."""

    settled: float
    residual: float
    peak: float

    def __str__(self):
        settled = (f'within {1e3 * NEAR:g} mm of its goal from {self.settled:.2f} s on'
                   if self.settled < math.inf else
                   f'not settled within {1e3 * NEAR:g} mm of its goal when the run ended')
        return (f'tip {settled}, bent by up to {1e3 * self.peak:.1f} mm, '
                f'by {1e3 * self.residual:.1f} mm after {DURATION:g} s')


def distance(record, goal=GOAL):
    """Return the distance of the tip from its goal, shape (n,) [m], in a record."""
    def place(x, y, angle, along, across):
        return np.array([x + along * np.cos(angle) - across * np.sin(angle),
                         y + along * np.sin(angle) + across * np.cos(angle)])
    along, across = record[:, 10:].T
    meant = place(*goal, LENGTH, 0.0)
    return np.linalg.norm(
        place(*record[:, 1:4].T, LENGTH + along, across) - meant[:, np.newaxis], axis=0)


def score(record, goal=GOAL):
    """Return the Score of a record, see `loop.Seen.row`; `settled` is inf if it never settles."""
    t, bent = record[:, 0], np.abs(record[:, 11])
    calm = np.append(np.flatnonzero(distance(record, goal) > NEAR), -1).max() + 1
    after = (t >= DURATION) & (t <= DURATION + WINDOW)
    return Score(t[calm] if calm < len(t) else math.inf, bent[after].max(), bent.max())


def plot(record, title, file, goal=GOAL):
    """Draw a record: coordinate and effort of the moved joint, deflection and error of the tip."""
    from matplotlib.figure import Figure
    t = record[:, 0]
    moved = np.argmax(np.abs(goal))
    figure = Figure(figsize=(7.0, 7.0), layout='constrained')
    curves = {('carrier x [m]', 'carrier y [m]', 'shaft [rad]')[moved]: record[:, 1 + moved],
              ('force [N]', 'force [N]', 'torque [N m]')[moved]: record[:, 7 + moved],
              'tip deflection [mm]': 1e3 * record[:, 11],
              'tip off its goal [mm]': 1e3 * distance(record, goal)}
    panels = figure.subplots(len(curves), sharex=True)
    for axes, (label, curve) in zip(panels, curves.items()):
        axes.plot(t, curve)
        axes.set(ylabel=label)
        axes.axvline(DURATION, color='grey', linestyle=':')
    panels[0].set(title=title)
    panels[-1].axhline(1e3 * NEAR, color='grey', linestyle=':')
    panels[-1].set(yscale='log', xlabel='t [s]')
    figure.savefig(file)


def main(text, scene, controllers, **goal):
    """Run what the command line asks for: a controller by name, with the node or in a loop."""
    parser = ArgumentParser(description=text.strip().splitlines()[0])
    parser.add_argument('controller', nargs='?', choices=controllers, default=[*controllers][-1])
    parser.add_argument('--loop', action='store_true', help='without ROS, in a loop')
    parser.add_argument('--plot', metavar='FILE', help='file for a picture of the run')
    chosen = parser.parse_args()
    controller = controllers[chosen.controller](scene)
    if chosen.loop:
        record = in_a_loop(scene, controller)
    else:
        try:
            from lock_step import with_the_node
        except ModuleNotFoundError as error:
            parser.error(f'the node needs ROS 2 ({error}); --loop runs without it')
        record = with_the_node(controller)
    told = f'{chosen.controller}: {len(record)} states answered'
    if len(record) and record[-1, 0] > DURATION:
        told += f'; {score(record, **goal)}'
    print(told)
    if chosen.plot and len(record):
        plot(record, chosen.controller, chosen.plot, **goal)
