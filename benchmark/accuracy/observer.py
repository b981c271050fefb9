# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Observers of simulated arms and of a real one: `make observer DATA=folder` fills doc/observer.md.

`made` needs no data. `real` is the record of the rotary flexible link of `real_arm`, which says
where it is from: its first half is fitted, and an observer follows the second by encoder and
voltage. The linear filter has the same fit, noise and disturbance, without dry friction.
"""

import math
import os
from pathlib import Path
import warnings

import numpy as np
from oracles.observed import observe

from benchmark import ROOT
from benchmark.drawing import DIFFERENCE, MEASURED, name_ends, PREDICTED, save, sheet
from benchmark.report import make_page, table
import timo_sim
from timo_sim.fitting.problem import r_squared

PERIOD, UPDATES, SEEDS = 0.01, 100, 100
# Sensors in words, and their noise.
SENSORS = {
    'encoder': {'encoder.noise': 1e-4},
    'encoder, strain gauge': {'encoder.noise': 1e-4, 'root_strain.noise': 2e-6},
    'encoder, IMU at the tip': {
        'encoder.noise': 1e-4, 'gyro.noise': 2e-3, 'tip_acceleration.noise': 0.05}}
ARMS = {'held': {'carrier.held': 'both'}, 'free': {}}
FILES, RECORD = ROOT / 'example' / 'real_arm', Path(
    os.environ.get('DATA', 'data'), 'Optimal_SysID/Data/data_vm.mat')
PERIOD_OF_RECORD = 0.002         # [s]
ENCODER = 2.0 * math.pi / 4096.0  # resolution of the real encoder [rad]


def errors(scene, seed):
    """Return error, deviation and deflection of the tip [m], and innovations, of an observer."""
    rows, innovations = [], []
    for observer, arm, _ in observe(scene, seed, (1.0, 0.5), PERIOD, UPDATES):
        true = arm.deflection()[1]
        rows.append([observer.deflection()[1] - true, observer.deflection_deviation[1], true])
        innovations.append(observer.normalised_innovation)
    return np.array(rows), np.array(innovations)


def made(quick):
    """Return a table of observers of simulated arms."""
    rows = []
    for arm, values in ARMS.items():
        for words, noise in SENSORS.items():
            scene = timo_sim.load_scene({}, {
                **values, 'arm.damping_ratio': [0.01],
                **{f'sensor.{name}': each for name, each in noise.items()}})
            runs = [errors(scene, seed) for seed in range(10 if quick else SEEDS)]
            tips, innovations = (np.array([run[k] for run in runs]) for k in (0, 1))
            late = tips[:, len(tips[0]) // 2:]
            rows.append([
                arm, words, f'{1e3 * np.std(late[..., 2]):.1f} mm',
                f'{1e3 * np.sqrt(np.mean(late[..., 0]**2)):.2f} mm',
                f'{100.0 * np.mean(abs(tips[..., 0]) < 3.0 * tips[..., 1]):.2f} %',
                f'{np.mean(innovations**2):.3f}'])
    return table(['carrier', 'sensors', 'rms deflection of the tip', 'rms error',
                  'within three deviations', 'mean square of normalised innovations'], rows)


class Link:
    """The real arm: its record, and what was fitted to the first half."""

    def __init__(self):
        scene = timo_sim.load_scene(FILES / 'merced.yaml')
        record = timo_sim.read_record(RECORD, FILES / 'merced_columns.yaml')
        # The arm behind its shaft, then the motor that turns it.
        angle = timo_sim.read_record(RECORD, FILES / 'merced_angle.yaml')
        self.arm = timo_sim.fit(scene, angle, [
            '~inf', 'arm.young_modulus', 'arm.damping_ratio', 'root_strain.gain'], hold_out=0.5)
        known = scene.vary({name: self.arm.scene.values[name]
                            for name in ('arm.young_modulus', 'arm.damping_ratio')})
        self.motor = timo_sim.fit(known, record, [
            '~inf', 'motor.shaft_inertia', 'motor.dc.torque_constant', 'motor.viscous_friction',
            'motor.coulomb_friction', 'motor.coulomb_speed', 'voltage.bias', 'root_strain.gain'],
            hold_out=0.5)
        self.scene = self.motor.scene.vary({'sensor.encoder.resolution': ENCODER})
        # Half of the dry friction, and about a period of the clamped arm.
        self.disturbance = 0.5 * self.scene.values['motor.coulomb_friction'], 0.4
        self.t, self.shaft = record.outputs['shaft'].t, record.outputs['shaft'].values
        self.strain = record.outputs['root_strain'].values / self.arm.values['root_strain.gain']
        self.volts = record.inputs['voltage'].values + self.motor.values['voltage.bias']
        self.held_out = self.t > self.motor.until

    def share(self, strain):
        """Return R^2 of a strain, of the length of the record, on the half that was held out."""
        return r_squared(self.strain[self.held_out], strain[self.held_out])

    def open_loop(self, scene, volts):
        """Return the strain of a run from the beginning by the voltage alone, times a factor."""
        simulator, found = timo_sim.Simulator(scene), []
        for volt in self.volts:
            found.append(simulator.sensors.root_strain)
            simulator.step(voltage=volts * volt, duration=PERIOD_OF_RECORD)
        return np.array(found)

    def observe(self, scene, volts):
        """Return the strain that an observer expects, and its consistency at the end."""
        observer = timo_sim.observer(scene, ['encoder'], {'torque': self.disturbance})
        found = []
        for k, angle in enumerate(self.shaft):
            observer.update({'encoder': angle}, {'voltage': volts * self.volts[k - 1]},
                            PERIOD_OF_RECORD if k else 0.0)
            found.append(observer.expected('root_strain')[0])
        return np.array(found), observer.consistency

    def observe_linearly(self, scene, volts):
        """Return the strain of a Kalman filter of the linear model."""
        fitted = timo_sim.observer(scene, ['encoder'], {'torque': self.disturbance})
        size, (deviation, time) = len(fitted.states), self.disturbance
        linear = timo_sim.linearize(scene.vary({'motor.coulomb_friction': 0.0})).select(
            ['voltage_V', 'torque_N_m'], ['shaft_rad', 'root_strain']).to_discrete(
                PERIOD_OF_RECORD)
        fade, entry = math.exp(-PERIOD_OF_RECORD / time), np.append(linear.B[:, 1], 1.0)
        a = np.zeros((size, size))
        a[:-1, :-1], a[:, -1] = linear.A, fade * entry
        c = np.hstack([linear.C, linear.D[:, 1:]])
        x, p, found = np.zeros(size), fitted.covariance, []
        for k, angle in enumerate(self.shaft):
            volt = volts * self.volts[k - 1] if k else 0.0
            if k:
                x, p = a @ x, a @ p @ a.T + (
                    deviation**2 * (1.0 - fade**2) * np.outer(entry, entry))
                x[:-1] += linear.B[:, 0] * volt
            gain = p @ c[0] / (c[0] @ p @ c[0] + ENCODER**2 / 12.0)
            x, p = x + gain * (angle - c[0] @ x), p - np.outer(gain, c[0] @ p)
            found.append(c[1] @ x + linear.D[1, 0] * volt)
        return np.array(found)


def draw(link, voltage, observed):
    """Draw the strain of the half that was held out, and errors."""
    figure, (above, *below) = sheet(3, height=5.4, sharex=True)
    part = link.held_out
    above.plot(link.t[part], 1e6 * link.strain[part], color=MEASURED, lw=3.0, label='measured')
    above.plot(link.t[part], 1e6 * observed[part], color=PREDICTED, lw=1.2,
               label='observer, on it')
    for axes, words, strain in zip(below, (
            'error of the\nobserver', 'error by the\nvoltage alone'), (observed, voltage)):
        axes.plot(link.t[part], 1e6 * (strain - link.strain)[part], color=DIFFERENCE, lw=1.0,
                  label=words)
        axes.set(ylim=(-80.0, 80.0))
    for axes in above, *below:
        axes.set(xlim=link.t[part][[0, -1]], ylabel='[1e-6]')
        axes.grid(alpha=0.3)
    above.set_title('strain at the root', loc='left')
    below[1].set(xlabel='t [s]')
    name_ends(above, *below)
    save(figure, 'observer')


def real(quick):
    """Observe the real arm; draw it, and return a table."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', timo_sim.ModelWarning)
        link = Link()
        scene, rows = link.scene, []
        for words, changed, volts in (
                ('as fitted', scene, 1.0), ('voltage 10 % too low', scene, 0.9),
                ('no dry friction in the model', scene.vary({'motor.coulomb_friction': 0.0}), 1.0),
                ('20 % more inertia of the shaft', scene.vary({
                    'motor.shaft_inertia': 1.2 * scene.values['motor.shaft_inertia']}), 1.0)):
            observed, consistency = link.observe(changed, volts)
            strains = (link.open_loop(changed, volts), link.observe_linearly(changed, volts),
                       observed)
            rows.append([words, *(f'{link.share(each):.4f}' for each in strains),
                         f'{consistency:.2f}'])
            if changed is scene and volts == 1.0:
                draw(link, strains[0], strains[2])
    return table(['R^2 of the strain', 'voltage alone', 'linear filter', 'observer',
                  '`consistency`'], rows)


PARTS = {'observer made': made, 'observer real': real}

if __name__ == '__main__':
    make_page(__spec__, __doc__, 'observer.md', PARTS, 'few seeds')
