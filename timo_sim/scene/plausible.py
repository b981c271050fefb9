# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Warnings about values of a scene that may not be meant."""

from collections.abc import Mapping
from functools import partial
import math
from typing import Any

import numpy as np

from timo_sim.model.bodies import SAME_PROFILE, thinned
from timo_sim.scene.bodies import along, BODIES, profiles_of
from timo_sim.scene.parameters import DEFAULTS, fixed_axes, NEUTRAL, PARAMETERS

# Ranges of real solids.
_PLAUSIBLE = {'young_modulus': (1e5, 2e12, 'Pa'), 'density': (10.0, 25000.0, 'kg/m3')}
_MAX_LENGTH = 30.0  # longest arm that is not taken for one in millimetres [m]
_MIN_SLENDERNESS = 3.0  # length over height; a shorter arm is a block, not a beam


def find_implausible(values: Mapping[str, Any]) -> str | None:
    """
    Return a warning about implausible values of a scene, or None.

    It marks those that are defaults, and says what is left out of a profile of many places.
    """
    each = partial(along, values)

    def shown(name):
        default = ' (the default)' if values[name] == PARAMETERS[name].default else ''
        return f'{name} = {values[name]:g} {PARAMETERS[name].unit}{default}'

    found = []
    for name, (low, high, unit) in _PLAUSIBLE.items():
        found += [f'arm.{name} = {value:g} {unit} is outside the range of real solids'
                  for value in each(name) if not low <= value <= high][:1]
    height = max(each('height'))
    moduli = np.column_stack(np.broadcast_arrays(each('shear_modulus'), each('young_modulus')))
    found += [f'arm.shear_modulus = {shear:g} Pa is above arm.young_modulus = {young:g} Pa'
              for shear, young in moduli if shear > young][:1]
    longest = max(values['arm.length'], values['hub.radius'], *each('width'), height)
    if longest > _MAX_LENGTH:
        found.append(f'a length of {longest:g} m is more than {_MAX_LENGTH:g} m: lengths are in '
                     'metres, not in millimetres')
    if values['arm.section.shape'] in ('round', 'tube') and values['arm.section.width'] != (
            PARAMETERS['arm.section.width'].default):
        found.append(f'{shown("arm.section.width")} is not used: the diameter is '
                     f'{shown("arm.section.height")}')
    for body in BODIES:
        speed, way, rest = (f'{body}.coulomb_{name}' for name in (
            'speed', 'presliding', 'static'))
        if values[speed] and values[way] and values[rest] == 1.0:
            found.append(f'{speed} = {values[speed]:g} is not used, since {rest} = 1')
    mass, inertia = values['end_effector.mass'], values['end_effector.inertia']
    if inertia > mass * (0.5 * values['arm.length'])**2 and (mass or inertia == PARAMETERS[
            'end_effector.inertia'].default):
        found.append(f'{shown("end_effector.inertia")} is that of {shown("end_effector.mass")} '
                     f'at more than half of {shown("arm.length")} from its centre')
    if values['arm.length'] < _MIN_SLENDERNESS * height:
        found.append(f'arm.length = {values["arm.length"]:g} m is less than '
                     f'{_MIN_SLENDERNESS:g} times arm.section.height = {height:g} m')
    places, *profiles = (tuple(each) for each in (
        values['arm.profile.position'], *profiles_of(values).values()))
    kept, _, change = thinned(places, tuple(each for each in profiles
                                            if len(each) == len(places)))
    if change > SAME_PROFILE:
        found.append(f'arm.profile.position has {len(places)} places, of which the model has '
                     f'{len(kept)}, with values within {100.0 * change:.2g} % of those given')
    angle = values['initial.shaft']
    if abs(angle) > 2.0 * math.pi:
        found.append(f'initial.shaft = {angle:g} rad is more than a turn; in degrees it would be '
                     f'{math.radians(angle):.4g} rad')
    return 'is this meant? ' + '; '.join(found) if found else None


def find_outdated(given: Mapping[str, Any], values: Mapping[str, Any]) -> str | None:
    """Return a warning about what a scene of its own without version leaves out, or None."""
    still = {'motor.mass': fixed_axes(values) == 'both' and not any(values['gravity']),
             'initial.shaft': values['motor.shaft'] == 'driven'}
    old = [f'{name} = {values[name]:g} (was {DEFAULTS[name]:g})' for name in NEUTRAL
           if name not in given and name in (
               'end_effector.mass', 'end_effector.inertia', *still) and not still.get(name)]
    if not old or 'scene_version' in given:
        return None
    return ('values that this scene leaves out are no longer those of the paper: '
            f'{", ".join(old)}; give them, or scene_version: 1 if this is meant')
