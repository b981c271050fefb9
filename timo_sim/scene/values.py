# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Values of parameters, by dotted name: checked, compared, or as older versions logged them."""

import math

from timo_sim.messages.outputs import FRAMES
from timo_sim.scene.parameter import did_you_mean, ParameterError, short, whole_ratio
from timo_sim.scene.parameters import PARAMETERS

_TIP = 'end_effector.mass', 'end_effector.inertia'
# 0.2.0 renamed these. Before 0.2.0 a limit of 0 meant no limit; now it is refused.
SPLIT = 'integrator.tolerance'  # 0.2.0 and earlier split steps by it; logs are read without it
_RENAMED = {'motor.dc.gear': 'motor.dc.gear_ratio', 'step_count': 'steps_per_call'}
_LIMITS = [name for name, parameter in PARAMETERS.items() if not parameter.finite]


def check(values, source):
    """
    Return values by dotted name, converted to the types of their parameters.

    Raises ParameterError, which names the source (a text), if a name is unknown or a value breaks
    its rule.
    """
    checked = {}
    for name, value in values.items():
        if name == SPLIT:
            raise ParameterError(f'{SPLIT} is not a parameter any more: steps are not split, take '
                                 f'a smaller integrator.step ({source})')
        if name not in PARAMETERS:
            raise ParameterError(f'{short(name, str)} = {short(value)} is not a parameter of '
                                 f'timo_sim ({source}){did_you_mean(name, PARAMETERS)}')
        try:
            checked[name] = PARAMETERS[name].check(value)
        except ParameterError as error:
            raise ParameterError(f'{error} ({source})') from None
    return checked


def frame_names(values):
    """
    Return the names of `messages.outputs.FRAMES` in messages, a dictionary.

    `values` are parameters of the node; missing ones have their defaults. Raises ParameterError if
    a name breaks its rule or two are the same.
    """
    given = {name: PARAMETERS[name].check(values.get(name, PARAMETERS[name].default))
             for name in ('frame_prefix', *(f'frame.{frame}' for frame in FRAMES))}
    names = {frame: ('' if frame == 'world' else given['frame_prefix']) + given[f'frame.{frame}']
             for frame in FRAMES}
    if len({*names.values()}) < len(names):
        raise ParameterError('frame.world, frame.carrier, frame.arm and frame.tip must differ, '
                             f'got {", ".join(map(short, names.values()))}')
    return names


def steps_in(duration, step):
    """Return how many time steps a duration has, both in s, or raise ParameterError."""
    return whole_ratio('duration', PARAMETERS['duration'].check(duration),
                       'integrator.step', step)


def check_runtime(values, later):
    """Raise ParameterError if `later` changes what cannot be set while a simulation runs."""
    reactions = values['model.formulation'] == 'newton_root_stress'
    fixed = [name for name, value in later.items() if value != values[name] and (
        not PARAMETERS[name].runtime or reactions and name in _TIP)]
    if fixed:
        raise ParameterError(f'{fixed[0]} = {short(later[fixed[0]])} cannot be set while a '
                             f'simulation{" of newton_root_stress" * (fixed[0] in _TIP)} runs; '
                             f'it stays {short(values[fixed[0]])}')


def current(values):
    """Return values that an older version logged, with their present names and meanings."""
    return {_RENAMED.get(name, name): math.inf if name in _LIMITS and value == 0.0 else value
            for name, value in values.items() if name != SPLIT}


def changed(values):
    """Return the values that differ from their defaults."""
    return {name: value for name, value in values.items() if value != PARAMETERS[name].default}
