# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Sensitivities: derivatives of what a run shows by parameters, initial state and commands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from timo_sim.model.layout import INPUTS
from timo_sim.scene.parameters import (
    checked, FUNCTION, MAPPING, Parameter, ParameterError, short, steps_in, warn)
from timo_sim.scene.scene import (
    INITIAL, initial_names, initial_scale, load_scene, number_of, overrides_of, SceneLike)
from timo_sim.simulation.batch import Batch
from timo_sim.simulation.loads import ARGUMENTS, check_arguments
from timo_sim.simulation.warnings import DivergenceError

_LEVELS, _RATIO = 8, 4.0  # differences for each input, and the ratio of their steps
_FIRST_STEP = 0.05  # the largest of these steps, in scales of the input
_ROUND_OFF = 1e-15  # of an output, relative
_MAX_ERROR = 1e-3  # estimated error that is warned of, in the largest of the derivatives
_SAMPLES = Parameter('samples', 1, '', 'times at which the output is taken', low=1)


@dataclass(frozen=True)
class Sensitivities:
    """
    Derivatives of an output by p inputs, see `sensitivities`.

    `values`, (samples, ...), is the output at times `t`, (samples,) [s]; `jacobian` and `error`,
    (samples, ..., p), are its derivatives by the `inputs`, and an estimate of their error.
    """

    inputs: tuple[str, ...]
    t: np.ndarray
    values: np.ndarray
    jacobian: np.ndarray
    error: np.ndarray


@checked(output=FUNCTION, commands=MAPPING)
def sensitivities(scene: SceneLike, duration: float,
                  output: Callable[[Batch], np.ndarray] = Batch.position,
                  parameters: Sequence[str] | Mapping[str, float] = (),
                  commands: Mapping[str, Any] | None = None,
                  samples: int = 1) -> Sensitivities:
    """
    Differentiate an output of a run by parameters, initial state and commands.

    Central differences of eight steps, each a quarter of the last, are extrapolated to a step of
    0; of all results the one with the smallest estimated error is taken, separately for each
    derivative. All runs are one `Batch`. Derivatives are those of the run with its modes and
    steps. Where an output has a kink, such as at a limit, the derivative is the mean of both
    sides, and the error includes half of their difference. Source: Ridders, Advances in
    Engineering Software 4 (1982) 75-76.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
    duration : float
        Sim time [s], a whole multiple of the time step.
    output : function(Batch) -> ndarray, shape (n, ...)
        Takes the batch of all n runs at the time of a sample; by default the tip's position.
    parameters : sequence of str, or dict
        Names of the scene's parameters, with [k] for an element of a list; `initial` stands for
        the whole initial state. A dict has the size of a change that matters for each; otherwise
        this is the value of the parameter.
    commands : dict, optional
        By name of a parameter of `Batch.step`, such as `torque`: values that act one after
        another, each as long, shape (k,), or (k, 2) for forces. Each number is an input.
    samples : int
        Number of times at which the output is taken, evenly spaced, the last at the end.

    Raises
    ------
    ParameterError
        If a name is unknown, a parameter is 0 and has no size, a changed value breaks its rule,
        the scene cannot be in a `Batch`, or steps are not a multiple of samples and commands.
    DivergenceError
        If the run itself diverges.

    Warns
    -----
    ModelWarning
        If the estimated error is above 1e-3 of the largest derivative by the same input.

    Examples
    --------
    >>> import timo_sim
    >>> found = timo_sim.sensitivities('paper', 1.0, parameters=['end_effector.mass', 'initial'])
    >>> found.jacobian.shape, found.inputs[:3]
    ((1, 2, 13), ('end_effector.mass', 'initial.carrier_x', 'initial.carrier_y'))

    """
    scene = load_scene(scene).with_fixed_shapes()
    steps = steps_in(duration, scene.step)
    commanded = _check_commands(commands or {})
    inputs = [*_inputs_of_scene(scene, parameters),
              *_inputs_of_commands(scene, commanded, duration)]
    if not inputs:
        raise ParameterError('sensitivities need parameters or commands, got none')
    sampled = _ends_of_parts(steps, 'samples', _SAMPLES.check(samples))
    edges = {0, *sampled}.union(*(_ends_of_parts(steps, name, len(values))
                                  for name, values in commanded.items()))
    changes = _FIRST_STEP / _RATIO**np.arange(_LEVELS)
    runs = [(scene, commanded)]
    for each in inputs:
        runs.extend(each.changed(scene, commanded, sign * change)
                    for sign in (1.0, -1.0) for change in each.scale * changes)
    seen = _outputs(runs, output, steps, sorted(edges), sampled)
    # Samples, inputs, signs, levels, output.
    varied = seen[:, 1:].reshape(len(seen), len(inputs), 2, _LEVELS, *seen.shape[2:])
    above, below = np.moveaxis(varied, (2, 1, 3), (0, 1, 2))  # input, level, sample, output
    found = [_derivative(seen[:, 0], above[k], below[k], each.scale * changes)
             for k, each in enumerate(inputs)]
    jacobian, error = (np.stack(parts, axis=-1) for parts in zip(*found))
    names, outputs = tuple(each.name for each in inputs), tuple(range(jacobian.ndim - 1))
    most, largest = error.max(axis=outputs), np.abs(jacobian).max(axis=outputs)
    doubtful = np.flatnonzero(~(most <= _MAX_ERROR * largest) & ~(largest == 0.0))
    if len(doubtful):
        worst = doubtful[np.argmax(most[doubtful] / largest[doubtful])]
        warn(f'derivatives by {len(doubtful)} of {len(names)} inputs have an estimated error '
             f'above {_MAX_ERROR:g} of the largest: {most[worst]:.1g} of {largest[worst]:.3g} by '
             f'{names[worst]}')
    return Sensitivities(names, scene.step * np.array(sampled), seen[:, 0], jacobian, error)


class _Input(NamedTuple):
    """A number of the scene or of a command as an input."""

    name: str
    scale: float
    changed: Callable  # (scene, commands, change) -> scene, commands


def _check_commands(commands):
    check_arguments(commands, 'commands')
    found = {}
    for name, values in commands.items():
        shape = np.shape(ARGUMENTS[name])
        try:
            found[name] = np.array(values, dtype=float)
        except (TypeError, ValueError):
            found[name] = np.empty(0)
        if found[name].ndim != 1 + len(shape) or found[name].shape[1:] != shape or not len(
                found[name]):
            raise ParameterError(f'commands {name} must be numbers of shape '
                                 f'{"(k, 2)" if shape else "(k,)"}, got {short(values)}')
    return found


def _ends_of_parts(steps, name, count):
    # The step at the end of each part.
    if not steps or steps % count:
        raise ParameterError(f'the {steps} steps of the run must be a multiple of the number of '
                             f'{name}, got {count}')
    return range(steps // count, steps + 1, steps // count)


def _inputs_of_scene(scene, parameters):
    given = parameters if isinstance(parameters, Mapping) else dict.fromkeys(parameters)
    for name, size in given.items():
        for each in initial_names(scene) if name == INITIAL else [name]:
            parameter, value = number_of(each, scene)
            usual = initial_scale(each, scene) if each.startswith(INITIAL) else abs(value)
            scale = usual if size is None else Parameter(
                f'size of {name}', 1.0, parameter.unit, '', low=0.0, open_low=True).check(size)
            if not scale:
                raise ParameterError(f'{each} is 0: give the size of a change that matters, as '
                                     f'parameters={{{each!r}: size}}')
            yield _Input(each, scale, lambda scene, commands, change, name=each, value=value: (
                scene.vary(overrides_of({name: value + change}, scene)), commands))


def _inputs_of_commands(scene, commanded, duration):
    body, model = scene.manipulator, scene.build()
    inertia = (body.shaft_inertia + model.point_inertia.sum()
               + model.point_mass @ model.points.lever**2)
    # What would move a rigid arm by its length, or turn it by a radian, within the run.
    by_force, by_torque = (size / duration**2 for size in (model.mass * body.arm.length, inertia))
    of_unit = {'N': by_force, 'N m': by_torque, 'V': 1.0}
    scales = {each.argument: of_unit[each.unit] for each in INPUTS if each.argument}
    for name, values in commanded.items():
        for place in np.ndindex(values.shape):
            yield _Input(
                name + ''.join(f'[{k}]' for k in place), scales[name],
                lambda scene, commands, change, name=name, place=place: (
                    scene, {**commands, name: _add_at(commands[name], place, change)}))


def _add_at(values, place, change):
    values = values.copy()
    values[place] += change
    return values


def _outputs(runs, output, steps, edges, sampled):
    # The output of all runs at the samples, (samples, n, ...); NaN for one that has diverged.
    batch, seen = Batch([scene for scene, _ in runs]), []
    table = {name: np.array([commanded[name] for _, commanded in runs]) for name in runs[0][1]}
    for first, last in zip(edges, edges[1:]):
        commands = {name: values[:, first * values.shape[1] // steps]
                    for name, values in table.items()}
        batch.step(duration=(last - first) * batch.scenes[0].step, **commands)
        if last in sampled:
            values = np.array(output(batch), dtype=float)
            if values.shape[:1] != (batch.n,):
                raise ParameterError(f'the output must be an array of {batch.n} rows, one for '
                                     f'each run, got one of shape {values.shape}')
            values[batch.failed] = np.nan
            seen.append(values)
    if batch.failed[0]:
        raise DivergenceError(batch.reason(0))
    return np.array(seen)


def _derivative(base, above, below, steps):
    """Return a derivative and its estimated error, both of the shape of the output, `base`."""
    steps = steps.reshape(-1, *np.ones(base.ndim, dtype=int))
    round_off = _ROUND_OFF * (np.abs(above) + np.abs(below)) / steps
    central = (above - below) / (2.0 * steps)
    # Half of the difference of the derivatives on both sides, which is 0 without a kink.
    kink = (above - 2.0 * base + below) / (2.0 * steps)
    kink[1:] = (_RATIO * kink[1:] - kink[:-1]) / (_RATIO - 1.0)
    found, error, earlier = central[0], np.full(base.shape, np.inf), [central[0]]
    bent = np.full(base.shape, np.nan)
    for level in range(1, len(steps)):
        row = [central[level]]
        for order, before in enumerate(earlier, start=1):
            factor = _RATIO**(2 * order)
            row.append((factor * row[-1] - before) / (factor - 1.0))
            estimate = np.maximum(np.abs(row[-1] - row[-2]), np.abs(row[-1] - before)
                                  ) + round_off[level]
            better = estimate < error
            found, error = np.where(better, row[-1], found), np.where(better, estimate, error)
            bent = np.where(better, np.abs(kink[level]), bent)
        earlier = row
    return found, error + bent
