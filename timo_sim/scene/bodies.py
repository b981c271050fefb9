# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Bodies and constraints, made of the checked values of a scene."""

from collections.abc import Mapping
from dataclasses import fields
import math
from typing import Any

import numpy as np

from timo_sim.model.bodies import Beam, Constraints, Gear, Manipulator, Section, thinned
from timo_sim.scene.parameters import (
    driven_along, fixed_axes, ParameterError, PARAMETERS, same_length, short)

BODIES = 'carrier', 'motor', 'motor.rotor'  # those with friction
# Presliding where none is given, seen from the shaft [m, rad].
_PRESLIDING = {'carrier': 1e-4, 'motor': 1e-3, 'motor.rotor': 1e-3}


def modal_count(values: Mapping[str, Any]) -> int:
    """Return the number of modal coordinates, axial ones included, without static shapes."""
    return (values['model.modes'] + values['model.axial_modes']
            + (values['motor.gear.stiffness'] > 0.0))


def manipulator_of(values: Mapping[str, Any]) -> Manipulator:
    """Return the Manipulator that the values describe."""
    elastic, back_emf = values['motor.gear.stiffness'], motor_constants(values)[1]
    gear, turns = None, values['motor.dc.gear_ratio']
    if elastic:
        gear = Gear(stiffness=elastic, damping=values['motor.gear.damping'],
                    backlash=values['motor.gear.backlash'],
                    inertia=turns**2 * values['motor.rotor.inertia'],
                    friction=turns**2 * values['motor.rotor.viscous_friction'] + back_emf)
    return Manipulator(
        arm=_arm(values), carrier_mass=values['carrier.mass'], motor_mass=values['motor.mass'],
        shaft_inertia=values['motor.shaft_inertia'],
        end_effector_mass=values['end_effector.mass'],
        end_effector_inertia=values['end_effector.inertia'],
        end_effector_offset=values['end_effector.offset'],
        off_tip=any((values['end_effector.offset'], *values['payload.offset'])),
        spring=tuple((stiffness, values['motor.spring.rest']) for stiffness in [
            values['motor.spring.stiffness']] if stiffness),
        carrier_friction=values['carrier.viscous_friction'],
        shaft_friction=values['motor.viscous_friction'] + (0.0 if elastic else back_emf),
        coulomb=tuple(_smooth_friction(values, body) for body in BODIES),
        hub_radius=values['hub.radius'], gear=gear, motor_limit=_motor_limit(values))


def _coulomb(values, body):
    # Limit, speed, presliding, friction at rest over that in motion, and asymmetry of the Coulomb
    # friction of a body; of the rotor as seen from the shaft.
    ratio = values['motor.dc.gear_ratio'] if body == 'motor.rotor' else 1.0
    limit, speed, reach, rest = (values[f'{body}.coulomb_{name}'] for name in (
        'friction', 'speed', 'presliding', 'static'))
    return (ratio * limit, speed / ratio, reach / ratio, rest,
            values.get(f'{body}.coulomb_asymmetry', 0.0))


def _smooth_friction(values, body):
    # A row of `Manipulator.coulomb`. Of friction with presliding the bodies do not know.
    limit, speed, reach, _, uneven = _coulomb(values, body)
    return (limit, speed, uneven) if speed and not reach else (0.0, 1.0, 0.0)


def dry_friction_of(values: Mapping[str, Any]) -> np.ndarray:
    """Return `Scene.bristles` of the values, shape (4, 5)."""
    elastic, held = values['motor.gear.stiffness'] > 0.0, fixed_axes(values)
    found = np.tile([0.0, 0.0, 0.0, 0.0, 1.0], (4, 1))
    for k, (body, moves) in enumerate((
            ('carrier', held not in ('x', 'both')), ('carrier', held not in ('y', 'both')),
            ('motor.rotor' if elastic else 'motor', values['motor.shaft'] == 'free'),
            ('motor', elastic))):
        limit, speed, reach, rest, uneven = _coulomb(values, body)
        if moves and limit and (reach or not speed):
            found[k] = [limit * (1.0 + uneven), limit * (1.0 - uneven), reach or _PRESLIDING[body],
                        rest - 1.0, speed or 1.0]
    return found


def _motor_limit(values):
    current, constant = values['motor.dc.current_limit'], values['motor.dc.torque_constant']
    if current == math.inf or values['motor.shaft'] != 'free':
        return ()
    if not constant:
        raise ParameterError('motor.dc.torque_constant must be > 0 N m/A with '
                             f'motor.dc.current_limit = {current:g} A, got {constant}')
    return (values['motor.dc.gear_ratio'] * constant * current, motor_constants(values)[1]),


def motor_constants(values: Mapping[str, Any]) -> tuple[float, float]:
    """
    Return the factors n k/R [N m/V] and (n k)^2/R [N m s/rad] of a DC motor; 0 without a motor.

    The motor's torque on the shaft is `n k/R V - (n k)^2/R theta'`, with voltage V, gear ratio n,
    torque constant k and resistance R. The second term is due to the back-EMF. Inductance is
    neglected.
    """
    resistance, constant = values['motor.dc.resistance'], values['motor.dc.torque_constant']
    if not resistance:
        return 0.0, 0.0
    if not constant:
        raise ParameterError('motor.dc.torque_constant must be > 0 N m/A with motor.dc.resistance '
                             f'= {resistance:g} ohm, got {constant}')
    at_shaft = values['motor.dc.gear_ratio'] * constant
    return at_shaft / resistance, at_shaft**2 / resistance


def constraints_of(values: Mapping[str, Any]) -> Constraints:
    """Return the Constraints that the values describe; ParameterError if nothing can move."""
    held, shaft = fixed_axes(values), values['motor.shaft']
    if held == 'both' and shaft != 'free' and modal_count(values) == 0:
        raise ParameterError(f'nothing can move: carrier.held = {values["carrier.held"]}, '
                             f'motor.shaft = {shaft}, model.modes = 0; change one of them')
    places = [0.0 if driven_along(values, axis) else values[f'initial.carrier_{axis}']
              for axis in 'xy']
    return Constraints(tuple(place if held in (axis, 'both') else None
                             for axis, place in zip('xy', places)), shaft != 'free',
                       values['initial.shaft'] if shaft == 'locked' else None)


# Sections of the arm.

def _parameter_of(part):
    # The parameter of a property of a section.
    return f'arm.{part}' if f'arm.{part}' in PARAMETERS else f'arm.section.{part}'


# Fields of a Section with their parameters, and those along the arm.
_SECTION = [(field.name, _parameter_of(part), f'arm.profile.{part}') for field in fields(Section)
            for part in [field.name.removeprefix('measured_')]]


def along(values: Mapping[str, Any], part: str) -> tuple[float, ...]:
    """Return the values of a property of the section, such as height, along the arm."""
    return values.get(f'arm.profile.{part}') or (values[_parameter_of(part)],)


def profiles_of(values: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
    """Return the fields of a Section that vary along the arm, with their values."""
    return {field: values[profile] for field, _, profile in _SECTION if values.get(profile)}


def _arm(values):
    section = {field: values[name] for field, name, _ in _SECTION}
    profiles = profiles_of(values)
    length, positions = values['arm.length'], values['arm.profile.position']
    root = tuple(each for each in [values['arm.root_stiffness']] if each < math.inf)
    _leave_out(values, section, profiles)
    if not positions and not profiles:
        _check_section(values)
        return Beam(length, Section(**section), root=root)
    if len(positions) < 2 or positions[0] != 0.0 or positions[-1] != length or not np.all(
            np.less_equal(positions[:-1], positions[1:])):
        raise ParameterError('arm.profile.position must ascend from 0 to arm.length = '
                             f'{length:g} m, got {short(list(positions))}')
    same_length({'arm.profile.position': positions, **{
        profile: values[profile] for _, _, profile in _SECTION if values.get(profile)}})
    _check_section(values)
    positions, varying, _ = thinned(positions, tuple(profiles.values()))
    return Beam(length, Section(**{**section, **dict(zip(profiles, varying))}), positions, root)


# What bending stiffness and mass per length may be measured without; numbers that stand for its
# limit: shear stiffness over bending stiffness, rotary inertia over mass, in lengths of the arm.
_NOT_MEASURED = {'shear_stiffness': 'shear deformation', 'rotary_inertia': 'rotary inertia',
                 'axial_stiffness': 'stretch'}
_STIFF_IN_SHEAR, _WITHOUT_INERTIA = 1e12, 1e-12


def _is_measured(values, part):
    return along(values, part) != (0.0,)


def left_out_of(values: Mapping[str, Any]) -> str:
    """Return what of the arm is left out, since its stiffness was measured without it; or ''."""
    names = [meaning for part, meaning in _NOT_MEASURED.items()
             if not _is_measured(values, part)]
    if not names or not _is_measured(values, 'bending_stiffness'):
        return ''
    return (f'the arm has no {", no ".join(names)}, since its bending stiffness and mass are '
            'measured and these are not')


def _leave_out(values, section, profiles):
    # Shape and material do not belong to a section whose stiffness is measured.
    mass, bending = 'mass_per_length', 'bending_stiffness'
    for name, other in (mass, bending), (bending, mass):
        if _is_measured(values, name) and not _is_measured(values, other):
            raise ParameterError(f'arm.section.{other} must be > 0 with arm.section.{name} = '
                                 f'{along(values, name)[0]:g}, since shape and material do not '
                                 f'belong to a measured section; got 0')
    if not _is_measured(values, bending):
        return
    if values['model.axial_modes'] and not _is_measured(values, 'axial_stiffness'):
        raise ParameterError('model.axial_modes must be 0 where arm.section.bending_stiffness is '
                             'measured and arm.section.axial_stiffness is not, got '
                             f'{values["model.axial_modes"]}')
    if not _is_measured(values, 'axial_stiffness'):
        section['measured_axial_stiffness'] = math.inf
    square = values['arm.length']**2
    for name, known, factor in (('shear_stiffness', bending, _STIFF_IN_SHEAR / square),
                                ('rotary_inertia', mass, _WITHOUT_INERTIA * square)):
        if not _is_measured(values, name):
            if source := profiles.get(f'measured_{known}'):
                profiles[f'measured_{name}'] = tuple(factor * value for value in source)
            else:
                section[f'measured_{name}'] = factor * section[f'measured_{known}']


# What parts of a shape take of its sizes: the part, the size, and how often.
_PARTS = {'tube': (('wall', 'height', 2.0),),
          'box': (('wall', 'height', 2.0), ('wall', 'width', 2.0)),
          'i': (('wall', 'height', 2.0), ('web', 'width', 1.0))}


def _check_section(values):
    shape = values['arm.section.shape']
    parts = _PARTS.get(shape, ())
    for name in ('wall', 'web'):
        given, needed = along(values, name), name in [part for part, *_ in parts]
        if (min(given) > 0.0) != needed:
            raise ParameterError(f'arm.section.{name} must be {"> 0" if needed else "0"} with '
                                 f'arm.section.shape = {shape}, got {given[0]:g}')
    for part, size, count in parts:  # linear in between: what fits at positions fits everywhere
        wanted, room = np.array(along(values, part)), np.array(along(values, size)) / count
        if (wanted > room).any():
            raise ParameterError(f'arm.section.{part} must be at most {min(room):g} m for '
                                 f'arm.section.{size}, got {max(wanted):g}')
