# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A track: what a view shows of a run, whatever the run comes from."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

POINTS = 41     # of the centre line that is drawn
BLOCK = 1024    # samples that are worked out at once: what they need stays near the processor


class TrackError(ValueError):
    """What a view needs is missing; the text says what."""


class Body(NamedTuple):
    """Sizes of what is drawn [m]: bodies of the arm's material, cube, cylinder and ball."""

    length: float
    thickness: float
    carrier: float
    motor: float
    end_effector: float


class Poses(NamedTuple):
    """Where everything is at m times, world axes."""

    line: np.ndarray    # centre line from root to tip, (m, p, 2) [m]
    shaft: np.ndarray   # (m,) [rad]
    effort: np.ndarray  # force x, y [N] and torque [N m] as applied, (m, 3)


class Trace(NamedTuple):
    """Curves of one panel."""

    panel: str          # key, as in 'tip_deflection'
    names: tuple        # of the k curves
    ns: np.ndarray      # sim time (n,) [ns]
    values: Callable    # from a slice to (m, k)


@dataclass(frozen=True)
class Track:
    """
    A run as a view takes it.

    Attributes
    ----------
    name : str
    ns : ndarray, shape (n,)
        Sim times of the samples [ns], not descending.
    poses : function(ndarray of int or slice) -> Poses
        At these samples.
    traces : list of Trace
    body : Body
    note : str
        What it is and how its shape is known, Markdown.

    """

    name: str
    ns: np.ndarray
    poses: Callable
    traces: list
    body: Body
    note: str

    def trace(self, panel):
        """Return the trace of a panel, or None."""
        return next((trace for trace in self.traces if trace.panel == panel), None)

    def frames(self, rate, at=None):
        """
        Return the samples that make at most so many frames per second, ascending.

        Where a sim time `at` [s] is given, the last sample until then is one of them.
        """
        span = self.ns[-1] - self.ns[0]
        wanted = self.ns[0] + np.round(np.arange(int(span * 1e-9 * rate) + 1) * (1e9 / rate))
        wanted = np.concatenate([np.searchsorted(self.ns, wanted), [len(self.ns) - 1]])
        if at is not None:
            place = np.searchsorted(self.ns, round(1e9 * at), side='right') - 1
            wanted = np.append(wanted, max(place, 0))
        return np.unique(wanted)


def unique_names(names):
    """Return names with a number after those that are there before."""
    return [name if names.index(name) == place else f'{name}_{place}'
            for place, name in enumerate(names)]


def joint_traces(trace, position, velocity, effort):
    """Return the traces of carrier, shaft and what acts on them."""
    return [trace('carrier', ('x', 'y'), lambda part: position[part, :2]),
            trace('shaft', ('theta',), lambda part: position[part, 2:]),
            trace('carrier_velocity', ('x', 'y'), lambda part: velocity[part, :2]),
            trace('shaft_speed', ('theta',), lambda part: velocity[part, 2:]),
            trace('force', ('x', 'y'), lambda part: effort[part, :2]),
            trace('torque', ('torque',), lambda part: effort[part, 2:])]


def span(ns):
    """Return in words how many samples there are and when."""
    return f'{len(ns)} samples, sim time {1e-9 * ns[0]:g} to {1e-9 * ns[-1]:g} s'
