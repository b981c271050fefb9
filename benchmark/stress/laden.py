# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Random scenes in gravity, or with loads at the tip that change."""

import math

import numpy as np

import timo_sim


def laden(given, seed=1):
    """Return a Cell in gravity, whose load at the tip changes, or one of both."""
    random, values = np.random.default_rng([seed, 2, given.number]), dict(given.values)
    length, mass = values['arm.length'], values['arm.density'] * math.prod(
        values[f'arm.{side}'] for side in ('length', 'width', 'height'))

    def log(low, high):
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    kind = random.choice(['gravity', 'payload', 'both'])
    if kind != 'payload':
        # By its weight the clamped arm sags by 1e-3 to 0.3 lengths.
        first = timo_sim.load_scene({**values, 'model.modes': 3, 'model.axial_modes': 0,
                                     'initial.modal_coordinates': []}).build().modes.omega[0]
        angle, strength = random.uniform(-np.pi, np.pi), 0.7 * log(1e-3, 0.3) * length * first**2
        values['gravity'] = [strength * np.cos(angle), strength * np.sin(angle)]
    if kind != 'gravity' and values['model.formulation'] != 'newton_root_stress':
        count = int(random.integers(1, 3))
        steps = np.sort(random.choice(given.steps, min(count, given.steps), replace=False)) + 1
        values['payload.time'] = (steps * values['integrator.step']).tolist()
        values['payload.mass'] = [mass * log(1e-2, 10.0) for _ in steps]
        values['payload.inertia'] = [mass * length**2 * log(1e-4, 1.0) for _ in steps]
        values['end_effector.pick_up'] = random.choice(['moving', 'moving', 'at_rest']).item()
    return given._replace(kind=f'{given.kind}, {kind}', values=values, elements=False)
