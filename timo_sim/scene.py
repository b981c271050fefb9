"""A scene: what is simulated, checked, from a YAML file, a dictionary and overrides."""

from bisect import bisect_left
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np
import yaml

from timo_sim.actuators import motor_constants
from timo_sim.parameters import (
    check, DELAYS, ParameterError, PARAMETERS, SCENE, short, whole_ratio)
from timo_sim.physics import FORMULATIONS
from timo_sim.physics.bodies import Beam, Manipulator, Section
from timo_sim.physics.formulation import Constraints
from timo_sim.physics.load import CHANNELS, Drive, Harmonic, Load, Piecewise, Table


_DEEPEST = max(name.count('.') for name in PARAMETERS)


@dataclass(frozen=True)
class Scene:
    """
    A manipulator, its initial motion, its loads, and how it is modelled and integrated.

    Attributes
    ----------
    manipulator : Manipulator
    constraints : Constraints
    load : Load
    step : float
        Time step [s].
    values : dict
        The scene's parameters by dotted name.

    """

    manipulator: Manipulator
    constraints: Constraints
    load: Load
    step: float
    values: dict

    def build(self):
        """Return the formulation of the equations of motion that the scene asks for, kept."""
        return self._formulation

    @cached_property
    def _formulation(self):
        count = self.values['model.modes']
        damping = np.array(self.values['arm.damping_ratio'] or 0.0)
        return FORMULATIONS[self.values['model.formulation']](
            self.manipulator, count, damping, self.constraints)

    @property
    def friction(self):
        """Largest Coulomb friction of carrier x, y [N] and shaft [N m], shape (3,)."""
        axis, shaft = (self.values[f'{body}.coulomb_friction'] for body in ('carrier', 'motor'))
        held = [position is not None for position in self.constraints.carrier]
        return np.where([*held, self.constraints.driven], 0.0, [axis, axis, shaft])

    def vary(self, overrides):
        """
        Return the scene with other values of some parameters.

        Parameters
        ----------
        overrides : dict
            Values by (nested or dotted) name.

        Returns
        -------
        Scene

        Raises
        ------
        ParameterError
            As `load_scene`.

        """
        return scene_from({**self.values, **check(flatten(overrides), 'override')})

    def __getstate__(self):
        # Without the formulation, which another process makes again.
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def initial_motion(self):
        """Return the motion at t = 0, shape (2 (3 + N),), see `physics.formulation`."""
        rest = np.zeros(self.values['model.modes'])
        position, velocity = (
            [[self.values[f'initial.{joint}{kind}'] for joint in ('carrier_x', 'carrier_y',
                                                                  'shaft')]
             for kind in ('', '_velocity')])
        if self.load.drive is not None:
            position[2], velocity[2], _ = self.load.drive.stages(0, 1, self.step)[0, 0]
        q = self.values['initial.modal_coordinates'] or rest
        qdot = self.values['initial.modal_rates'] or rest
        return np.concatenate([position, q, velocity, qdot])


def load_scene(source, overrides=None):
    """
    Read and check a scene.

    Parameters
    ----------
    source : str, Path or dict
        A ROS parameter file, or values by (nested or dotted) name. What is not given has its
        default, the paper's manipulator at rest without loads; parameters of the node are
        checked and left out.
    overrides : dict, optional
        Further values by name, which win.

    Returns
    -------
    Scene

    Raises
    ------
    ParameterError
        If a name is unknown or a value breaks its rule; the text says which.
    OSError
        If the file cannot be read.

    """
    if isinstance(source, dict):
        given, origin = flatten(source), 'given values'
    else:
        given, origin = read_parameter_file(source), str(source)
    values = {name: parameter.default for name, parameter in PARAMETERS.items()}
    values.update(check(given, origin))
    values.update(check(flatten(overrides or {}), 'override'))
    return scene_from(values)


def project(scene, deflection, rotation):
    """
    Project a deflection field, or a velocity field, on the modes of a scene.

    Exact to first order in the field; give the result to the parameters
    `initial.modal_coordinates` or `initial.modal_rates`.

    Parameters
    ----------
    scene : Scene
    deflection : function(ndarray) -> array_like
        w(xi) in the arm frame [m], or its rate [m/s], for xi of shape (p,) [m].
    rotation : function(ndarray) -> array_like
        phi(xi) [rad], or its rate [rad/s].

    Returns
    -------
    tuple of float, length N
        [m sqrt(kg)] or [m sqrt(kg)/s]. Source: paper eqs. (21), (23).

    """
    return tuple(scene.build().project(deflection, rotation).tolist())


def scene_from(values):
    """Return the scene of a full set of checked values."""
    values = {name: values[name] for name, parameter in PARAMETERS.items()
              if parameter.scope == SCENE}
    _check_counts(values)

    manipulator = Manipulator(
        _arm(values), values['carrier.mass'], values['motor.mass'], values['motor.shaft_inertia'],
        values['end_effector.mass'], values['end_effector.inertia'],
        values['carrier.viscous_friction'],
        values['motor.viscous_friction'] + motor_constants(values)[1])
    step = values['integrator.step']
    for name in DELAYS:
        whole_ratio(name, values[name], 'integrator.step', step)
    load = Load({channel: tuple(_terms(f'load.{channel}', values, step)) for channel in CHANNELS},
                _drive(values))
    scene = Scene(manipulator, _constraints(values), load, step, values)
    if scene.friction.any() and values['integrator.tolerance']:
        raise ParameterError('integrator.tolerance must be 0 with coulomb_friction, whose steps '
                             f'cannot be split, got {values["integrator.tolerance"]:g}')
    try:
        with np.errstate(over='raise', divide='raise', invalid='raise'):
            finite = _is_finite(scene)
    except ArithmeticError:
        finite = False
    except ValueError as error:
        # What only the physics can tell, such as modes too close to each other.
        raise ParameterError(f'model.formulation = {values["model.formulation"]}, model.modes = '
                             f'{values["model.modes"]}: {error}') from None
    if not finite:
        raise ParameterError('the values of this scene are too large or too small together: no '
                             'finite equations of motion, or no finite initial energy')
    return scene


def _is_finite(scene):
    # Whether equations of motion and initial energy are finite.
    formulation, motion = scene.build(), scene.initial_motion()
    return np.isfinite(formulation.linear).all() and (
        not motion[3:].any() or np.isfinite(formulation.energy(motion[np.newaxis])[0]))


def read_parameter_file(path):
    """
    Read the values for the node `timo_sim` from a ROS parameter file.

    Returns
    -------
    dict
        Unchecked values by dotted name.

    """
    try:
        content = yaml.safe_load(Path(path).read_text(encoding='utf-8'))
    except (yaml.YAMLError, RecursionError, ValueError, LookupError, AttributeError) as error:
        # PyYAML raises nearly anything for a tag on a value that does not suit it.
        reason = ' '.join(str(error).split())
        raise ParameterError(f'{path} is not a YAML file: {reason}') from None
    values = {}
    sections = content.items() if isinstance(content, dict) else ()
    for node, section in sections:
        if str(node).rpartition('/')[2] in ('**', 'timo_sim') and isinstance(section, dict):
            values.update(flatten(section.get('ros__parameters') or {}))
    if not values:
        raise ParameterError(f'{path} must have parameters under timo_sim: ros__parameters:')
    return values


def flatten(values, prefix=''):
    """Return values by dotted name, of values by nested or dotted name."""
    flat = {}
    for name, value in values.items():
        # No name is deeper; what YAML aliases can make of few lines must not be walked through.
        if isinstance(value, dict) and prefix.count('.') <= _DEEPEST:
            flat.update(flatten(value, f'{prefix}{name}.'))
        else:
            flat[f'{prefix}{name}'] = value
    return flat


def _check_counts(values):
    modes = values['model.modes']
    if values['model.accuracy'] > 0.0:
        modes = 0  # to be chosen: what has an element for each mode cannot be given
    for name, allowed in (('arm.damping_ratio', (0, 1, modes)),
                          ('initial.modal_coordinates', (0, modes)),
                          ('initial.modal_rates', (0, modes))):
        if len(values[name]) not in allowed:
            expected = ' or '.join(str(count) for count in sorted(set(allowed)))
            cause = 'a stated model.accuracy' if values['model.accuracy'] else (
                f'model.modes = {modes}')
            raise ParameterError(f'{name} must have {expected} elements for {cause}, got '
                                 f'{len(values[name])}')


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


def _constraints(values):
    held, shaft, carrier = values['carrier.held'], values['motor.shaft'], [None, None]
    still = {'initial.shaft_velocity': f'motor.shaft = {shaft}'} if shaft == 'locked' else {}
    for axis, name in enumerate('xy'):
        if held in (name, 'both'):
            carrier[axis] = values[f'initial.carrier_{name}']
            still[f'initial.carrier_{name}_velocity'] = f'carrier.held = {held}'
    for name, reason in still.items():
        if values[name] != 0.0:
            raise ParameterError(f'{name} must be 0 with {reason}, got {values[name]}')
    if held == 'both' and shaft != 'free' and values['model.modes'] == 0:
        raise ParameterError(f'nothing can move: carrier.held = both, motor.shaft = {shaft}, '
                             'model.modes = 0')
    return Constraints(tuple(carrier), shaft != 'free')


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
