# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
All parameters, with default, unit, meaning and rule, defined once for YAML, Python and ROS.

The defaults are the paper's manipulator (its Tables 1 and 3) at rest, without loads; a scene that
gives any of `arm` has nothing of it (`complete`). Values are given by dotted name; [k] stands for
an element of a list.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
import difflib
import functools
import inspect
import math
import os
import re
import reprlib
import sys
from typing import Any, TypeVar
import warnings

import numpy as np

from timo_sim.model import FORMULATIONS
from timo_sim.model.bodies import SHAPES
from timo_sim.model.layout import INPUTS
from timo_sim.topics.commands import JOINTS
from timo_sim.topics.outputs import FRAMES, outputs, SENSORS, TRANSFORMS

SCENE, NODE = 'scene', 'node'
_Function = TypeVar('_Function', bound=Callable)
LATEST = 2**31 - 1  # [s] largest time that a stamp of ROS can hold, 68 years
MOST_STEPS = 100000  # of one call of a service of the node

_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxlist, _SHORT.maxtuple, _SHORT.maxother = 2, 8, 8, 60
_SHORT.maxstring = 60


class ParameterError(ValueError):
    """A value that breaks a rule; the text states name, value and rule."""


class StepError(ParameterError):
    """A step that is too long for other values; one of `longest` [s] is not."""

    def __init__(self, text: str, longest: float) -> None:
        super().__init__(text)
        self.longest = longest


class ModelWarning(UserWarning):
    """A scene or a run for which the model may not hold; the text says why, and what to do."""


@dataclass(frozen=True)
class Parameter:
    """A parameter and its rule."""

    name: str                # dotted
    default: object          # its type is the parameter's: bool, int, float, str, tuple of float
    unit: str
    meaning: str
    low: float = -math.inf   # range of the value, or of each element
    high: float = math.inf
    open_low: bool = False   # whether `low` itself is excluded
    choices: Collection[str] = ()  # allowed texts; empty: all
    form: tuple = ()         # of a text: a regular expression, and the same rule in words
    scope: str = SCENE       # SCENE: part of the physics; NODE: only the node has it
    runtime: bool = False    # whether it can be set while the node runs
    finite: bool = True      # whether infinity is refused
    alone: bool = False      # whether a number stands for a list of this one

    @property
    def rule(self) -> str:
        """The rule for values, in words."""
        kind = {bool: 'true or false', int: 'a whole number',
                float: 'a finite number' if self.finite else 'a number',
                str: 'a text', tuple: 'a finite number, or a list of them,' if self.alone
                else 'a list of finite numbers'}[type(self.default)]
        if self.choices:
            return 'one of ' + ', '.join(self.choices)
        if self.form:
            return self.form[1]
        bounds = []
        if self.low > -math.inf:
            bounds.append(f'{">" if self.open_low else ">="} {self.low:g}')
        if self.high < math.inf:
            bounds.append(f'<= {self.high:g}')
        unit = f' {self.unit}' if bounds and self.unit else ''
        none = '' if self.finite else ', .inf for no limit'
        return ' '.join([kind, ' and '.join(bounds)]).strip(' ,') + unit + none

    def check(self, value: Any) -> Any:
        """
        Return the value converted to the parameter's type, or raise ParameterError.

        A whole number is accepted for a float, and so is a text like '70.5e9', which is how PyYAML
        reads a number without a sign in the exponent.
        """
        if type(value) is float and self.low < value < self.high:  # the most frequent case
            if isinstance(self.default, float):
                return value
            if isinstance(self.default, tuple) and self.alone:
                return (value,)
        try:
            if isinstance(self.default, tuple):
                if value is None:  # ROS reads an empty list as no value
                    return ()
                if self.alone and (isinstance(value, str) or not hasattr(value, '__iter__')):
                    return (self._checked_number(value),)
                if isinstance(value, (str, bytes, dict, set)) or not hasattr(value, '__iter__'):
                    raise ValueError
                return tuple(self._checked_number(element) for element in value)
            if isinstance(self.default, float):
                return self._checked_number(value)
            if isinstance(value, np.generic):
                value = value.item()
            if (type(value) is not type(self.default) or self.choices and value not in self.choices
                    or isinstance(value, str) and (
                        b'\0' in value.encode()
                        or self.form and not re.fullmatch(self.form[0], value))
                    or isinstance(value, int) and not self.low <= value <= self.high):
                raise ValueError
            return value
        except (ValueError, TypeError, OverflowError):
            raise ParameterError(
                f'{self.name} must be {self.rule}, got {short(value)}') from None

    def _checked_number(self, value):
        if isinstance(value, (bool, np.bool_)):
            raise ValueError
        number = float(value)
        above = number > self.low if self.open_low else number >= self.low
        if not (above and number <= self.high) or self.finite and not math.isfinite(number):
            raise ValueError
        return number


def warn(text: str) -> None:
    """Give a ModelWarning whose place is the caller's line outside of this package."""
    level, frame = 1, sys._getframe()
    # functools is skipped, too, because it calls the functions of cached properties.
    while frame.f_back and frame.f_globals.get('__name__', '').partition('.')[0] in (
            'timo_sim', 'functools'):
        level, frame = level + 1, frame.f_back
    warnings.warn(text, ModelWarning, stacklevel=level)


def short(value: Any, show: Callable[[Any], str] = _SHORT.repr) -> str:
    """Return any value as one line of at most 60 characters."""
    try:
        shown = show(value)
    except ValueError:  # a whole number of thousands of digits
        shown = f'a huge {type(value).__name__}'
    shown = ''.join(char if char.isprintable() else ' ' for char in shown)
    return shown if len(shown) <= 60 else shown[:57] + '...'


def did_you_mean(name: Any, names: Iterable[str]) -> str:
    """Return '; did you mean X?' for the name that is most like the given one, or ''."""
    close = difflib.get_close_matches(str(name), names, n=1)
    return f'; did you mean {close[0]}?' if close else ''


def check_keys(place: str, entry: Any, known: Collection[str]) -> None:
    """Raise ParameterError unless an entry of a mapping, named by its place, has known keys."""
    if not isinstance(entry, Mapping):
        raise ParameterError(f'{place} must have some of {", ".join(known)}, got {short(entry)}')
    for key in entry:
        if key not in known:
            raise ParameterError(f'{place}: {short(key, str)} is not known: take '
                                 f'{", ".join(known)}{did_you_mean(key, known)}')


def whole_ratio(name: str, value: float, unit_name: str, unit: float) -> int:
    """Return value / unit, whole to 1e-6 or round-off, or raise ParameterError."""
    ratio = value / unit
    count = round(ratio) if math.isfinite(ratio) else 0
    near = abs(ratio - count) <= max(1e-6, 1e-15 * ratio) and (count or not value)
    if not near or not math.isfinite(ratio):
        raise ParameterError(f'{name} = {value:.12g} must be a whole multiple of '
                             f'{unit_name} = {unit:.12g}, the ratio is {ratio:.15g}')
    return count


def same_length(lists: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return lists by name if they have the same length, or raise ParameterError."""
    if len({len(values) for values in lists.values()}) > 1:
        lengths = ', '.join(f'{name}: {len(values)}' for name, values in lists.items())
        raise ParameterError(f'these must have the same length, got {lengths}')
    return tuple(lists.values())


def _positive(name, default, unit, meaning, **more):
    return Parameter(name, default, unit, meaning, low=0.0, open_low=True, **more)


def _not_negative(name, default, unit, meaning, **more):
    return Parameter(name, default, unit, meaning, low=0.0, **more)


def _limit(name, unit, meaning):
    return Parameter(name, math.inf, unit, f'{meaning}; .inf: no limit', low=0.0, open_low=True,
                     finite=False, runtime=True)


def _friction(body, name, speed, force, least, runtime=False):
    # Of a body with these units of speed and force; `least` is its presliding where none is given.
    way, along = speed.removesuffix('/s'), ', the same along world x and y' * (body == 'carrier')
    kind = f'{"force" if force == "N" else "torque"} on the {name}'
    asymmetry = [] if body == 'carrier' else [Parameter(
        f'{body}.coulomb_asymmetry', 0.0, '', f'part a by which this friction on the {name} is '
        'larger in forward and smaller in backward motion: 1 + a and 1 - a times as large',
        low=-1.0, high=1.0)]
    return [
        _not_negative(f'{body}.viscous_friction', 0.0, f'{force} s/{way}', f'viscous friction '
                      f'{kind} per speed{along}', runtime=runtime),
        _not_negative(f'{body}.coulomb_friction', 0.0, force, f'largest Coulomb friction '
                      f'{kind}{along}'),
        _not_negative(f'{body}.coulomb_speed', 0.0, speed, f'speed v_s of the {name} over which '
                      'it builds up without presliding, as tanh(v / v_s)'),
        *asymmetry,
        _not_negative(f'{body}.coulomb_presliding', 0.0, way, f'way of the {name} over which '
                      'this friction builds up after each reversal, as of a spring; 0: '
                      f'{least}, unless there is a coulomb_speed'),
        Parameter(f'{body}.coulomb_static', 1.0, '', f'this friction of the {name} at rest over '
                  'that in motion, to which it comes over coulomb_speed', low=0.0, high=10.0)]


def _load(channel, unit, meaning):
    rows = (
        ('harmonic.amplitude', unit, f'{meaning}: amplitudes of harmonic terms, '
         'amplitude sin(2 pi frequency t + phase)', -math.inf),
        ('harmonic.frequency', 'Hz', 'frequencies of these terms', 0.0),
        ('harmonic.phase', 'rad', 'phases of these terms; empty: all 0', -math.inf),
        ('piecewise.time', 's', f'{meaning}: times at which it jumps to a new constant value',
         0.0),
        ('piecewise.value', unit, 'values from these times on', -math.inf),
        ('table.time', 's', f'{meaning}: times of points, linear in between, constant before '
         'and after; a repeated time is a jump', 0.0),
        ('table.value', unit, 'values at these points', -math.inf))
    return [Parameter(f'load.{channel}.{name}', (), of, text, low=low, runtime=True)
            for name, of, text, low in rows]


def _profile(name, unit, block=''):
    return _positive(f'arm.profile.{name}', (), unit,
                     f'arm.{block}{name} at arm.profile.position; empty: constant')


def _rate(name, topic, default):
    return _positive(name, default, 'Hz', f'messages per second of sim time on {topic}',
                     scope=NODE, runtime=True)


def _sensor(name, unit, meaning):
    prefix = f'sensor.{name}'
    return [
        _not_negative(f'{prefix}.noise', 0.0, unit, 'standard deviation of the noise in '
                      + meaning, high=_MAX_SENSOR_ERROR, runtime=True),
        Parameter(f'{prefix}.bias', 0.0, unit, f'constant that is added to {meaning}',
                  low=-_MAX_SENSOR_ERROR, high=_MAX_SENSOR_ERROR, runtime=True),
        _not_negative(f'{prefix}.resolution', 0.0, unit, f'{meaning} is rounded to multiples of '
                      'this; 0: not rounded', high=_MAX_SENSOR_ERROR, runtime=True)]


_MAX_SENSOR_ERROR = 1e9  # keeps sensor arithmetic finite
_MAX_ANGLE = 1e6         # [rad] up to which sine and cosine are accurate
_FRAME = r'[^/\s]\S*'    # a name that tf2 accepts
_OUTPUTS = outputs(1)
# Measured properties of a section: name, unit, meaning.
MEASURED = (('mass_per_length', 'kg/m', 'mass per length'),
            ('rotary_inertia', 'kg m', 'rotary inertia per length'),
            ('bending_stiffness', 'N m2', 'bending stiffness E I'),
            ('shear_stiffness', 'N', 'shear stiffness kappa G A'),
            ('axial_stiffness', 'N', 'axial stiffness E A'))
# Density [kg/m3], Young's modulus [Pa], Poisson's ratio: usual values of handbooks.
MATERIALS = {'acrylic': (1180.0, 3.1e9, 0.37), 'aluminium': (2700.0, 70e9, 0.33),
             'brass': (8500.0, 105e9, 0.34), 'pla': (1240.0, 3.3e9, 0.36),
             'stainless_steel': (7900.0, 195e9, 0.29), 'steel': (7850.0, 210e9, 0.30),
             'titanium': (4430.0, 114e9, 0.34)}
OF_MATERIAL = 'arm.density', 'arm.young_modulus', 'arm.shear_modulus'
_SENSOR_TOPICS = [output.name for output in _OUTPUTS if output.delay]

_ALL = [
    Parameter('scene_version', 1, '', 'version of the rule for what a scene leaves out', low=1,
              high=1),
    _positive('arm.length', 2.0, 'm', 'length of the arm'),
    Parameter('arm.section.shape', 'rectangle', '', 'shape of the section; i stands in the plane, '
              'its web along the height', choices=SHAPES),
    _positive('arm.section.width', 0.02, 'm', 'section size normal to the plane of motion; not of '
              'round and tube'),
    _positive('arm.section.height', 0.02, 'm', 'section size in the plane of motion, diameter of '
              'round and tube; half of it is the distance of the outer fibre'),
    _not_negative('arm.section.wall', 0.0, 'm', 'thickness of the wall of tube and box, and of '
                  'the flanges of i'),
    _not_negative('arm.section.web', 0.0, 'm', 'thickness of the web of i'),
    _positive('arm.section.shear_correction', 0.85, '', 'shear correction factor kappa of a '
              'rectangle; other shapes have that of Cowper (1966)'),
    *[_not_negative(f'arm.section.{name}', 0.0, unit, f'measured {meaning}; 0: that of shape and '
                    'material') for name, unit, meaning in MEASURED],
    Parameter('arm.material', 'none', '', 'material whose usual density and moduli the arm has, '
              'as far as they are not given beside it; none: they are those below',
              choices=('none', *MATERIALS)),
    _positive('arm.density', 2710.0, 'kg/m3', 'density'),
    _positive('arm.young_modulus', 70.5e9, 'Pa', "Young's modulus"),
    _positive('arm.shear_modulus', 27e9, 'Pa', 'shear modulus'),
    _not_negative('arm.profile.position', (), 'm', 'distances from the root between which the '
                  'section varies linearly, from 0 to arm.length; a repeated one is a jump'),
    *[_profile(name, unit, 'section.') for name, unit in (
        ('width', 'm'), ('height', 'm'), ('wall', 'm'), ('web', 'm'),
        *(each[:2] for each in MEASURED))],
    _profile('density', 'kg/m3'),
    _profile('young_modulus', 'Pa'),
    _profile('shear_modulus', 'Pa'),
    _positive('arm.root_stiffness', math.inf, 'N m/rad', 'rotational stiffness of the clamp at '
              'the root; .inf: it does not give', finite=False),
    Parameter('arm.damping_ratio', (), '', 'modal damping ratios: one for all modes, or one for '
              'each; empty: undamped', low=0.0, high=1.0, runtime=True, alone=True),
    Parameter('arm.damping_of', 'clamped', '', 'vibrations that have these damping ratios: those '
              'of the arm clamped at the shaft, or of the whole manipulator (system), whose '
              'frequencies are higher', choices=('clamped', 'system')),
    _not_negative('hub.radius', 0.0, 'm', "distance from the shaft's axis to the root of the arm, "
                  'along the arm; the inertia of the hub is part of motor.shaft_inertia'),
    _not_negative('carrier.mass', 5.0, 'kg', 'mass of the carrier; > 0 unless it is held'),
    *_friction('carrier', 'carrier', 'm/s', 'N', '1e-4 m', runtime=True),
    _limit('carrier.force_limit', 'N', 'largest force along an axis that commands can apply'),
    _limit('carrier.force_rate_limit', 'N/s', 'largest rate at which that force changes'),
    Parameter('carrier.held', 'none', '', 'axes of the world along which the carrier cannot move',
              choices=('none', 'x', 'y', 'both')),
    _not_negative('carrier.drive.time', (), 's', 'times of points of a carrier that is driven '
                  'along an axis, from 0 on; quintic polynomials in between, constant speed '
                  'afterwards'),
    *[Parameter(f'carrier.drive.{axis}{part}', (), unit, text.format(axis)) for axis in 'xy'
      for part, unit, text in (('', 'm', 'places along world {} at these times; empty: no points'),
                               ('_speed', 'm/s', 'speeds along {} at these times'),
                               ('_acceleration', 'm/s2',
                                'accelerations along {} at these times, the last 0'))],
    _not_negative('carrier.drive.harmonic.frequency', (), 'Hz', 'frequencies of harmonic terms of '
                  'the place of a driven carrier, amplitude sin(2 pi frequency t + phase)'),
    Parameter('carrier.drive.harmonic.phase', (), 'rad', 'phases of these terms; empty: all 0'),
    *[Parameter(f'carrier.drive.harmonic.{axis}', (), 'm', 'amplitudes of these terms along '
                f'world {axis}; empty: it has none') for axis in 'xy'],
    _not_negative('motor.mass', 5.0, 'kg', 'mass of the motor, which moves with the carrier'),
    _not_negative('motor.shaft_inertia', 2.0, 'kg m2', 'moment of inertia of the motor shaft'),
    *_friction('motor', 'shaft', 'rad/s', 'N m', '1e-3 rad', runtime=True),
    _not_negative('motor.spring.stiffness', 0.0, 'N m/rad', 'stiffness of a spring between '
                  'carrier and shaft, or of a cable; 0: there is none'),
    Parameter('motor.spring.rest', 0.0, 'rad', 'shaft angle at which it is relaxed',
              low=-_MAX_ANGLE, high=_MAX_ANGLE),
    _not_negative('motor.gear.stiffness', 0.0, 'N m/rad', 'torsional stiffness of the gear, at '
                  'the shaft; the torque then acts on the rotor; 0: the gear is rigid'),
    _not_negative('motor.gear.damping', 0.0, 'N m s/rad', 'damping beside this stiffness'),
    _not_negative('motor.gear.backlash', 0.0, 'rad', 'play of the gear at the shaft, from stop to '
                  'stop'),
    _not_negative('motor.rotor.inertia', 0.0, 'kg m2', 'moment of inertia of the rotor of an '
                  'elastic gear, about its own axis'),
    *_friction('motor.rotor', 'rotor', 'rad/s', 'N m', '1e-3 rad of the shaft'),
    _limit('motor.torque_limit', 'N m', 'largest torque that commands can apply'),
    _limit('motor.torque_rate_limit', 'N m/s', 'largest rate at which that torque changes'),
    _not_negative('motor.dc.resistance', 0.0, 'ohm', 'resistance of a DC motor that is commanded '
                  'by voltage; 0: there is none'),
    _not_negative('motor.dc.torque_constant', 0.0, 'N m/A', 'torque of the rotor per current, and '
                  'back-EMF per speed [V s/rad]'),
    _positive('motor.dc.gear_ratio', 1.0, '', 'turns of the rotor per turn of the shaft; the '
              'inertia of the rotor, times its square, is part of motor.shaft_inertia unless the '
              'gear is elastic'),
    _limit('motor.dc.voltage_limit', 'V', 'largest voltage that commands can apply'),
    _positive('motor.dc.current_limit', math.inf, 'A', 'largest current of the motor of a free '
              'shaft; it limits the torque of commands and loads, less that of the back-EMF; '
              '.inf: no limit', finite=False),
    Parameter('motor.shaft', 'free', '', 'free: turned by the torque; locked at initial.shaft; '
              'driven along motor.drive', choices=('free', 'locked', 'driven')),
    _not_negative('motor.drive.time', (), 's', 'times of the points of a driven shaft, from 0 on; '
                  'quintic polynomials in between, constant speed afterwards'),
    Parameter('motor.drive.angle', (), 'rad', 'angles at these times',
              low=-_MAX_ANGLE, high=_MAX_ANGLE),
    Parameter('motor.drive.speed', (), 'rad/s', 'speeds at these times'),
    Parameter('motor.drive.acceleration', (), 'rad/s2',
              'accelerations at these times, the last 0'),
    _not_negative('end_effector.mass', 2.0, 'kg', 'mass at the tip, with what it carries',
                  runtime=True),
    _not_negative('end_effector.inertia', 0.5, 'kg m2', 'moment of inertia at the tip, with what '
                  'it carries, about its centre of mass', runtime=True),
    Parameter('end_effector.offset', 0.0, 'm', 'distance of this centre of mass from the tip, '
              'along the arm; > 0 is beyond the tip', runtime=True),
    Parameter('end_effector.pick_up', 'moving', '', 'how a load moves before it is added to the '
              'end effector: with the tip (moving), or not (at_rest), so that it is picked up in '
              'a plastic impact', choices=('moving', 'at_rest'), runtime=True),
    _positive('payload.time', (), 's', 'times at which the end effector picks up or drops loads'),
    _not_negative('payload.mass', (), 'kg', 'end_effector.mass from each of these times on'),
    _not_negative('payload.inertia', (), 'kg m2', 'end_effector.inertia from each of these times '
                  'on'),
    Parameter('payload.offset', (), 'm', 'end_effector.offset from each of these times on; empty: '
              'all 0'),
    Parameter('gravity', (0.0, 0.0), 'm/s2', 'acceleration of free fall along world x and y; 0: '
              'the plane of motion is horizontal', low=-1e6, high=1e6),
    Parameter('initial.carrier_x', 0.0, 'm', 'carrier position at t = 0'),
    Parameter('initial.carrier_y', 0.0, 'm', 'carrier position at t = 0'),
    Parameter('initial.shaft', math.pi / 4, 'rad', 'shaft angle at t = 0',
              low=-_MAX_ANGLE, high=_MAX_ANGLE),
    Parameter('initial.carrier_x_velocity', 0.0, 'm/s', 'carrier velocity at t = 0'),
    Parameter('initial.carrier_y_velocity', 0.0, 'm/s', 'carrier velocity at t = 0'),
    Parameter('initial.shaft_velocity', 0.0, 'rad/s', 'shaft speed at t = 0'),
    Parameter('initial.modal_coordinates', (), 'm sqrt(kg)', 'modal coordinates at t = 0, one for '
              'each mode; empty: straight arm'),
    Parameter('initial.modal_rates', (), 'm sqrt(kg)/s', 'their rates at t = 0; empty: 0'),
    Parameter('initial.equilibrium', False, '', 'whether the run begins at rest where gravity and '
              'the loads of t = 0 balance; a free shaft is sought from initial.shaft on'),
    Parameter('model.formulation', 'exact', '', 'equations of motion',
              choices=FORMULATIONS),
    Parameter('model.modes', 3, '', 'number of assumed modes; 0 is a rigid arm', low=0, high=40),
    Parameter('model.static_modes', 'auto', '', 'loads whose static shapes follow the modes: '
              'force or torque on the end effector, both, or the weight in gravity; auto: those '
              'that a light end effector needs',
              choices=('auto', 'none', 'force', 'torque', 'both', 'weight')),
    Parameter('model.axial_modes', 0, '', 'number of modes in which the arm stretches; they '
              'follow the bending modes in all lists; 0: it does not stretch; > 0 only with '
              'formulation exact', low=0, high=3),
    _not_negative('model.accuracy', 0.0, 'm', 'tip error for which model.modes and '
                  'integrator.step are refined; 0: their given values are used'),
    Parameter('integrator.step', 0.001, 's', 'time step', low=1e-9, high=1000.0),
    *[parameter for each in INPUTS if each.prescribed
      for parameter in _load(each.name, each.unit, each.meaning)],
    _not_negative('push.position', 0.0, 'm', 'distance from the root to the point of the arm at '
                  'which load.push_x and load.push_y act; 0: there is none'),
    Parameter('sensor.seed', 0, '', 'seed of the noise of all sensors', low=0, high=1000000000),
    *[parameter for sensor in SENSORS
      for parameter in _sensor(sensor.name, sensor.unit, sensor.meaning)],
    _not_negative('sensor.root_strain.position', 0.0, 'm', 'distance from the root to the strain '
                  'gauge'),
    _not_negative('sensor.tip_imu.position', 0.0, 'm', 'distance from the root to the IMU; 0: it '
                  'is at the tip'),
    *[_not_negative(output.delay, 0.0, 's', 'sim time from a measurement to its message on '
                    f'{output.name}, a whole multiple of integrator.step', high=1000.0)
      for output in _OUTPUTS if output.delay],
    _not_negative('real_time_factor', 1.0, '', 'sim time per wall time; 0: as fast as possible',
                  high=1e6, scope=NODE, runtime=True),
    _not_negative('catch_up_limit', 0.1, 's', 'most wall time that is caught up after a delay; '
                  'the rest is dropped and counted', high=LATEST, scope=NODE, runtime=True),
    _not_negative('duration', 0.0, 's', 'sim time after which the node ends; 0: never',
                  high=LATEST, scope=NODE),
    _not_negative('command_timeout', 0.0, 's', 'sim time after which a command falls to zero if '
                  'no other follows; 0: held for ever', high=LATEST, scope=NODE, runtime=True),
    Parameter('sync', 'free', '', 'lock step: free: off; wait: each sync_period waits for a '
              'command with the stamp of the state or none', choices=('free', 'wait'),
              scope=NODE),
    _positive('sync_period', 0.002, 's', 'sim time from one wait for a command to the next',
              high=LATEST, scope=NODE),
    _positive('sync_timeout', 1.0, 's', 'wall time after which a wait ends without a command; not '
              'before the first one, or while nobody publishes', high=LATEST, scope=NODE),
    Parameter('start_paused', False, '', 'whether the node starts paused, until ~/pause or ~/step',
              scope=NODE),
    Parameter('steps_per_call', 1, '', 'time steps of one call of ~/step', low=1, high=MOST_STEPS,
              scope=NODE, runtime=True),
    Parameter('publish_clock', False, '', 'whether sim time is published on /clock', scope=NODE),
    *[_rate(output.rate, output.name, 100.0) for output in _OUTPUTS],
    _rate(TRANSFORMS.rate, TRANSFORMS.name, 25.0),
    Parameter('frame_prefix', '', '', 'prefix of the names of all frames but world', form=(
        f'({_FRAME})?', 'empty or a text without blanks that does not begin with /'), scope=NODE),
    *[Parameter(f'frame.{name}', name, '', f'name of the frame {name} in messages',
                form=(_FRAME, 'a name without blanks that does not begin with /'), scope=NODE)
      for name in FRAMES],
    Parameter('estimate_error', True, '', 'whether a finer run measures the error of the tip',
              scope=NODE),
    Parameter('record', True, '', 'whether the run is logged to an MCAP file', scope=NODE),
    Parameter('record_file', '', '', 'path of the log; empty: timo_sim_DATE_TIME.mcap in the '
              'working directory', scope=NODE),
    Parameter('record_sensors', False, '', f'whether {", ".join(_SENSOR_TOPICS[:-1])} and '
              f'{_SENSOR_TOPICS[-1]} are logged also while nobody subscribes', scope=NODE),
    Parameter('publish_tf', False, '', 'whether the frames of the bent arm are published on /tf, '
              'and the URDF on robot_description; needs tf2_msgs', scope=NODE),
]

PARAMETERS = {parameter.name: parameter for parameter in _ALL}
DEFAULTS = {name: parameter.default for name, parameter in PARAMETERS.items()}
RATES = [name for name in PARAMETERS if name.startswith('rate.')]
DELAYS = [name for name in PARAMETERS if name.endswith('.delay')]
POSITIONS = [f'initial.{joint}' for joint in JOINTS]
VELOCITIES = [f'{name}_velocity' for name in POSITIONS]
MODAL = 'initial.modal_coordinates', 'initial.modal_rates'


def check(values: Mapping[str, Any], source: str) -> dict[str, Any]:
    """
    Return values by name as their types; raise ParameterError that names the text `source`.

    `arm.material` stands for density and moduli; what is given beside it of these has its own
    value.
    """
    checked: dict[str, Any] = {}
    for name, value in values.items():
        if name not in PARAMETERS:
            raise ParameterError(f'{short(name, str)} = {short(value)} is not a parameter of '
                                 f'timo_sim ({source}){did_you_mean(name, PARAMETERS)}')
        try:
            checked[name] = PARAMETERS[name].check(value)
        except ParameterError as error:
            raise ParameterError(f'{error} ({source})') from None
    if checked.get('arm.material', 'none') != 'none':
        density, young, poisson = MATERIALS[checked['arm.material']]
        of_material = density, young, 0.5 * young / (1.0 + poisson)
        checked = dict(zip(OF_MATERIAL, of_material)) | checked
    return checked


def frame_names(values: Mapping[str, Any]) -> dict[str, str]:
    """
    Return the names of `topics.outputs.FRAMES` in messages, a dictionary.

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


def _is_number(value):
    return not isinstance(value, bool) and math.isfinite(value)


def _are_numbers(value):
    # Complex numbers, texts and objects are no floats of the same kind.
    return np.isfinite(np.asarray(value).astype(float, casting='same_kind')).all()


def _are_texts(value):
    return isinstance(value, (list, tuple)) and all(isinstance(each, str) for each in value)


def _is_whole(value):
    return isinstance(value, (int, np.integer)) and type(value) is not bool and 0 <= value < 2**63


# Rules of arguments that are no parameters: a test, and the same in words.
FLAG: Any = lambda value: isinstance(value, (bool, np.bool_)), 'true or false'
FUNCTION: Any = callable, 'a function'
MAPPING: Any = lambda value: isinstance(value, Mapping), 'values by name'
NUMBER: Any = _is_number, 'a finite number'
NUMBERS: Any = _are_numbers, 'a finite number, or an array of them'
PATH: Any = lambda value: isinstance(value, (str, os.PathLike)) and value != '', 'a path'
TEXT: Any = lambda value: isinstance(value, str), 'a text'
TEXTS: Any = _are_texts, 'a list of names'
CONTACT: Any = lambda value: value in ('', 'closed', 'open'), "closed, open or ''"
WHOLE: Any = _is_whole, 'a whole number from 0 to 2^63 - 1'


def numbers(name: str, value: Any, *shapes: tuple[int, ...]) -> np.ndarray:
    """Return finite numbers of one of some shapes as an array, or raise ParameterError."""
    try:
        found = np.asarray(value).astype(float, casting='same_kind')
        if found.shape in shapes and np.isfinite(found).all():
            return found
    except (TypeError, ValueError):  # also of lists of different lengths
        pass
    kinds = ['a finite number' if not shape else f'finite numbers of shape {shape}' if (
        shape[1:]) else f'{"two" if shape[0] == 2 else shape[0]} finite numbers'
        for shape in shapes]
    raise ParameterError(f'{name} must be {" or ".join(kinds)}, got {short(value)}')


def checked(**rules: Any) -> Callable[[_Function], _Function]:
    """
    Return a decorator: a function's arguments must keep these rules, or are a ParameterError.

    None is also right for an argument of which it is the default.
    """
    def decorate(function):
        parameters = inspect.signature(function).parameters
        optional = {name for name, each in parameters.items() if each.default is None}
        ruled = [(place, name, *rules[name]) for place, name in enumerate(parameters)
                 if name in rules]

        @functools.wraps(function)
        def call(*args, **keywords):
            for place, name, test, words in ruled:
                if place >= len(args) and name not in keywords:
                    continue
                value = args[place] if place < len(args) else keywords[name]
                if value is None and name in optional:
                    continue
                try:
                    good = test(value)
                except (TypeError, ValueError, OverflowError, LookupError):
                    good = False
                if not good:
                    raise ParameterError(f'{name} must be {words}, got {short(value)}')
            return function(*args, **keywords)
        return call
    return decorate


def steps_in(duration: Any, step: float) -> int:
    """Return how many time steps a duration has, both in s, or raise ParameterError."""
    return whole_ratio('duration', PARAMETERS['duration'].check(duration),
                       'integrator.step', step)


def check_runtime(values: Mapping[str, Any], later: Mapping[str, Any]) -> None:
    """Raise ParameterError if `later` changes what cannot be set while a simulation runs."""
    fixed = [name for name, value in later.items()
             if value != values[name] and not PARAMETERS[name].runtime]
    if fixed:
        raise ParameterError(f'{fixed[0]} = {short(later[fixed[0]])} cannot be set while a '
                             f'simulation runs; it stays {short(values[fixed[0]])}')


# What a scene of its own has where it does not say; the paper's manipulator has other values.
NEUTRAL = {'carrier.mass': 0.0, 'motor.mass': 0.0, 'motor.shaft_inertia': 0.0,
           'end_effector.mass': 0.0, 'end_effector.inertia': 0.0, 'initial.shaft': 0.0}


def gives_arm(names: Iterable[str]) -> bool:
    """Return whether values of these names are a scene of its own: whether they give any `arm`."""
    return any(name.startswith('arm.') for name in names)


def complete(given: Mapping[str, Any], own: bool) -> dict[str, Any]:
    """
    Return all values by name: checked ones that are given, and what they leave out.

    That is the paper's manipulator at rest, and none of it in a scene of its `own`: there it is no
    mass, no load and a straight arm at rest at angle 0. Raises ParameterError if such a scene
    lacks a value that nobody can assume.
    """
    values = {**DEFAULTS, **(NEUTRAL if own else {}), **given}
    for name, why in _asked_for(values) if own else ():
        profile = name.replace('section.', '').replace('arm.', 'arm.profile.')
        if name not in given and not given.get(profile):
            raise ParameterError(
                f'{name} must be given{why}: values that give any arm.* are a scene of its own, '
                "which has nothing of the paper's arm; overrides of a scene, such as "
                "load_scene('paper', {...}) or --set, change that scene")
    return values


def _asked_for(values):
    """Yield names that a scene of its own must give, each with the reason."""
    yield 'arm.length', ''
    if not all(values[f'arm.section.{name}'] or values[f'arm.profile.{name}']
               for name in ('mass_per_length', 'bending_stiffness')):
        shape = values['arm.section.shape']
        if shape not in ('round', 'tube'):
            yield 'arm.section.width', ', or a measured stiffness and mass per length'
        yield 'arm.section.height', ', or a measured stiffness and mass per length'
        for name in OF_MATERIAL:
            yield name, ', or arm.material'
    if values['motor.shaft'] != 'locked':
        yield 'motor.shaft_inertia', f' with motor.shaft = {values["motor.shaft"]}'
    if fixed_axes(values) != 'both':
        yield 'carrier.mass', f' with carrier.held = {values["carrier.held"]}'


def fixed_axes(values: Mapping[str, Any]) -> str:
    """Return the axes along which the carrier is held or driven: none, x, y or both."""
    held = values['carrier.held']
    found = [axis for axis in 'xy' if held in (axis, 'both') or driven_along(values, axis)]
    return 'both' if len(found) == 2 else ''.join(found) or 'none'


def driven_along(values: Mapping[str, Any], axis: str) -> bool:
    """Return whether the carrier is driven along an axis, x or y."""
    return bool(values[f'carrier.drive.{axis}'] or values[f'carrier.drive.harmonic.{axis}'])


def stated(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a file states: all of the manipulator and its start, and what else changed."""
    groups = 'arm.', 'hub.', 'carrier.', 'motor.', 'end_effector.', 'gravity', 'initial.'
    others = changed(values)
    return {name: value for name, value in values.items()
            if name == 'scene_version' or name.startswith(groups) or name in others}


def changed(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that differ from their defaults, or from those of the material."""
    named = values.get('arm.material', 'none') != 'none'
    return {name: value for name, value in values.items()
            if value != PARAMETERS[name].default or named and name in OF_MATERIAL}
