# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Sensitivities: derivatives of what a run shows by parameters of its scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import numpy as np

from timo_sim.model.differences import differences
from timo_sim.scene.parameters import (
    checked, FUNCTION, Parameter, ParameterError, steps_in, TEXTS, warn)
from timo_sim.scene.numbers import (
    INITIAL, initial_names, initial_scale, number_of, overrides_of)
from timo_sim.scene.scene import load_scene, SceneLike
from timo_sim.simulation.batch import Batch
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


@checked(output=FUNCTION, parameters=(
    lambda given: isinstance(given, Mapping) or TEXTS[0](given), 'names, or sizes by name'))
def sensitivities(scene: SceneLike, duration: float,
                  output: Callable[[Batch], np.ndarray] = Batch.position,
                  parameters: Sequence[str] | Mapping[str, float] = (),
                  samples: int = 1) -> Sensitivities:
    """
    Differentiate an output of a run by parameters of the scene, its initial state among them.

    Central differences of eight steps, each a quarter of the last, are extrapolated to a step of
    0; of all results the one with the smallest estimated error is taken, separately for each
    derivative. All runs are one `Batch`. Derivatives are those of the run with its modes and
    steps. Where an output has a kink, such as at a limit, the derivative is the mean of both
    sides, and the error includes half of their difference. Derivatives by commands are those of
    `Simulator.step_derivatives`. Source: Ridders, Advances in Engineering Software 4 (1982) 75-76.

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
    samples : int
        Number of times at which the output is taken, evenly spaced, the last at the end.

    Raises
    ------
    ParameterError
        If a name is unknown, a parameter is 0 and has no size, a changed value breaks its rule,
        the scene cannot be in a `Batch`, or steps are not a multiple of samples.
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
    inputs = [*_inputs(scene, parameters)]
    if not inputs:
        raise ParameterError('sensitivities need parameters, got none')
    count = _SAMPLES.check(samples)
    if not steps or steps % count:
        raise ParameterError(f'the {steps} steps of the run must be a multiple of the number of '
                             f'samples, got {count}')
    changes = _FIRST_STEP / _RATIO**np.arange(_LEVELS)
    scales = np.array([scale for *_, scale in inputs])

    def shown(shifts):
        scenes = []
        for row in shifts.reshape(len(shifts), len(inputs), _LEVELS).sum(axis=2):
            changed = {name: value + change for (name, value, _), change in zip(inputs, row)
                       if change}
            scenes.append(scene.vary(overrides_of(changed, scene)) if changed else scene)
        seen = _outputs(Batch(scenes), output, steps // count, count)
        shapes.append((count, *seen.shape[2:]))
        return np.moveaxis(seen, 1, 0).reshape(len(shifts), -1)

    shapes: list[tuple[int, ...]] = []
    value, slope, kink = differences(shown, np.outer(scales, changes).ravel())
    slopes, kinks = (each.T.reshape(len(scales), _LEVELS, -1) for each in (slope, kink))
    found = [_extrapolate(value, central, bent, scale * changes)
             for central, bent, scale in zip(slopes, kinks, scales)]
    jacobian, error = (np.stack(parts, axis=-1).reshape(*shapes[0], len(inputs))
                       for parts in zip(*found))
    names, outputs = tuple(name for name, _, _ in inputs), tuple(range(jacobian.ndim - 1))
    most, largest = error.max(axis=outputs), np.abs(jacobian).max(axis=outputs)
    doubtful = np.flatnonzero(~(most <= _MAX_ERROR * largest) & ~(largest == 0.0))
    if len(doubtful):
        worst = doubtful[np.argmax(most[doubtful] / largest[doubtful])]
        warn(f'derivatives by {len(doubtful)} of {len(names)} inputs have an estimated error '
             f'above {_MAX_ERROR:g} of the largest: {most[worst]:.1g} of {largest[worst]:.3g} by '
             f'{names[worst]}: give the size of a change of it that matters')
    t = scene.step * np.arange(steps // count, steps + 1, steps // count)
    return Sensitivities(names, t, value.reshape(shapes[0]), jacobian, error)


def _inputs(scene, parameters):
    # Name, value and scale of each input.
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
            yield each, value, scale


def _outputs(batch, output, steps, count):
    # The output after each `steps` steps, (count, n, ...); NaN of a run that has diverged.
    seen = []
    for _ in range(count):
        batch.advance(steps)
        values = np.array(output(batch), dtype=float)
        if values.shape[:1] != (batch.n,):
            raise ParameterError(f'the output must be an array of {batch.n} rows, one for each '
                                 f'run, got one of shape {values.shape}')
        values[batch.failed] = np.nan
        seen.append(values)
    if batch.failed[0]:
        raise DivergenceError(batch.reason(0))
    return np.array(seen)


def _extrapolate(value, central, kink, steps):
    """Return a derivative and its estimated error, (p,), from differences of all steps, (L, p)."""
    round_off = 2.0 * _ROUND_OFF * (np.abs(value) / steps[:, np.newaxis] + np.abs(central))
    # Half of the difference of the derivatives on both sides, which is 0 without a kink; NaN
    # where a run fails.
    kink[1:] = (_RATIO * kink[1:] - kink[:-1]) / (_RATIO - 1.0)
    central = np.where(np.isnan(kink), np.nan, central)
    found, error, earlier = central[0], np.full(value.shape, np.inf), [central[0]]
    bent = np.full(value.shape, np.nan)
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
