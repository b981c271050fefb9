# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Values that keep their rules but are hardly meant: wrong units, degrees, mixed-up moduli."""

import math

# Material, for solids; an angle beyond this is more likely one in degrees.
_STIFFNESS, _DENSITY, _MOST_TURNS = (1e5, 2e12), (10.0, 25000.0), 2.0 * math.pi
# Of the arm: a Timoshenko beam of one or two heights is a block.
_LEAST_SLENDERNESS = 3.0


def implausible(values):
    """
    Return what to say of implausible values of a scene, or None.

    Parameters
    ----------
    values : dict
        Of all parameters of the scene, checked.

    """
    found = [*_material(values), *_shape(values), *_angles(values)]
    return 'is this meant? ' + '; '.join(found) if found else None


def _each(values, name):
    return values.get(f'arm.profile.{name}') or (values[f'arm.{name}'],)


def _material(values):
    for name, unit, (low, high) in (('young_modulus', 'Pa', _STIFFNESS),
                                    ('density', 'kg/m3', _DENSITY)):
        for value in _each(values, name):
            if not low <= value <= high:
                yield f'arm.{name} = {value:g} {unit} is that of no solid'
                break
    if min(_each(values, 'young_modulus')) < max(_each(values, 'shear_modulus')):
        yield (f'arm.shear_modulus = {max(_each(values, "shear_modulus")):g} Pa is above '
               f'arm.young_modulus = {min(_each(values, "young_modulus")):g} Pa')


def _shape(values):
    height = max(_each(values, 'height'))
    if values['arm.length'] < _LEAST_SLENDERNESS * height:
        yield (f'arm.length = {values["arm.length"]:g} m is less than {_LEAST_SLENDERNESS:g} '
               f'times arm.height = {height:g} m')


def _angles(values):
    if abs(values['initial.shaft']) > _MOST_TURNS:
        yield (f'initial.shaft = {values["initial.shaft"]:g} rad is more than a turn; in degrees '
               f'it would be {math.radians(values["initial.shaft"]):.4g} rad')
