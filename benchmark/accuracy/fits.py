# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Fits to made records, whose truth is known: intervals, time, outliers, moving arms, starts.

`make benchmark-fit` writes doc/benchmark/fits.json, from which `make pages` fills the tables of
doc/fit.md; `--quick` does a few records of each, to run/benchmark.

The arm is that of a laboratory: a steel strip of 0.42 m on a geared DC motor with dry friction,
driven by voltages at 500 Hz. Records are made by `simulate` with a quarter of the step of the fits
and the same modes, and with the voltage as a load of the scene, so nothing of `timo_sim.fitting`
is in them. The Cramer-Rao bound is that of central differences of the record without noise.
"""

from concurrent.futures import ProcessPoolExecutor
import json
from multiprocessing import get_context
import os
from statistics import median
import sys
import time
from unittest import mock
import warnings

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import bilinear, lfilter

from benchmark import ROOT
from benchmark.report import machine, parser
from benchmark.timing import seconds
import timo_sim
from timo_sim.fitting.problem import Problem
from timo_sim.fitting.suspects import suspects

sys.path.append(str(ROOT / 'example'))
import certify  # noqa: E402, I100, I202

PERIOD, STEP, FINER = 0.002, 0.002, 4   # of records, of fits [s]; parts of it in records
NOISE = {'shaft': 1e-3, 'tip_transverse': 5e-4}     # standard deviations [rad, m]
DELAY = 'tip_transverse.delay'
SCENE = {
    'arm.length': 0.42, 'arm.section.width': 0.02, 'arm.section.height': 0.001,
    'arm.density': 7800.0,
    'arm.young_modulus': 200e9, 'arm.shear_modulus': 77e9, 'arm.damping_ratio': [0.01],
    'carrier.held': 'both', 'initial.shaft': 0.0, 'integrator.step': STEP,
    'motor.shaft_inertia': 2e-3, 'motor.viscous_friction': 0.02, 'motor.coulomb_friction': 0.03,
    'motor.dc.resistance': 2.6, 'motor.dc.torque_constant': 0.0077, 'motor.dc.gear_ratio': 70.0,
    'end_effector.mass': 0.05, 'end_effector.inertia': 1e-5,
    'model.static_modes': 'none'}  # whatever the first guess of the tip's mass is
# First guesses, as factors of the truth.
GUESSES = {'arm.young_modulus': 0.75, 'end_effector.mass': 1.3, 'arm.damping_ratio': 0.6,
           'motor.viscous_friction': 3.0, 'motor.coulomb_friction': 0.4,
           'motor.dc.torque_constant': 0.8, 'motor.shaft_inertia': 1.3}
FREE = [*GUESSES, DELAY]
TRUTH = {**{name: np.ravel(SCENE[name])[0] for name in GUESSES}, DELAY: 0.0035}
STEP_OF_BOUND = 1e-3    # of the central differences, in logarithms and in periods of the record
OUTLIERS, OUTLIER = 0.01, 30.0      # part of the samples, and their size in standard deviations
BEGUN = 1.0                 # time at which a record of a moving arm begins [s]
# What records cannot tell apart: their input and outputs, what is free, and what is to be named.
_MOTOR = ['motor.dc.torque_constant', 'motor.dc.resistance', 'motor.viscous_friction']
_FACTOR = ['torque.gain', 'arm.young_modulus', 'arm.density', 'end_effector.mass',
           'motor.shaft_inertia', 'motor.viscous_friction', 'motor.coulomb_friction',
           'end_effector.inertia']
UNIDENTIFIABLE = [
    ('voltage', [*NOISE], ['arm.young_modulus', *_MOTOR], _MOTOR),
    ('torque', [*NOISE], _FACTOR, _FACTOR),
    ('voltage', ['shaft'], ['voltage.delay', 'shaft.delay', 'arm.young_modulus'],
     ['voltage.delay', 'shaft.delay'])]

# Records with wrong first guesses: input, outputs, what is free.
WRONG, SPREAD = 3.0, 1.5    # factors: of first guesses; up to which truths of records differ
GAIN = 'root_strain.gain'
_ARM = ['arm.young_modulus', 'end_effector.mass', 'arm.damping_ratio']
_SHAFT = ['motor.viscous_friction', 'motor.coulomb_friction', 'motor.shaft_inertia']
KINDS = {
    'steps and chirp': ('voltage', [*NOISE], [*_ARM, *_SHAFT, 'motor.dc.torque_constant', DELAY]),
    'multisine': ('torque', ['shaft', 'root_strain'], [*_ARM, *_SHAFT, GAIN]),
    'chirp': ('torque', ['shaft_velocity', 'tip_acceleration'], [*_ARM, *_SHAFT]),
    'driven': ('drive', ['tip_transverse'], [*_ARM, DELAY])}
RELATIVE_NOISE = 0.01   # of the standard deviation of a quantity
# Effects that a record has and the fitted scene lacks, and words that name each.
EFFECTS = {
    'nothing': '', 'friction': 'dry friction', 'input delay': 'delay of voltage',
    'output delay': 'delay of tip_transverse', 'offset': 'offset of tip_transverse',
    'limit': 'limit of the voltage',
    'gravity': 'gravity', 'mode': 'one more mode', 'resonance': '',
    'direction': 'depends on the direction', 'near rest': 'near rest',
    'presliding': 'presliding', 'backlash': 'backlash', 'gear': 'elastic gear',
    'spring': 'a spring', 'clamp': 'a clamp', 'dead zone': 'a dead zone',
    'held stiffness': 'arm.young_modulus', 'held inertia': 'motor.shaft_inertia',
    'held tip mass': 'end_effector.mass'}  # of which the scene has a wrong value
SMOOTH = [name for name in FREE if name not in ('motor.coulomb_friction', DELAY)]
HELD = 'motor.dc.torque_constant'    # which is known where another value is held
SAME = 1.01     # ratio of residuals below which two fits ended at the same minimum


def voltage(duration):
    """Return times and a voltage: 0.1 s of nothing, then steps and a chirp from 0.5 to 10 Hz."""
    t = PERIOD * np.arange(round(duration / PERIOD))
    chirp = np.sin(2.0 * np.pi * (0.5 * t + 0.5 * 9.5 / duration * t**2))
    return t, (t > 0.1) * (1.8 * np.sign(np.sin(2.0 * np.pi * 0.6 * t + 0.3)) + 1.4 * chirp)


def torque(scene, volts):
    """Return the torque of the motor at rest for a voltage [N m]."""
    constant, gear, resistance = (scene[f'motor.dc.{name}'] for name in (
        'torque_constant', 'gear_ratio', 'resistance'))
    return constant * gear / resistance * volts


def outputs(truth, duration):
    """Return times and, by output, what sensors without noise show."""
    t, volts = voltage(duration)
    scene = {**SCENE, **{name: value for name, value in truth.items() if name != DELAY}}
    scene['arm.damping_ratio'] = np.ravel(scene['arm.damping_ratio'])
    run = timo_sim.simulate({
        **scene, 'integrator.step': STEP / FINER, 'load.torque.piecewise.time': t,
        'load.torque.piecewise.value': torque(scene, volts)}, duration, estimate=False)
    tip = CubicSpline(run.t, run.deflection(scene['arm.length'])[:, 1])
    return t, {'shaft': CubicSpline(run.t, run.shaft)(t),
               'tip_transverse': tip(np.maximum(t - truth[DELAY], 0.0))}


def record(seed, duration, outliers=0.0, begun=0.0):
    """Return a Record with noise of a seed, and with outliers; it may begin in the motion."""
    random = np.random.default_rng(seed)
    t, clean = outputs(TRUTH, duration + begun)
    measured = {}
    for name, values in clean.items():
        noise = random.standard_normal(len(t))
        noise += OUTLIER * random.choice([-1.0, 1.0], len(t)) * (random.random(len(t)) < outliers)
        measured[name] = t, values + NOISE[name] * noise
    return timo_sim.Record.of({'voltage': voltage(duration + begun)}, measured).cut(begun)


def guess(shaft=0.0):
    """Return the scene with the first guesses, at rest at an angle of the shaft [rad]."""
    return timo_sim.load_scene(SCENE, {'initial.shaft': shaft, **{
        name: [factor * TRUTH[name]] if name == 'arm.damping_ratio' else factor * TRUTH[name]
        for name, factor in GUESSES.items()}})


def coordinate(name, value):
    """Return the logarithm of a value, and of the delay its number of periods."""
    return value / PERIOD if name == DELAY else np.log(value)


def bound(duration):
    """Return the least standard deviations of coordinates, by Cramer and Rao, shape (p,)."""
    columns = []
    for name in FREE:
        ends = []
        for step in (STEP_OF_BOUND, -STEP_OF_BOUND):
            value = (TRUTH[name] + step * PERIOD if name == DELAY
                     else TRUTH[name] * np.exp(step))
            shown = outputs({**TRUTH, name: value}, duration)[1]
            ends.append(np.concatenate([shown[each] / NOISE[each] for each in NOISE]))
        columns.append((ends[0] - ends[1]) / (2.0 * STEP_OF_BOUND))
    q, r = np.linalg.qr(np.column_stack(columns))
    return np.linalg.norm(np.linalg.inv(r), axis=1)


def quiet(function, *arguments, **options):
    """Call without the warnings of a model, which the Fit holds."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', timo_sim.ModelWarning)
        return function(*arguments, **options)


def errors(kind, seed, duration):
    """Return errors of a fit's coordinates, and whether its intervals hold the truth, (2, p)."""
    options = {'soft_l1': {'loss': 'soft_l1'}}.get(kind, {})
    free = [*FREE, 'initial'] if kind == 'initial' else FREE
    made = record(seed, duration, OUTLIERS * (kind in ('linear', 'soft_l1')),
                  BEGUN * (kind in ('rest', 'initial')))
    first = made.outputs['shaft'].values[0]
    scene = guess(first if kind in ('rest', 'initial') else 0.0)
    found = quiet(timo_sim.fit, scene, made, free, **options).estimates
    return [[coordinate(name, found[name].value) - coordinate(name, TRUTH[name])
             for name in FREE],
            [float(found[name].low <= TRUTH[name] <= found[name].high) for name in FREE]]


def many(kind, count, duration):
    """Return the `errors` of fits to records of seeds 0, 1, ..., shape (count, 2, p)."""
    begun = time.monotonic()
    with ProcessPoolExecutor(os.cpu_count(), get_context('spawn')) as pool:
        found = np.array([*pool.map(errors, [kind] * count, range(count), [duration] * count)])
    print(f'{count} fits of kind {kind} in {time.monotonic() - begun:.0f} s', flush=True)
    return found


def coverage(count, duration):
    """Return, by parameter, how many intervals hold the truth, and deviations over the bound."""
    least, found = bound(duration), many('plain', count, duration)
    return {'count': count, 'duration': duration, 'parameters': {name: {
        'truth': TRUTH[name], 'guess': GUESSES.get(name, 0.0) * TRUTH[name],
        'held': int(found[:, 1, k].sum()), 'bound': least[k], 'deviation': found[:, 0, k].std(),
        'mean_error': found[:, 0, k].mean()}
        for k, name in enumerate(FREE)}}


def against(kinds, count, duration):
    """
    Return, by kind of fit, errors over the bound and intervals that hold the truth.

    Errors are the root mean square over all parameters and fits that give numbers, in standard
    deviations of the bound; intervals are counted among them.
    """
    least, found = bound(duration), {}
    for kind in kinds:
        errors_of, held = np.moveaxis(many(kind, count, duration), 1, 0)
        good = np.isfinite(errors_of)
        rms = float(np.sqrt(np.mean((errors_of / least)[good]**2))) if good.any() else None
        found[kind] = {'numbers': float(good.mean()), 'error': rms,
                       'held': float(held[good].mean()) if good.any() else None}
    return {'count': count, 'duration': duration, 'kinds': found}


def unidentifiable(duration):
    """Return what fits say of parameters that the record cannot tell apart."""
    rows, whole = [], record(0, duration)
    for kind, shown, free, expected in UNIDENTIFIABLE:
        t, volts = voltage(duration)
        scene, inputs = timo_sim.load_scene(SCENE), {'voltage': (t, volts)}
        if kind == 'torque':
            # The same motion, from the torque that the motor has and the friction of its back-EMF.
            back = torque(SCENE, 1.0) * SCENE['motor.dc.torque_constant'] * SCENE[
                'motor.dc.gear_ratio']
            scene = scene.vary({'motor.dc.resistance': 0.0, 'motor.dc.torque_constant': 0.0,
                                'motor.viscous_friction': SCENE['motor.viscous_friction'] + back})
            inputs = {'torque': (t, torque(SCENE, volts))}
        if 'shaft.delay' not in free:
            free = [*free, DELAY]
        fitted = quiet(timo_sim.fit, scene, timo_sim.Record.of(
            inputs, {name: whole.outputs[name] for name in shown}), ['~inf', *free])
        rows.append({'input': kind, 'outputs': shown, 'free': free, 'expected': expected,
                     'named': fitted.unidentified, 'values': fitted.values,
                     'without_number': [name for name, each in fitted.estimates.items()
                                        if not each.identified]})
    return rows


def time_of_fit(duration, rounds):
    """Return the times of a fit that is done again and again, its runs, and the time of one."""
    made, run, calls = record(0, duration), Problem.run, []

    def counting(*arguments, **options):
        calls.append(None)
        return run(*arguments, **options)

    with mock.patch.object(Problem, 'run', counting):
        quiet(timo_sim.fit, guess(), made, FREE)  # compiles, and counts
    times = [quiet(timo_sim.fit, guess(), made, FREE).seconds for _ in range(rounds)]
    problem = Problem(guess(), made, FREE, {}, made.duration)
    values = {free.name: free.start for free in problem.free}
    single = [seconds(lambda: problem.run(values)) for _ in range(25)]
    return {'duration': duration, 'parameters': len(FREE), 'times': times, 'least': min(times),
            'median': median(times), 'runs': len(calls), 'run': median(single), 'target': 3.0}


def signal(kind, duration, random):
    """Return times and the voltage of a kind of record."""
    t, volts = voltage(duration)
    turn = 2.0 * np.pi * t
    if kind == 'multisine':
        lines = np.arange(1, round(10.0 * duration)) / duration
        phases = random.uniform(0.0, 2.0 * np.pi, len(lines))
        volts = 6.0 / np.sqrt(len(lines)) * np.sin(np.outer(turn, lines) + phases).sum(axis=1)
    elif kind == 'chirp':
        volts = 3.0 * np.sin(turn * (0.5 + 0.5 * 15.0 / duration * t))
    return t, volts


def made(seed, duration):
    """Return the kind of a record, the record, what is free, the true scene and a wrong one."""
    random = np.random.default_rng(seed)
    kind = [*KINDS][seed % len(KINDS)]
    given, shown, free = KINDS[kind]
    t, volts = signal(kind, duration, random)
    truth = {name: factor * np.ravel(SCENE.get(name, 1.0))[0]
             for name, factor in zip(free, SPREAD**random.uniform(-1.0, 1.0, len(free)))
             if name != DELAY}
    gain = truth.pop(GAIN, 1.0)
    values = {**truth, 'arm.damping_ratio': [truth['arm.damping_ratio']]}
    if given == 'torque':
        values |= {'motor.dc.resistance': 0.0, 'motor.dc.torque_constant': 0.0}
        volts = torque(SCENE, volts)
    scene = {**SCENE, **values}
    load = {'load.torque.piecewise.time': t, 'load.torque.piecewise.value': (
        torque(scene, volts) if given == 'voltage' else volts)}
    if given == 'drive':
        angle = CubicSpline(*[np.cumsum(each) for each in (
            np.r_[0.0, 0.3 + 0.3 * random.random(99)], np.r_[0.0, random.uniform(-1, 1, 99)])],
            bc_type='clamped')
        volts, bend = angle(t), angle(t, 2)
        bend[-1] = 0.0  # since the shaft goes on at the last speed
        load = {'motor.shaft': 'driven', 'motor.drive.time': t, 'motor.drive.angle': volts,
                'motor.drive.speed': angle(t, 1), 'motor.drive.acceleration': bend}
    run = timo_sim.simulate({**scene, 'integrator.step': STEP / FINER, **load}, duration,
                            estimate=False)
    clean = {'shaft': lambda: run.shaft, 'shaft_velocity': lambda: run.shaft_velocity,
             'tip_transverse': lambda: run.deflection()[:, 1],
             'root_strain': lambda: gain * run.root_strain(),
             'tip_acceleration': lambda: run.tip_acceleration()[:, 1]}
    measured = {}
    for name in shown:
        seen = clean[name]()[::FINER][:len(t)]
        if f'{name}.delay' in free:
            seen = np.interp(t - TRUTH[DELAY], t, seen)
        noise = RELATIVE_NOISE * np.std(seen) * random.standard_normal(len(t))
        measured[name] = t, seen + noise
    wrong = {name: value * WRONG**random.choice([-1.0, 1.0]) for name, value in truth.items()}
    wrong['arm.damping_ratio'] = [wrong['arm.damping_ratio']]
    true = timo_sim.load_scene(scene)
    return kind, timo_sim.Record.of({given: (t, volts)}, measured), free, true, true.vary(wrong)


def start(seed, duration):
    """Return kind, ratio of residuals to those of a fit that starts with the truth, and times."""
    kind, measured, free, *scenes = made(seed, duration)
    sizes, times = [], []
    for scene in scenes:
        begun = time.process_time()
        found = quiet(timo_sim.fit, scene, measured, free)
        times.append(time.process_time() - begun)
        sizes.append(np.array([each.rms for each in found.errors.values()]))
    return kind, float((sizes[1] / sizes[0]).max()), *times


def starts(count, duration):
    """Return, by kind of record, how many fits with wrong first guesses end where good ones do."""
    with ProcessPoolExecutor(os.cpu_count(), get_context('spawn')) as pool:
        found = [*pool.map(start, range(count), [duration] * count)]
    rows = {}
    for kind in KINDS:
        own = [each[1:] for each in found if each[0] == kind]
        ratios, *times = np.transpose(own)
        rows[kind] = {'count': len(own), 'same': int(np.count_nonzero(ratios < SAME)),
                      'ratios': ratios.tolist(), 'seconds': [float(np.median(each))
                                                             for each in times]}
    return {'count': count, 'duration': duration, 'wrong': WRONG, 'kinds': rows}


def lacking(effect, seed, duration):
    """Return a record of a random arm with one effect, and the scene of a fit, without it."""
    random = np.random.default_rng(seed)
    t, volts = voltage(duration)
    truth = {name: 1.3**random.uniform(-1.0, 1.0) * np.ravel(SCENE[name])[0] for name in SMOOTH}
    size = 2.0**random.uniform(-1.0, 1.0)
    base = {**SCENE, 'motor.coulomb_friction': 0.0, **truth,
            'arm.damping_ratio': [truth['arm.damping_ratio']]}
    if effect in ('direction', 'near rest', 'presliding'):
        base |= {'motor.coulomb_friction': 0.03, 'motor.coulomb_speed': 0.2}
    shaft = 0.5 * truth['motor.shaft_inertia']
    gear = {'motor.shaft_inertia': shaft, 'motor.rotor.inertia': shaft / 70.0**2,
            'motor.gear.stiffness': 100.0 * size, 'motor.gear.damping': 0.05}
    more = {'friction': {'motor.coulomb_friction': 0.03 * size},
            'direction': {'motor.coulomb_asymmetry': 0.3 * size**0.5},
            'near rest': {'motor.coulomb_speed': size},
            'presliding': {'motor.coulomb_presliding': 0.02 * size, 'motor.coulomb_static': 0.7},
            'spring': {'motor.spring.stiffness': 0.1 * size},
            'clamp': {'arm.root_stiffness': 1.0 / size},
            'gear': {**gear, 'motor.gear.stiffness': 10.0 * size},
            'backlash': {**gear, 'motor.gear.backlash': 0.02 * size},
            'gravity': {'gravity': [0.5 * size * np.cos(seed), 0.5 * size * np.sin(seed)]},
            'mode': {'model.modes': 3}}.get(effect, {})
    limit = 2.5 * size**-0.3 if effect == 'limit' else np.inf
    dead = 0.3 * size if effect == 'dead zone' else 0.0
    late = STEP / FINER * round(8.0 * size)
    begin = np.append(0.0, t[1:] + (late if effect == 'input delay' else 0.0))
    if effect == 'mode':  # a chirp through the second one
        volts = 12.0 * np.sin(2.0 * np.pi * (20.0 + 40.0 / duration * t) * t)
    run = timo_sim.simulate({
        **base, **more, 'integrator.step': STEP / FINER, 'load.torque.piecewise.time': begin,
        'load.torque.piecewise.value': torque(
            base, np.clip(volts, -limit, limit) - np.clip(volts, -dead, dead))}, duration,
        estimate=False)
    tip = CubicSpline(run.t, run.deflection()[:, 1])
    seen = {'shaft': run.shaft[::FINER][:len(t)],
            'tip_transverse': tip(np.maximum(t - (late if effect == 'output delay' else 0.0), 0))}
    if effect == 'resonance':
        omega = 2.0 * np.pi * random.uniform(20.0, 60.0)
        shaken = lfilter(*bilinear([omega**2], [1.0, 0.02 * omega, omega**2], 1.0 / PERIOD), volts)
        seen['tip_transverse'] += 1.5e-3 * size / np.std(shaken) * shaken
    if effect == 'offset':
        seen['tip_transverse'] += 2e-3 * size
    if effect == 'output sign':
        seen['tip_transverse'] *= -1.0
    measured = timo_sim.Record.of(
        {'voltage': (t, -volts if effect == 'input sign' else volts)},
        {name: (t, each + NOISE[name] * random.standard_normal(len(t)))
         for name, each in seen.items()})
    wrong = {name: value * 1.3**random.choice([-1.0, 1.0]) for name, value in truth.items()}
    wrong['arm.damping_ratio'] = [wrong['arm.damping_ratio']]
    if effect.startswith('held'):  # else all other values stand for the wrong one
        wrong[HELD] = truth[HELD]
    return measured, timo_sim.load_scene({}, {**base, **wrong, **(
        {'model.modes': 1} if effect == 'mode' else {})})


def suspected(effect, seed, duration):
    """
    Return what a fit suspects: names and shares, the first one first; what it says; time.

    The time is that of the processor to find suspects, over that of the rest of the fit.
    """
    (measured, scene), spent = lacking(effect, seed, duration), []

    def timed(*arguments):
        begun = time.process_time()
        named = suspects(*arguments)
        spent.append(time.process_time() - begun)
        return named

    begun = time.process_time()
    with mock.patch('timo_sim.fitting.result.suspects', timed):
        held = (HELD, EFFECTS[effect]) if effect.startswith('held') else ()
        found = quiet(timo_sim.fit, scene, measured, [
            name for name in SMOOTH if name not in held], starts=1)
    rest = time.process_time() - begun - sum(spent)
    return [[each.name, each.share] for each in found.suspects], [
        text for text in found.warnings if 'look like' in text], sum(spent) / rest


def all_suspected(count, duration):
    """Return, by effect, what fits to records with this effect suspect."""
    tasks = [(name, seed, duration) for name in EFFECTS for seed in range(count)]
    with ProcessPoolExecutor(os.cpu_count(), get_context('spawn')) as pool:
        found = [*pool.map(suspected, *zip(*tasks))]
    rows = {}
    for name, words in EFFECTS.items():
        own = [each for each, task in zip(found, tasks) if task[0] == name]
        names = [names for names, says, _ in own if says]
        first = [[says[0].partition(' (')[0].removeprefix('the residuals look like '), each[0][1]]
                 for each, says, _ in own if says]
        rivals = [next((share / each[0][1] for text, share in each if words not in text), 0.0)
                  for each in names if words and words in each[0][0]]
        rows[name] = {
            'words': words, 'named': len(names),
            'first': sum(bool(words) and words in each for each, _ in first),
            'alone': sum(len(says) == 1 and ', or ' not in says[0] for _, says, _ in own),
            'shares': [share for _, share in first], 'rivals': rivals,
            'times': [ratio for *_, ratio in own],
            'others': sorted({each for each, _ in first if not words or words not in each})}
    return {'count': count, 'duration': duration, 'effects': rows}


def certified(seed, duration, samples):
    """Return whether predicted intervals hold the overshoot and settling of a true arm, (2,)."""
    random = np.random.default_rng(seed)
    truth = {name: 1.3**random.uniform(-1.0, 1.0) * np.ravel(certify.ARM[name])[0]
             for name in certify.FREE}
    truth['arm.damping_ratio'] = [truth['arm.damping_ratio']]
    arm = timo_sim.load_scene(certify.ARM, {**truth, 'integrator.step': STEP / FINER})
    found = quiet(timo_sim.fit, certify.ARM, certify.excite(arm, duration, seed), certify.FREE)
    stroke = random.uniform(-certify.STROKE, certify.STROKE), random.uniform(0.0, certify.SLEW)
    true = np.ravel(certify.slew([arm], *stroke))
    predicted = np.array(certify.slew(
        [found.scene.vary(each) for each in found.sample(samples, seed).variations], *stroke))
    low, high = np.quantile(predicted, [0.025, 0.975], axis=1, method='weibull')
    return [[*map(float, (low <= true) & (true <= high))], [*map(float, (high - low) / true)],
            float(any(each.profile for each in found.estimates.values()))]


def coverage_of_loops(count, duration, samples):
    """Return how often predicted intervals hold what the closed loop of the true arm does."""
    with ProcessPoolExecutor(os.cpu_count(), get_context('spawn')) as pool:
        held, widths, profiled = zip(*pool.map(
            certified, range(count), [duration] * count, [samples] * count))
    return {'count': count, 'duration': duration, 'samples': samples,
            'profiled': int(sum(profiled)), 'loops': {
                name: {'held': int(inside), 'interval': certify.between(int(inside), count),
                       'width': float(width)}
                for name, inside, width in zip(('overshoot', 'time to settle'), np.sum(held, 0),
                                               np.median(widths, 0))}}


PARTS = {
    'time': lambda quick: time_of_fit(10.0, 1 if quick else 5),
    'unidentifiable': lambda quick: unidentifiable(4.0),
    'coverage': lambda quick: coverage(4 if quick else 100, 4.0),
    'outliers': lambda quick: against(['plain', 'linear', 'soft_l1'], 2 if quick else 20, 4.0),
    'moving': lambda quick: against(['rest', 'initial'], 2 if quick else 6, 4.0),
    'starts': lambda quick: starts(4 if quick else 100, 10.0),
    'suspects': lambda quick: all_suspected(1 if quick else 10, 2.0),
    'loops': lambda quick: coverage_of_loops(4 if quick else 200, 2.0, 200)}


def main():
    """Measure, and write the figures."""
    command = parser(__spec__, __doc__, 'a few records of each')
    command.add_argument('--part', choices=PARTS, help='measure this alone, and keep the others')
    arguments = command.parse_args()
    path = ROOT / ('run' if arguments.quick else 'doc') / 'benchmark' / 'fits.json'
    path.parent.mkdir(parents=True, exist_ok=True)
    found = json.loads(path.read_text()) if arguments.part and path.exists() else {}
    found |= {'machine': machine(), 'noise': NOISE, 'period': PERIOD, 'step': STEP, 'finer': FINER,
              'outlier': [OUTLIERS, OUTLIER], 'begun': BEGUN}
    for name in [arguments.part] if arguments.part else PARTS:
        found[name] = PARTS[name](arguments.quick)
        print(json.dumps(found[name], indent=1), flush=True)
    path.write_text(json.dumps(found, indent=1) + '\n', encoding='utf-8')


if __name__ == '__main__':
    main()
