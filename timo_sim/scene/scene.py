# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The class Scene, which describes what is simulated; functions that load, check and build it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache, partial
import math
from pathlib import Path
import re
from types import MappingProxyType
from typing import Any

import numpy as np

from timo_sim.model import formulation_class
from timo_sim.model.bodies import (
    Beam, Constraints, Gear, Manipulator, Quadrature, SAME_PROFILE, Section, thinned)
from timo_sim.model.formulation import Formulation
from timo_sim.model.layout import AFTER, ANGLE, INPUTS, SPEED, START
from timo_sim.model.modes import axial_modes, compliance, modes_of
from timo_sim.model.statics import equilibrium
from timo_sim.scene.files import flatten, read_parameter_file
from timo_sim.scene.loads import (
    CHANNELS, check_slope, Drive, Harmonic, Load, Piecewise, Table)
from timo_sim.scene.parameters import (
    changed, check, checked, complete, DELAYS, did_you_mean, find_outdated, FUNCTION, gives_arm,
    MAPPING, NUMBER, Parameter, ParameterError, PARAMETERS, SCENE, short, warn, whole_ratio)
from timo_sim.topics.outputs import Output, outputs

# Ranges of real solids; `load_scene` warns of values outside.
_PLAUSIBLE = {'young_modulus': (1e5, 2e12, 'Pa'), 'density': (10.0, 25000.0, 'kg/m3')}
# Parameters of a load's terms.
_TERM_NAMES = {channel: tuple(f'load.{channel}.{name}' for name in (
    'harmonic.amplitude', 'harmonic.frequency', 'harmonic.phase', 'piecewise.time',
    'piecewise.value', 'table.time', 'table.value')) for channel in CHANNELS}
_MAX_NUMBER = 1e50  # products of six numbers, as in an energy, do not overflow
_MAX_LENGTH = 30.0  # longest arm that is not taken for one in millimetres [m]
_MIN_SLENDERNESS = 3.0  # length over height; a shorter arm is a block, not a beam
# Phases of an axial vibration in a step [rad]: above which a finer run has it critically damped,
# above which a scene has it slowed down (bent arms diverged from 0.88 on), and to which.
AXIAL_PHASE, _LEFT, _SLOWED = 4.0, 0.7, 0.5
# Presliding where none is given, seen from the shaft [m, rad].
_PRESLIDING = {'carrier': 1e-4, 'motor': 1e-3, 'motor.rotor': 1e-3}
_OF_MATERIAL = 'density', 'young_modulus', 'shear_modulus'
_MODAL = 'initial.modal_coordinates', 'initial.modal_rates'
_JOINTS = 'carrier_x', 'carrier_y', 'shaft'
_POSITION = [f'initial.{joint}' for joint in _JOINTS]
_VELOCITY = [f'{name}_velocity' for name in _POSITION]
_SCENE_NAMES = [name for name, parameter in PARAMETERS.items() if parameter.scope == SCENE]


@dataclass(frozen=True, repr=False)
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
    values : mapping
        The scene's parameters by dotted name; `vary` returns a scene with others.
    static : tuple of str
        Loads whose static shapes follow the modes in bending, see `needed_static`.
    keeps_axial : bool
        Whether axial vibrations stay as fast as they are, whatever the step.

    Examples
    --------
    >>> import timo_sim
    >>> timo_sim.load_scene('paper').vary({'arm.length': 1.5}).manipulator.arm.length
    1.5

    """

    manipulator: Manipulator
    constraints: Constraints
    load: Load
    step: float
    values: Mapping[str, Any]
    static: tuple[str, ...] = ()
    keeps_axial: bool = False

    def __repr__(self) -> str:
        values, count = self.values, len(changed(self.values))
        return (f'<Scene: arm of {values["arm.length"]:g} m, {values["model.formulation"]} with '
                f'N = {self.modal_count}, h = {1e3 * self.step:g} ms, {count} '
                f'{"parameter" if count == 1 else "parameters"} not at default>')

    @property
    def modal_count(self) -> int:
        """Number of modal coordinates: modes and static shapes, elastic gear, axial modes."""
        return modal_count(self.values) + len(self.static)

    @property
    def left_out(self) -> str:
        """What of the arm is left out, since its stiffness was measured without it; or ''."""
        names = [meaning for name, meaning in _NOT_MEASURED.items()
                 if _is_measured(self.values, 'bending_stiffness')
                 and not _is_measured(self.values, name)]
        return bool(names) * (f'the arm has no {", no ".join(names)}, since its bending stiffness '
                              'and mass are measured and these are not')

    @property
    def outputs(self) -> list[Output]:
        """The topics that carry its motion."""
        return outputs(self.modal_count, self.manipulator.gear is not None)

    @checked(basis=(lambda basis: isinstance(basis, Manipulator), 'a Manipulator'), tip=(
        lambda tip: tip[0] >= 0.0 <= tip[1] and len(tip) == 2, 'two numbers >= 0'))
    def build(self, basis: Manipulator | None = None,
              tip: tuple[float, float] | None = None) -> Formulation:
        """
        Return the scene's Formulation of the equations of motion; it is made once and kept.

        `basis` is the same arm with another end effector, whose modes are assumed; `tip` are mass
        [kg] and inertia [kg m2] at the tip, if not those of the end effector.
        """
        body = self.manipulator if tip is None else replace(
            self.manipulator, end_effector_mass=tip[0], end_effector_inertia=tip[1])
        if body == self.manipulator == (basis or body):
            return self._own_model
        return self._model(self._damping, body, basis or self.manipulator)

    def _model(self, damping, body, basis=None):
        values = self.values
        return _shared_model(
            values['model.formulation'], body, values['model.modes'],
            tuple(np.ravel(damping).tolist()), self.constraints, self.static,
            values['model.axial_modes'], tuple(values['gravity']), basis or body,
            values['push.position'], (self.fastest_shape, self.fastest))

    @cached_property
    def _own_model(self):
        return self._model(self._damping, self.manipulator)

    @cached_property
    def fastest(self) -> float:
        """
        Frequency to which faster axial vibrations are slowed down [rad/s]; infinite if none is.

        That is done if steps cover more than 0.7 rad of one, theory (T67): the stretch then
        follows slow forces.
        """
        if not (count := self.values['model.axial_modes']) or self.keeps_axial or not self.step:
            return math.inf
        omega = axial_modes(self.manipulator, count, self.constraints).omega
        return _SLOWED / self.step if self.step * omega[-1] > _LEFT else math.inf

    @cached_property
    def fastest_shape(self) -> float:
        """The same of static shapes of an arm soft in shear, in `exact` [rad/s]."""
        if (not self.static or not self.step or self.values['model.formulation'] != 'exact'
                or not _soft_in_shear(self.manipulator.arm)):
            return math.inf
        limit, goal = (_SHEAR_PHASE, _SHEAR_PHASE) if 'shear' in self.static else (
            AXIAL_PHASE, _SLOWED)
        omega = modes_of(self.manipulator, self.values['model.modes'], self.static).omega
        return goal / self.step if self.step * omega[-1] > limit else math.inf

    @cached_property
    def _damping(self):
        # Ratios of the modes of the clamped arm.
        values, damping = self.values, np.array(self.values['arm.damping_ratio'] or 0.0)
        count, shapes = values['model.modes'], len(self.static)
        if shapes:
            arm = count + values['model.axial_modes']
            if damping.size == 1 or damping.size == arm:
                damping = np.insert(np.broadcast_to(damping, (arm,)), count, shapes * [
                    np.ravel(damping)[min(count, damping.size) - 1]])
            # A shape that the step does not resolve follows its load, without resonance.
            phase = self.step * modes_of(self.manipulator, count, self.static).omega[count:]
            damping[count:count + shapes] += _STATIC_DAMPING * (
                phase > (_SHEAR_PHASE if 'shear' in self.static else _STATIC_PHASE))
        if values['arm.damping_of'] == 'clamped' or not damping.any():
            return damping
        from timo_sim.model.formulation import clamped_ratios
        ratios = clamped_ratios(self._model(0.0, self.manipulator), damping)
        if ratios.min() < 0.0:
            raise ParameterError(
                'arm.damping_of = system must be possible with damping of the clamped modes, but '
                f'mode {np.argmin(ratios) + 1} would need a ratio of {ratios.min():.2g} for '
                f'arm.damping_ratio = {short(list(values["arm.damping_ratio"]))}')
        return ratios

    @cached_property
    def payloads(self) -> tuple:
        """Changes of the load at the tip: step, mass [kg], inertia [kg m2] from then on."""
        return payloads_of(self.values)

    @cached_property
    def bristles(self) -> np.ndarray:
        """
        Dry friction of the joints, which that over a speed is not, shape (4, 5).

        Rows are of carrier x, y, of the shaft or, with an elastic gear, the rotor, and of the
        shaft of an elastic gear. Columns are friction in forward and in backward motion [N, N m],
        presliding [m, rad], by how much of itself friction is more at rest, and the speed over
        which that goes [m/s, rad/s]; 0, 0, 0, 0, 1 for joints without.
        """
        values, gear, found = self.values, bool(self.manipulator.gear), []
        bodies = ['carrier', 'carrier', 'motor.rotor' if gear else 'motor', 'motor']
        free = [*(place is None for place in self.constraints.carrier),
                not self.constraints.driven, gear]
        for body, moves in zip(bodies, free):
            ratio = values['motor.dc.gear_ratio'] if body == 'motor.rotor' else 1.0
            limit, speed, reach, rest = (values[f'{body}.coulomb_{name}'] for name in (
                'friction', 'speed', 'presliding', 'static'))
            uneven = values.get(f'{body}.coulomb_asymmetry', 0.0)
            found.append([
                ratio * limit * (1.0 + uneven), ratio * limit * (1.0 - uneven),
                reach / ratio or _PRESLIDING[body], rest - 1.0, speed / ratio or 1.0]
                if moves and limit and (reach or not speed) else [0.0, 0.0, 0.0, 0.0, 1.0])
        return np.array(found)

    @property
    def has_dry_friction(self) -> bool:
        """Whether a joint has dry friction, which depends on more than its speed."""
        return bool(self.bristles[:, :2].any())

    def vary(self, overrides: Mapping[str, Any]) -> Scene:
        """Return the scene with other values by name, nested or dotted; else ParameterError."""
        return scene_from({**self.values, **check(flatten(overrides), 'override')})

    def with_fixed_shapes(self) -> Scene:
        """Return the scene with its static shapes named, so that `vary` keeps them."""
        names = {loads: name for name, loads in _STATIC.items()}
        return self.vary({'model.static_modes': names[self.static]})

    @checked(run=(lambda run: hasattr(run, 'payloads'), 'a Run'), t=NUMBER)
    def at(self, run: Any, t: float) -> Scene:
        """
        Return the scene that begins with the state of a run of the same bodies at a sample, t [s].

        The scene's own loads start again from t = 0, and joints that move have slid before. Raises
        ParameterError if the run has no sample then or other modes, or the scene has a driven
        shaft.

        >>> import timo_sim
        >>> scene = timo_sim.load_scene('paper')
        >>> run = timo_sim.simulate(scene, 1.0)
        >>> further = timo_sim.simulate(scene.at(run, 1.0), 1.0)
        """
        sample = int(np.argmin(np.abs(run.t - t)))
        if not abs(run.t[sample] - t) <= 1e-9 * max(1.0, abs(t)):
            raise ParameterError(f't = {t:g} s must be the time of a sample, the nearest is '
                                 f'{run.t[sample]:.12g} s')
        if run.q.shape[1] != self.modal_count:
            raise ParameterError(f'the run must have {self.modal_count} modal coordinates, as '
                                 f'many as the scene, got {run.q.shape[1]}')
        if self.values['motor.shaft'] == 'driven':
            raise ParameterError('motor.shaft = driven starts at the beginning of motor.drive, '
                                 'not at the state of a run')
        before = round(run.t[sample] / run.scene.step)
        changed = [step for step, *_ in run.payloads if step < before]
        if changed:
            raise ParameterError(
                f't = {t:g} s must not be after a change of the load at the tip, since the modes '
                'are those of the first end effector; it changes at '
                f'{changed[0] * run.scene.step:g} s')
        position, velocity = run.values[sample].reshape(2, -1).tolist()
        return self.vary({
            **dict(zip(_POSITION, position)), **dict(zip(_VELOCITY, velocity)),
            'initial.modal_coordinates': position[3:], 'initial.modal_rates': velocity[3:],
            'initial.equilibrium': False})

    def __getstate__(self):
        # The formulation is left out: the other process builds it again.
        state = {field.name: getattr(self, field.name) for field in fields(self)}
        return {**state, 'values': dict(self.values)}

    def __setstate__(self, state):
        self.__dict__.update(state, values=MappingProxyType(state['values']))

    @checked(model=(lambda model: isinstance(model, Formulation), 'a Formulation'))
    def initial_motion(self, model: Formulation | None = None) -> np.ndarray:
        """Return the motion at t = 0, shape (2 (3 + N),), of the scene's or another model."""
        if model in (None, self._own_model):
            return self._initial_motion.copy()
        return self._motion_of(model)

    @cached_property
    def _initial_motion(self):
        return self._motion_of(self._own_model)

    def _motion_of(self, model):
        values, rest = self.values, np.zeros(self.modal_count)
        position, velocity = ([values[name] for name in names] for names in (_POSITION, _VELOCITY))
        if self.load.drive is not None:
            # The drive at the end of step -1: the stages of a step with a kink see it smoothed.
            position[2], velocity[2] = self.load.stages(-1, 1, self.step)[
                0, AFTER, [ANGLE, SPEED]]
        q, qdot = map(self.modal, _MODAL)
        motion = np.concatenate([position, q or rest, velocity, qdot or rest])
        if not values['initial.equilibrium']:
            return motion
        try:
            return equilibrium(model, motion, self.load_at_start())
        except ValueError as error:
            raise ParameterError(f'initial.equilibrium = true: {error}') from None

    @checked(name=(lambda name: name in _MODAL, ' or '.join(_MODAL)))
    def modal(self, name: str) -> tuple[float, ...]:
        """Return a list of initial coordinates or rates with those of static shapes, or ()."""
        given, count = self.values[name], self.values['model.modes']
        if given and len(given) < self.modal_count:
            given = (*given[:count], *len(self.static) * (0.0,), *given[count:])
        return given

    def load_at_start(self) -> np.ndarray:
        """Return the scene's own load at t = 0, shape (LOADS,), see `model.layout`."""
        return self.load.stages(0, 1, self.step)[0, START]


# What functions with an argument `scene` accept, see `load_scene`.
SceneLike = Scene | str | Path | Mapping[str, Any]


@checked(overrides=MAPPING)
def load_scene(source: SceneLike, overrides: Mapping[str, Any] | None = None) -> Scene:
    """
    Read and check a scene.

    Parameters
    ----------
    source : str, Path, dict or Scene
        A YAML file, the name of an installed scene ('arm', 'paper', 'pick_and_place', 'spin_up',
        'standing'), or values by (nested or dotted) name. A file or dict that gives any `arm.*` is
        a scene of its own: what it leaves out is 0, no load, or has to be given. Any other changes
        the paper's manipulator at rest without loads. Parameters of the node are checked and left
        out.
    overrides : dict, optional
        Values by name that replace those of the source, or are added to them.

    Raises
    ------
    ParameterError, OSError
        If a name is unknown or a value breaks its rule; if the file cannot be read.

    Warns
    -----
    ModelWarning
        If values are implausible, such as a shaft angle of 45 rad.

    Examples
    --------
    >>> import timo_sim
    >>> timo_sim.load_scene('paper', {'model.modes': 5}).values['model.modes']
    5

    """
    if isinstance(source, Scene):
        return source.vary(overrides) if overrides else source
    return scene_from(values_of(source, overrides))


def values_of(source: str | Path | Mapping[str, Any],
              overrides: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return all checked values by name, also those of the node; arguments as of `load_scene`."""
    if from_file := isinstance(source, str | Path):
        given, origin = read_parameter_file(source), str(source)
    else:
        given, origin = flatten(source), 'given values'
    own = gives_arm(given)
    given = {**check(given, origin), **check(flatten(overrides or {}), 'override')}
    try:
        values = complete(given, own)
    except ParameterError as error:
        raise ParameterError(f'{error} ({origin})') from None
    with physical(values):
        texts = (find_outdated(given, values) if own and from_file else None,
                 find_implausible(values))
    for text in filter(None, texts):
        warn(text)
    return values


def scene_from(values: Mapping[str, Any], static: tuple[str, ...] | None = None,
               keeps_axial: bool = False) -> Scene:
    """
    Return the Scene of checked values, or raise ParameterError if they do not fit together.

    `static` are its static shapes, by default those of `model.static_modes`; for `keeps_axial` see
    `Scene`.
    """
    values = MappingProxyType({
        name: tuple(value) if isinstance(value := values[name], list) else value
        for name in _SCENE_NAMES})
    check_gear(values)
    check_together(values)
    body = manipulator_of(values)
    if static is None:
        chosen = values['model.static_modes']
        with physical(values):
            static = _needed_static(body, values['model.modes']) if chosen == 'auto' else (
                _STATIC[chosen] if values['model.modes'] else ())
    check_counts(values, static)
    payloads_of(values)
    step = values['integrator.step']
    for name in DELAYS:
        whole_ratio(name, values[name], 'integrator.step', step)
    load = Load({channel: _terms_of(channel, tuple([values[name] for name in names]), step)
                 for channel, names in _TERM_NAMES.items()}, _drive(values))
    scene = Scene(manipulator=body, constraints=constraints_of(values), load=load, step=step,
                  values=values, static=static, keeps_axial=keeps_axial)
    check_finite(scene)
    check_slope(scene)
    return scene


@checked(deflection=FUNCTION, rotation=FUNCTION)
def project_on_modes(scene: SceneLike, deflection: Callable[[np.ndarray], Any],
                     rotation: Callable[[np.ndarray], Any]) -> tuple[float, ...]:
    """
    Project a deflection field, or a velocity field, on the modes of a scene.

    The result, a tuple of N modal coordinates [m sqrt(kg)] or rates [m sqrt(kg)/s], is exact to
    first order in the field, and is a value for the parameters `initial.modal_coordinates` or
    `initial.modal_rates`. Source: paper eqs. (21), (23).

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
    deflection, rotation : function(ndarray) -> array_like
        Deflection w(xi) in the arm frame [m] and rotation phi(xi) [rad], or their rates, for xi of
        shape (p,) [m].

    Examples
    --------
    >>> import timo_sim
    >>> scene = timo_sim.load_scene({})
    >>> q = timo_sim.project_on_modes(scene, lambda xi: 0.01 * xi**2, lambda xi: 0.02 * xi)
    >>> bent = scene.vary({'initial.modal_coordinates': q})

    """
    return tuple(load_scene(scene).build().project_on_modes(deflection, rotation).tolist())


# The argument `static` of a Formulation, by `model.static_modes`.
_STATIC = {'none': (), 'force': ('force',), 'torque': ('torque',), 'both': ('force', 'torque'),
           'weight': ('weight',)}
# A static shape is damped by so much more if its phase in a step is above [rad].
_STATIC_PHASE, _STATIC_DAMPING = 1.0, 1.0
# The same, and the phase to which it is slowed, if one is of shear: it resonates with stretch.
_SHEAR_PHASE = 0.2
# Of the tip's static deflection and rotation, what the modes of a finer run may leave out before a
# scene needs shapes, and before the finer run does: more than those of a tip as heavy as its arm.
_LEFT_OUT, _LEFT_OUT_BY_FINER = (1e-4, 1e-2), (3e-6, 3e-6)
# Share of shear in the deflection by a force above which axial forces, which turn it, matter.
_SOFT_IN_SHEAR = 0.03
_BENDING = 0, 2  # deflection and rotation of the tip among rows of `compliance`
MORE_MODES = 2  # of a finer run


def needed_static(scene: Scene, finer: int = 0) -> tuple[str, ...]:
    """
    Return the loads on the tip whose static shapes a scene needs, see doc/theory.md (T9).

    Of the responses to others, two more modes miss at most 1e-4 of the tip's deflection and 1e-2
    of its rotation, so that a finer run sees what the modes miss. Whether the scene has such loads
    does not count: a command may be one. A `finer` run, of so many modes, leaves out at most 3e-6;
    if the arm is soft in shear, it has a shape of shear alone besides, which no mode has.
    """
    body, rest = scene.manipulator, _LEFT_OUT_BY_FINER
    if not finer:
        return _needed_static(body, scene.values['model.modes'])
    return _needed_static(body, finer, rest, (0,)) + _soft_in_shear(body.arm) * ('shear',)


@lru_cache(maxsize=64)
def _soft_in_shear(arm):
    rule = Quadrature(arm.breaks, 40)
    section = arm.at(rule.nodes)
    bent = rule.weights @ ((arm.length - rule.nodes)**2 / section.bending_stiffness)
    sheared = np.sum(rule.weights / section.shear_stiffness)
    return bool(sheared > _SOFT_IN_SHEAR * (bent + sheared))


@lru_cache(maxsize=64)
def _needed_static(body, count, left_out=_LEFT_OUT, further=(0, MORE_MODES)):
    if not count:
        return ()
    for static in (), ('torque',):
        for more in further:  # few modes are found sooner
            modes = modes_of(body, count + more, static)
            whole, shapes = compliance(body, modes, body.arm.length)
            whole, shapes = whole[np.ix_(_BENDING, _BENDING)], shapes[[*_BENDING]]
            seen = shapes / modes.omega**2 @ shapes.T
            if (np.abs(1.0 - seen / whole) < np.transpose([left_out])).all():
                return static
    return _STATIC['both']


# Scenes that differ in loads, limits or initial motion share their equations of motion.
@lru_cache(maxsize=4)
def _shared_model(name, body, modes, damping, constraints, static, axial, gravity, basis, push,
                  fastest):
    return formulation_class(name)(body, modes, damping[0] if len(damping) == 1 else damping,
                                   constraints, static=static, axial=axial, gravity=gravity,
                                   basis=basis, push=push, fastest=fastest)


def manipulator_of(values: Mapping[str, Any]) -> Manipulator:
    """Return the Manipulator that the values describe."""
    elastic, turns = values['motor.gear.stiffness'], values['motor.dc.gear_ratio']
    return Manipulator(
        arm=_arm(values), carrier_mass=values['carrier.mass'], motor_mass=values['motor.mass'],
        shaft_inertia=values['motor.shaft_inertia'],
        end_effector_mass=values['end_effector.mass'],
        end_effector_inertia=values['end_effector.inertia'],
        carrier_friction=values['carrier.viscous_friction'],
        shaft_friction=values['motor.viscous_friction'] + (
            0.0 if elastic else motor_constants(values)[1]),
        # Of Coulomb friction with presliding the bodies do not know.
        coulomb=tuple(
            (ratio * values[f'{body}.coulomb_friction'], speed / ratio,
             values.get(f'{body}.coulomb_asymmetry', 0.0))
            if speed and not values[f'{body}.coulomb_presliding'] else (0.0, 1.0, 0.0)
            for body, ratio in (('carrier', 1.0), ('motor', 1.0), ('motor.rotor', turns))
            for speed in [values[f'{body}.coulomb_speed']]),
        hub_radius=values['hub.radius'], gear=Gear(
            elastic, values['motor.gear.damping'], values['motor.gear.backlash'],
            turns**2 * values['motor.rotor.inertia'],
            turns**2 * values['motor.rotor.viscous_friction'] + motor_constants(values)[1])
        if elastic else None, motor_limit=_motor_limit(values))


def _motor_limit(values):
    current, constant = values['motor.dc.current_limit'], values['motor.dc.torque_constant']
    if current == math.inf or values['motor.shaft'] != 'free':
        return ()
    if not constant:
        raise ParameterError('motor.dc.torque_constant must be > 0 N m/A with '
                             f'motor.dc.current_limit = {current:g} A, got {constant}')
    return (values['motor.dc.gear_ratio'] * constant * current, motor_constants(values)[1]),


@lru_cache(maxsize=4 * len(_TERM_NAMES))
def _terms_of(channel, given, step):
    # Equal terms are one object, so that scenes under the same load can share what follows of it.
    values = dict(zip(_TERM_NAMES[channel], given))
    return tuple(_terms(f'load.{channel}', values, step)) if any(given) else ()


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
    held, shaft = values['carrier.held'], values['motor.shaft']
    if held == 'both' and shaft != 'free' and modal_count(values) == 0:
        raise ParameterError(f'nothing can move: carrier.held = both, motor.shaft = {shaft}, '
                             'model.modes = 0')
    return Constraints(tuple(values[f'initial.carrier_{axis}'] if held in (axis, 'both') else None
                             for axis in 'xy'), shaft != 'free',
                       values['initial.shaft'] if shaft == 'locked' else None)


def payloads_of(values: Mapping[str, Any]) -> tuple[tuple[int, float, float], ...]:
    """Return the steps at which loads at the tip change, and its mass and inertia from then on."""
    times, masses, inertias = _same_length({
        name: values[name] for name in ('payload.time', 'payload.mass', 'payload.inertia')})
    if not np.all(np.less(times[:-1], times[1:])):
        raise ParameterError(f'payload.time must ascend, got {short(list(times))}')
    steps = [whole_ratio(f'payload.time[{k}]', time, 'integrator.step', values['integrator.step'])
             for k, time in enumerate(times)]
    return tuple(zip(steps, masses, inertias))


# Fields of a Section with their parameters, and those along the arm.
_SECTION = [(field.name, f'arm.{name}' if name in _OF_MATERIAL else f'arm.section.{name}',
             f'arm.profile.{name}') for field in fields(Section)
            for name in [field.name.removeprefix('measured_')]]


def _profiles(values):
    # The fields of a Section that vary along the arm, with their values.
    return {field: values[profile] for field, _, profile in _SECTION if values.get(profile)}


def _arm(values):
    section = {field: values[name] for field, name, _ in _SECTION}
    profiles = _profiles(values)
    length, positions = values['arm.length'], values['arm.profile.position']
    _leave_out(values, section, profiles)
    if not positions and not profiles:
        _check_section(values)
        return Beam(length, Section(**section))
    if len(positions) < 2 or positions[0] != 0.0 or positions[-1] != length or not np.all(
            np.less_equal(positions[:-1], positions[1:])):
        raise ParameterError('arm.profile.position must ascend from 0 to arm.length = '
                             f'{length:g} m, got {short(list(positions))}')
    _same_length({'arm.profile.position': positions, **{
        profile: values[profile] for _, _, profile in _SECTION if values.get(profile)}})
    _check_section(values)
    positions, varying, _ = thinned(positions, tuple(profiles.values()))
    return Beam(length, Section(**{**section, **dict(zip(profiles, varying))}), positions)


# What bending stiffness and mass per length may be measured without; numbers that stand for its
# limit: shear stiffness over bending stiffness, rotary inertia over mass, in lengths of the arm.
_NOT_MEASURED = {'shear_stiffness': 'shear deformation', 'rotary_inertia': 'rotary inertia',
                 'axial_stiffness': 'stretch'}
_STIFF_IN_SHEAR, _WITHOUT_INERTIA = 1e6, 1e-12


def _is_measured(values, name):
    return bool(values.get(f'arm.profile.{name}') or values[f'arm.section.{name}'])


def _leave_out(values, section, profiles):
    # Shape and material do not belong to a section whose stiffness is measured.
    mass, bending = 'mass_per_length', 'bending_stiffness'
    for name, other in (mass, bending), (bending, mass):
        if _is_measured(values, name) and not _is_measured(values, other):
            raise ParameterError(f'arm.section.{other} must be > 0 with arm.section.{name} = '
                                 f'{_each(values, name)[0]:g}, since shape and material do not '
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


def _each(values, name):
    # The values of a section's property along the arm.
    block = '' if name in _OF_MATERIAL else 'section.'
    return values.get(f'arm.profile.{name}') or (values[f'arm.{block}{name}'],)


# What parts of a shape take of its sizes: the part, the size, and how often.
_PARTS = {'tube': (('wall', 'height', 2.0),),
          'box': (('wall', 'height', 2.0), ('wall', 'width', 2.0)),
          'i': (('wall', 'height', 2.0), ('web', 'width', 1.0))}


def _check_section(values):
    shape = values['arm.section.shape']
    parts = _PARTS.get(shape, ())
    for name in ('wall', 'web'):
        given, needed = _each(values, name), name in [part for part, *_ in parts]
        if (min(given) > 0.0) != needed:
            raise ParameterError(f'arm.section.{name} must be {"> 0" if needed else "0"} with '
                                 f'arm.section.shape = {shape}, got {given[0]:g}')
    for part, size, count in parts:  # linear in between: what fits at positions fits everywhere
        given, room = np.array(_each(values, part)), np.array(_each(values, size)) / count
        if (given > room).any():
            raise ParameterError(f'arm.section.{part} must be at most {min(room):g} m for '
                                 f'arm.section.{size}, got {max(given):g}')


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


def modal_count(values: Mapping[str, Any]) -> int:
    """Return the number of modal coordinates, axial ones included, without static shapes."""
    return (values['model.modes'] + values['model.axial_modes']
            + (values['motor.gear.stiffness'] > 0.0))


def check_gear(values: Mapping[str, Any]) -> None:
    """Raise ParameterError if gear, rotor and friction of the motor do not fit together."""
    elastic = values['motor.gear.stiffness']
    for name, value in values.items():
        if name.startswith(('motor.gear.', 'motor.rotor.')) and not elastic and (
                value != PARAMETERS[name].default):
            raise ParameterError(f'{name} needs motor.gear.stiffness > 0, got {elastic:g}')
    for body in ('carrier', 'motor', 'motor.rotor'):
        speed, reach, rest = (f'{body}.coulomb_{name}' for name in (
            'speed', 'presliding', 'static'))
        if values[rest] != 1.0 and not (values[speed] and values[reach]):
            raise ParameterError(f'{rest} = {values[rest]:g} needs {speed} and {reach} > 0, got '
                                 f'{values[speed]:g} and {values[reach]:g}')
    if not elastic:
        return
    for name, good, rule in (
            ('motor.rotor.inertia', values['motor.rotor.inertia'] > 0.0, '> 0 kg m2'),
            ('motor.shaft', values['motor.shaft'] == 'free', 'free'),
            ('model.formulation', values['model.formulation'] == 'exact', 'exact'),
            ('arm.damping_of', values['arm.damping_of'] == 'clamped', 'clamped')):
        if not good:
            raise ParameterError(f'{name} must be {rule} with motor.gear.stiffness = {elastic:g}, '
                                 f'got {values[name]}')


def check_together(values: Mapping[str, Any]) -> None:
    """Raise ParameterError if values of different parameters do not fit together."""
    held, shaft, formulation = (
        values[name] for name in ('carrier.held', 'motor.shaft', 'model.formulation'))
    for name, rule, other, forbidden in (
            ('initial.shaft_velocity', '0', 'motor.shaft', shaft == 'locked'),
            ('initial.carrier_x_velocity', '0', 'carrier.held', held in ('x', 'both')),
            ('initial.carrier_y_velocity', '0', 'carrier.held', held in ('y', 'both')),
            ('initial.equilibrium', 'false', 'motor.shaft', shaft == 'driven'),
            *((name, 'empty or 0', 'initial.equilibrium', values['initial.equilibrium'])
              for name in (*_VELOCITY, 'initial.modal_coordinates', 'initial.modal_rates')),
            ('model.axial_modes', '0', 'model.formulation', formulation != 'exact')):
        if forbidden and values[name]:
            raise ParameterError(f'{name} must be {rule} with {other} = {values[other]}, got '
                                 f'{short(values[name])}')
    if held != 'both' and not values['carrier.mass']:
        raise ParameterError(f'carrier.mass must be > 0 kg with carrier.held = {held}, got 0')
    if len(values['gravity']) != 2:
        raise ParameterError(f'gravity must have 2 elements, got {len(values["gravity"])}')
    if values['push.position'] > values['arm.length']:
        raise ParameterError('push.position must be at most arm.length = '
                             f'{values["arm.length"]:g} m, got {values["push.position"]:g}')
    for each in INPUTS:
        if each.needs and each.prescribed and not values[each.needs]:
            for name in _TERM_NAMES[each.name]:
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
                          ('initial.modal_coordinates', (0, modes, modes + shapes)),
                          ('initial.modal_rates', (0, modes, modes + shapes))):
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
            'motion or its initial energy are not finite') from None
    except ParameterError:  # a ValueError that says already what to do
        raise
    except ValueError as error:
        # Only the physics finds some errors, such as modes too close to each other.
        raise ParameterError(f'model.formulation = {values["model.formulation"]}, '
                             f'model.modes = {values["model.modes"]}: {error}') from None


def check_finite(scene: Scene) -> None:
    """Raise ParameterError if a scene's equations of motion, or energies, may overflow."""
    with physical(scene.values):
        if not (np.isfinite(scene.build().linear).all() and max(
                scene.build().magnitude_bound, np.abs(scene.initial_motion()).max()
                ) < _MAX_NUMBER):
            raise OverflowError


def find_implausible(values: Mapping[str, Any]) -> str | None:
    """
    Return a warning about implausible values of a scene, or None.

    It marks those that are defaults, and says what is left out of a profile of many places.
    """
    each = partial(_each, values)

    def shown(name):
        default = ' (the default)' * (values[name] == PARAMETERS[name].default)
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
    for body in ('carrier', 'motor', 'motor.rotor'):
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
        values['arm.profile.position'], *_profiles(values).values()))
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


INITIAL = 'initial'  # stands for the whole initial state
# Parameters that no derivative or fit can vary begin with these.
_FIXED = 'model.', 'integrator.', 'sensor.', 'payload.time', 'motor.drive'
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
    if base.startswith('initial.modal') and value == ():
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
    joints = [joint for joint, held in zip(_JOINTS, still) if not held]
    modes = range(scene.modal_count)
    return [*(f'initial.{joint}' for joint in joints),
            *(f'initial.{joint}_velocity' for joint in joints),
            *(f'initial.modal_coordinates[{n}]' for n in modes),
            *(f'initial.modal_rates[{n}]' for n in modes)]


def initial_scale(name: str, scene: Scene) -> float:
    """
    Return a change of one number of the initial state.

    It moves the tip by a tenth of the arm's length, or turns it by 0.1 rad.
    """
    base, n = _split_index(name)
    model, length = scene.build(), scene.manipulator.arm.length
    if base.startswith('initial.modal'):  # a gear turns the shaft, and no section of the arm
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
