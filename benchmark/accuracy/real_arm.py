# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Fit two real arms and predict the rest of their records: `make real-arm` fills doc/real_arm.md.

The records are of others and not part of this repository. DATA names a folder with copies of two
public ones: `git clone https://github.com/gleylaz/Optimal_SysID` and
`git clone https://github.com/BenHagenau/ASEN2003` there. Beside each fit stands that of the
textbook's lumped model, two inertias and a torsion spring, to the same half of the record.
"""

import os
from pathlib import Path
from typing import NamedTuple
import warnings

import numpy as np
from scipy.linalg import expm
from scipy.optimize import least_squares

from benchmark import ROOT
from benchmark.report import make_page, table
import timo_sim
from timo_sim.fitting.problem import r_squared

FILES = ROOT / 'example' / 'real_arm'
DATA = Path(os.environ.get('DATA', 'data'))
HOLD_OUT = 0.5
MOTOR = ['arm.young_modulus', 'motor.shaft_inertia', 'motor.dc.torque_constant',
         'motor.viscous_friction', 'motor.coulomb_friction']


class Case(NamedTuple):
    """A record, the scene that it is fitted to, and what is free."""

    title: str
    record: str     # in the folder of the data
    columns: str
    scene: str
    tip: str        # quantity
    free: list


CASES = [
    Case('merced',
         'Optimal_SysID/Data/data_vm.mat', 'merced_columns.yaml', 'merced.yaml', 'root_strain',
         [*MOTOR, 'motor.coulomb_speed', 'voltage.bias', 'root_strain.gain',
          'arm.damping_ratio']),
    Case('boulder',
         'ASEN2003/Lab 6: Rotary Arm/4PM_Group37_FlexArm_Unit6', 'boulder_voltage.yaml',
         'boulder.yaml', 'tip_transverse',
         ['arm.young_modulus', 'motor.dc.torque_constant', 'motor.dc.resistance',
          'motor.coulomb_friction', 'motor.coulomb_speed', 'voltage.bias', 'voltage.delay',
          'tip_transverse.gain', 'tip_transverse.delay', 'tip_transverse.lag', 'initial.shaft']),
    Case('boulder_angle',
         'ASEN2003/Lab 6: Rotary Arm/4PM_Group37_FlexArm_Unit6', 'boulder_angle.yaml',
         'boulder.yaml', 'tip_transverse',
         ['arm.young_modulus', 'arm.damping_ratio', 'initial.modal_coordinates[0]',
          'initial.modal_rates[0]', 'tip_transverse.gain', 'tip_transverse.delay',
          'tip_transverse.lag']),
]
TITLES = {'merced': 'A rotary flexible link', 'boulder': 'An arm with a mass at its tip',
          'boulder_angle': 'The same arm behind its shaft'}
# Case, what is left out in words, parameters that are not free, and changes of the scene.
ABLATIONS = [
    ('merced', 'nothing', [], None),
    ('merced', 'a bias of the voltage', ['voltage.bias'], None),
    ('merced', 'a speed over which dry friction builds up: the shaft sticks',
     ['motor.coulomb_speed'], {'motor.coulomb_speed': 0.0}),
    ('merced', 'dry friction', ['motor.coulomb_speed', 'motor.coulomb_friction'],
     {'motor.coulomb_friction': 0.0}),
    ('merced', 'an unknown gain of the strain gauge', ['root_strain.gain'], None),
    ('merced', 'the second and third mode', [], {'model.modes': 1}),
    ('boulder', 'nothing', [], None),
    ('boulder', 'a bias of the voltage', ['voltage.bias'], None),
    ('boulder_angle', 'nothing', [], None),
    ('boulder_angle', 'delay and lag of the tip sensor',
     ['tip_transverse.delay', 'tip_transverse.lag'], None),
]


def lumped(t, inputs, values):
    """
    Return shaft and tip angle of the textbook's model at equal steps, shape (n, 2) [rad].

    `inputs` are torques on the shaft, one for each step [N m]; `values` are spring [N m/rad],
    inertias of shaft and arm [kg m2], friction of the shaft and damping of the spring
    [N m s/rad], and the first angle of the shaft [rad].
    """
    spring, shaft, arm, friction, damping, first = values
    a = np.zeros((5, 5))
    a[0, 2] = a[1, 3] = 1.0
    a[2, 1:5] = spring / shaft, -friction / shaft, damping / shaft, 1.0 / shaft
    a[3] = -a[2]
    a[3, 1] -= spring / arm
    a[3, 3] -= damping / arm
    step = expm(a * (t[1] - t[0]))
    state, found = np.array([first, 0.0, 0.0, 0.0, 0.0]), np.empty((len(t), 2))
    for k, torque in enumerate(inputs):
        found[k] = state[:2]
        state[4] = torque
        state = step @ state
    return found


def textbook(case, record, scene):
    """Return R^2 of shaft and tip of the lumped model, fitted and held out, shape (2, 2)."""
    if 'voltage' not in record.inputs:
        return None
    t = np.arange(0.0, record.duration, 0.002)
    channel, half = record.inputs['voltage'], (1.0 - HOLD_OUT) * record.duration
    outputs = [record.outputs[name] for name in ('shaft', case.tip)]
    body = scene.manipulator
    arm = body.end_effector_mass * body.arm.length**2 + (
        7757.0 * 0.02 * 0.001 if case.scene == 'merced.yaml' else 5249.0 * 0.0254 * 0.001
    ) * body.arm.length**3 / 3.0
    start = np.log([1.3, 0.0021, arm, 0.1, 1e-3, 0.1, np.std(outputs[1].values) / 0.05])
    size = [float(np.std(each.values)) for each in outputs]

    def predicted(x):
        spring, shaft, inertia, friction, damping, gain, sensor = np.exp(x[:7].clip(-20.0, 10.0))
        bias, late, delay = x[7:10]
        place = np.searchsorted(channel.t, t - late, side='right') - 1
        found = lumped(t, gain * (channel.values[np.maximum(place, 0)] + bias),
                       [spring, shaft, inertia, friction, damping,
                        scene.values['initial.shaft']])
        return (np.interp(outputs[0].t, t, found[:, 0]),
                sensor * np.interp(outputs[1].t - delay, t, found[:, 1]))

    def residuals(x, end):
        return np.concatenate([
            (each - channel.values)[channel.t <= end] / scale
            for each, channel, scale in zip(predicted(x), outputs, size)]).clip(-1e3, 1e3)

    best = None
    for factor in (0.3, 1.0, 3.0):  # first guesses of the spring, against local minima
        x = np.concatenate([start, [0.0, 0.0, 0.0]])
        x[0] += np.log(factor)
        for end in (0.25 * half, half):
            found = least_squares(residuals, x, args=(end,), x_scale='jac', max_nfev=60)
            x = found.x
        best = found if best is None or found.cost < best.cost else best
    return [[r_squared(channel.values[part], each[part])
             for part in (channel.t <= half, channel.t > half)]
            for each, channel in zip(predicted(best.x), outputs)]


def fitted(case, without=(), changes=None):
    """Return scene, record and Fit of a case; `without` are parameters that are not free."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', timo_sim.ModelWarning)
        scene = timo_sim.load_scene(FILES / case.scene, changes)
        record = timo_sim.read_record(DATA / case.record, FILES / case.columns)
        free = [name for name in case.free if name not in without]
        return scene, record, timo_sim.fit(scene, record, free, hold_out=HOLD_OUT)


def what_matters(quick):
    """Return a table of the R^2 that is left without a part of the model."""
    rows = []
    for title, words, without, changes in ABLATIONS:
        case, = (case for case in CASES if case.title == title)
        found = fitted(case, without, changes)[2]
        rows.append([TITLES[title], words, ', '.join(
            f'{name} {each.hold_out_r_squared:.4f}' for name, each in found.errors.items())])
    return table(['arm', 'without', 'R^2 held out'], rows)


def section(case):
    """Fit a case, draw it, and return what the page says of it."""
    scene, record, found = fitted(case)
    picture = ROOT / 'doc' / 'real_arm' / f'{case.title}.png'
    found.plot().savefig(picture, dpi=80)
    rows = [[f'`timo_sim`, {name}', f'{each.r_squared:.4f}', f'{each.hold_out_r_squared:.4f}',
             'yes' if each.hold_out_r_squared >= 0.95 else 'no']
            for name, each in found.errors.items()]
    for name, values in zip(('shaft', case.tip), textbook(case, record, scene) or []):
        rows.append([f'textbook, {name}', *(f'{value:.4f}' for value in values), ''])
    command = ' \\\n    '.join([
        f"timo_sim fit '{case.record}'",
        f'--scene example/real_arm/{case.scene} --mapping example/real_arm/{case.columns}',
        f'--hold-out {HOLD_OUT:g} --free {case.free[0]}', *case.free[1:],
        '-o fitted.yaml --png fit.png'])
    return '\n\n'.join([
        f'```\n{command}\n```', f'![Measured and predicted](real_arm/{case.title}.png)',
        table(['R^2 of', 'first half, fitted', 'second half, held out', 'at least 0.95'], rows),
        f'```text\n{found.report().replace(str(DATA) + "/", "")}\n```'])


PARTS = {**{case.title: lambda quick, case=case: section(case) for case in CASES},
         'what matters': what_matters}

if __name__ == '__main__':
    make_page(__spec__, __doc__, 'real_arm.md', PARTS)
