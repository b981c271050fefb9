# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Fit real arms and predict what was held out: `make real-arm DATA=folder` fills doc/real_arm.md.

The records are of others and not part of this repository; the page lists what to clone into the
folder DATA. Its protocol is what `models_of`, `bounds_of` and `HOLD_OUT` say; that without a
choice by hand is `--auto`. Beside each fit stand those of the textbook's lumped model and of a
black box, to the same part of the record. What doc/real_arm has scores of is fitted again with
ANEW=1 alone.
"""

import json
import os
from pathlib import Path
from textwrap import wrap
from time import process_time
from typing import NamedTuple
from unittest import mock
import warnings

from nfoursid.nfoursid import NFourSID
import numpy as np
import pandas
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.signal import lfilter, savgol_filter

from benchmark import ROOT
from benchmark.accuracy.clock import LONG, mend, pauses, SAMPLE
from benchmark.accuracy.unpack import unpack
from benchmark.drawing import save
from benchmark.report import make_page, table
import timo_sim
from timo_sim.fitting.problem import r_squared

FILES = ROOT / 'example' / 'real_arm'
DATA, ANEW = Path(os.environ.get('DATA', 'data')), bool(os.environ.get('ANEW'))
HOLD_OUT = 0.5
SPREAD = 5.0  # of an output, in `noise` of its mapping
DELAYS = -0.002, 0.2  # bounds of delays [s]: what is late is not early
SHORT = 0.1  # time in which a way of the shaft is one way [s]
BACK = 0.25  # part of all ways in the lesser direction, above which the shaft moves in both
FACTOR = 10.0  # to which a first guess is right
SECONDS = 180  # that a fit without a choice by hand may take
SCORES, AUTO_SCORES = (ROOT / 'doc' / 'real_arm' / f'{name}.json' for name in ('scores', 'auto'))
# The first lines of a command's file.
HEAD = ('#!/bin/sh\n# The fit of doc/real_arm.md, in the folder of the records, with a link to '
        'example/ in it.\n')

ARM = ['arm.young_modulus', 'arm.damping_ratio']
FRICTION = ['viscous_friction', 'coulomb_friction', 'coulomb_speed', 'coulomb_asymmetry',
            'coulomb_presliding', 'coulomb_static']
SHAFT = ['motor.shaft_inertia', *(f'motor.{name}' for name in FRICTION)]
ROTOR = ['motor.rotor.inertia', *(f'motor.rotor.{name}' for name in FRICTION)]
DRIVES = {  # what is free for each kind of input
    'voltage': [*SHAFT, 'motor.dc.torque_constant', 'initial.shaft', 'voltage.gain',
                'voltage.delay', 'voltage.lag'],
    'torque': [*SHAFT, 'torque.gain', 'initial.shaft', 'torque.delay', 'torque.lag'],
    'force_x': [*(f'carrier.{name}' for name in FRICTION), 'force_x.gain', 'force_x.lag',
                'gravity[0]']}
GEAR = ['motor.gear.stiffness', 'motor.gear.damping', 'motor.gear.backlash']
PRESLIDING, REST = ('coulomb_presliding', 'coulomb_static'), 0.5
TIME = 0.2  # presliding begins at coulomb_speed times this [s]
MODELS = 'rigid gear', 'rigid gear, presliding', 'elastic gear', 'elastic gear, presliding'
INITIAL = 'initial.modal_coordinates[0]', 'initial.modal_rates[0]'


class Case(NamedTuple):
    """A record, the scene that it is fitted to, and what its source leaves open."""

    name: str
    lab: str
    record: str             # in the folder of the data
    columns: str
    scene: str
    more: tuple = ()        # free besides those of the rule
    fixed: tuple = ()       # of the rule, but not free
    gear: float = 0.0       # ratio of that through which it is driven
    other: tuple = ()       # record and columns that are held out in place of the second half
    step: float = 0.02      # of the black box [s]


CASES = [
    Case('merced', 'Merced', 'Optimal_SysID/Data/data_vm.mat', 'merced_columns.yaml',
         'merced.yaml', gear=70.0),
    Case('boulder_6', 'Boulder, unit 6', 'ASEN2003/Lab 6: Rotary Arm/4PM_Group37_FlexArm_Unit6',
         'boulder_6.yaml', 'boulder.yaml', gear=48.4),
    Case('boulder_angle', 'Boulder, unit 6, from its shaft on',
         'ASEN2003/Lab 6: Rotary Arm/4PM_Group37_FlexArm_Unit6', 'boulder_angle.yaml',
         'boulder.yaml'),
    Case('boulder_other', 'Boulder, another group',
         'Control-Systems-Rotary-Control/flexibleArm_test_3', 'boulder_other.yaml',
         'boulder.yaml', gear=48.4,
         other=('Control-Systems-Rotary-Control/flexibleArm_test_4', 'boulder_other.yaml')),
    Case('prague', 'Prague', 'quanser-2-dof-serial-flexible-link/software/quanser_updated/'
         'lqr_full_10deg.mat', 'prague_columns.yaml', 'prague.yaml',
         more=('end_effector.inertia', 'tip_torque.gain'), gear=100.0),
    Case('delft', 'Delft', 'flexible-beam-control/ResonanceDataChirp20_clock.csv',
         'delft_chirp20.yaml', 'delft.yaml', other=(
             'flexible-beam-control/ResonanceDataChirp45_clock.csv', 'delft_chirp45.yaml')),
    Case('bratislava', 'Bratislava', 'AutomationShield/matlab/examples/LinkShield/resultID.mat',
         'bratislava_columns.yaml', 'bratislava.yaml',
         fixed=('tip_acceleration.gain', 'tip_acceleration.delay', 'tip_acceleration.lag'),
         step=0.006),
    Case('lisbon', 'Lisbon', 'FlexibleArmControl/LabData/Lab3Data/3_lab_a00_f00_repeating.mat',
         'lisbon_columns.yaml', 'lisbon.yaml', gear=70.0),
    Case('lisbon_2017', 'Lisbon, another unit', 'computer-control/model_identification/code/'
         'responses_files/scope_data_PRBS.mat', 'lisbon_2017.yaml', 'lisbon.yaml', gear=70.0),
    Case('boulder_7', 'Boulder, unit 7', 'ASEN2003/Lab 6: Rotary Arm/Unit7_Flex_trial1.csv',
         'boulder_7_columns.yaml', 'boulder_7.yaml', gear=48.4),
    Case('boulder_april', 'Boulder, ringing', 'ASEN2003/Lab 6: Rotary Arm/flexarm_K1K2_6_-5',
         'boulder_april_columns.yaml', 'boulder_april.yaml', gear=48.4),
    Case('boulder_213', 'Boulder, last', 'ASEN2003/Lab 6: Rotary Arm/flexarm_K1K2K3_6_-5_213',
         'boulder_213_columns.yaml', 'boulder_213.yaml', gear=48.4),
]
_LAB_6, _SERIAL = 'ASEN2003/Lab 6: Rotary Arm', 'quanser-2-dof-serial-flexible-link/software'
_RULER, _PIEZO = 'systemid/example/2009-04-21', 'piezo_control/matlab/db/Old/2014-06-23'
BLIND = [
    Case('blind_ruler', 'a robot of one ruler', f'{_RULER}/swept1-0-10hz.txt',
         'blind_ruler_columns.yaml', 'blind_ruler.yaml', step=0.004,
         other=(f'{_RULER}/step1.txt', 'blind_ruler_columns.yaml')),
    Case('blind_lisbon', 'Lisbon, a square wave',
         'FlexibleArmControl/LabData/Lab3Data/3_lab_a12_f04_square.mat',
         'blind_lisbon_columns.yaml', 'lisbon.yaml'),
    Case('blind_boulder', 'Boulder, feedback of all rates',
         f'{_LAB_6}/flexarm_K1K2K3k4_6_-3_213_4', 'blind_boulder_columns.yaml',
         'boulder_213.yaml'),
    Case('blind_boulder_other', 'Boulder, another group',
         'Control-Systems-Rotary-Control/flexibleArm_test_2',
         'blind_boulder_other_columns.yaml', 'boulder.yaml'),
    Case('blind_delft', 'Delft, a step', 'flexible-beam-control/StepDampingData.csv',
         'blind_delft_columns.yaml', 'delft.yaml'),
    Case('blind_prague', 'Prague, full feedback',
         f'{_SERIAL}/quanser_updated/Results/data_fsf_Im1.mat', 'blind_prague_columns.yaml',
         'prague.yaml'),
    # The second blind test.
    Case('blind_lisbon_2016', 'Lisbon, a third unit',
         'CC-Lab/cc_lab2/4a_sim_prbs_fa_150Hz/workspace.mat', 'blind_lisbon_2016_columns.yaml',
         'blind_lisbon.yaml', other=('CC-Lab/cc_lab2/5a_sim_prbs_b_0.2/workspace.mat',
                                     'blind_lisbon_2016_columns.yaml')),
    Case('blind_lisbon_2018', 'Lisbon, a fourth unit', 'CC/lab2_pbrs3.mat',
         'blind_lisbon_2018_columns.yaml', 'blind_lisbon.yaml',
         other=('CC/lab2_pbrs2.mat', 'blind_lisbon_2018_columns.yaml')),
    Case('blind_leuven', 'Leuven', 'QNN/data/robot_arm.dat', 'blind_leuven_columns.yaml',
         'blind_leuven.yaml', step=0.002),
    Case('blind_yverdon', 'Yverdon',
         'matlab-scripts/heig-vd/regul/labos/lame-flexible/data/SBPA_lame.mat',
         'blind_yverdon_columns.yaml', 'blind_yverdon.yaml', step=0.002),
    Case('blind_partial', 'Prague, partial feedback',
         f'{_SERIAL}/quanser_updated/Results/data_psf_Im1.mat', 'blind_partial_columns.yaml',
         'prague.yaml'),
    Case('blind_rates', 'Boulder, feedback of one rate', f'{_LAB_6}/flexarm_K1K2K3_6_-3_213',
         'blind_rates_columns.yaml', 'boulder_213.yaml',
         other=(f'{_LAB_6}/flexarm_K1K2K3k4_6_-3_213_2', 'blind_rates_columns.yaml')),
    # The third blind test.
    Case('blind_genoa', 'Genoa', 'SSCSA/FRF/FRF_sc_sc_new_table.csv', 'blind_genoa_columns.yaml',
         'blind_genoa.yaml', step=0.004),
    Case('blind_buenos_aires', 'Buenos Aires', f'{_PIEZO} 15h21m58s_table.csv',
         'blind_buenos_aires_columns.yaml', 'blind_buenos_aires.yaml', step=0.03,
         other=(f'{_PIEZO} 15h23m39s_table.csv', 'blind_buenos_aires_columns.yaml')),
    Case('blind_strip', 'a robot of one strip', 'ben_fea_vs_exp/swept_sine_kp_1_amp_50.txt',
         'blind_strip_columns.yaml', 'blind_strip.yaml', step=0.004,
         other=('ben_fea_vs_exp/OL_pulse_test_sys_check_SLFR_RTP_OL_Test_uend=0.txt',
                'blind_strip_columns.yaml')),
    Case('blind_servo', 'Bratislava, from its servo on',
         'AutomationShield_R2/matlab/examples/LinkShield/LinkShield_ID_Data.mat',
         'blind_servo_columns.yaml', 'blind_servo.yaml', step=0.005),
    Case('blind_april', 'Boulder, feedback of angle and strain', f'{_LAB_6}/flexarm_k1k2_6_-3',
         'blind_april_columns.yaml', 'boulder_april.yaml'),
    Case('blind_square', 'Lisbon, the third unit again',
         'CC-Lab/cc_lab2/3a_sim_square_fa_150Hz/workspace.mat',
         'blind_lisbon_2016_columns.yaml', 'blind_lisbon.yaml'),
]


def models_of(case, scene, record, until):
    """
    Return the models of a case by name: values of its scene that change, and what is free.

    The record is fitted until then [s].
    """
    drive, tip = next(iter(record.inputs), ''), list(record.outputs)[-1]
    sensor = [f'{tip}.{kind}' for kind in ('gain', 'bias', 'delay', 'lag')]
    # A bias is not known of another record; one direction shows no asymmetry.
    hidden = ('.bias',) if case.other else ()
    hidden += () if goes_back(record, until) else ('asymmetry',)

    def free(driven):
        return [name for name in (*ARM, *driven, *sensor, *INITIAL, *case.more)
                if name not in case.fixed and not name.endswith(hidden)]

    driven = DRIVES.get(drive, [])
    gears = {'rigid gear': ({}, free(driven))}
    if case.gear:
        gears['elastic gear'] = (with_rotor(scene, case.gear), free(
            [*ROTOR, *GEAR, *(name for name in driven if name not in SHAFT)]))
    models = {}
    for name, (values, names) in gears.items():
        models[name] = values, [each for each in names if not each.endswith(PRESLIDING)]
        if len(models[name][1]) < len(names):
            start = scene.vary(values).values
            body, = {each.removesuffix('.coulomb_static') for each in names
                     if each.endswith('.coulomb_static')}
            models[f'{name}, presliding'] = {
                **values, f'{body}.coulomb_static': REST,
                f'{body}.coulomb_presliding': TIME * start[f'{body}.coulomb_speed']}, names
    return models


def goes_back(record, until):
    """Return whether the shaft moves in both directions until then [s]."""
    if 'shaft' not in record.outputs:
        return False
    t, values, *_ = record.outputs['shaft']
    ways = np.diff(np.interp(np.arange(0.0, min(until, t[-1]), SHORT), t, values))
    return bool(min(ways[ways > 0.0].sum(), -ways[ways < 0.0].sum()) > BACK * np.abs(ways).sum())


def with_rotor(scene, ratio):
    """Return what changes in a scene whose drive becomes a rotor behind an elastic gear."""
    inertia, viscous, dry, speed = (scene.values[name] for name in SHAFT[:4])
    stiffness = 20.0 * dry / 0.05  # twists by 0.05 rad under the largest torque of the record
    return {'motor.dc.gear_ratio': ratio, 'motor.shaft_inertia': 0.1 * inertia,
            'motor.viscous_friction': 0.0, 'motor.coulomb_friction': 0.0,
            'motor.coulomb_speed': 0.0, 'motor.gear.stiffness': stiffness,
            'motor.gear.damping': 0.002 * stiffness, 'motor.gear.backlash': 0.01,
            'motor.rotor.inertia': 0.9 * inertia / ratio**2,
            'motor.rotor.viscous_friction': viscous / ratio**2,
            'motor.rotor.coulomb_friction': dry / ratio,
            'motor.rotor.coulomb_speed': speed * ratio}


def read(record, columns):
    """Return the Record of a file in the folder of the data; a mended one is made."""
    path = DATA / record
    for end, make, kind in ('_clock', mend, '.csv'), ('_table', unpack, '.mat'):
        if path.stem.endswith(end) and not path.exists():
            make(path.with_name(f'{path.stem.removesuffix(end)}{kind}'))
    return timo_sim.read_record(path, FILES / columns)


def bounds_of(names, scene):
    """Return bounds by name: delays are not early, and a first guess is right to FACTOR."""
    found = {name: DELAYS for name in names if name.endswith('.delay')}
    for name in names:
        if name.endswith('.coulomb_static'):
            found[name] = 0.01, 1.0
            continue
        guess = 1.0 if name.endswith('.gain') else scene.values.get(name, 0.0)
        guess = guess[0] if isinstance(guess, tuple) else guess
        if guess > 0.0 and not name.startswith('initial.'):
            found[name] = guess / FACTOR, guess * FACTOR
    return found


def guesses_of(names, before):
    """Return what is free, without widths: from where a Fit before ended, but for its bounds."""
    posterior = before and before.posterior
    values = posterior.objective.values(posterior.x, 0) if before else {}
    return [*(  # as the page shows it
        f'{name}={values[name]:.5g}' if name in values and not before.estimates[name].bound
        else name for name in names), '~inf']


def fitted(case):
    """Return the Fit of a case, its model's name and what was free, and R^2 that chose it."""
    (record, _, until), *_ = parts_of(case)
    scene, trials, halves = timo_sim.load_scene(FILES / case.scene), {}, {}

    def fit(name, part, hold_out, others=(), before=None):
        values, free = models_of(case, scene, part, (1.0 - hold_out) * part.duration)[name]
        start = scene.vary(values)
        guesses = guesses_of(free, before)
        return timo_sim.fit(start, part, guesses, bounds_of(free, start), hold_out,
                            hold_out_records=others, quick=part is not record), guesses

    models = [*models_of(case, scene, record, until)]
    if len(models) > 1:
        for name in models:
            halves[name], _ = fit(name, record.cut(0.0, until), HOLD_OUT)
            trials[name] = {  # a record that rests there has no spread of its own
                output: 1.0 - (each.hold_out_rms / SPREAD / record.outputs[output].noise)**2
                for output, each in halves[name].errors.items()}
    chosen = best_of(trials) if trials else models[0]
    others = [read(*case.other)] if case.other else []
    found, free = fit(chosen, record, 0.0 if others else HOLD_OUT, others, halves.get(chosen))
    return found, chosen, free, trials


def parts_of(case):
    """Return the record that is fitted and that which is held out, by [(Record, from, to)] [s]."""
    record = read(case.record, case.columns)
    if case.other:
        other = read(*case.other)
        return [(record, 0.0, np.inf), (other, 0.0, np.inf)]
    half = (1.0 - HOLD_OUT) * record.duration
    return [(record, 0.0, half), (record, half, np.inf)]


def scores(parts, predictions):
    """Return R^2 by output, (fitted, held out), of predictions (by record, by output)."""
    return {name: tuple(r_squared(*(values[(record.outputs[name].t >= begin)
                                           & (record.outputs[name].t <= end)]
                                    for values in (record.outputs[name].values, found[name])))
                        for (record, begin, end), found in zip(parts, predictions))
            for name in parts[0][0].outputs}


def lumped(t, inputs, values):
    """
    Return driven angle and deflection of the textbook's model at equal steps, shape (n, 2) [rad].

    `inputs` are torques on shaft and tip, for each step [N m]; `values` are spring [N m/rad],
    inertias of shaft and arm [kg m2], friction of the shaft and damping of the spring
    [N m s/rad], and the first angle of the shaft [rad]. For a cart they are forces and masses.
    """
    spring, shaft, arm, friction, damping, first = values
    a = np.zeros((6, 6))
    a[0, 2] = a[1, 3] = 1.0
    a[2, 1:5] = spring / shaft, -friction / shaft, damping / shaft, 1.0 / shaft
    a[3] = -a[2]
    a[3, 1] -= spring / arm
    a[3, 3] -= damping / arm
    a[3, 5] = 1.0 / arm
    step = expm(a * (t[1] - t[0]))
    poles, shapes = np.linalg.eig(step[:4, :4])
    forces = np.vstack([[first, 0.0, 0.0, 0.0], inputs[:-1] @ step[:4, 4:].T])
    parts = np.linalg.lstsq(shapes, forces.T, rcond=None)[0]
    states = [lfilter([1.0], [1.0, -pole], part) for pole, part in zip(poles, parts)]
    return (shapes @ states)[:2].real.T


def textbook(case, parts):
    """Return R^2 by output, (fitted, held out), of the lumped model, if it has the input."""
    drive = next(iter(parts[0][0].inputs), None)
    if drive not in (*DRIVES, 'tip_force_y'):
        return None
    # A force on the tip is that on an arm whose shaft, a million times as heavy, stands still.
    *shaft, tip = parts[0][0].outputs
    heavy, pushed = (1e6, 1) if drive == 'tip_force_y' else (1.0, 0)
    period, most = min(0.002, case.step / 2.0), 12.0 if shaft else 16.0  # of logarithms
    size = {name: np.std(channel.values) for name, channel in parts[0][0].outputs.items()}
    # Of unit inertia of the shaft, because only ratios show. Frequencies begin with several
    # guesses, against local minima.
    largest = {name: np.abs(channel.values).max() for name, channel in parts[0][0].inputs.items()}

    def held(record, name, t):
        channel = record.inputs[name]
        place = np.searchsorted(channel.t, t, side='right') - 1
        return channel.values[np.maximum(place, 0)] / largest[name]

    def predicted(x, record, end=np.inf):
        spring, arm, friction, damping, gain, sensor, push = np.exp(x[:7].clip(-8.0, most))
        bias, late, delay, level, first = x[7:]
        t = np.arange(0.0, min(end, record.duration) + period, period)
        torques = np.zeros((len(t), 2))
        torques[:, pushed] = gain * (held(record, drive, t - late) + bias)
        if 'tip_torque' in record.inputs:
            torques[:, 1] = push * held(record, 'tip_torque', t)
        found = lumped(t, torques, [spring, heavy, arm, heavy * friction, damping, first])
        t_tip = record.outputs[tip].t - delay
        bent = sensor * np.interp(t_tip, t, found[:, 1]) + level
        if tip == 'tip_x':
            bent += np.interp(t_tip, t, found[:, 0])
        elif tip == 'tip_acceleration':
            rates = np.gradient(np.gradient(found.sum(axis=1), t), t)
            bent = sensor * np.interp(t_tip, t, rates) + level
        return {**{name: np.interp(record.outputs[name].t, t, found[:, 0]) for name in shaft},
                tip: bent}

    def residuals(x, end):
        record = parts[0][0]
        found = predicted(x, record, end)
        return np.concatenate([
            (found[name] - channel.values)[channel.t <= end][::4] / size[name]
            for name, channel in record.outputs.items()]).clip(-1e3, 1e3)

    # Logarithms lie where they are clipped, delays where those of the other model do.
    bounds = np.tile([[-np.inf], [np.inf]], 12)
    bounds[:, :7] = [[-8.0] * 7, [most] * 7]
    bounds[:, 8:10] = np.transpose([DELAYS, DELAYS])
    best, half = None, min(parts[0][2], parts[0][0].duration)
    # A cart is heavier than its arm, and follows its voltage as a speed.
    arm, friction, sensor = (0.1, 100.0, 1.0) if tip == 'tip_x' else (
        2.0, 10.0, size[tip] / (50.0 if tip == 'tip_acceleration' else 0.05))
    for hertz in np.geomspace(0.5, 12.0 if shaft else 100.0, 20):
        x = np.log([(2 * np.pi * hertz)**2 * arm, arm, friction, 0.1, 100.0, sensor, 10.0])
        x = np.concatenate([x, [0.0, 0.0, 0.0], [parts[0][0].outputs[name].values[0]
                                                 for name in (tip, *shaft)], [0.0] * (not shaft)])
        for end in (0.5 * half, half):
            found = least_squares(residuals, x, args=(end,), bounds=bounds, x_scale='jac',
                                  max_nfev=40)
            x = found.x
        best = found if best is None or found.cost < best.cost else best
    return scores(parts, [predicted(best.x, record) for record, *_ in parts])


def black_box(case, parts):
    """Return R^2 by output, (fitted, held out), and the order of a linear model by N4SID."""
    def sampled(record):
        fine = np.arange(0.0, record.duration, case.step / 10)
        fine = fine[:len(fine) // 10 * 10]
        return fine[::10], *(np.column_stack([np.zeros((len(fine) // 10, 0)), *(
            np.interp(fine, channel.t, channel.values).reshape(-1, 10).mean(axis=1)
            for channel in channels.values())]) for channels in (record.inputs, record.outputs))

    def runs(a, c, u):
        """Return what each entry of first state, B and D adds to a run, shape (n, p, entries)."""
        order, inputs = len(a), u.shape[1]
        x = np.eye(order, order * (1 + inputs))
        found = np.empty((len(u), len(c), x.shape[1] + len(c) * inputs))
        for k, each in enumerate(u):
            found[k] = np.column_stack([c @ x, np.kron(np.eye(len(c)), each)])
            x = a @ x
            x[:, order:] += np.kron(np.eye(order), each)
        return found

    def model_of(order):
        frame = pandas.DataFrame(np.column_stack([u, shown])[:known])
        names = list(frame.columns)
        found = NFourSID(frame, names[u.shape[1]:], names[:u.shape[1]], num_block_rows=20)
        found.subspace_identification()
        model = found.system_identification(rank=order)[0]
        # Kept from growing; then the run is fitted, which is linear in all but a and c.
        speeds, vectors = np.linalg.eig(model.a)
        speeds /= np.maximum(1.0, np.abs(speeds))
        a = (vectors * speeds @ np.linalg.inv(vectors)).real
        entries = runs(a, model.c, u[:known])
        return a, model.c, np.linalg.lstsq(entries.reshape(-1, entries.shape[2]),
                                           shown[:known].ravel(), rcond=None)[0]

    t, u, y = sampled(parts[0][0])
    known = int(np.searchsorted(t, min(parts[0][2], t[-1])))
    size = y[:known].std(axis=0)
    shown = (y - y[:known].mean(axis=0)) / size
    trials = []
    for order in range(2, 13):
        a, c, entries = model_of(order)
        error = np.mean((runs(a, c, u[:known]) @ entries - shown[:known])**2)
        trials.append((error, order, a, c, entries))
    _, order, a, c, entries = min(trials, key=lambda trial: trial[0])
    predictions = []
    for record, *_ in parts:
        t, u, now = sampled(record)
        run = runs(a, c, u) @ entries * size + y[:known].mean(axis=0) + now[0] - y[0]
        predictions.append({name: np.interp(channel.t, t + 0.45 * case.step, run[:, k])
                            for k, (name, channel) in enumerate(record.outputs.items())})
    return scores(parts, predictions), order


def in_words(scores):
    """Return R^2 by output in words, for a table."""
    return ', '.join(f'{each:.3f}' if each > -1.0 else 'below -1'
                     for each in (scores or {}).values())


def held_out(scores):
    """Return R^2 of what was held out, by output, from (fitted, held out)."""
    return {name: held for name, (_, held) in (scores or {}).items()}


def best_of(trials):
    """Return the model whose outputs have the largest sum of R^2."""
    return max(trials, key=lambda name: sum(trials[name].values()))


def scores_in(file):
    """Return what was found before, by the name of a Case."""
    return json.loads(file.read_text(encoding='utf-8')) if file.exists() else {}


def summary(quick):
    """Fit what has no scores yet, or all with ANEW, and return the table of `overview`."""
    for case in CASES:
        if ANEW or case.name not in scores_in(SCORES):
            section(case)
    for case in (*CASES, *BLIND):
        if case.name != 'boulder_angle' and (
                ANEW or 'held' not in scores_in(AUTO_SCORES).get(case.name, {})):
            choose_effects(case)
    return overview()


def overview():
    """Return the table of R^2 of what was held out, by what was found before."""
    rows, by_hand, alone = [], scores_in(SCORES), scores_in(AUTO_SCORES)
    for case in (*CASES, *BLIND):
        hand, *rivals, trials = by_hand.get(case.name, [None, {}, {}, {}])
        rivals = [held_out(each) for each in rivals]
        own = alone.get(case.name, {})
        if not hand and not own:
            continue
        kept = [*own.get('kept', []), *['its time was up'] * own.get('stopped', False)]
        done = 'held' in own
        rows.append([
            f'[{case.lab}](real_arm/{case.name}.txt)', ', '.join(
                name.replace('_', ' ') for name in hand or own['blind']),
            in_words(held_out(hand)), in_words(own.get('held')),
            in_words(own.get('blind')), *map(in_words, own.get('rivals', rivals)),
            best_of(trials) if trials else '', '; '.join(kept) or 'nothing' * done,
            f"{own['seconds']:.0f} s" if done else ''])
    return table(['record', 'R^2, held out, of', 'by hand', '`--auto`', 'when it was blind',
                  'textbook', 'black box', 'model by hand', '`--auto` kept', 'its time'], rows)


def friction(record):
    """Return the largest torque at rest, and dry friction in motion by its balance [N m]."""
    shaft, torque = record.outputs['shaft'], record.inputs['torque']
    speed, rate = (savgol_filter(shaft.values, 51, 3, order, record.period) for order in (1, 2))
    held = savgol_filter(np.interp(shaft.t, torque.t, torque.values), 51, 3)
    rests, moves = np.abs(speed) < 0.005, np.abs(speed) > 0.5
    terms = np.column_stack([rate, speed, np.sign(speed), np.ones(len(speed))])
    return np.abs(held[rests]).max(), np.linalg.lstsq(terms[moves], held[moves], rcond=None)[0][2]


def cart(sweep):
    """Return R^2 of an integral of the voltage for the cart of Delft, and its drift [m/s]."""
    t, voltage, x, _ = np.loadtxt(DATA / sweep, delimiter=',', unpack=True)
    first = np.flatnonzero(voltage < 0.0)[0]
    way = np.cumsum(voltage[first:-1] * np.diff(t[first:]))
    terms = np.column_stack([way, t[first + 1:], np.ones(len(way))])
    (_, drift, _), left, *_ = np.linalg.lstsq(terms, x[first + 1:], rcond=None)
    return 1.0 - left[0] / len(way) / np.var(x[first + 1:]), drift


def missing(quick):
    """Return which model was chosen, and what records show of effects that are missing."""
    cases, rows = {case.name: case for case in CASES}, []
    for name, (*_, trials) in scores_in(SCORES).items():
        rows += [[cases[name].lab, *(in_words(trials.get(model)) for model in MODELS)]
                 ] * bool(trials)
    ringing = read(cases['bratislava'].record, cases['bratislava'].columns).outputs
    t, values, *_ = ringing['tip_acceleration']
    up = np.flatnonzero((values[:-1] < 0.0) & (values[1:] >= 0.0))
    up = t[up] - values[up] * (t[up + 1] - t[up]) / (values[up + 1] - values[up])
    first, last = (1.0 / np.diff(part).mean() for part in np.array_split(up, 4)[::3])
    sweeps = [cases['delft'].record, cases['delft'].other[0]]
    true, counted = (np.array([cart(name.replace('_clock', mended)) for name in sweeps])
                     for mended in ('_clock', ''))
    lost = pauses(np.loadtxt(DATA / sweeps[1], delimiter=',', usecols=2)) / SAMPLE
    short, long = lost[(lost > 0.0) & (lost <= LONG)], lost[lost > LONG]
    rest, motion = friction(read(cases['prague'].record, cases['prague'].columns))
    return '\n\n'.join([
        table(['choice of the model', *MODELS], rows),
        f'Prague: the shaft rests under torques of up to {rest:.1f} N m; dry friction in motion, '
        f'faster than 0.5 rad/s, takes {motion:.1f} N m. '
        f'Delft: in the sweep that is held out the sampler pauses {len(short)} times for some '
        f'{np.median(short):.1f} ms and {len(long)} times for some {np.median(long):.1f} ms, '
        f'{SAMPLE * lost.sum():.1f} s in all. An integral of its voltage describes the cart with '
        f'an R^2 of {true[1, 0]:.4f}, and of {counted[1, 0]:.4f} with the times as counted; '
        f'beside it the cart drifts by {1e3 * true[1, 1]:.2f} mm/s, in the fitted sweep by '
        f'{1e3 * true[0, 1]:.2f} mm/s. Bratislava: the strip rings at {first:.2f} Hz in '
        f'the first quarter and at {last:.2f} Hz in the last.'])


def fit_of(case):
    """Return the beginning of the command line of a fit: record, what is held out, scene."""
    held = f"--hold-out-record '{case.other[0]}'" if case.other else f'--hold-out {HOLD_OUT:g}'
    columns = ' --mapping '.join(f'example/real_arm/{each}'
                                 for each in dict.fromkeys([case.columns, *case.other[1:]]))
    return (f"timo_sim fit '{case.record}' {held} \\\n"
            f'    --scene example/real_arm/{case.scene} --mapping {columns}')


def command_of(case, parts, chosen, free):
    """Return the command line of a fit with the chosen model and what is free."""
    (record, _, until), *_ = parts
    scene = timo_sim.load_scene(FILES / case.scene)
    values, names = models_of(case, scene, record, until)[chosen]
    shown = ' --bounds '.join(f'{name}={low:.5g}:{high:.5g}' for name, (low, high) in bounds_of(
        names, scene.vary(values)).items())
    changes = ' '.join(['--set', *(f'{name}={value:.6g}' for name, value in values.items())])
    return ' \\\n    '.join([
        fit_of(case), *wrap(f'--bounds {shown}', 112), *(wrap(changes, 112) if values else []),
        *(f'--free {",".join(line.split())}' for line in wrap(' '.join(free), 105)),
        '-o fitted.yaml --png fit.png "$@"'])


def section(case):
    """Fit a case, draw it, and write scores, command and report."""
    parts = parts_of(case)
    found, chosen, free, trials = fitted(case)
    held = (found.more or [found])[-1]
    own = {name: (each.r_squared, held.errors[name].hold_out_r_squared)
           for name, each in found.errors.items()}
    box, order = black_box(case, parts)
    by_model = {'`timo_sim`': own, 'textbook': textbook(case, parts),
                f'black box of order {order}': box}
    SCORES.write_text(json.dumps({**scores_in(SCORES), case.name: [
        *by_model.values(), trials]}, indent=1) + '\n', encoding='utf-8')
    save(held.plot(), f'real_arm/{case.name}')
    script = FILES / f'{case.name}.sh'
    script.write_text(f'{HEAD}{command_of(case, parts, chosen, free)}\n', encoding='utf-8')
    script.chmod(0o755)
    rows = [[model, *(in_words({'': each}) for score in scored.values() for each in score)]
            for model, scored in by_model.items() if scored]
    scored = table(['R^2', *(f'{name}, {part}' for name in own
                             for part in ('fitted', 'held out'))], rows)
    report = found.report().replace(f'{DATA}/', '')
    (ROOT / 'doc' / 'real_arm' / f'{case.name}.txt').write_text(
        f'{report}\n\n{scored}\n', encoding='utf-8')


def choose_effects(case):
    """
    Fit a case by `--auto` alone, and keep what was held out, what was chosen, and its time.

    The time that it may take is that of the processor: other work does not count.
    """
    parts, began = parts_of(case), process_time()
    others = [parts[1][0]] if case.other else []
    with mock.patch('time.monotonic', process_time), mock.patch(
            'timo_sim.fitting.result.monotonic', process_time):
        found = timo_sim.fit(
            timo_sim.load_scene(FILES / case.scene), parts[0][0], auto=True, quick=True,
            time=SECONDS, hold_out=0.0 if others else HOLD_OUT, hold_out_records=others)
    used, held = process_time() - began, (found.more or [found])[-1]
    old = scores_in(AUTO_SCORES)
    row = {**{key: old[case.name][key] for key in ('blind', 'rivals') if key in old.get(
        case.name, {})}, 'seconds': used, 'held': {
        name: each.hold_out_r_squared for name, each in held.errors.items()}, 'kept': [
            line.partition(':')[0] for line in found.ladder[1:] if not line.startswith(' ')
            and ' tried: ' not in line], 'stopped': ' tried: ' in found.ladder[-1]}
    if case in BLIND:
        row.setdefault('blind', row['held'])
        if 'rivals' not in row:
            row['rivals'] = [held_out(scored) for scored in (
                textbook(case, parts), black_box(case, parts)[0])]
        (ROOT / 'doc' / 'real_arm' / f'{case.name}.txt').write_text(
            found.report().replace(f'{DATA}/', '') + '\n', encoding='utf-8')
        script = FILES / f'{case.name}.sh'
        script.write_text(f'{HEAD}{fit_of(case)} \\\n    --auto --quick --time {SECONDS} '
                          '-o fitted.yaml --png fit.png "$@"\n', encoding='utf-8')
        script.chmod(0o755)
    AUTO_SCORES.write_text(json.dumps({**old, case.name: row}, indent=1) + '\n', encoding='utf-8')


PARTS = {'summary': summary, 'missing': missing}

if __name__ == '__main__':
    warnings.simplefilter('ignore', timo_sim.ModelWarning)  # the reports have them
    make_page(__spec__, __doc__, 'real_arm.md', PARTS)
