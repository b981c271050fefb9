# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Measured frequency responses as records, which linear models predict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
from typing import Any, cast

import numpy as np

from timo_sim.fitting.problem import Problem, sensor_of
from timo_sim.fitting.record import Channel, DRIVE, INPUT_UNITS, OUTPUTS, Record, unit_of
from timo_sim.model.layout import with_unit
from timo_sim.runs.linear import linearize
from timo_sim.scene.parameters import check_keys, Parameter, ParameterError, short
from timo_sim.scene.scene import Scene

_KEYS = 'magnitude', 'phase', 'real', 'imaginary', 'unit', 'scale', 'coherence'
_RULES = {'scale': Parameter('scale', 1.0, '', ''),
          'unit': Parameter('unit', 'dB', '', '', choices=('dB',))}
_FEWEST = 5                # frequencies
_MOST_COHERENT = 0.999     # more is not believed


@dataclass(frozen=True)
class Response(Record):
    """
    A measured frequency response as a Record, whose times are frequencies [Hz].

    Each output has two values for each frequency, the logarithm of the magnitude and the phase
    [rad], multiplied by its `weights`, shape (n,).
    """

    weights: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def period(self) -> float:
        """A tenth of the time that matters at the highest frequency [s]."""
        return 0.01 / self.duration

    def cut(self, start: float = 0.0, end: float = math.inf) -> Record:
        """Refuse: the part would be a Record in time."""
        raise ParameterError('a frequency response cannot be cut: leave out rows of its table')

    def response(self, name: str, values: np.ndarray) -> np.ndarray:
        """Return the complex response of an output, (n,), from its values, (2 n,)."""
        log = values.reshape(-1, 2) / self.weights[name][:len(values) // 2, np.newaxis]
        return np.exp(log[:, 0] + 1j * log[:, 1])


def response_of(mapping: Mapping[str, Any], table: Any, source: str) -> Response:
    """Return the Response in Columns with a mapping, see doc/fit.md; ParameterError for others."""
    def numbers(column):
        return np.asarray(table.column(column), dtype=float)

    cause, outputs = mapping.get('input', ''), mapping.get('outputs')
    if cause not in INPUT_UNITS or cause == DRIVE or not isinstance(outputs, Mapping) or not (
            outputs.keys() <= OUTPUTS.keys()) or {*mapping} != {'frequency', 'input', 'outputs'}:
        raise ParameterError(
            'a frequency response must have frequency, a column [Hz]; input, one of '
            f'{", ".join(name for name in INPUT_UNITS if name != DRIVE)}; and outputs, of '
            f'{", ".join(OUTPUTS)}; got {short(mapping)}')
    frequency = numbers(mapping['frequency'])
    channels, weights = {}, {}
    for name, entry in outputs.items():
        check_keys(f'outputs: {name}', entry, _KEYS)
        rules = {each: _RULES[each].check(entry[each]) for each in entry.keys() & _RULES.keys()}
        if {'real', 'imaginary'} <= entry.keys():
            measured = numbers(entry['real']) + 1j * numbers(entry['imaginary'])
        elif {'magnitude', 'phase'} <= entry.keys():
            size = numbers(entry['magnitude'])
            size = 10.0**(size / 20.0) if 'unit' in rules else size
            if (size < 0.0).any():
                raise ParameterError(f'outputs: {name}: magnitudes must be >= 0 or have unit: dB, '
                                     f'got {np.nanmin(size):g} ({source})')
            measured = size * np.exp(1j * np.radians(numbers(entry['phase'])))
        else:
            raise ParameterError(f'outputs: {name} must have columns magnitude and phase [deg], '
                                 'or real and imaginary')
        measured = measured * rules.get('scale', 1.0)
        sure = np.minimum(numbers(entry['coherence']), _MOST_COHERENT) if 'coherence' in entry \
            else np.full(len(frequency), 0.5)
        good = np.isfinite(measured) & (measured != 0.0) & (frequency > 0.0) & (sure > 0.0)
        order = np.argsort(frequency[good])
        t, measured, sure = frequency[good][order], measured[good][order], sure[good][order]
        if len(t) < _FEWEST or not (np.diff(t) > 0.0).all():
            raise ParameterError(f'{name} must have {_FEWEST} or more different frequencies > 0 '
                                 f'with a response, got {len(t)} ({source})')
        # The variance of logarithm and phase is in proportion to (1 - c) / c.
        weight = np.sqrt(sure / (1.0 - sure))
        weights[name] = weight / np.sqrt(np.mean(weight**2))
        log = np.stack([np.log(np.abs(measured)), np.unwrap(np.angle(measured))], -1)
        channels[name] = Channel(np.repeat(t, 2), (weights[name][:, np.newaxis] * log).ravel())
    return Response({cause: Channel(np.zeros(1), np.ones(1))}, channels, source, weights)


class ResponseProblem(Problem):
    """A Problem whose record is a Response; its runs are LinearModels about the first motion."""

    def _run(self, scene, values, end):
        cause, = self.record.inputs
        return linearize(scene).select(
            [with_unit(cause, INPUT_UNITS[cause])],
            [with_unit(name, unit_of(name)) for name in self.record.outputs])

    def predicted(self, values: Mapping[str, float], end: float = math.inf,
                  run: Any = None) -> dict[str, np.ndarray]:
        """Return what outputs should show until `end` [Hz]; raises what `run` raises."""
        run, record, found = run or cast(Any, self.run(values)), cast(Response, self.record), {}
        cause, = record.inputs
        for k, (name, channel) in enumerate(record.outputs.items()):
            t, measured = channel.t[channel.t <= end], channel.values[channel.t <= end]
            s = 2j * np.pi * t[::2]
            response = run.frequency_response(t[::2])[:, k, 0]
            for gain, _, delay, lag, _ in (sensor_of(values, each) for each in (cause, name)):
                response = gain * np.exp(-delay * s) / (1.0 + lag * s) * response
            apart = np.log(response / record.response(name, measured))  # of phases within pi
            found[name] = measured + np.repeat(record.weights[name][:len(s)], 2) * np.stack(
                [apart.real, apart.imag], -1).ravel()
        return found


def problem_of(scene: Scene, record: Record, names: Sequence[str],
               bounds: Mapping[str, Sequence[float]], until: float) -> Problem:
    """Return the Problem of a Record or a Response."""
    kind = ResponseProblem if isinstance(record, Response) else Problem
    return kind(scene, record, names, bounds, until)
