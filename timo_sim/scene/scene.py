# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The class Scene, which describes what is simulated, and functions that load and check one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from timo_sim.physics.arm.bodies import Constraints, Manipulator
from timo_sim.physics.equations import formulation_class
from timo_sim.physics.equations.base import Formulation
from timo_sim.physics.layout import START
from timo_sim.scene.build import (
    check_counts, check_finite, check_initial, constraints_of, implausible, load_of,
    manipulator_of, modal_count, payloads_of)
from timo_sim.scene.files import flatten, read_parameter_file
from timo_sim.scene.friction import check_slope, largest
from timo_sim.scene.initial import initial_motion, state_of
from timo_sim.scene.loads import Load
from timo_sim.scene.parameter import ParameterError, SCENE, short, warn, whole_ratio
from timo_sim.scene.parameters import DELAYS, PARAMETERS
from timo_sim.scene.values import changed, check
from timo_sim.scene.summary import html_table

# The argument `static` of a Formulation, by `model.static_modes`.
_STATIC = {'none': (), 'force': ('force',), 'torque': ('torque',), 'both': ('force', 'torque'),
           'weight': ('weight',)}


# Scenes that differ in loads, limits or initial motion share their equations of motion.
@lru_cache(maxsize=4)
def _shared_model(name, body, modes, damping, constraints, static, axial, gravity, basis):
    return formulation_class(name)(body, modes, damping[0] if len(damping) == 1 else damping,
                                   constraints, static=static, axial=axial, gravity=gravity,
                                   basis=basis)


_OF_SCENE = [name for name, parameter in PARAMETERS.items() if parameter.scope == SCENE]


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

    def __repr__(self) -> str:
        values, count = self.values, len(changed(self.values))
        return (f'<Scene: arm of {values["arm.length"]:g} m, {values["model.formulation"]} with '
                f'N = {self.modal_count}, h = {1e3 * self.step:g} ms, {count} '
                f'{"parameter" if count == 1 else "parameters"} not at default>')

    def _repr_html_(self) -> str:
        return html_table(repr(self)[1:-1], changed(self.values))

    @property
    def modal_count(self) -> int:
        """Number of modal coordinates: of modes in bending, then of axial ones."""
        return modal_count(self.values)

    def build(self, basis: Manipulator | None = None,
              tip: tuple[float, float] | None = None) -> Formulation:
        """
        Return the scene's Formulation of the equations of motion; it is made once and kept.

        Parameters
        ----------
        basis : Manipulator, optional
            The same arm with another end effector, whose modes are assumed.
        tip : tuple of float, optional
            Mass [kg] and inertia [kg m2] at the tip, if not those of the end effector.

        """
        body = self.manipulator if tip is None else replace(
            self.manipulator, end_effector_mass=tip[0], end_effector_inertia=tip[1])
        if body == self.manipulator == (basis or body):
            return self._own_model
        return self._model(self._own_model.damping, body, basis or self.manipulator)

    def _model(self, damping, body, basis=None):
        values = self.values
        return _shared_model(
            values['model.formulation'], body, values['model.modes'],
            tuple(np.ravel(damping).tolist()), self.constraints,
            _STATIC[values['model.static_modes']], values['model.axial_modes'],
            tuple(values['gravity']), basis or body)

    @cached_property
    def _own_model(self):
        values, damping = self.values, np.array(self.values['arm.damping_ratio'] or 0.0)
        if values['arm.damping_of'] == 'clamped' or not damping.any():
            return self._model(damping, self.manipulator)
        from timo_sim.physics.equations.system_damping import clamped_ratios
        ratios = clamped_ratios(self._model(0.0, self.manipulator), damping)
        if ratios.min() < 0.0:
            raise ParameterError(
                'arm.damping_of = system must be possible with damping of the clamped modes, but '
                f'mode {np.argmin(ratios) + 1} would need a ratio of {ratios.min():.2g} for '
                f'arm.damping_ratio = {short(list(values["arm.damping_ratio"]))}')
        return self._model(ratios, self.manipulator)

    @cached_property
    def payloads(self) -> tuple:
        """Changes of the load at the tip: step, mass [kg], inertia [kg m2] from then on."""
        return payloads_of(self.values)

    @property
    def friction(self) -> np.ndarray:
        """Largest dry friction of carrier x, y [N] and shaft [N m], 0 if not free, (3,)."""
        return largest(self.values, self.constraints)

    def vary(self, overrides: Mapping[str, Any]) -> Scene:
        """
        Return the scene with other values of some parameters, by (nested or dotted) name.

        Raises ParameterError if a name is unknown or a value breaks its rule, as `load_scene`.
        """
        return scene_from({**self.values, **check(flatten(overrides), 'override')})

    def with_load(self, load: Load) -> Scene:
        """Return the scene under another load, which its `values` do not describe."""
        return replace(self, load=load)

    def at(self, run: Any, t: float) -> Scene:
        """
        Return the scene with the state of a run as its initial state.

        The scene's own loads start again from t = 0.

        Parameters
        ----------
        run : Run
            A run of the same bodies with as many modes.
        t : float
            Sim time of one of its samples [s].

        Returns
        -------
        Scene

        Raises
        ------
        ParameterError
            If the run has no sample at t or other modes, or the scene has a driven shaft.

        Examples
        --------
        >>> import timo_sim
        >>> scene = timo_sim.load_scene('paper')
        >>> run = timo_sim.simulate(scene, 1.0)
        >>> further = timo_sim.simulate(scene.at(run, 1.0), 1.0)

        """
        return self.vary(state_of(self, run, t))

    def __getstate__(self):
        # Without the formulation, which the other process builds again.
        state = {field.name: getattr(self, field.name) for field in fields(self)}
        return {**state, 'values': dict(self.values)}

    def __setstate__(self, state):
        self.__dict__.update(state, values=MappingProxyType(state['values']))

    def initial_motion(self, model: Formulation | None = None) -> np.ndarray:
        """Return the motion at t = 0, shape (2 (3 + N),), of the scene's or another model."""
        if model in (None, self._own_model):
            return self._initial_motion.copy()
        return initial_motion(self, model)

    @cached_property
    def _initial_motion(self):
        return initial_motion(self, self._own_model)

    def load_at_start(self) -> np.ndarray:
        """Return the scene's own load at t = 0, shape (14,), see `physics.layout`."""
        return self.load.stages(0, 1, self.step)[0, START]


# What functions with an argument `scene` accept, see `load_scene`.
SceneLike = Scene | str | Path | Mapping[str, Any]


def load_scene(source: SceneLike, overrides: Mapping[str, Any] | None = None) -> Scene:
    """
    Read and check a scene.

    Parameters
    ----------
    source : str, Path, dict or Scene
        A ROS parameter file, the name of an installed scene ('paper', 'pick_and_place', 'spin_up',
        'standing'), or values by (nested or dotted) name. Values that are not given have their
        defaults: the paper's manipulator at rest without loads. Parameters of the node are checked
        and left out.
    overrides : dict, optional
        Values by name that replace those of the source.

    Returns
    -------
    Scene

    Raises
    ------
    ParameterError
        If a name is unknown or a value breaks its rule; the text says which.
    OSError
        If the file cannot be read.

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
    if not isinstance(source, str | Path):
        given, origin = flatten(source), 'given values'
    else:
        given, origin = read_parameter_file(source), str(source)
    values = {name: parameter.default for name, parameter in PARAMETERS.items()}
    values.update(check(given, origin))
    values.update(check(flatten(overrides or {}), 'override'))
    doubts = implausible(values)
    if doubts:
        warn(doubts)
    return scene_from(values)


def scene_from(values):
    """Return the Scene of checked values, or raise ParameterError if they do not fit together."""
    values = MappingProxyType({
        name: tuple(value) if isinstance(value := values[name], list) else value
        for name in _OF_SCENE})
    check_counts(values)
    check_initial(values)
    payloads_of(values)
    step = values['integrator.step']
    for name in DELAYS:
        whole_ratio(name, values[name], 'integrator.step', step)
    scene = Scene(manipulator_of(values), constraints_of(values), load_of(values), step, values)
    check_finite(scene)
    check_slope(scene)
    return scene
