# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The stored finite-element references, and the scenes that have no file of their own."""

import csv
import math
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

import timo_sim

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / 'test' / 'data'
LENGTH, DURATION, PERIOD, STEP = 2.0, 10.0, 0.01, 0.002  # of the paper's scene, and its runs
# Torque steps on the paper's manipulator, without forces.
TORQUE = {'load.torque.piecewise.time': [0.0, 0.5, 1.0],
          'load.torque.piecewise.value': [20.0, -20.0, 0.0]}
# The paper's arm, let go horizontally: it swings about a shaft on a held carrier.
PENDULUM = {'gravity': [0.0, -9.81], 'carrier.held': 'both', 'initial.shaft': 0.0}
# The arm of config/spin_up.yaml, clamped and let go horizontally: its weight bends it by up to a
# fifth of its length.
CANTILEVER = {'arm.length': 10.0, 'arm.section.width': math.sqrt(0.006),
              'arm.section.height': math.sqrt(0.006),
              'arm.density': 200.0, 'arm.young_modulus': 1.4e4 / 3e-6,
              'arm.shear_modulus': 1e7 / 0.006, 'arm.section.shear_correction': 1.0,
              'end_effector.mass': 0.0, 'end_effector.inertia': 0.0, 'gravity': [0.0, -9.81],
              'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.shaft': 0.0}
STATIONS = {'0': 0.0, 'l4': 0.25, 'l2': 0.5, '3l4': 0.75, 'l': 1.0}  # xi / l


def read(name):
    """Return the comment and the columns, by name, of a stored table."""
    with open(DATA / f'finite_elements_{name}.csv', encoding='utf-8') as file:
        comment = file.readline().lstrip('# ').strip()
        names, *rows = csv.reader(file)
    return comment, dict(zip(names, np.array(rows, dtype=float).T))


def world(theta, carrier, along, across):
    """Return points of the arm frame in world axes, all of shape (n,), carrier (n, 2) [m]."""
    cosine, sine = np.cos(theta), np.sin(theta)
    return carrier + np.column_stack([cosine * along - sine * across,
                                      sine * along + cosine * across])


def station(reference, name, length):
    """
    Return position and angle of a section of the finite-element model.

    Returns
    -------
    position : ndarray, shape (n, 2)
        In world axes [m].
    angle : ndarray, shape (n,)
        Of the section in world axes [rad].

    """
    theta = reference['theta_rad']
    carrier = np.column_stack([reference['x_c_m'], reference['y_c_m']])
    if name == '0':
        return carrier, theta
    along = STATIONS[name] * length + reference[f'u_{name}_m']
    return (world(theta, carrier, along, reference[f'w_{name}_m']),
            theta + reference[f'phi_{name}_rad'])


def spin_up():
    """Return theta [rad], its rate and its acceleration, as functions of t [s]."""
    rate = 2.0 * math.pi / 15.0
    return (
        lambda t: 0.4 * (t**2 / 2 + (math.cos(rate * t) - 1) / rate**2) if t < 15 else 6 * t - 45,
        lambda t: 0.4 * (t - math.sin(rate * t) / rate) if t < 15 else 6.0,
        lambda t: 0.4 * (1 - math.cos(rate * t)) if t < 15 else 0.0)


def peak(t, values):
    """Return the largest absolute value of a cubic spline through samples 10 ms apart."""
    fine = np.linspace(t[0], t[-1], 20 * len(t) - 19)
    return np.abs(CubicSpline(t, values)(fine)).max()


def simulate(formulation, modes, period=PERIOD):
    """Return a run of the paper's scene, by default sampled as the reference."""
    scene = timo_sim.load_scene(ROOT / 'config' / 'paper.yaml', {
        'model.formulation': formulation, 'model.modes': modes, 'integrator.step': STEP})
    return timo_sim.simulate(scene, DURATION, sample_every=round(period / STEP), estimate=False)


def motion_of(run):
    """Return position and angle of a run at each station, as `station` of the reference."""
    return {name: (run.position(share * LENGTH), run.shaft + run.rotation(share * LENGTH))
            for name, share in STATIONS.items()}


def errors(motion, truth):
    """
    Return the errors of x, y and angle at each station, in per cent, shape (n, 3).

    They are relative to the largest absolute value of the same quantity in the reference.
    """
    result = {}
    for name in STATIONS:
        ours, theirs = (np.column_stack([position, angle])
                        for position, angle in (motion[name], truth[name]))
        result[name] = 100.0 * np.abs(ours - theirs) / np.abs(theirs).max(axis=0)
    return result
