# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The free parameters of a fit: their names, scales and bounds."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from timo_sim.fitting.quantities import unit_of
from timo_sim.scene.numbers import INITIAL, initial_names, initial_scale, number_of
from timo_sim.scene.parameter import did_you_mean, ParameterError, short

# Of a quantity of the record, by default; an input has no lag.
SENSOR = {'gain': 1.0, 'bias': 0.0, 'delay': 0.0, 'lag': 0.0}
_FURTHEST = 1e3  # factor by which a positive parameter may differ from its start


@dataclass(frozen=True)
class Free:
    """
    A free parameter.

    Attributes
    ----------
    name : str
        Of the scene, with [k] for an element of a list, or QUANTITY.gain, .bias, .delay, .lag.
    start, low, high : float
        First value and bounds, in the unit of the parameter.
    scale : float
        Change that matters, in the same unit; of a logarithm 1.
    log : bool
        Whether the fit works with its logarithm, and `scale` is a part of the value.
    unit : str

    """

    name: str
    start: float
    low: float
    high: float
    scale: float
    log: bool
    unit: str

    def coordinate(self, value):
        """Return the coordinate of the fit for a value."""
        with np.errstate(divide='ignore'):
            return np.log(value) if self.log else value / self.scale

    def value(self, coordinate):
        """Return the value for a coordinate."""
        return math.exp(coordinate) if self.log else float(coordinate * self.scale)


def free_parameters(names, bounds, scene, record):
    """
    Return the Free parameters of a fit, a list.

    Parameters
    ----------
    names : sequence of str
        See `fit`.
    bounds : dict
        (low, high) by name.
    scene : Scene
    record : Record

    Raises
    ------
    ParameterError
        If a name is unknown or given twice, or a start is outside of its bounds.

    """
    wanted = [each for name in names for each in (
        initial_names(scene) if name == INITIAL else [name])]
    if not wanted:
        raise ParameterError('a fit must have at least one free parameter, got none')
    for place, name in enumerate(wanted):
        if name in wanted[:place]:
            raise ParameterError(f'{name} is free twice')
    for name in bounds:
        if name not in wanted:
            raise ParameterError(f'bounds of {short(name, str)} need it to be free; free are '
                                 f'{", ".join(wanted)}{did_you_mean(name, wanted)}')
    return [_free(name, bounds.get(name), scene, record) for name in wanted]


def _free(name, bounds, scene, record):
    quantity, _, kind = name.rpartition('.')
    channels = {**record.inputs, **record.outputs}
    if quantity in channels and kind in SENSOR and (kind != 'lag' or quantity in record.outputs):
        values = channels[quantity].values
        # A search that begins at a bound leaves it slowly.
        start = 2.0 * record.period if kind == 'lag' else SENSOR[kind]
        low, high, scale, log, unit = {
            'gain': (0.0, math.inf, 1.0, True, ''),
            'bias': (-math.inf, math.inf, float(np.std(values)) or 1.0, False, unit_of(quantity)),
            'delay': (-0.1 * record.duration, 0.1 * record.duration, 10.0 * record.period, False,
                      's'),
            'lag': (0.0, 0.1 * record.duration, 10.0 * record.period, False, 's'),
        }[kind]
    else:
        parameter, start = number_of(
            name, scene, ' nor QUANTITY.gain, .bias, .delay or .lag of ' + ', '.join(channels),
            [f'{channel}.{kind}' for channel in channels for kind in SENSOR])
        low, high, unit = parameter.low, parameter.high, parameter.unit
        log = low == 0.0
        scale = initial_scale(name, scene) if name.startswith(INITIAL) else max(abs(start), 1.0)
        scale = 1.0 if log else scale
        if log and start == 0.0:
            raise ParameterError(f'{name} must be > 0 {unit} in the scene to be fitted, since its '
                                 'first value is a guess to begin with; got 0')
    given = (-math.inf, math.inf) if bounds is None else bounds
    try:
        given = float(given[0]), float(given[1])
        good = len(bounds or given) == 2 and given[0] < given[1]
    except (TypeError, ValueError, IndexError):
        good = False
    if not good:
        raise ParameterError(f'bounds of {name} must be two ascending numbers, got '
                             f'{short(bounds)}')
    low, high = max(low, given[0]), min(high, given[1])
    if log:
        low, high = max(low, start / _FURTHEST), min(high, start * _FURTHEST)
    if not low <= start <= high:
        raise ParameterError(f'{name} = {start:g} must be within its bounds, {low:g} to {high:g}, '
                             'where the fit begins')
    return Free(name, start, low, high, scale, log, unit)
