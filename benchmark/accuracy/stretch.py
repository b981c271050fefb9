# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Compares `exact`, with 0 to 3 axial modes, with an arm that stretches: `make stretch`.

A number is the largest distance of the tips in a run of 2 to 20 s, in lengths of the arm. The
reference is `test/oracles/spectral_elements.py`, with the E A of the section.
"""

import math
import warnings

import numpy as np

from benchmark.report import parser, table
from oracles import spectral_elements
import timo_sim

PERIOD = 0.05  # of the samples that are compared [s]
AXIAL = (0, 1, 2, 3)
HELD = {'carrier.held': 'both'}
PUSH = {'load.tip_force_y.piecewise.time': [0.0, 0.1],
        'load.tip_force_y.piecewise.value': [20.0, 0.0]}
SPINNING = {'initial.shaft_velocity': 10.0, **PUSH}
THICK = {'arm.length': 0.4, 'arm.section.height': 0.05, 'arm.section.width': 0.05,
         'motor.shaft_inertia': 0.1,
         'end_effector.inertia': 0.01}
SOFT = {'arm.length': 1.0, 'arm.section.height': 0.04, 'arm.section.width': 0.04,
        'arm.young_modulus': 1e8,
        'arm.shear_modulus': 4e7, 'arm.density': 1200.0, 'motor.shaft_inertia': 0.5,
        'end_effector.mass': 0.5, 'end_effector.inertia': 0.01}


def spun_up(speed, duration, **values):
    """Return a scene with held carrier that a torque spins up to a speed [rad/s] in a time [s]."""
    values = {**HELD, 'initial.shaft': 0.0, **values}
    body = timo_sim.load_scene({}, values).manipulator
    section, length = body.arm.section, body.arm.length
    inertia = (body.shaft_inertia + section.mass_per_length * length**3 / 3.0
               + body.end_effector_mass * length**2 + body.end_effector_inertia)
    rest, torque = duration / 4.0, inertia * speed / (0.75 * duration)
    return {**values, 'load.torque.table.time': [0.0, rest, 3.0 * rest, duration],
            'load.torque.table.value': [0.0, torque, torque, 0.0]}


# Name, values or file, duration [s], modes in bending, steps [s].
SCENES = [
    ('spun up to 10 rad/s', spun_up(10.0, 2.0), 5.0, 5, (0.005, 0.001)),
    ('spun up to 40 rad/s', spun_up(40.0, 2.0), 2.0, 12, (0.0025, 0.001)),
    ('10 rad/s, a push', {**HELD, **SPINNING}, 4.0, 5, (0.005, 0.001)),
    ('the same, free carrier', SPINNING, 4.0, 5, (0.005, 0.001)),
    ('the same, x held', {'carrier.held': 'x', **SPINNING}, 4.0, 8, (0.001, 0.0005)),
    ('driven to 10 rad/s, free carrier', {
        'motor.shaft': 'driven', 'motor.drive.time': [0.0, 1.0], 'motor.drive.angle': [0.0, 5.0],
        'motor.drive.speed': [0.0, 10.0], 'motor.drive.acceleration': [0.0, 0.0]},
     4.0, 5, (0.005, 0.001)),
    ('locked shaft, carrier pushed', {
        'motor.shaft': 'locked', 'load.force_x.piecewise.time': [0.0, 0.2],
        'load.force_x.piecewise.value': [100.0, 0.0]}, 4.0, 5, (0.005, 0.001)),
    ('thick, spun up to 60 rad/s', spun_up(60.0, 1.0, **THICK), 2.0, 5, (0.001, 0.0005)),
    ('soft, spun up to 10 rad/s', spun_up(10.0, 1.0, **SOFT), 2.0, 8, (0.005, 0.001)),
    ('soft, starts at 10 rad/s', {**HELD, **SOFT, 'initial.shaft_velocity': 10.0}, 2.0, 8,
     (0.005, 0.001)),
    ('spin-up of Simo and Vu-Quoc', timo_sim.load_scene('spin_up').values, 20.0, 5, (0.01, 0.005)),
]


def error(scene, tip, duration):
    """Return the largest distance of the tip from a reference, (n, 2) [m], in arm lengths."""
    try:
        run = timo_sim.simulate(scene, duration, round(PERIOD / scene.step), estimate=False)
    except timo_sim.DivergenceError:
        return math.inf
    length = scene.manipulator.arm.length
    return np.linalg.norm(run.position(length) - tip, axis=1).max() / length


def row(name, values, duration, modes, steps):
    """Return the cells of a scene, and how far two meshes of its reference are apart."""
    scene = timo_sim.load_scene({}, {**values, 'integrator.step': PERIOD})
    samples = round(duration / PERIOD)
    coarse = spectral_elements.simulate(scene, PERIOD, samples)[2]
    tip = spectral_elements.simulate(scene, PERIOD, samples, order=13, courant=0.25)[2]
    cells = [name]
    for axial in AXIAL:
        found = [error(scene.vary({'model.modes': modes, 'model.axial_modes': axial,
                                   'integrator.step': step}), tip, duration) for step in steps]
        cells.append(', '.join(f'{each:.0e}' if each < 1.0 else 'diverges' for each in found))
    return [*cells, f'{np.abs(coarse - tip).max() / scene.manipulator.arm.length:.0e}']


def main():
    """Print a table."""
    quick = parser(__spec__, __doc__, 'two scenes').parse_args().quick
    warnings.simplefilter('ignore', timo_sim.ModelWarning)
    rows = []
    for scene in SCENES[:2] if quick else SCENES:
        name, *cells = row(*scene)
        print(name, *cells, sep=', ', flush=True)
        rows.append([name, scene[3], ', '.join(f'{1e3 * step:g}' for step in scene[4]), *cells])
    print(table(['scene', 'N', 'h [ms]', *(f'A = {axial}' for axial in AXIAL), 'two meshes'],
                rows))


if __name__ == '__main__':
    main()
