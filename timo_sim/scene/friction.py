# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Coulomb friction of a scene: of which joints, and the longest step for it."""

import numpy as np

from timo_sim.scene.parameter import ParameterError

# A step is stable up to 2.785 over the rate at which friction brakes joints, as is measured for 0
# to 5 modes; the mobility of joints may grow a little in a run.
_STABLE = 2.5


def largest(values, constraints):
    """Return the largest dry friction of carrier x, y [N] and shaft [N m], 0 if not free, (3,)."""
    axis, shaft = (0.0 if values[f'{body}.coulomb_speed'] else values[f'{body}.coulomb_friction']
                   for body in ('carrier', 'motor'))
    held = [position is not None for position in constraints.carrier]
    return np.where([*held, constraints.driven], 0.0, [axis, axis, shaft])


def check_slope(scene):
    """Raise ParameterError if steps are too long for friction that builds up over a speed."""
    limit, speed = np.array(scene.manipulator.coulomb)[[0, 0, 1]].T
    if not limit.any():
        return
    model, motion = scene.build(), scene.initial_motion()
    free = [*model.axes, *range(2 + model.first, model.size // 2)]
    root = np.sqrt(limit / speed)[[joint for joint in free if joint < 3], np.newaxis]
    rate = 0.0
    # Along the arm the carrier is less mobile than across it.
    for motion[2] in (0.0, 0.5 * np.pi):
        mobility = np.linalg.inv(model.mass_matrix(motion)[0][np.ix_(free, free)])
        slopes = root * mobility[:len(root), :len(root)] * root.T
        rate = max(rate, *np.linalg.eigvalsh(slopes), 0.0)
    if rate * scene.step > _STABLE:
        raise ParameterError(f'integrator.step = {scene.step:g} s must be at most '
                             f'{_STABLE / rate:.2g} s for Coulomb friction with this slope: take '
                             f'that, or a coulomb_speed {rate * scene.step / _STABLE:.2g} times '
                             'as large')
