# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Random scenes in which errors grow, each of more than 2048 steps.

The arm buckles, stands or is pressed near its critical load, vibrates in resonance, bends by half
its length, or picks up loads at rest; others are ordinary scenes that run long.
"""

import numpy as np

from benchmark.stress.scenes import Cell, cell

STEPS = 2100, 3200  # least and most
HARD = 'buckling', 'near critical', 'standing', 'resonance', 'far bend', 'long', 'pick-up at rest'
_STANDING = 7.837  # q l^3 / (E I) at which a uniform column buckles under its weight q per length


def hard_cell(number, seed=1):
    """Return a Cell: that of a number is the same in every run with the seed."""
    random, kind = np.random.default_rng([seed, 2, number]), HARD[number % len(HARD)]
    base = cell(17 * number + (14 if kind == 'resonance' else 0), seed)  # 14: kind resonance
    values = {name: value for name, value in base.values.items()
              if kind in ('long', 'resonance') or not name.startswith(
                  ('load.', 'motor.drive', 'initial.'))}
    steps = int(random.integers(*STEPS)) // 20 * 20
    values.update({'model.formulation': 'exact', 'model.modes': int(random.choice([3, 5])),
                   'model.axial_modes': 0})
    if kind in ('long', 'resonance'):
        values.pop('initial.modal_coordinates', None)
        return Cell(number, kind, values, steps, steps // 20, False)
    length, height = values['arm.length'], values['arm.height']
    area = height * values['arm.width']
    stiffness = values['arm.young_modulus'] * area * height**2 / 12.0
    mass = values['arm.density'] * area * length
    omega = np.sqrt(3.0 * stiffness / length**3 / (0.24 * mass + values['end_effector.mass']))
    step = float(np.clip(2.0 * np.pi / omega * random.uniform(2.0, 8.0) / steps, 1e-6, 0.02))
    end = steps * step
    values.update({'integrator.step': step, 'carrier.held': str(random.choice(['both', 'y'])),
                   'motor.shaft': 'locked', 'initial.shaft': 0.0})
    critical = np.pi**2 * stiffness / (4.0 * length**2)
    push = float(np.exp(random.uniform(np.log(1e-5), np.log(1e-2)))) * stiffness / length**2
    across = {'load.tip_force_y.piecewise.time': [0.0], 'load.tip_force_y.piecewise.value': [push]}
    if kind in ('buckling', 'near critical'):
        share = random.uniform(1.02, 1.6) if kind == 'buckling' else random.uniform(0.9, 0.995)
        values.update({**across, 'load.tip_force_x.table.time': [0.0, 0.3 * end],
                       'load.tip_force_x.table.value': [0.0, float(-share * critical)]})
    elif kind == 'standing':
        values.update({**across, 'initial.shaft': np.pi / 2.0, 'carrier.held': 'both'})
        values['load.tip_force_x.piecewise.time'] = values.pop('load.tip_force_y.piecewise.time')
        values['load.tip_force_x.piecewise.value'] = values.pop('load.tip_force_y.piecewise.value')
        tip = values['end_effector.mass'] = mass * random.uniform(0.0, 2.0)
        limit = stiffness / length**2 / (mass / _STANDING + tip / (np.pi**2 / 4.0))
        values['gravity'] = [0.0, float(-random.uniform(0.8, 1.1) * limit)]
    elif kind == 'far bend':
        size = random.uniform(1.5, 6.0) * stiffness / length**2
        values.update({'load.tip_force_y.table.time': [0.0, 0.5 * end],
                       'load.tip_force_y.table.value': [0.0, float(size)]})
    else:
        values.update({
            'carrier.held': 'both', 'motor.shaft': 'free', 'initial.shaft': -0.6,
            'end_effector.mass': 0.3 * mass, 'end_effector.inertia': 0.02 * mass * length**2,
            'motor.shaft_inertia': mass * length**2, 'end_effector.pick_up': 'at_rest',
            'payload.time': [steps // 4 * step, steps // 2 * step],
            'payload.mass': [mass * random.uniform(0.5, 2.0), 0.3 * mass],
            'payload.inertia': [0.1 * mass * length**2, 0.02 * mass * length**2],
            'load.torque.piecewise.time': [0.0],
            'load.torque.piecewise.value': [random.uniform(0.05, 0.5) * stiffness / length]})
    return Cell(number, kind, {name: np.asarray(value).tolist() for name, value in values.items()},
                steps, steps // 20, False)
