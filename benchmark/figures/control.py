# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Compare the controllers in example/, in a loop without ROS: settling time, residual vibration.

It prints Markdown tables, and draws doc/control.png. Noise and limits are those of
example/slew.yaml.
"""

import sys
import time

import numpy as np

from benchmark import ROOT
from benchmark.drawing import BLACK, BLUE, GREEN, name_ends, RED, save, sheet
from benchmark.report import parser, table
import timo_sim

sys.path.append(str(ROOT / 'example'))
import carrier  # noqa: E402
from loop import in_a_loop  # noqa: E402
from lqr import LQR  # noqa: E402
import mppi  # noqa: E402
from pd import PD, turn  # noqa: E402
from shaping import shaped  # noqa: E402
import slew  # noqa: E402

PLANTS = {
    'as modelled': {},
    'tip 10 % heavier': {'end_effector.mass': 2.2},
    '1 N s stroke on the tip': {'load.tip_force_y.piecewise.time': [1.0, 1.05],
                                'load.tip_force_y.piecewise.value': [20.0, 0.0]},
}


class Planned(PD):
    """PD on the plan of the LQR, whose torque is fed forward."""

    def __init__(self, scene):
        self._plan, names = LQR(scene).plan, timo_sim.linearize(scene).states
        places = [names.index(name) for name in ('shaft_rad', 'shaft_velocity_rad_per_s')]
        super().__init__(lambda t: self._plan.at(t).x[places])

    def effort(self, t, seen):
        """Return the torque on the shaft [N m] that answers what is seen."""
        return {'shaft': super().effort(t, seen)['shaft'] + self._plan.at(t).u[0]}


SLEWS = {'PD': lambda scene: PD(turn), 'ZV': lambda scene: shaped(scene, 'ZV'),
         'ZVD': lambda scene: shaped(scene, 'ZVD'), 'EI': lambda scene: shaped(scene, 'EI'),
         'LQR': LQR,
         "PD on the LQR's plan": Planned}
# With a motor that is too weak for the plan of 2 s.
WEAK = {'ZV': SLEWS['ZV'], 'LQR, plan of 3 s': lambda scene: LQR(scene, 3.0),
        'LQR, shortest plan': lambda scene: LQR(scene, None), 'MPPI': mppi.MPPI}
PAYLOAD = 2.0  # [kg]
COLOURS = {'PD': RED, 'ZV': BLACK, 'ZVD': GREEN, 'LQR': BLUE}


def told(score):
    """Return settling time and residual vibration as text."""
    return f'{settling(score)}, {1e3 * score.residual:.2f} mm'


def settling(score):
    """Return the settling time as text."""
    return f'{score.settled:.2f} s' if np.isfinite(score.settled) else 'not within 5 s'


def slews(scene):
    """Return the rows of the table of slews, and the records on the plant as modelled."""
    rows, records = [], {}
    for name, make in SLEWS.items():
        cells = []
        for plant, values in PLANTS.items():
            record = in_a_loop(scene.vary(values), make(scene), slew.DURATION + 3.0)
            records.setdefault(name, record)
            cells.append(told(slew.score(record)))
        rows.append([name, *cells, f'{np.abs(records[name][:, 9]).max():.1f} N m'])
    return rows, records


def weak(scene):
    """Return the rows of slews with a weak motor, and the median time of a plan of MPPI [s]."""
    scene, times = scene.vary({'motor.torque_limit': mppi.LIMIT}), []

    class Timed(mppi.MPPI):
        def replan(self, x):
            start = time.perf_counter()
            super().replan(x)
            times.append(time.perf_counter() - start)

    rows = []
    for name, make in {**WEAK, 'MPPI': Timed}.items():
        records = [in_a_loop(scene.vary(values), make(scene), slew.DURATION + 3.0)
                   for values in PLANTS.values()]
        rows.append((name, *map(settling, map(slew.score, records))))
    return rows, float(np.median(times))


def carries(scene):
    """Yield the rows of the table of slews with a payload, which a controller knows or not."""
    loaded = scene.vary({'end_effector.mass': scene.values['end_effector.mass'] + PAYLOAD})
    for name in ('LQR', "PD on the LQR's plan"):
        yield name, *(told(slew.score(in_a_loop(loaded, SLEWS[name](known), slew.DURATION + 3.0)))
                      for known in (scene, loaded))


def moves(scene):
    """Yield the rows of the table of motions of the carrier."""
    free = scene.vary({'carrier.held': 'none'})
    for name, controller in (
            ('PD', carrier.Follower(carrier.rigid(free), False)),
            ("PD, a rigid arm's forces fed forward", carrier.Follower(carrier.rigid(free))),
            ("PD, the flexible arm's forces fed forward", carrier.Follower(free))):
        record = in_a_loop(free, controller, slew.DURATION + 3.0)
        score = slew.score(record, carrier.GOAL)
        yield name, f'{score.settled:.2f} s', f'{1e3 * score.residual:.3f} mm'


def draw(records):
    """Draw the slews over each other, and how far the tip is from its goal."""
    figure, axes = sheet(3, height=6.8, sharex=True)
    for name, colour in COLOURS.items():
        record = records[name]
        t, off = record[:, 0], 1e3 * slew.distance(record)
        axes[0].plot(t, record[:, 9], color=colour, linewidth=1.0)
        axes[1].plot(t, 1e3 * record[:, 11], color=colour)
        # The largest distance from then on: once below the line the tip stays near its goal.
        axes[2].semilogy(t, np.maximum.accumulate(off[::-1])[::-1], color=colour, label=name)
    for each, label in zip(axes, ('torque [N m]', 'tip deflection [mm]',
                                  'tip off its goal,\nat most from then on [mm]')):
        each.set(ylabel=label)
        each.grid(alpha=0.3)
        each.axvline(slew.DURATION, color='grey', linestyle=':')
    axes[2].axhline(1e3 * slew.NEAR, color='grey', linestyle=':')
    axes[2].set(xlabel='t [s]', xlim=(0.0, t[-1]), ylim=(1e-3, 2e3))
    figure.align_ylabels(axes)
    name_ends(axes[2])
    save(figure, 'control')


def main():
    """Print the tables and draw the picture."""
    parser(__spec__, __doc__).parse_args()
    scene = timo_sim.load_scene(slew.SCENE)
    rows, records = slews(scene)
    print(table(['', *PLANTS, 'peak torque'], rows))
    draw(records)
    print('\ndoc/control.png is drawn\n')
    print(table([f'with {PAYLOAD:g} kg more at the tip', 'payload not known', 'payload known'],
                carries(scene)) + '\n')
    rows, span = weak(scene)
    print(table([f'motor of {mppi.LIMIT:g} N m', *PLANTS], rows))
    print(f'\na plan of MPPI: {1e3 * span:.0f} ms, for {1e3 * mppi.HOLD:g} ms\n')
    print(table(['carrier by 0.5 m', 'settled', 'residual'], moves(scene)))


if __name__ == '__main__':
    main()
