# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0


"""Fits that start far from the truth, fits to several records, and the record to take next."""

from click.testing import CliRunner
import numpy as np
import pytest
import yaml

import timo_sim
from timo_sim.cli import main

PERIOD, DURATION = 0.004, 3.0
T = PERIOD * np.arange(round(DURATION / PERIOD))
TRUTH = {'arm.young_modulus': 200e9, 'end_effector.mass': 0.05, 'motor.viscous_friction': 0.05,
         'motor.shaft_inertia': 2e-3}
SCENE = timo_sim.load_scene({
    'arm.length': 0.42, 'arm.height': 0.001, 'arm.density': 7800.0, 'arm.shear_modulus': 77e9,
    'arm.damping_ratio': [0.02], 'carrier.held': 'both', 'end_effector.inertia': 1e-5,
    'initial.shaft': 0.0, 'integrator.step': PERIOD, **TRUTH})
NOISE = {'shaft': 1e-3, 'tip_transverse': 5e-4}  # standard deviations [rad, m]
SQUARE = 0.1 * np.sign(np.sin(4.0 * T + 0.3))
SLOW = 0.1 * np.sin(1.5 * T)


def made(torque, seed, shaft=0.0, bias=0.0, size=1.0, noise=NOISE):
    """Return a Record of the true scene, from a run with the torque as a load."""
    random = np.random.default_rng(seed)
    run = timo_sim.simulate(SCENE.vary({
        'initial.shaft': shaft, 'load.torque.piecewise.time': T,
        'load.torque.piecewise.value': torque}), DURATION, estimate=False)
    clean = {'shaft': run.shaft[:-1] + bias, 'tip_transverse': run.deflection(0.42)[:-1, 1]}
    return timo_sim.Record.of({'torque': (T, torque)}, {
        name: (T, values + size * noise[name] * random.standard_normal(len(T)))
        for name, values in clean.items()})


def wrong(*factors):
    """Return the scene with guesses that are wrong by factors."""
    return SCENE.vary({name: factor * value
                       for factor, (name, value) in zip(factors, TRUTH.items())})


def test_a_fit_starts_well_however_wrong_the_guess_is():
    for seed, factors in enumerate([(3.0, 1 / 3.0, 3.0, 3.0), (1 / 9.0, 3.0, 1 / 3.0, 1 / 3.0)]):
        found = timo_sim.fit(wrong(*factors), made(SQUARE, seed), [*TRUTH])
        for name, value in TRUTH.items():
            each = found.estimates[name]
            assert abs(each.value - value) < 4.0 * each.deviation, name


def test_another_set_of_parameters_that_fits_as_well_is_told():
    """The tip of a rigid arm shows the square of its length, or the sign of a gain."""
