# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Stress test of arms in motion under a smooth load on a light tip, against spectral elements.

Random clamped arms, straight at first, for 0.5 s under a harmonic torque or force on the tip of
2 Hz. The resistance to shear, kappa G A L^2 / (E I), is 20 to 1e5. The reference has no modes and
no damping (`test/oracles/spectral_elements.py`); two meshes bound its error.
`python -m benchmark.stress.in_motion --kind torque --only 3` does number 3 of a kind alone.
"""

import math

import numpy as np

from benchmark.stress.at_rest import counts, print_some, VERDICTS
from oracles import spectral_elements
import timo_sim
from timo_sim.runs.run import run_scene
from timo_sim.runs.simulate import measure_error

KINDS = {'tip_torque': 60, 'tip_force_y': 60}
_MODES, _STEPS = (3, 5, 8), (5e-4, 1e-3, 2e-3)  # each number is compiled once; [s]
_HERTZ, _PERIOD, _SAMPLES, _SEEN = 2.0, 0.01, 50, 1e-6
_ORDERS = 8, 10  # of two spectral elements
MOVED = *VERDICTS, 'two meshes'


def drawn(kind, number, seed=1):
    """Return a random scene."""
    random = np.random.default_rng([seed, 5, list(KINDS).index(kind), number])

    def log(low, high):
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    # kappa G A L^2 / (E I) is 12 kappa (L / height)^2 G / E, and G / E is below a half.
    ratio, length = log(20.0, 1e5), log(0.3, 3.0)
    slenderness = max(20.0, math.sqrt(ratio / (0.5 * 12.0 * 0.85))) * log(1.0, 2.0)
    height, density = length / slenderness, 2000.0
    first = 2.0 * math.pi * _HERTZ * log(1.5, 12.0)  # about the first frequency [rad/s]
    young = 12.0 * density * (first * length**2 / 3.52 / height)**2 * (1.0 + 8.0 / ratio)
    stiffness, mass = young * height**4 / 6.0, 2.0 * density * length * height**2
    tip = mass * log(1e-6, 1e-2) * int(random.integers(2))
    size = log(1e-3, 0.2) * stiffness / length * (
        2.0 if kind == 'tip_torque' else 3.0 / length)  # bends the tip so far at rest [lengths]
    return timo_sim.load_scene({
        'arm.length': length, 'arm.section.height': height, 'arm.section.width': 2.0 * height,
        'arm.density': density, 'arm.young_modulus': young, 'arm.section.shear_correction': 0.85,
        'arm.shear_modulus': young * ratio / (12.0 * 0.85 * slenderness**2),
        'arm.damping_ratio': [], 'end_effector.mass': tip,
        'end_effector.inertia': tip * length**2 * log(1e-3, 0.2),
        'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.shaft': 0.0,
        'model.modes': int(random.choice(_MODES)),
        'model.static_modes': ('auto', 'none')[number % 2],
        'integrator.step': float(random.choice(_STEPS)),
        f'load.{kind}.harmonic.amplitude': [size], f'load.{kind}.harmonic.frequency': [_HERTZ],
        f'load.{kind}.harmonic.phase': [float(random.choice([0.0, math.pi]))]})


def judge(kind, number, seed=1):
    """Return what becomes of a scene: error, estimate, distance of meshes [lengths], warning."""
    scene = drawn(kind, number, seed)
    length, every = scene.values['arm.length'], round(_PERIOD / scene.step)
    found = {'number': number, 'modes': scene.values['model.modes'],
             'static': scene.values['model.static_modes'], 'shapes': len(scene.static)}
    try:
        run = measure_error(run_scene(scene, every * _SAMPLES, every))
    except (timo_sim.ParameterError, timo_sim.DivergenceError) as error:
        return {**found, 'error': math.nan, 'estimate': math.nan, 'doubt': 0.0,
                'warning': str(error)}
    lower, tip = (spectral_elements.simulate(scene, _PERIOD, _SAMPLES, order=order,
                                             courant=0.9)[2] for order in _ORDERS)
    error, doubt = (float(np.hypot(*(path - tip).T).max()) / length
                    for path in (run.position(), lower))
    return {**found, 'error': error, 'doubt': doubt, 'warning': run.warning,
            'estimate': run.stats['estimated_tip_error_m'] / length}


def rows(quick=False):
    """Yield the rows of the table: load, static modes and `MOVED`."""
    for kind, count in KINDS.items():
        found = [judge(kind, number) for number in range(3 if quick else count)]
        for static in 'auto', 'none':
            these = [each for each in found if each['static'] == static]
            yield (kind, static, *counts(these, _SEEN),
                   f'{max(each["doubt"] for each in these):.1e}')


if __name__ == '__main__':
    print_some(__spec__, __doc__, drawn, judge, KINDS)
