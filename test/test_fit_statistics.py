# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Fits to made records: intervals hold the truth, and no estimate could be much better."""

import numpy as np
import pytest

import timo_sim

SEEDS, DURATION, PERIOD = 20, 2.0, 0.004
TRUTH = {'arm.young_modulus': 200e9, 'motor.viscous_friction': 0.05, 'motor.shaft_inertia': 2e-3}
GUESSES = {'arm.young_modulus': 1.3, 'motor.viscous_friction': 0.6, 'motor.shaft_inertia': 0.7}
NOISE = {'shaft': 1e-3, 'tip_transverse': 5e-4}  # standard deviations [rad, m]
T = PERIOD * np.arange(round(DURATION / PERIOD))
TORQUE = 0.1 * np.sign(np.sin(5.0 * T + 0.3)) * np.cos(9.0 * T)
SCENE = timo_sim.load_scene({}, {
    'arm.length': 0.42, 'arm.section.height': 0.001, 'arm.density': 7800.0,
    'arm.shear_modulus': 77e9,
    'arm.damping_ratio': [0.02], 'carrier.held': 'both', 'end_effector.mass': 0.05,
    'end_effector.inertia': 1e-5, 'initial.shaft': 0.0, 'integrator.step': PERIOD, **TRUTH})


def clean(values):
    """Return what sensors without noise show, with the torque as a load of the scene."""
    run = timo_sim.simulate(SCENE.vary({
        **values, 'load.torque.piecewise.time': T, 'load.torque.piecewise.value': TORQUE}),
        DURATION, estimate=False)
    return {'shaft': run.shaft[:-1], 'tip_transverse': run.deflection(0.42)[:-1, 1]}


def bound():
    """Return the least standard deviations of the logarithms, by Cramer and Rao, shape (3,)."""
    columns = []
    for name, value in TRUTH.items():
        up, down = (clean({name: value * np.exp(step)}) for step in (1e-3, -1e-3))
        columns.append(np.concatenate([(up[each] - down[each]) / (2e-3 * NOISE[each])
                                       for each in NOISE]))
    jacobian = np.column_stack(columns)
    return np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))


@pytest.fixture(scope='module')
def fits():
    shown = clean({})
    guess = SCENE.vary({name: factor * TRUTH[name] for name, factor in GUESSES.items()})
    found = []
    for seed in range(SEEDS):
        random = np.random.default_rng(seed)
        record = timo_sim.Record.of({'torque': (T, TORQUE)}, {
            name: (T, values + NOISE[name] * random.standard_normal(len(T)))
            for name, values in shown.items()})
        found.append(timo_sim.fit(guess, record, [*TRUTH], starts=1))
    return found


@pytest.mark.parametrize('name', TRUTH)
def test_intervals_hold_the_truth(fits, name):
    held = sum(fit.estimates[name].low <= TRUTH[name] <= fit.estimates[name].high for fit in fits)
    # Of 20 intervals of 95 %, fewer than 17 hold it with a probability of 1.6 %.
    assert held >= 17


def test_estimates_are_as_good_as_can_be(fits):
    errors = np.array([[np.log(fit.values[name] / TRUTH[name]) for name in TRUTH]
                       for fit in fits])
    ratio = errors.std(axis=0, ddof=1) / bound()
    # Of 20, a standard deviation is outside of this with a probability of 0.6 %.
    assert np.all((0.6 < ratio) & (ratio < 1.5)), ratio


def test_the_intervals_are_those_of_the_bound(fits):
    white = [fit for fit in fits if fit.white]
    assert len(white) >= 17  # by chance 2 % of the records do not seem to be
    least = bound()
    for fit in white:
        found = [fit.estimates[name].deviation / fit.values[name] for name in TRUTH]
        # 5 standard deviations of those that are estimated from 500 samples.
        assert found == pytest.approx(least, rel=0.16)
