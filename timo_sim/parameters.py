"""
The parameters: name, default, unit, meaning and rule of each, once for YAML, Python and ROS.

The defaults are the paper's manipulator (its Tables 1 and 3) at rest, without loads.
"""

from dataclasses import dataclass
import math
import reprlib

import numpy as np

from timo_sim.physics import FORMULATIONS

SCENE, NODE = 'scene', 'node'
LATEST = 2**31 - 1  # [s] that a stamp of ROS can hold, 68 years; it counts in nanoseconds


_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxlist, _SHORT.maxtuple, _SHORT.maxother = 2, 8, 8, 60
_SHORT.maxstring = 60


class ParameterError(ValueError):
    """A parameter that breaks its rule; the text names parameter, value and rule."""


@dataclass(frozen=True)
class Parameter:
    """
    A parameter and its rule.

    Attributes
    ----------
    name : str
        Dotted name.
    default : bool, int, float, str or tuple of float
        Its type is the parameter's type.
    unit, meaning : str
    low, high : float
        Range of the value, or of each element.
    open_low : bool
        Whether `low` itself is excluded.
    choices : tuple of str
    scope : str
        SCENE: part of the physics. NODE: the node's own.
    runtime : bool
        Whether the node lets it be set while it runs.

    """

    name: str
    default: object
    unit: str
    meaning: str
    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    choices: tuple = ()
    scope: str = SCENE
    runtime: bool = False

    @property
    def rule(self):
        """What a value must be, in words."""
        kind = {bool: 'true or false', int: 'a whole number', float: 'a finite number',
                str: 'a text', tuple: 'a list of finite numbers'}[type(self.default)]
        if self.choices:
            return 'one of ' + ', '.join(self.choices)
        bounds = []
        if self.low > -math.inf:
            bounds.append(f'{">" if self.open_low else ">="} {self.low:g}')
        if self.high < math.inf:
            bounds.append(f'<= {self.high:g}')
        unit = f' {self.unit}' if bounds and self.unit else ''
        return ' '.join([kind, ' and '.join(bounds)]).strip() + unit

    def check(self, value):
        """
        Return the value as the parameter's type.

        A whole number is accepted for a float, and so is a text like '70.5e9', which is how YAML
        1.1 reads a number without a sign in the exponent.

        Raises
        ------
        ParameterError
            If the value breaks the rule.

        """
        try:
            if isinstance(self.default, tuple):
                if value is None:  # what ROS makes of an empty list
                    return ()
                if isinstance(value, (str, bytes, dict, set)) or not hasattr(value, '__iter__'):
                    raise ValueError
                return tuple(self._checked_number(element) for element in value)
            if isinstance(self.default, float):
                return self._checked_number(value)
            if isinstance(value, np.generic):
                value = value.item()
            if type(value) is not type(self.default):
                raise ValueError
            if self.choices and value not in self.choices:
                raise ValueError
            if isinstance(value, str) and '\0' in value:
                raise ValueError
            if isinstance(value, int) and not self.low <= value <= self.high:
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
        if not (math.isfinite(number) and above and number <= self.high):
            raise ValueError
        return number


def short(value, show=_SHORT.repr):
    """Return a value as one line of text that cannot be long, whatever the value."""
    try:
        shown = show(value)
    except ValueError:  # a whole number of thousands of digits
        shown = f'a huge {type(value).__name__}'
    shown = ''.join(sign if sign.isprintable() else ' ' for sign in shown)
    return shown if len(shown) <= 60 else shown[:57] + '...'


def _positive(name, default, unit, meaning, **more):
    return Parameter(name, default, unit, meaning, low=0.0, open_low=True, **more)


def _not_negative(name, default, unit, meaning, **more):
    return Parameter(name, default, unit, meaning, low=0.0, **more)


def _load(channel, unit, meaning):
    prefix = f'load.{channel}'
    return [
        Parameter(f'{prefix}.harmonic.amplitude', (), unit,
                  f'{meaning}: amplitudes of its terms amplitude sin(2 pi frequency t + phase)',
                  runtime=True),
        Parameter(f'{prefix}.harmonic.frequency', (), 'Hz', 'frequencies of the same terms',
                  low=0.0, runtime=True),
        Parameter(f'{prefix}.harmonic.phase', (), 'rad', 'phases of the same terms; none: all 0',
                  runtime=True),
        Parameter(f'{prefix}.piecewise.time', (), 's',
                  f'{meaning}: times at which it jumps to a new constant value', low=0.0,
                  runtime=True),
        Parameter(f'{prefix}.piecewise.value', (), unit, 'value from each of these times on',
                  runtime=True),
        Parameter(f'{prefix}.table.time', (), 's',
                  f'{meaning}: times of points joined by straight lines; a time twice is a jump',
                  low=0.0, runtime=True),
        Parameter(f'{prefix}.table.value', (), unit, 'values at these points', runtime=True),
    ]


def _profile(name, unit):
    return _positive(f'arm.profile.{name}', (), unit,
                     f'values of arm.{name} at these positions, instead of that one')


def _rate(topic, default):
    return _positive(f'rate.{topic}', default, 'Hz', f'messages per second of sim time on {topic}',
                     scope=NODE, runtime=True)


def _sensor(name, unit, meaning):
    prefix = f'sensor.{name}'
    return [
        _not_negative(f'{prefix}.noise', 0.0, unit,
                      f'standard deviation of the noise in {meaning}', high=_WRONG,
                      runtime=True),
        Parameter(f'{prefix}.bias', 0.0, unit, f'what is added to {meaning}', low=-_WRONG,
                  high=_WRONG, runtime=True),
        _not_negative(f'{prefix}.resolution', 0.0, unit, f'step in which {meaning} is shown; 0: '
                      'not rounded', high=_WRONG, runtime=True)]


def _delay(topic):
    return _not_negative(f'sensor.{topic}.delay', 0.0, 's', f'sim time from a measurement to its '
                         f'message on ~/{topic}, a whole multiple of integrator.step', high=1000.0)


_WRONG = 1e9  # of which nothing overflows
_TURNS = 1e6  # [rad] of which sine and cosine are still accurate

_ALL = [
    _positive('arm.length', 2.0, 'm', 'length of the arm'),
    _positive('arm.width', 0.02, 'm', 'section size normal to the plane of motion'),
    _positive('arm.height', 0.02, 'm', 'section size in the plane of motion'),
    _positive('arm.density', 2710.0, 'kg/m3', 'density'),
    _positive('arm.young_modulus', 70.5e9, 'Pa', "Young's modulus"),
    _positive('arm.shear_modulus', 27e9, 'Pa', 'shear modulus'),
    _positive('arm.shear_correction', 0.85, '', 'shear correction factor kappa'),
    _not_negative('arm.profile.position', (), 'm', 'distances from the root between which the '
                  'section varies linearly, from 0 to arm.length; one twice is a jump'),
    _profile('width', 'm'),
    _profile('height', 'm'),
    _profile('density', 'kg/m3'),
    _profile('young_modulus', 'Pa'),
    _profile('shear_modulus', 'Pa'),
    Parameter('arm.damping_ratio', (), '', 'modal damping ratios: none, one for all modes, or one '
              'for each', low=0.0, high=1.0, runtime=True),
    _positive('carrier.mass', 5.0, 'kg', 'mass of the carrier'),
    _not_negative('carrier.viscous_friction', 0.0, 'N s/m', 'force against the carrier per speed, '
                  'along world x and y', runtime=True),
    _not_negative('carrier.coulomb_friction', 0.0, 'N', 'largest force of dry friction on the '
                  'carrier, the same along world x and y'),
    _not_negative('carrier.force_limit', 0.0, 'N', 'largest force that a command makes along an '
                  'axis; 0: any', runtime=True),
    _not_negative('carrier.force_rate_limit', 0.0, 'N/s', 'how fast it changes at most; 0: at '
                  'once', runtime=True),
    Parameter('carrier.held', 'none', '', 'axes of the world along which the carrier cannot move',
              choices=('none', 'x', 'y', 'both')),
    _not_negative('motor.mass', 5.0, 'kg', 'mass of the motor, on the carrier'),
    _not_negative('motor.shaft_inertia', 2.0, 'kg m2', 'moment of inertia of the motor shaft'),
    _not_negative('motor.viscous_friction', 0.0, 'N m s/rad', 'torque against the shaft per speed',
                  runtime=True),
    _not_negative('motor.coulomb_friction', 0.0, 'N m', 'largest torque of dry friction on the '
                  'shaft'),
    _not_negative('motor.torque_limit', 0.0, 'N m', 'largest torque that a command makes; 0: any',
                  runtime=True),
    _not_negative('motor.torque_rate_limit', 0.0, 'N m/s', 'how fast it changes at most; 0: at '
                  'once', runtime=True),
    _not_negative('motor.dc.resistance', 0.0, 'ohm', 'of the winding of a DC motor that takes '
                  'voltages; 0: there is none'),
    _not_negative('motor.dc.torque_constant', 0.0, 'N m/A', 'torque of the rotor per current, and '
                  'back-EMF per speed [V s/rad]'),
    _positive('motor.dc.gear', 1.0, '', 'turns of the rotor per turn of the shaft; the inertia of '
              'the rotor, times its square, is part of motor.shaft_inertia'),
    _not_negative('motor.dc.voltage_limit', 0.0, 'V', 'largest voltage that a command makes; 0: '
                  'any', runtime=True),
    Parameter('motor.shaft', 'free', '', 'free: turned by the torque; locked at initial.shaft; '
              'driven along motor.drive', choices=('free', 'locked', 'driven')),
    _not_negative('motor.drive.time', (), 's', 'a driven shaft passes these points, quintic in '
                  'between and at the last speed afterwards; the first is at 0'),
    Parameter('motor.drive.angle', (), 'rad', 'angles at these times',
              low=-_TURNS, high=_TURNS),
    Parameter('motor.drive.speed', (), 'rad/s', 'speeds at these times'),
    Parameter('motor.drive.acceleration', (), 'rad/s2',
              'accelerations at these times, the last 0'),
    _not_negative('end_effector.mass', 2.0, 'kg', 'mass at the tip'),
    _not_negative('end_effector.inertia', 0.5, 'kg m2', 'moment of inertia at the tip'),
    Parameter('initial.carrier_x', 0.0, 'm', 'carrier position at t = 0'),
    Parameter('initial.carrier_y', 0.0, 'm', 'carrier position at t = 0'),
    Parameter('initial.shaft', math.pi / 4, 'rad', 'shaft angle at t = 0',
              low=-_TURNS, high=_TURNS),
    Parameter('initial.carrier_x_velocity', 0.0, 'm/s', 'carrier velocity at t = 0'),
    Parameter('initial.carrier_y_velocity', 0.0, 'm/s', 'carrier velocity at t = 0'),
    Parameter('initial.shaft_velocity', 0.0, 'rad/s', 'shaft speed at t = 0'),
    Parameter('initial.modal_coordinates', (), 'm sqrt(kg)', 'modal coordinates at t = 0: none '
              '(straight arm) or one for each mode'),
    Parameter('initial.modal_rates', (), 'm sqrt(kg)/s', 'their rates at t = 0'),
    Parameter('model.formulation', 'exact', '', 'equations of motion',
              choices=tuple(FORMULATIONS)),
    Parameter('model.modes', 3, '', 'number of assumed modes; 0 is a rigid arm', low=0, high=40),
    _not_negative('model.accuracy', 0.0, 'm', 'tip error for which model.modes and '
                  'integrator.step are chosen, instead of given; 0: they are given'),
    Parameter('integrator.step', 0.001, 's', 'time step', low=1e-9, high=1000.0),
    _not_negative('integrator.tolerance', 0.0, 'm', 'largest estimated tip error of a step, '
                  'which is done in two to 64 parts to stay below; 0: in one, whatever its error'),
    *_load('force_x', 'N', 'force on the carrier along world x'),
    *_load('force_y', 'N', 'force on the carrier along world y'),
    *_load('torque', 'N m', 'torque on the shaft'),
    *_load('tip_force_x', 'N', 'force on the end effector along world x'),
    *_load('tip_force_y', 'N', 'force on the end effector along world y'),
    *_load('tip_torque', 'N m', 'torque on the end effector'),
    Parameter('sensor.seed', 0, '', 'what the noise of all sensors is drawn from', low=0,
              high=1000000000),
    *_sensor('root_strain', '', 'the strain of the outer fibre at the root'),
    _delay('root_strain'),
    *_sensor('tip_acceleration', 'm/s2', 'either axis of the acceleration of the tip'),
    *_sensor('gyro', 'rad/s', 'the angular velocity of the tip'),
    _delay('tip_imu'),
    *_sensor('encoder', 'rad', 'the shaft angle'),
    _delay('encoder'),
    _not_negative('real_time_factor', 1.0, '', 'sim time per wall time; 0: as fast as possible',
                  high=1e6, scope=NODE, runtime=True),
    _not_negative('catch_up_limit', 0.1, 's', 'wall time that is caught up after a delay; what is '
                  'beyond it is dropped and counted', high=LATEST, scope=NODE, runtime=True),
    _not_negative('duration', 0.0, 's', 'sim time after which the node ends; 0: never',
                  high=LATEST, scope=NODE),
    _not_negative('command_timeout', 0.0, 's', 'sim time after which a command without successor '
                  'falls to zero; 0: held for ever', high=LATEST, scope=NODE, runtime=True),
    Parameter('sync', 'free', '', 'whether each sync_period waits for a command: wait; else free',
              choices=('free', 'wait'), scope=NODE),
    _positive('sync_period', 0.002, 's', 'sim time from one wait for a command to the next',
              high=LATEST, scope=NODE),
    _positive('sync_timeout', 1.0, 's', 'wall time after which a wait ends without a command; the '
              'first has no end', high=LATEST, scope=NODE),
    Parameter('start_paused', False, '', 'whether the simulation waits for ~/pause or ~/step',
              scope=NODE),
    Parameter('step_count', 1, '', 'time steps of one call of ~/step', low=1, high=1000000,
              scope=NODE, runtime=True),
    Parameter('publish_clock', False, '', 'whether sim time goes to /clock', scope=NODE),
    _rate('joint_states', 100.0),
    _rate('modal_state', 100.0),
    _rate('tip_deflection', 100.0),
    _rate('tip_pose', 100.0),
    _rate('carrier_pose', 100.0),
    _rate('root_strain', 100.0),
    _rate('tip_imu', 100.0),
    _rate('encoder', 100.0),
    _rate('clock', 100.0),
    _rate('arm_shape', 50.0),
    _rate('tf', 50.0),
    Parameter('record', True, '', 'whether the run is logged to an MCAP file', scope=NODE),
    Parameter('record_file', '', '', 'path of the log; empty: timo_sim_DATE_TIME.mcap in the '
              'working directory', scope=NODE),
    Parameter('record_sensors', False, '', 'whether ~/root_strain, ~/tip_imu and ~/encoder are '
              'logged also while nobody subscribes', scope=NODE),
    Parameter('rerun_live', '', '', 'address of a running viewer of rerun to which the motion is '
              'streamed, such as rerun+http://127.0.0.1:9876/proxy; empty: none', scope=NODE),
    Parameter('publish_arm_shape', False, '', 'whether the centre line goes to ~/arm_shape, for '
              'RViz; needs visualization_msgs', scope=NODE),
    Parameter('publish_tf', False, '', 'whether the frames carrier, arm and tip go to /tf; needs '
              'tf2_msgs', scope=NODE),
]

PARAMETERS = {parameter.name: parameter for parameter in _ALL}
RATES = [name for name in PARAMETERS if name.startswith('rate.')]
DELAYS = [name for name in PARAMETERS if name.endswith('.delay')]


def check(values, source):
    """
    Check a set of values.

    Parameters
    ----------
    values : dict
        Value of each dotted name.
    source : str
        Where they come from, for the message.

    Returns
    -------
    dict
        The values as their types.

    Raises
    ------
    ParameterError
        If a name is unknown or a value breaks its rule.

    """
    checked = {}
    for name, value in values.items():
        if name not in PARAMETERS:
            raise ParameterError(f'{short(name, str)} = {short(value)} is not a parameter of '
                                 f'timo_sim ({source})')
        try:
            checked[name] = PARAMETERS[name].check(value)
        except ParameterError as error:
            raise ParameterError(f'{error} ({source})') from None
    return checked


def changed(values):
    """Return those of some values that are not the default."""
    return {name: value for name, value in values.items() if value != PARAMETERS[name].default}


def whole_ratio(name, value, unit_name, unit):
    """
    Return how many times `unit` fits into `value`, a whole number.

    Raises
    ------
    ParameterError
        If it is not whole to 1e-9 relative (ten thousand times the rounding of the decimals);
        the message holds the ratio.

    """
    ratio = value / unit
    count = round(ratio) if math.isfinite(ratio) else 0
    if abs(ratio - count) > 1e-9 * ratio or not math.isfinite(ratio):
        raise ParameterError(f'{name} = {value:.12g} must be a whole multiple of '
                             f'{unit_name} = {unit:.12g}, the ratio is {ratio:.12g}')
    return count
