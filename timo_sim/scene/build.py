# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Build bodies, constraints and loads of a scene, and find values that do not fit together.

`values` are checked values of all the scene's parameters, by dotted name.
"""

from bisect import bisect_left
from dataclasses import fields
import functools
import math

import numpy as np

from timo_sim.physics.arm.bodies import Beam, Constraints, Manipulator, Section
from timo_sim.scene.loads import CHANNELS, Drive, Harmonic, Load, Piecewise, Table
from timo_sim.scene.parameter import ParameterError, short, whole_ratio
from timo_sim.scene.parameters import PARAMETERS

# Ranges of real solids; `load_scene` warns of values outside.
_PLAUSIBLE = {'young_modulus': (1e5, 2e12, 'Pa'), 'density': (10.0, 25000.0, 'kg/m3')}
# Parameters of a load's terms.
_OF_CHANNELS = {channel: tuple(f'load.{channel}.{name}' for name in (
    'harmonic.amplitude', 'harmonic.frequency', 'harmonic.phase', 'piecewise.time',
    'piecewise.value', 'table.time', 'table.value')) for channel in CHANNELS}
_OF_TERMS = ('integrator.step', *(name for names in _OF_CHANNELS.values() for name in names))
_ORDINARY = 1e20  # numbers below this do not overflow in an energy
_LONGEST = 30.0  # longest arm that is not taken for one in millimetres [m]
_LEAST_SLENDERNESS = 3.0  # length over height; a shorter arm is a block, not a beam


def manipulator_of(values):
    """Return the Manipulator that the values describe."""
    return Manipulator(
        _arm(values), values['carrier.mass'], values['motor.mass'], values['motor.shaft_inertia'],
        values['end_effector.mass'], values['end_effector.inertia'],
        values['carrier.viscous_friction'],
        values['motor.viscous_friction'] + motor_constants(values)[1],
        tuple(_smooth_coulomb(values, body) for body in ('carrier', 'motor')))


def _smooth_coulomb(values, body):
    # Coulomb friction without a speed is dry: joints stick.
    speed = values[f'{body}.coulomb_speed']
    return (values[f'{body}.coulomb_friction'], speed) if speed else (0.0, 1.0)


def load_of(values):
    """Return the Load that the values describe, with the drive of the shaft."""
    return Load(_terms_of(tuple((name, values[name]) for name in _OF_TERMS)), _drive(values))


@functools.lru_cache(maxsize=4)
def _terms_of(items):
    # One object for equal terms, so that many scenes under the same load can share what it does.
    values = dict(items)
    return {channel: _channel(f'load.{channel}', values['integrator.step'],
                              tuple((name, values[name]) for name in names))
            if any(values[name] for name in names) else () for channel, names in
            _OF_CHANNELS.items()}


@functools.lru_cache(maxsize=32)
def _channel(prefix, step, items):
    return tuple(_terms(prefix, dict(items), step))


def motor_constants(values):
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


def constraints_of(values):
    """Return the Constraints that the values describe; raise ParameterError if they conflict."""
    held, shaft, carrier = values['carrier.held'], values['motor.shaft'], [None, None]
    zero = {'initial.shaft_velocity': f'motor.shaft = {shaft}'} if shaft == 'locked' else {}
    for axis, name in enumerate('xy'):
        if held in (name, 'both'):
            carrier[axis] = values[f'initial.carrier_{name}']
            zero[f'initial.carrier_{name}_velocity'] = f'carrier.held = {held}'
    for name, reason in zero.items():
        if values[name] != 0.0:
            raise ParameterError(f'{name} must be 0 with {reason}, got {values[name]}')
    if held == 'both' and shaft != 'free' and modal_count(values) == 0:
        raise ParameterError(f'nothing can move: carrier.held = both, motor.shaft = {shaft}, '
                             'model.modes = 0')
    return Constraints(tuple(carrier), shaft != 'free',
                       values['initial.shaft'] if shaft == 'locked' else None)


def payloads_of(values):
    """Return the steps at which loads at the tip change, and its mass and inertia from then on."""
    times, masses, inertias = _same_length({
        name: values[name] for name in ('payload.time', 'payload.mass', 'payload.inertia')})
    if not np.all(np.less(times[:-1], times[1:])):
        raise ParameterError(f'payload.time must ascend, got {short(list(times))}')
    if times and values['model.formulation'] == 'newton_root_stress':
        raise ParameterError('payload.time must be empty with model.formulation = '
                             f'newton_root_stress, got {short(list(times))}')
    steps = [whole_ratio(f'payload.time[{k}]', time, 'integrator.step', values['integrator.step'])
             for k, time in enumerate(times)]
    return tuple(zip(steps, masses, inertias))


def check_initial(values):
    """Raise ParameterError if gravity is no vector, or an equilibrium is given a motion."""
    if len(values['gravity']) != 2:
        raise ParameterError(f'gravity must have 2 elements, got {len(values["gravity"])}')
    if not values['initial.equilibrium']:
        return
    if values['motor.shaft'] == 'driven':
        raise ParameterError('initial.equilibrium must be false with motor.shaft = driven, whose '
                             'shaft may move at t = 0')
    for name, value in values.items():
        if name.startswith('initial.') and ('velocity' in name or 'modal' in name) and value:
            raise ParameterError(f'{name} must not be given with initial.equilibrium = true, got '
                                 f'{short(value)}')


def modal_count(values):
    """Return the number of modal coordinates, axial ones included."""
    return values['model.modes'] + values['model.axial_modes']


def check_counts(values):
    """Raise ParameterError if axial modes, or lengths of lists by mode, do not fit the model."""
    modes, axial = modal_count(values), values['model.axial_modes']
    if axial and values['model.formulation'] != 'exact':
        raise ParameterError('model.axial_modes must be 0 with model.formulation = '
                             f'{values["model.formulation"]}, got {axial}')
    if values['model.accuracy'] > 0.0:
        modes = 0  # chosen later, so that lists with an element for each mode cannot be given
    for name, allowed in (('arm.damping_ratio', (0, 1, modes)),
                          ('initial.modal_coordinates', (0, modes)),
                          ('initial.modal_rates', (0, modes))):
        if len(values[name]) not in allowed:
            expected = ' or '.join(str(count) for count in sorted(set(allowed)))
            cause = 'a stated model.accuracy' if values['model.accuracy'] else (
                f'model.modes = {values["model.modes"]}' + (
                    f' and model.axial_modes = {axial}' if axial else ''))
            raise ParameterError(f'{name} must have {expected} elements for {cause}, got '
                                 f'{len(values[name])}')


def check_finite(scene):
    """Raise ParameterError if a scene's equations of motion or its initial energy overflow."""
    try:
        with np.errstate(over='raise', divide='raise', invalid='raise'):
            formulation, motion = scene.build(), scene.initial_motion()
            finite = np.isfinite(formulation.linear).all() and (
                formulation.largest < _ORDINARY and np.abs(motion).max() < _ORDINARY
                or np.isfinite(formulation.energy(motion[np.newaxis])[0]))
    except ArithmeticError:
        finite = False
    except ParameterError:
        raise
    except ValueError as error:
        # Only the physics finds some errors, such as modes too close to each other.
        raise ParameterError(f'model.formulation = {scene.values["model.formulation"]}, '
                             f'model.modes = {scene.values["model.modes"]}: {error}') from None
    if not finite:
        raise ParameterError('the values of this scene are too large or too small together: its '
                             'equations of motion or its initial energy are not finite')


def implausible(values):
    """
    Return the text of a warning about values that are allowed but implausible, or None.

    It marks values that are the defaults, which nobody may have meant together with the others.
    """
    def each(name):
        return values.get(f'arm.profile.{name}') or (values[f'arm.{name}'],)

    def told(name, unit):
        default = ' (the default)' * (values[name] == PARAMETERS[name].default)
        return f'{name} = {values[name]:g} {unit}{default}'

    found = []
    for name, (low, high, unit) in _PLAUSIBLE.items():
        found += [f'arm.{name} = {value:g} {unit} is outside the range of real solids'
                  for value in each(name) if not low <= value <= high][:1]
    height = max(each('height'))
    shear, young = each('shear_modulus'), each('young_modulus')
    count = max(len(shear), len(young))  # a single value is that of all positions
    found += [f'arm.shear_modulus = {stiff:g} Pa is above arm.young_modulus = {soft:g} Pa'
              for stiff, soft in zip(shear * (count // len(shear)), young * (count // len(young)))
              if stiff > soft][:1]
    longest = max(values['arm.length'], *each('width'), height)
    if longest > _LONGEST:
        found.append(f'a length of {longest:g} m is more than {_LONGEST:g} m: lengths are in '
                     'metres, not in millimetres')
    mass, inertia = values['end_effector.mass'], values['end_effector.inertia']
    if inertia > mass * (0.5 * values['arm.length'])**2 and (mass or inertia == PARAMETERS[
            'end_effector.inertia'].default):
        found.append(f'{told("end_effector.inertia", "kg m2")} is that of '
                     f'{told("end_effector.mass", "kg")} at more than half of '
                     f'{told("arm.length", "m")} from its centre')
    if values['arm.length'] < _LEAST_SLENDERNESS * height:
        found.append(f'arm.length = {values["arm.length"]:g} m is less than '
                     f'{_LEAST_SLENDERNESS:g} times arm.height = {height:g} m')
    angle = values['initial.shaft']
    if abs(angle) > 2.0 * math.pi:
        found.append(f'initial.shaft = {angle:g} rad is more than a turn; in degrees it would be '
                     f'{math.radians(angle):.4g} rad')
    return 'is this meant? ' + '; '.join(found) if found else None


def _arm(values):
    names = [field.name for field in fields(Section)]
    section = {name: values[f'arm.{name}'] for name in names}
    length, positions = values['arm.length'], values['arm.profile.position']
    profiles = {name: values[f'arm.profile.{name}'] for name in names
                if values.get(f'arm.profile.{name}')}
    if not positions and not profiles:
        return Beam(length, Section(**section))
    if len(positions) < 2 or positions[0] != 0.0 or positions[-1] != length or not np.all(
            np.less_equal(positions[:-1], positions[1:])):
        raise ParameterError('arm.profile.position must ascend from 0 to arm.length = '
                             f'{length:g} m, got {short(list(positions))}')
    _same_length({f'arm.profile.{name}': values for name, values in
                  {'position': positions, **profiles}.items()})
    return Beam(length, Section(**{**section, **profiles}), positions)


def _drive(values):
    names = [f'motor.drive.{name}' for name in ('time', 'angle', 'speed', 'acceleration')]
    points = _same_length({name: values[name] for name in names})
    shaft, time, acceleration = values['motor.shaft'], points[0], points[3]
    if (shaft == 'driven') != bool(time):
        raise ParameterError(f'motor.drive must be given with motor.shaft = driven, and only '
                             f'then; got {len(time)} points with motor.shaft = {shaft}')
    if shaft == 'locked':
        return Drive((0.0,), (values['initial.shaft'],), (0.0,), (0.0,))
    if not time:
        return None
    if time[0] != 0.0 or not np.all(np.less(time[:-1], time[1:])):
        raise ParameterError(f'motor.drive.time must ascend from 0, got {short(list(time))}')
    if acceleration[-1] != 0.0:
        raise ParameterError('motor.drive.acceleration must end with 0, since the shaft goes on '
                             f'at the last speed; got {acceleration[-1]}')
    return Drive(*points)


def _terms(prefix, values, step):
    amplitude = values[f'{prefix}.harmonic.amplitude']
    phase = values[f'{prefix}.harmonic.phase'] or (0.0,) * len(amplitude)
    yield from map(Harmonic, *_same_length({
        f'{prefix}.harmonic.amplitude': amplitude,
        f'{prefix}.harmonic.frequency': values[f'{prefix}.harmonic.frequency'],
        f'{prefix}.harmonic.phase': phase}))
    for kind, term, ordered in (('piecewise', Piecewise, np.less),
                                ('table', Table, np.less_equal)):
        names = f'{prefix}.{kind}.time', f'{prefix}.{kind}.value'
        time, value = _same_length({name: values[name] for name in names})
        if not time:
            continue
        if not np.all(ordered(time[:-1], time[1:])):
            raise ParameterError(f'{names[0]} must ascend, got {short(list(time))}')
        for jump in term(time, value).jumps():
            place = bisect_left(time, jump)
            whole_ratio(f'{names[0]}[{place}]', jump, 'integrator.step', step)
        yield term(time, value)


def _same_length(lists):
    if len({len(values) for values in lists.values()}) > 1:
        lengths = ', '.join(f'{name}: {len(values)}' for name, values in lists.items())
        raise ParameterError(f'these must have the same length, got {lengths}')
    return tuple(lists.values())
