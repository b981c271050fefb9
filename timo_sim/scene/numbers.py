# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The numbers of a scene that may vary continuously: their names, values, scales, and their change.

A name is that of a parameter, with [k] for an element of a list.
"""

import math
import re

from timo_sim.scene.parameter import did_you_mean, ParameterError, SCENE, short
from timo_sim.scene.parameters import PARAMETERS

INITIAL = 'initial'  # stands for the whole initial state
_FIXED = 'model.', 'integrator.', 'sensor.', 'payload.time', 'motor.drive'
_INDEXED = re.compile(r'(.+)\[(\d+)\]')


def number_of(name, scene, others='', names=()):
    """
    Return the Parameter of a name, and its value in a scene.

    Parameters
    ----------
    name : str
    scene : Scene
    others : str
        What else the caller knows, for the text of an error.
    names : iterable of str
        Names of these, of which one may be meant.

    Raises
    ------
    ParameterError
        If the name is unknown or ambiguous, or it is no number of the physics.

    """
    base, place = _base(name)
    parameter = PARAMETERS.get(base)
    if parameter is None:
        raise ParameterError(f'{short(name, str)} cannot be free: it is '
                             f'{"neither" if others else "not"} a parameter of the scene{others}'
                             f'{did_you_mean(base, [*PARAMETERS, *names])}')
    value = scene.values.get(base)
    if base.startswith('initial.modal') and value == ():
        value = (0.0,) * scene.modal_count
    if (parameter.scope != SCENE or base.startswith(_FIXED)
            or not isinstance(value, (float, tuple)) or value is True):
        raise ParameterError(f'{name} cannot be free: it is no number of the physics')
    if isinstance(value, tuple):
        if place is None and len(value) == 1:
            place = 0
        if place is None or place >= len(value):
            raise ParameterError(f'{name} cannot be free: {base} has {len(value)} elements, of '
                                 f'which one is named {base}[0]')
        return parameter, value[place]
    if place is not None:
        raise ParameterError(f'{name} cannot be free: {base} is one number')
    if not math.isfinite(value) or parameter.name.endswith('_limit'):
        raise ParameterError(f'{name} cannot be free: it is a limit')
    return parameter, value


def _base(name):
    match = _INDEXED.fullmatch(name)
    return (match.group(1), int(match.group(2))) if match else (name, None)


def initial_names(scene):
    """Return the names of all numbers of the initial state that are not prescribed."""
    still = scene.build().constrained
    joints = [joint for joint, held in zip(('carrier_x', 'carrier_y', 'shaft'), still) if not held]
    modes = range(scene.modal_count)
    return [*(f'initial.{joint}' for joint in joints),
            *(f'initial.{joint}_velocity' for joint in joints),
            *(f'initial.modal_coordinates[{n}]' for n in modes),
            *(f'initial.modal_rates[{n}]' for n in modes)]


def initial_scale(name, scene):
    """Return what of the initial state moves the tip by a tenth of the arm, or turns it by 0.1."""
    base, n = _base(name)
    model, length = scene.build(), scene.manipulator.arm.length
    if base == 'initial.modal_coordinates':
        return 0.1 * length / model.reach[3 + n]
    if base == 'initial.modal_rates':
        return 0.1 * length / model.reach[3 + n] * model.modes.omega[n]
    return 0.1 if 'shaft' in name else 0.1 * length


def placed(values, scene):
    """Return numbers of the scene, by name, as overrides of whole parameters."""
    found = {}
    for name, value in values.items():
        base, place = _base(name)
        if isinstance(scene.values[base], tuple):
            whole = found.get(base) or scene.values[base] or (0.0,) * scene.modal_count
            place = place or 0
            found[base] = (*whole[:place], value, *whole[place + 1:])
        else:
            found[base] = value
    return found
