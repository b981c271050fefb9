# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Which record to take next: the input that would narrow the widest interval of a fit most."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from timo_sim.fitting.problem import Problem
from timo_sim.fitting.record import Channel, DRIVE, Record
from timo_sim.fitting.search import Search
from timo_sim.model.layout import INPUTS
from timo_sim.runs.modes import modes
from timo_sim.scene.parameters import Parameter, ParameterError
from timo_sim.scene.scene import Scene

_LIMIT = Parameter('limit', 1.0, '', '', low=0.0, open_low=True)
_DURATION = Parameter('duration', 1.0, 's', '', low=0.0, open_low=True)
_WEAKEST = 1e-6  # information on each coordinate, so that unidentified ones have an interval
_BAND = 0.2, 1.3  # ends of a band of frequencies, relative to the first and second of the scene


class NextInput(NamedTuple):
    """
    An input for the next record, and what the fit to it and the records so far would gain.

    `ratios` has, by parameter, its interval with the new record over that without it; `widest` is
    the parameter with the widest interval so far, relative to its value if it is positive.
    """

    kind: str           # step, chirp, multisine, or `again`: as in the first record
    quantity: str
    t: np.ndarray       # (n,) [s]
    values: np.ndarray  # (n,)
    widest: str
    ratios: dict[str, float]

    def save(self, path: str | Path) -> None:
        """Write times [s] and values as CSV."""
        np.savetxt(path, np.stack([self.t, self.values], axis=1), '%.9g', ',', comments='',
                   header=f'time,{self.quantity}')


def next_inputs(search: Search, information: np.ndarray, scene: Scene, limit: float | None,
                duration: float | None) -> list[NextInput]:
    """
    Return inputs of the first record's kind, the most useful one first.

    `information`, (p, p), is the inverse of the covariance of a fit's coordinates with white
    residuals. `limit` bounds the input, by default by its largest value in the first record;
    `duration` is by default that of the first record [s].
    """
    first = search.problems[0]
    quantity = next((name for name in first.record.inputs if name != DRIVE), None)
    if quantity is None:
        raise ParameterError('the next input needs a first record with an input other than drive')
    channel = first.record.inputs[quantity]
    limit = np.abs(channel.values).max() if limit is None else _LIMIT.check(limit)
    name = next(each.limit for each in INPUTS if each.name == quantity)
    limit = min(limit, first.scene.values[name] if name else limit)
    duration = first.record.duration if duration is None else _DURATION.check(duration)
    t = first.record.period * np.arange(round(duration / first.record.period) + 1)
    values = search.values(search.x, 0)
    before = np.sqrt(np.diag(np.linalg.inv(information + _WEAKEST * np.eye(len(information)))))
    shared = [k for k, free in enumerate(search.free) if not free.is_own]
    widest = search.free[max(shared or range(len(before)), key=before.__getitem__)].name
    again = np.clip(np.interp(t, channel.t, channel.values), -limit, limit)
    found = []
    for kind, signal in {**_signals(t, limit, scene), 'again': again}.items():
        record = Record.of({quantity: Channel(t, signal, hold=channel.hold)}, {
            name: (t, np.zeros(len(t))) for name in first.record.outputs})
        problem = Problem(scene, record, [free.name for free in first.free], {}, record.duration)
        new = Search([problem], 'linear')
        new.x = np.array([free.coordinate(values[free.name]) for free in new.free])
        new.deviations = search.deviations[:1]
        after = np.sqrt(np.diag(np.linalg.inv(_add(information, search, new))))
        found.append(NextInput(kind, quantity, t, signal, widest, {
            free.name: float(ratio) for free, ratio in zip(search.free, after[:len(before)] / before)}))
    return sorted(found, key=lambda each: each.ratios[widest])


def _add(information, search, new):
    """Return the information on what is free in a search, and in a record that is new."""
    names, jacobian = [free.name for free in search.free], new.jacobian(new.x)
    # Its own biases, delays and initial state come behind.
    own = [free.name for free in new.free if free.is_own]
    places = [len(names) + own.index(free.name) if free.is_own else names.index(free.name)
              for free in new.free]
    found = _WEAKEST * np.eye(len(names) + len(own))
    found[:len(names), :len(names)] += information
    found[np.ix_(places, places)] += jacobian.T @ jacobian
    return found


def _signals(t, limit, scene):
    """Return signals within a limit, (n,), by kind."""
    duration = t[-1]
    frequencies = [*modes(scene).frequency[:2]] or [5.0 / duration]
    high = min(_BAND[1] * frequencies[-1], 0.25 / (t[1] - t[0]))
    low = min(max(_BAND[0] * frequencies[0], 1.0 / duration), high)
    lines = np.arange(round(low * duration), max(round(high * duration), 1) + 1) / duration
    k = np.arange(len(lines))
    phases = -np.pi * k * (k + 1) / len(k)  # Schroeder's, for low peaks
    many = np.sin(2.0 * np.pi * np.outer(t, lines) + phases).sum(axis=1)
    return {'step': limit * np.select([t < 0.25 * duration, t < 0.5 * duration], [1.0, -1.0]),
            'chirp': limit * np.sin(2.0 * np.pi * (low + 0.5 * (high - low) / duration * t) * t),
            'multisine': limit * many / np.abs(many).max()}
