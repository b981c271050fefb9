# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The class Scene, which describes what is simulated, and functions that load it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
import math
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from timo_sim.compiled.constants import pack, Packed
from timo_sim.compiled.entry import Call
from timo_sim.model import formulation_class
from timo_sim.model.bodies import Constraints, Manipulator
from timo_sim.model.formulation import Formulation
from timo_sim.model.layout import (
    AFTER, ANGLE, PLACE_X, PLACE_Y, SPEED, SPEED_X, SPEED_Y, START)
from timo_sim.model.modes import axial_modes
from timo_sim.model.statics import equilibrium
from timo_sim.scene.bodies import (
    constraints_of, dry_friction_of, left_out_of, manipulator_of, modal_count)
from timo_sim.scene.checks import (
    check_counts, check_finite, check_slope, check_together, physical)
from timo_sim.scene.files import flatten, read_parameter_file
from timo_sim.scene.loads import Load, load_of, payloads_of, SHAFT_DRIVE
from timo_sim.scene.parameters import (
    changed, check, checked, complete, DELAYS, driven_along, FUNCTION, gives_arm, MAPPING, MODAL,
    ParameterError, PARAMETERS, POSITIONS, SCENE, short, VELOCITIES, warn, whole_ratio)
from timo_sim.scene.plausible import find_implausible, find_outdated
from timo_sim.scene.static_shapes import (
    fastest_shape, needed_static, SLOWED, STATIC, with_shapes)
from timo_sim.steps.sensors import add_errors, SensorErrors
from timo_sim.topics.outputs import (
    Output, outputs, SENSORS, title, TRANSFORMS, TRANSFORMS_OF_IMU)

# Phase of an axial vibration in a step above which a scene has it slowed down [rad]: bent arms
# diverged from 0.88 on.
_LEFT = 0.7
_TIP: Any = (lambda tip: tip[0] >= 0.0 <= tip[1] and 2 <= len(tip) <= 3,
             'two numbers >= 0, and an offset')
_TIP_FIELDS = 'end_effector_mass', 'end_effector_inertia', 'end_effector_offset'
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
    values: MappingProxyType[str, Any]
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
        return left_out_of(self.values)

    @property
    def outputs(self) -> list[Output]:
        """The topics that carry its motion."""
        return outputs(self.modal_count, self.manipulator.gear is not None,
                       bool(self.values['sensor.tip_imu.position']))

    @property
    def transforms(self) -> Output:
        """The topic with its frames."""
        return TRANSFORMS_OF_IMU if self.values['sensor.tip_imu.position'] else TRANSFORMS

    @checked(tip=_TIP, first=_TIP)
    def build(self, tip: tuple[Any, ...] | None = None,
              first: tuple[Any, ...] | None = None) -> Formulation:
        """
        Return the scene's Formulation of the equations of motion; it is made once and kept.

        `tip` are mass [kg], inertia [kg m2] and offset [m] at the tip, `first` those with which
        the modes are computed; by default those of the end effector.
        """
        own = self.manipulator
        body, basis = (
            own if each is None else replace(own, **dict[str, Any](zip(_TIP_FIELDS, each)))
            for each in (tip, first))
        return self._own_model if body == own == basis else self._model(
            self._damping, body, basis)

    def _model(self, damping, body, basis=None):
        values = self.values
        return _shared_model(
            values['model.formulation'], body, values['model.modes'],
            tuple(np.ravel(damping).tolist()), self.constraints, static=self.static,
            axial=values['model.axial_modes'], gravity=tuple(values['gravity']),
            basis=basis or body, push=values['push.position'],
            gauge=values['sensor.root_strain.position'], imu=values['sensor.tip_imu.position'],
            fastest=(self.fastest_shape, self.fastest))

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
        return SLOWED / self.step if self.step * omega[-1] > _LEFT else math.inf

    @cached_property
    def fastest_shape(self) -> float:
        """The same of static shapes of an arm soft in shear, in `exact` [rad/s]."""
        if self.values['model.formulation'] != 'exact':
            return math.inf
        return fastest_shape(self.manipulator, self.values['model.modes'], self.static, self.step)

    @cached_property
    def _damping(self):
        # Ratios of the modes of the clamped arm.
        values, damping = self.values, np.array(self.values['arm.damping_ratio'] or 0.0)
        if self.static:
            damping = with_shapes(damping, self.manipulator, values['model.modes'],
                                  values['model.axial_modes'], self.static, self.step)
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
        """Changes of the load at the tip: step, then mass [kg], inertia [kg m2], offset [m]."""
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
        return dry_friction_of(self.values)

    @cached_property
    def sensor_errors(self) -> Packed:
        """`SensorErrors` of the axes of SENSORS, in their order."""
        axes = [(2 * number + axis, sensor) for number, sensor in enumerate(SENSORS)
                for axis in range(len(sensor.columns))]
        noise, bias, resolution = np.array([[
            self.values[f'sensor.{sensor.name}.{kind}'] for _, sensor in axes]
            for kind in ('noise', 'bias', 'resolution')])
        late = [self.values[f'sensor.{title(sensor.topic)}.delay'] for _, sensor in axes]
        return pack(SensorErrors(
            seed=self.values['sensor.seed'], key=np.array([key for key, _ in axes]), noise=noise,
            bias=bias, resolution=resolution, delay=np.rint(np.array(late) / self.step)))

    @cached_property
    def add_sensor_errors(self) -> Call:
        """`add_errors` of these."""
        return add_errors.of(self.sensor_errors)

    @cached_property
    def has_sensor_errors(self) -> bool:
        """Whether a reading differs from what is measured, or comes later."""
        return any(value for name, value in self.values.items()
                   if name.startswith('sensor.') and not name.endswith(('.seed', '.position')))

    @property
    def has_dry_friction(self) -> bool:
        """Whether a joint has dry friction, which depends on more than its speed."""
        return bool(self.bristles[:, :2].any())

    def vary(self, overrides: Mapping[str, Any]) -> Scene:
        """Return the scene with other values by name, nested or dotted; else ParameterError."""
        return scene_from(self.values | check(flatten(overrides), 'override'))

    def with_fixed_shapes(self) -> Scene:
        """Return the scene with its static shapes named, so that `vary` keeps them."""
        names = {loads: name for name, loads in STATIC.items()}
        return self.vary({'model.static_modes': names[self.static]})

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
        position, velocity = ([values[name] for name in names] for names in (
            POSITIONS, VELOCITIES))
        # Drives at the end of step -1: the stages of a step with a kink see them smoothed.
        driven = [*(driven_along(values, axis) for axis in 'xy'), self.load.terms[SHAFT_DRIVE]]
        if any(driven):
            at_start = self.load.stages(-1, 1, self.step)[0, AFTER]
            for k, columns in enumerate(((PLACE_X, SPEED_X), (PLACE_Y, SPEED_Y), (ANGLE, SPEED))):
                if driven[k]:
                    position[k], velocity[k] = at_start[[*columns]]
        q, qdot = map(self.modal, MODAL)
        motion = np.concatenate([position, q or rest, velocity, qdot or rest])
        if not values['initial.equilibrium']:
            return motion
        try:
            found = equilibrium(model, motion, self.load_at_start())
            found[model.size // 2:][:2] = velocity[:2]
            return found
        except ValueError as error:
            raise ParameterError(f'initial.equilibrium = true: {error}') from None

    @checked(name=(lambda name: name in MODAL, ' or '.join(MODAL)))
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


def with_load(scene: Scene, load: Load) -> Scene:
    """Return a scene with another load; what was computed without its load is kept."""
    other = replace(scene, load=load)
    other.__dict__.update({name: value for name, value in vars(scene).items()
                           if name not in ('load', '_initial_motion')})
    return other


def scene_from(values: Mapping[str, Any], static: tuple[str, ...] | None = None) -> Scene:
    """
    Return the Scene of checked values, or raise ParameterError if they do not fit together.

    `static` are its static shapes, by default those of `model.static_modes`.
    """
    values = MappingProxyType({name: values[name] for name in _SCENE_NAMES})
    check_together(values)
    body = manipulator_of(values)
    if static is None:
        chosen = values['model.static_modes']
        with physical(values):
            static = needed_static(body, values['model.modes']) if chosen == 'auto' else (
                STATIC[chosen] if values['model.modes'] else ())
    check_counts(values, static)
    payloads_of(values)
    step = values['integrator.step']
    for name in DELAYS:
        whole_ratio(name, values[name], 'integrator.step', step)
    scene = Scene(manipulator=body, constraints=constraints_of(values), load=load_of(values),
                  step=step, values=values, static=static)
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


# Scenes that differ in loads, limits, dry friction or initial motion share their equations of
# motion, also if others that a fit tries come between them.
@lru_cache(maxsize=16)
def _shared_model(name, *arguments, **keywords):
    return formulation_class(name)(*arguments, **keywords)
