# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Stress test of axial modes: hard scenes at N = 5 that must not diverge for an axial mode alone.

Random arms that buckle under a force along them that grows, bend far, spin and are thin, or are
soft and move freely, in steps of 1, 2 and 5 ms. Each is run with one axial mode and with none.
`python -m benchmark.stress.axial --only 17` does number 17 alone.
"""

import json
import math

import numpy as np

from benchmark.stress.at_rest import print_some
import timo_sim
from timo_sim.runs.run import run_scene

COUNT = 240
VERDICTS = ('tried', 'slowed down', 'diverge without', 'diverge with', 'diverge only with',
            'largest distance')
_STEPS, _MODES, _SECONDS = (1e-3, 2e-3, 5e-3), 5, 1.0


def drawn(number, seed=1):
    """Return name and values of a random scene, without axial modes."""
    random = np.random.default_rng([seed, 6, number])

    def log(low, high):
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    kind = KINDS[number % len(KINDS)]
    length, slenderness, density = log(0.3, 3.0), log(15.0, 150.0), log(1e3, 8e3)
    first = 2.0 * math.pi * log(0.5, 8.0)  # about the first frequency [rad/s]
    if kind is _spin:
        length, slenderness = log(0.5, 3.0), log(300.0, 1000.0)
    height = length / slenderness
    young = 12.0 * density * (first * length**2 / 3.52 / height)**2
    mass, stiffness = 2.0 * density * length * height**2, young * height**4 / 6.0
    values = {
        'arm.length': length, 'arm.section.height': height, 'arm.section.width': 2.0 * height,
        'arm.density': density, 'arm.young_modulus': young,
        'arm.shear_modulus': young * log(0.02, 0.4),
        'arm.damping_ratio': [log(1e-3, 0.1)] if random.random() < 0.5 else [],
        'end_effector.mass': mass * log(1e-2, 3.0) if random.random() < 0.7 else 0.0,
        'end_effector.inertia': 0.0, 'carrier.mass': mass * log(0.1, 10.0),
        'motor.mass': 0.1 * mass, 'motor.shaft_inertia': mass * length**2 * log(1e-2, 1.0),
        'model.modes': _MODES, 'integrator.step': float(random.choice(_STEPS)),
        'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.shaft': 0.0}
    return kind.__name__[1:].replace('_', ' '), {**values, **kind(
        random, log, stiffness / length**2, length, mass)}


def _table(channel, size):
    """Return a load that grows within three tenths of the time and stays."""
    return {f'load.{channel}.table.time': [0.0, 0.3 * _SECONDS],
            f'load.{channel}.table.value': [0.0, float(size)]}


def _buckling(random, log, force, length, mass):
    return {**_table('tip_force_x', -random.uniform(1.02, 2.5) * math.pi**2 / 4.0 * force),
            'load.tip_force_y.piecewise.time': [0.0],
            'load.tip_force_y.piecewise.value': [log(1e-4, 1e-2) * force]}


def _large_cantilever(random, log, force, length, mass):
    return {**_table('tip_force_y', random.uniform(1.5, 10.0) * force),
            **_table('tip_force_x', -random.uniform(0.0, 5.0) * force)}


def _spin(random, log, force, length, mass):
    speed, end = log(5.0, 30.0), random.uniform(0.2, 0.8) * _SECONDS
    return {'motor.shaft': 'driven', 'motor.drive.time': [0.0, end],
            'motor.drive.angle': [0.0, 0.5 * speed * end], 'motor.drive.speed': [0.0, speed],
            'motor.drive.acceleration': [0.0, 0.0]}


def _free(random, log, force, length, mass):
    return {'carrier.held': str(random.choice(['none', 'none', 'both'])), 'motor.shaft': 'free',
            'initial.shaft_velocity': log(0.1, 10.0),
            'load.tip_force_x.harmonic.amplitude': [log(0.01, 2.0) * force],
            'load.tip_force_x.harmonic.frequency': [log(0.5, 20.0)],
            'load.tip_force_y.harmonic.amplitude': [log(0.01, 2.0) * force],
            'load.tip_force_y.harmonic.frequency': [log(0.5, 20.0)],
            'load.torque.harmonic.amplitude': [log(0.01, 1.0) * force * length],
            'load.torque.harmonic.frequency': [log(0.5, 20.0)]}


KINDS = _buckling, _large_cantilever, _spin, _free


def judge(number, seed=1):
    """Return what becomes of a scene with one axial mode, and with none."""
    kind, values = drawn(number, seed)
    found, paths = {'number': number, 'kind': kind, 'step': values['integrator.step']}, []
    for axial, name in (0, 'without'), (1, 'with'):
        scene = timo_sim.load_scene({**values, 'model.axial_modes': axial})
        try:
            run = run_scene(scene, round(_SECONDS / scene.step), 20)
            paths.append(run.position())
            found[name] = ''
        except timo_sim.DivergenceError as error:
            found[name] = str(error)
    off = np.hypot(*(paths[0] - paths[1]).T).max() if len(paths) == 2 else math.nan
    return {**found, 'slowed': math.isfinite(scene.fastest),
            'distance': float(off) / values['arm.length']}


def rows(quick=False):
    """Yield the rows of the table: kind and `VERDICTS`."""
    every = [judge(number) for number in range(COUNT // 20 if quick else COUNT)]
    for kind in sorted({each['kind'] for each in every}):
        these = [each for each in every if each['kind'] == kind]
        yield (kind, len(these), *(sum(bool(each[name]) for each in these)
                                   for name in ('slowed', 'without', 'with')),
               sum(bool(each['with']) and not each['without'] for each in these),
               f'{np.nanmax([each["distance"] for each in these]):.1e}')


if __name__ == '__main__':
    print_some(__spec__, __doc__, lambda *which: json.dumps(drawn(*which)[1], indent=1), judge)
