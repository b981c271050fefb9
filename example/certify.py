# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
How likely a closed loop keeps its bounds, given all that a record says of the arm.

    python example/certify.py

A record of an arm is fitted. Then a PD controller slews 10 000 arms that the record allows
(`Fit.sample`), together in a `Batch`, each with its own noise of the encoder and a stroke on the
tip, of another strength, at another time. Of these runs those within bounds are counted.
"""

from argparse import ArgumentParser
import time

import numpy as np
from scipy.stats import beta
from slew import smooth
import timo_sim

# The arm of a laboratory: a steel strip on a geared DC motor.
ARM = {'arm.length': 0.42, 'arm.section.width': 0.02, 'arm.section.height': 0.001,
       'arm.density': 7800.0,
       'arm.young_modulus': 200e9, 'arm.shear_modulus': 77e9, 'arm.damping_ratio': [0.02],
       'carrier.held': 'both', 'initial.shaft': 0.0, 'integrator.step': 0.002,
       'motor.shaft_inertia': 2e-3, 'motor.viscous_friction': 0.02, 'motor.dc.resistance': 2.6,
       'motor.dc.torque_constant': 0.0077, 'motor.dc.gear_ratio': 70.0,
       'motor.dc.voltage_limit': 12.0, 'end_effector.mass': 0.05, 'end_effector.inertia': 1e-5}
FREE = ['arm.young_modulus', 'arm.damping_ratio', 'end_effector.mass', 'motor.shaft_inertia',
        'motor.viscous_friction', 'motor.dc.torque_constant']
PERIOD, DURATION, SLEW, GOAL = 0.002, 2.5, 1.0, np.pi / 4  # [s], [s], [s], [rad]
STIFFNESS, DAMPING = 10.0, 1.0          # of the controller [V/rad, V s/rad]
NOISE = 2e-4                            # of the encoder, standard deviation [rad]
STROKE, STROKE_LASTS = 1.0, 0.02            # largest force on the tip [N], its duration [s]
MAX_OVERSHOOT, MAX_SETTLED, BAND = 0.05, 1.3, 0.02  # part of the slew, [s], part of the slew


def excite(scene, duration=4.0, seed=0):
    """Return a Record of an arm under a voltage of steps and a chirp, with noise."""
    t, random = PERIOD * np.arange(round(duration / PERIOD)), np.random.default_rng(seed)
    volts = 1.8 * np.sign(np.sin(3.8 * t + 0.3)) + np.sin(2.0 * np.pi * (0.5 + 1.2 * t) * t)
    constant, ratio, resistance = (scene.values[f'motor.dc.{name}'] for name in (
        'torque_constant', 'gear_ratio', 'resistance'))
    run = timo_sim.simulate(scene.vary({
        'load.torque.piecewise.time': t,
        'load.torque.piecewise.value': constant * ratio / resistance * volts}), duration)
    every = round(PERIOD / scene.step)
    outputs = {'shaft': (run.shaft, 1e-3), 'tip_transverse': (run.deflection()[:, 1], 5e-4)}
    return timo_sim.Record.of({'voltage': (t, volts)}, {
        name: (t, seen[::every][:len(t)] + noise * random.standard_normal(len(t)))
        for name, (seen, noise) in outputs.items()})


def slew(scenes, stroke=0.0, begin=0.0, noise=0.0, seed=0, device='cpu'):
    """
    Slew all arms by PD; return overshoot, (n,), as a part of the slew, and time to settle [s].

    `stroke` [N] and `begin` [s], numbers or arrays, (n,), are force and time of the strokes. A run
    that never settles counts as settled at its end.
    """
    batch, random = timo_sim.Batch(scenes, device=device), np.random.default_rng(seed)
    last, force, angles = np.zeros(batch.n), np.zeros((batch.n, 2)), []
    for t in PERIOD * np.arange(round(DURATION / PERIOD)):
        encoder = batch.motion.shaft + noise * random.standard_normal(batch.n)
        part, rate = smooth(t, SLEW)
        volts = (STIFFNESS * (GOAL * part - encoder)
                 + DAMPING * (GOAL * rate - (encoder - last) / PERIOD))
        force[:, 1] = np.where((begin <= t) & (t < begin + STROKE_LASTS), stroke, 0.0)
        batch.step(voltage=volts, tip_force=force, duration=PERIOD)
        last = encoder
        x, y = batch.position().T
        angles.append(np.arctan2(y, x) / GOAL - 1.0)
    off = np.array(angles)
    outside = np.abs(off) - BAND
    late = len(off) - 1 - np.argmax(outside[::-1] > 0.0, axis=0)  # the last sample outside
    k, n = np.minimum(late, len(off) - 2), np.arange(batch.n)
    share = outside[k, n] / (outside[k, n] - outside[k + 1, n])
    return off.max(axis=0), PERIOD * (k + 1 + np.clip(share, 0.0, 1.0))


def between(count, n):
    """Return the 95 % interval (Clopper and Pearson) of a probability, for `count` of n."""
    return (beta.ppf(0.025, count, n - count + 1) if count else 0.0,
            beta.ppf(0.975, count + 1, n - count) if count < n else 1.0)


def main():
    """Fit, sample, slew and count."""
    parser = ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('-n', type=int, default=10000, help='number of closed loops')
    parser.add_argument('--device', default='cpu', help='cpu, or cuda: an NVIDIA GPU')
    given, begun = parser.parse_args(), time.monotonic()
    n = given.n
    found = timo_sim.fit(timo_sim.load_scene(ARM), excite(timo_sim.load_scene(ARM, {
        'arm.young_modulus': 180e9, 'end_effector.mass': 0.06, 'integrator.step': 0.0005})), FREE)
    print(found.report(), end='\n\n')
    random = np.random.default_rng(1)
    overshoot, settled = slew(
        [found.scene.vary(each) for each in found.sample(n).variations],
        STROKE * random.uniform(-1.0, 1.0, n), random.uniform(0.0, SLEW, n), NOISE,
        device=given.device)
    good = {f'overshoot up to {100.0 * MAX_OVERSHOOT:g} %': overshoot <= MAX_OVERSHOOT,
            f'settled within {MAX_SETTLED:g} s': settled <= MAX_SETTLED}
    for text, kept in {**good, 'both': np.all([*good.values()], axis=0)}.items():
        low, high = between(kept.sum(), n)
        print(f'{text}: {100.0 * kept.mean():.1f} % of {n} runs, 95 % interval '
              f'{100.0 * low:.1f} to {100.0 * high:.1f} %')
    print(f'95 % of the runs overshoot by {100.0 * np.quantile(overshoot, 0.95):.1f} % at most '
          f'and settle in {np.quantile(settled, 0.95):.2f} s; {time.monotonic() - begun:.0f} s')


if __name__ == '__main__':
    main()
