# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Numbers of a scene by name, such as `initial.modal_rates[1]`: what fits and derivatives vary."""

from collections.abc import Iterable, Mapping
import math
import re
from typing import Any

from timo_sim.scene.parameters import (
    did_you_mean, MODAL, Parameter, ParameterError, PARAMETERS, SCENE, short)
from timo_sim.scene.scene import Scene
from timo_sim.topics.commands import JOINTS

INITIAL = 'initial'  # stands for the whole initial state
# Parameters that no derivative or fit can vary begin with these.
_FIXED = 'model.', 'integrator.', 'sensor.', 'payload.time', 'motor.drive', 'carrier.drive'
_INDEXED = re.compile(r'(.+)\[(\d+)\]')


def number_of(name: str, scene: Scene, others: str = '',
              names: Iterable[str] = ()) -> tuple[Parameter, float]:
    """
    Return the Parameter of a name, and its value in a scene, or raise ParameterError.

    The text of the error ends with `others`: what besides parameters would be valid, `names`.
    """
    base, place = _split_index(name)
    parameter = PARAMETERS.get(base)
    if parameter is None:
        raise ParameterError(f'{short(name, str)} cannot be free: it is '
                             f'{"neither" if others else "not"} a parameter of the scene{others}'
                             f'{did_you_mean(base, [*PARAMETERS, *names])}')
    value = scene.values.get(base)
    if base in MODAL and value == ():
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
    if parameter.runtime and not parameter.finite:
        raise ParameterError(f'{name} cannot be free: it is a limit of commands')
    if not math.isfinite(value):
        raise ParameterError(f'{name} must be finite to be free, got {value}')
    return parameter, value


def _split_index(name):
    match = _INDEXED.fullmatch(name)
    return (match.group(1), int(match.group(2))) if match else (name, None)


def initial_names(scene: Scene) -> list[str]:
    """Return the names of all numbers of the initial state that are not prescribed."""
    still = scene.build().constrained
    joints = [joint for joint, held in zip(JOINTS, still) if not held]
    modes = range(scene.modal_count)
    return [*(f'initial.{joint}' for joint in joints),
            *(f'initial.{joint}_velocity' for joint in joints),
            *(f'{name}[{n}]' for name in MODAL for n in modes)]


def initial_scale(name: str, scene: Scene) -> float:
    """
    Return a change of one number of the initial state.

    It moves the tip by a tenth of the arm's length, or turns it by 0.1 rad.
    """
    base, place = _split_index(name)
    model, length, n = scene.build(), scene.manipulator.arm.length, place or 0
    if base in MODAL:  # a gear turns the shaft, and no section of the arm
        travel = model.tip_travel[3 + n] or length * model.section_turn_bound[n]
        return 0.1 * length / travel * (
            model.modes.omega[n] if base == 'initial.modal_rates' else 1.0)
    return 0.1 if 'shaft' in name else 0.1 * length


def overrides_of(values: Mapping[str, float], scene: Scene) -> dict[str, Any]:
    """Return the overrides of whole parameters that set numbers of a scene, given by name."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        base, place = _split_index(name)
        if isinstance(scene.values[base], tuple):
            whole = found.get(base) or scene.values[base] or (0.0,) * scene.modal_count
            place = place or 0
            found[base] = (*whole[:place], value, *whole[place + 1:])
        else:
            found[base] = value
    return found
