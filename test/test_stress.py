# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The numerics of `make stress` find errors without a warning; those found once are gone."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from benchmark.stress import numerics, scenes, truth
import timo_sim


@pytest.fixture(autouse=True)
def few_modes(monkeypatch):
    """Let references have fewer modes; the errors of these scenes change by less than 7 %."""
    monkeypatch.setattr(truth, '_MODES', (6, 1))
    monkeypatch.setattr(truth, '_FEWER', (5, 1))


BODY = {'arm.section.width': 0.02, 'arm.density': 2710.0, 'arm.young_modulus': 70.5e9,
        'arm.shear_modulus': 27e9, 'motor.shaft_inertia': 2.0, 'initial.shaft': np.pi / 4,
        'arm.length': 2.0, 'motor.mass': 0.0, 'initial.shaft_velocity': 1.0,
        'end_effector.mass': 2.168, 'end_effector.inertia': 0.08672, 'carrier.mass': 10.0}


def plain(steps=200, step=0.01, bend=0.01, **changes):
    """Return a Cell: a spinning arm that starts with its tip bent by `bend` [m]."""
    values = {**BODY, 'model.formulation': 'exact', 'model.modes': 3, 'integrator.step': step,
              'arm.section.height': 0.02, 'motor.shaft': 'free', **changes}
    scene = timo_sim.load_scene({}, values)
    shape = [bend / scene.build().tip_travel[3]] + (values['model.modes'] - 1) * [0.0]
    return scenes.Cell(0, 'test', {**values, 'initial.modal_coordinates': shape}, steps,
                       max(1, steps // 20), False)


def at_resonance(number, ratio, **changes):
    """Return a Cell whose torque has `ratio` times the frequency of a vibration."""
    cell = plain(**changes)
    scene = timo_sim.load_scene(cell.values)
    found = np.sort(np.linalg.eigvals(scene.build().linear).imag)
    found = found[found > 1.0]  # carrier and shaft do not vibrate
    arm = scene.manipulator.arm
    return cell._replace(values={
        **cell.values,
        'load.torque.harmonic.amplitude': [0.3 * arm.section.mass_per_length * arm.length**3],
        'load.torque.harmonic.frequency': [ratio * found[number - 1] / (2.0 * np.pi)]})


# Scenes whose errors once gave no warning: with an estimate of third order, or checked too late.
SILENT_ONCE = {
    'thick': partial(plain, **{
        'model.formulation': 'newton', 'arm.section.height': 0.2, 'end_effector.mass': 21.68,
        'end_effector.inertia': 0.8672}),
    'light carrier': partial(plain, step=0.02, bend=1e-3, steps=100, **{
        'model.formulation': 'newton', 'arm.section.height': 0.5, 'end_effector.mass': 5420.0,
        'end_effector.inertia': 21680.0, 'carrier.mass': 1e-3, 'arm.damping_ratio': [1.0],
        'load.torque.piecewise.time': [0.0, 0.2], 'load.torque.piecewise.value': [65.0, 0.0]}),
    'strong bend': partial(plain, bend=1.0, **{'model.modes': 5}),
    'beside resonance': partial(at_resonance, 1, 1.05, step=0.005, steps=400, **{
        'model.formulation': 'newton', 'arm.section.height': 0.04, 'end_effector.mass': 0.0,
        'carrier.mass': 1e-3, 'initial.shaft_velocity': 0.0, 'arm.damping_ratio': [0.01]}),
    'at resonance': partial(at_resonance, 2, 1.0, step=0.001, steps=2000, bend=1.0, **{
        'model.modes': 5, 'end_effector.mass': 216.8, 'end_effector.inertia': 0.0,
        'carrier.mass': 1e6, 'initial.shaft_velocity': 0.0, 'arm.damping_ratio': [0.1]})}


@pytest.mark.parametrize('cell', SILENT_ONCE.values(), ids=SILENT_ONCE)
def test_errors_that_were_silent_once_no_longer_are(cell):
    for found in truth.judge(cell()):
        assert found['verdict'] != 'silent' or found['against'] == 'exact', found


def test_errors_of_steps_give_a_warning():
    """Compare with the same modes at finer steps, so that only the error of the steps shows."""
    cells = [scenes.cell(number, seed=2) for number in range(10 * len(scenes.KINDS))]
    seen = []
    for cell in cells:
        # A static shape that steps do not resolve is damped, which finer steps do not do.
        values = {**cell.values, 'model.static_modes': 'none'}
        cell = cell._replace(values=values)
        if (values['model.modes'], values['carrier.held'], values['motor.shaft']) != (
                3, 'none', 'free') or values['model.axial_modes'] or cell.kind == 'dry' or (
                truth.family(cell) != 'exact'):
            continue
        path, _, warning = truth._run(cell, {})
        if path is not None:
            finer = truth._Finer(cell)
            error = finer.distance(path, finer.path_of((3, 0), finer.parts))
            assert warning or error < truth.ACCURATE, (cell, error)
            seen.append(error)
    assert len(seen) > 20 and np.median(seen) < 1e-5


def without_warnings(monkeypatch):
    speaking = truth.run_scene
    monkeypatch.setattr(truth, 'run_scene', lambda *arguments: replace(
        speaking(*arguments), warning=None))
    monkeypatch.setattr(truth, 'measure_error', lambda run: run)


def test_an_error_without_a_warning_is_silent(monkeypatch):
    cell = plain(50, 0.02, 0.3, **{'initial.shaft_velocity': 36.0, 'carrier.mass': 1.0})
    finer = truth._Finer(cell)
    monkeypatch.setattr(truth, '_Finer', lambda *_: finer)
    told = truth.judge(cell)[0]
    without_warnings(monkeypatch)
    untold = truth.judge(cell)[0]
    assert told['verdict'] == 'flagged' and untold['verdict'] == 'silent'
    assert told['error'] == untold['error'] > truth.ACCURATE
    assert numerics.is_listed(untold)


def test_the_two_references_agree_and_see_too_few_modes_and_stretch(monkeypatch):
    """The errors of a spinning arm under a push are far larger than the references' distance."""
    push = {'load.tip_force_y.piecewise.time': [0.0, 0.1],
            'load.tip_force_y.piecewise.value': [20.0, 0.0], 'initial.shaft_velocity': 10.0}
    cell = plain(step=0.005, steps=120, bend=0.0, **push)._replace(elements=True)
    finer = truth._Finer(cell)
    elements = truth._Elements(cell, finer)
    assert elements.distance(finer.path) < 2e-6
    monkeypatch.setattr(truth, '_Elements', lambda *_: elements)
    found = [each['error'] for each in truth.judge(cell)]
    assert found == pytest.approx(found[:1] * 2, rel=0.1) and found[0] > 1e-4


@pytest.mark.parametrize('number', range(2))
def test_linear_models_of_heavy_tips(number):
    """They converge with the modes, down to the round-off of elements with a heavy tip."""
    few, many = (np.array(numerics.linear_errors(number, modes)) for modes in (3, 8))
    assert (many < np.maximum(1e-4, 0.1 * few)).all() and few.max() < 0.01


def test_linear_models_known_by_hand():
    """A beam of Euler and Bernoulli, and two bodies on the spring of a gear."""
    for errors in numerics.section_errors, numerics.gear_errors:
        assert max(errors(np.random.default_rng(1))) < 1e-4
