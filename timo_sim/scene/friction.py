# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""Coulomb friction of a scene: of which joints, and rules for it."""

import numpy as np

from timo_sim.scene.parameter import ParameterError

# A step of the method is stable up to 2.78 over the rate at which friction brakes a joint.
_STABLE = 2.0


def largest(values, constraints):
    """Return the largest friction of carrier x, y [N] and shaft [N m], 0 if not free, (3,)."""
    axis, shaft = (values[f'{body}.coulomb_friction'] for body in ('carrier', 'motor'))
    held = [position is not None for position in constraints.carrier]
    return np.where([*held, constraints.driven], 0.0, [axis, axis, shaft])


def speeds(values, limit):
    """Return the speeds over which it builds up; 0 for joints that stick or have none, (3,)."""
    axis, shaft = (values[f'{body}.coulomb_speed'] for body in ('carrier', 'motor'))
    return np.where(limit > 0.0, [axis, axis, shaft], 0.0)


def check_friction(scene):
    """Raise ParameterError if one joint sticks and another does not."""
    values, rubbing, slow = scene.values, scene.friction > 0.0, scene.friction_speed
    if slow.any() and not slow[rubbing].all():
        raise ParameterError('carrier.coulomb_speed and motor.coulomb_speed must both be 0 or '
                             'both > 0 where both have Coulomb friction, got '
                             f'{values["carrier.coulomb_speed"]:g} and '
                             f'{values["motor.coulomb_speed"]:g}')


def check_slope(scene):
    """Raise ParameterError if steps are too long for friction that builds up over a speed."""
    slow, mobility = scene.friction_speed, np.zeros(3)
    if not slow.any():
        return
    model = scene.build()
    free = [*model.axes, *range(2 + model.first, model.size // 2)]
    matrix = model.mass_matrix(scene.initial_motion())[0][np.ix_(free, free)]
    for coordinate, each in zip(free, np.diag(np.linalg.inv(matrix))):
        if coordinate < 3:
            mobility[coordinate] = each
    rate = np.max(mobility * np.divide(scene.friction, slow, out=np.zeros(3), where=slow > 0.0))
    if rate * scene.step > _STABLE:
        raise ParameterError(f'integrator.step = {scene.step:g} s must be at most '
                             f'{_STABLE / rate:.2g} s for Coulomb friction with this slope: take '
                             'that, or a larger coulomb_speed')
