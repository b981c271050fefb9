# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""What values of a scene must fit together; each check raises ParameterError."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from timo_sim.model.layout import INPUTS, Motion
from timo_sim.scene.bodies import BODIES, modal_count
from timo_sim.scene.loads import TERM_NAMES
from timo_sim.scene.parameters import (
    driven_along, fixed_axes, MODAL, ParameterError, PARAMETERS, short, StepError, VELOCITIES)
from timo_sim.steps.bristles import fastest, mobilities, MORE, REACH, SLOW, springs_of

_MAX_NUMBER = 1e50  # products of six numbers, as in an energy, do not overflow


_OF_GEAR = [name for name in PARAMETERS if name.startswith(('motor.gear.', 'motor.rotor.'))]


def _shown(value):
    return f'{value:g}' if isinstance(value, float) else value if isinstance(
        value, str) else short(value)


def check_together(values: Mapping[str, Any]) -> None:
    """Raise ParameterError if values of different parameters do not fit together."""
    held, shaft, elastic = (
        values[name] for name in ('carrier.held', 'motor.shaft', 'motor.gear.stiffness'))
    fixed = fixed_axes(values)
    for name in () if elastic else _OF_GEAR:
        if values[name] != PARAMETERS[name].default:
            raise ParameterError(f'{name} needs motor.gear.stiffness > 0, got {elastic:g}')
    for body in BODIES:
        speed, reach, rest = (f'{body}.coulomb_{name}' for name in (
            'speed', 'presliding', 'static'))
        if values[rest] != 1.0 and not (values[speed] and values[reach]):
            raise ParameterError(f'{rest} = {values[rest]:g} needs {speed} and {reach} > 0, got '
                                 f'{values[speed]:g} and {values[reach]:g}')
    if values['motor.spring.stiffness'] and shaft == 'free' and (
            values['arm.damping_of'] != 'clamped'):
        raise ParameterError('arm.damping_of must be clamped with a free shaft on a spring, which '
                             f'vibrates, too, got {values["arm.damping_of"]}')
    # Rules that hold with some values of another parameter: numbers are 0 or > 0, texts as named.
    gear = 'motor.gear.stiffness'
    for name, rule, other, holds in (
            ('motor.rotor.inertia', '> 0 kg m2', gear, elastic),
            ('motor.shaft', 'free', gear, elastic),
            ('arm.damping_of', 'clamped', gear, elastic),
            ('initial.shaft_velocity', '0', 'motor.shaft', shaft == 'locked'),
            ('initial.carrier_x_velocity', '0', 'carrier.held', fixed in ('x', 'both')),
            ('initial.carrier_y_velocity', '0', 'carrier.held', fixed in ('y', 'both')),
            ('initial.equilibrium', 'false', 'motor.shaft', shaft == 'driven'),
            *((name, 'empty or 0', 'initial.equilibrium', values['initial.equilibrium'])
              for name in (*VELOCITIES, *MODAL)),
            ('model.axial_modes', '0', 'model.formulation',
             values['model.formulation'] != 'exact'),
            ('carrier.mass', '> 0 kg', 'carrier.held', fixed != 'both')):
        value = values[name]
        right = value == rule if isinstance(value, str) else bool(value) == rule.startswith('>')
        if holds and not right:
            raise ParameterError(f'{name} must be {rule} with {other} = {_shown(values[other])}, '
                                 f'got {_shown(value)}')
    for axis in 'xy':
        given = [name for name in TERM_NAMES[f'carrier_acceleration_{axis}'] if values[name]]
        if driven_along(values, axis) and (held in (axis, 'both') or given):
            what = given[0] if given else f'carrier.held = {held}'
            raise ParameterError(f'{what} must not be given along {axis}, since carrier.drive '
                                 'moves the carrier along it')
        if given and fixed not in (axis, 'both'):
            raise ParameterError(f'{given[0]} needs a carrier that is held along {axis}, got '
                                 f'carrier.held = {held}')
    if len(values['gravity']) != 2:
        raise ParameterError(f'gravity must have 2 elements, got {len(values["gravity"])}')
    for name in 'push', 'sensor.root_strain', 'sensor.tip_imu':
        if values[f'{name}.position'] > values['arm.length']:
            raise ParameterError(
                f'{name}.position must be at most arm.length = {values["arm.length"]:g} m, got '
                f'{values[f"{name}.position"]:g}')
    for each in INPUTS:
        if each.needs and each.prescribed and not values[each.needs]:
            for name in TERM_NAMES[each.name]:
                if values[name]:
                    raise ParameterError(f'{name} needs {each.needs} > 0, got 0')


def check_counts(values: Mapping[str, Any], static: tuple[str, ...]) -> None:
    """Raise ParameterError if lengths of lists by mode do not fit the model."""
    modes, axial, shapes = modal_count(values), values['model.axial_modes'], len(static)
    elastic = values['motor.gear.stiffness'] > 0.0
    if values['model.accuracy'] > 0.0:
        modes = shapes = 0  # chosen later: no lists with an element for each mode can be given
    arm = max(modes - elastic, 0)
    for name, allowed in (('arm.damping_ratio', (0, 1, arm, arm + shapes)),
                          *((name, (0, modes, modes + shapes)) for name in MODAL)):
        if len(values[name]) not in allowed:
            expected = ' or '.join(str(count) for count in sorted(set(allowed)))
            cause = 'a stated model.accuracy' if values['model.accuracy'] else (
                f'model.modes = {values["model.modes"]}' + (
                    f' and model.axial_modes = {axial}' if axial else '') + (
                    ' and an elastic gear' if elastic else ''))
            raise ParameterError(f'{name} must have {expected} elements for {cause}, got '
                                 f'{len(values[name])}')


@contextmanager
def physical(values: Mapping[str, Any]) -> Iterator[None]:
    """Raise what the physics of these values raises as ParameterError, overflows included."""
    try:
        with np.errstate(over='raise', divide='raise', invalid='raise'):
            yield
    except ArithmeticError:
        raise ParameterError(
            'the values of this scene are too large or too small together: its equations of '
            'motion or its initial energy are not finite; check the units') from None
    except ParameterError:  # a ValueError that says already what to do
        raise
    except ValueError as error:
        # Only the physics finds some errors, such as modes too close to each other.
        raise ParameterError(f'model.formulation = {values["model.formulation"]}, '
                             f'model.modes = {values["model.modes"]}: {error}') from None


def check_finite(scene: Any) -> None:
    """Raise ParameterError if a scene's equations of motion, or energies, may overflow."""
    with physical(scene.values):
        if not (np.isfinite(scene.build().linear).all() and max(
                scene.build().magnitude_bound, np.abs(scene.initial_motion()).max()
                ) < _MAX_NUMBER):
            raise OverflowError


# A step is stable up to 2.785 over the rate at which friction brakes joints, as is measured for 0
# to 5 modes; the mobility of joints may grow a little in a run.
_STABLE = 2.5
# Largest phase in a step of the fastest vibration of a gear with play, or of joints on bristles.
# From 1.5 on contacts without damping gain energy, as is measured for rigid and bending arms, held
# and free.
_CONTACT = 1.0


def check_slope(scene: Any) -> None:
    """Raise StepError if steps are too long for friction over a speed or way, or for backlash."""
    gear, bristles, smooth = scene.manipulator.gear, scene.bristles, scene.manipulator.coulomb
    if not (any(limit for limit, *_ in smooth) or bristles[:, REACH].any()
            or gear and gear.backlash):
        return
    # By joint as bristles: carrier x, y, rotor or shaft, shaft of an elastic gear.
    limit, speed, asymmetry = np.array(smooth)[
        [0, 0, 2 if gear else 1, 1]].T * [[1.0, 1.0, 1.0, bool(gear)], 4 * [1.0], 4 * [1.0]]
    bent = Motion(scene.initial_motion()).q
    mobile = mobilities(scene.build(), tuple(bent) if bent.any() else ())  # as steps need them
    # The steepest slope of t (1 + a t) is at most 1 + 0.52 a times the one at rest, and that of
    # 1 / (1 + x^2) is 0.65.
    slope = limit / speed * (1.0 + 0.52 * np.abs(asymmetry)) + 0.65 * bristles[
        :, :2].max(axis=1) * np.abs(bristles[:, MORE]) / bristles[:, SLOW]
    rate = fastest(slope, mobile)
    bristle = np.sqrt(fastest(springs_of(bristles), mobile))
    contact = 0.0
    if gear and gear.backlash:  # its twist is the rotor's angle less that of the shaft
        contact = max(np.sqrt(gear.stiffness * (each[2, 2] + each[3, 3] - 2.0 * each[2, 3]))
                      for each in mobile)
    for found, most, what, name, power in (
            (contact, _CONTACT, 'backlash of a gear with this stiffness', 'motor.gear.stiffness',
             -2),
            (bristle, _CONTACT, 'Coulomb friction with so small a presliding',
             'coulomb_presliding', 2),
            (rate, _STABLE, 'Coulomb friction with this slope', 'coulomb_speed', 1)):
        if found * scene.step > most:
            longest = 0.99 * most / found
            default = ' (as large as 0.001 rad or 0.0001 m by default)' if power == 2 else ''
            raise StepError(f'integrator.step = {scene.step:g} s must be at most {longest:.3g} s '
                            f'for {what}: take that, or a {name} '
                            f'{(scene.step / longest)**power:.3g} times as large{default}',
                            longest)
