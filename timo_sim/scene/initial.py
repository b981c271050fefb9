# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The motion that a scene begins with: as given, at rest in equilibrium, or that of a run."""

import numpy as np

from timo_sim.physics.equations.equilibrium import equilibrium
from timo_sim.scene.parameter import ParameterError

_POSITION = [f'initial.{joint}' for joint in ('carrier_x', 'carrier_y', 'shaft')]
_VELOCITY = [f'{name}_velocity' for name in _POSITION]


def initial_motion(scene, model):
    """Return the motion of a model at t = 0, shape (2 (3 + N),), see `physics.layout`."""
    rest = np.zeros(scene.modal_count)
    position, velocity = ([scene.values[name] for name in names]
                          for names in (_POSITION, _VELOCITY))
    if scene.load.drive is not None:
        position[2], velocity[2], _ = scene.load.drive.stages(0, 1, scene.step)[0, 0]
    q = scene.values['initial.modal_coordinates'] or rest
    qdot = scene.values['initial.modal_rates'] or rest
    motion = np.concatenate([position, q, velocity, qdot])
    if not scene.values['initial.equilibrium']:
        return motion
    try:
        return equilibrium(model, motion, scene.load_at_start())
    except ValueError as error:
        raise ParameterError(f'initial.equilibrium = true: {error}') from None


def state_of(scene, run, t):
    """Return the parameters of a scene that begins with the state of a run, see `Scene.at`."""
    sample = int(np.argmin(np.abs(run.t - t)))
    if not abs(run.t[sample] - t) <= 1e-9 * max(1.0, abs(t)):
        raise ParameterError(f't = {t:g} s must be the time of a sample, the nearest is '
                             f'{run.t[sample]:.12g} s')
    if run.q.shape[1] != scene.modal_count:
        raise ParameterError(f'the run must have {scene.modal_count} modal coordinates, as '
                             f'many as the scene, got {run.q.shape[1]}')
    if scene.values['motor.shaft'] == 'driven':
        raise ParameterError('motor.shaft = driven starts at the beginning of motor.drive, '
                             'not at the state of a run')
    changed = [step for step, *_ in run.payloads if step < round(run.t[sample] / run.scene.step)]
    if changed:
        raise ParameterError(
            f't = {t:g} s must not be after a change of the load at the tip, since the modes are '
            f'those of the first end effector; it changes at {changed[0] * run.scene.step:g} s')
    position, velocity = run.motion[sample].reshape(2, -1).tolist()
    return {**dict(zip(_POSITION, position)), **dict(zip(_VELOCITY, velocity)),
            'initial.modal_coordinates': position[3:], 'initial.modal_rates': velocity[3:],
            'initial.equilibrium': False}
