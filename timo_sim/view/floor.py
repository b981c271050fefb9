# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The floor that views draw where there is gravity: a line under the carrier, and an arrow."""

from typing import NamedTuple

import numpy as np

_BESIDE = 0.08  # from the carrier's centre to the arrow, and its length, in arm lengths


class Floor(NamedTuple):
    """A line normal to gravity through the underside of the carrier at its first position."""

    place: np.ndarray   # under the carrier, (2,) [m]
    along: np.ndarray   # unit vector, to the right for who stands on the floor, (2,)
    arrow: np.ndarray   # from tail to head, which is on the floor, (2, 2) [m]

    def line(self, bounds):
        """Return the ends of a line that crosses a rectangle with the corners `bounds`, (2, 2)."""
        return self.place + np.linalg.norm(bounds[1] - bounds[0]) * np.array([-1.0, 1.0])[
            :, np.newaxis] * self.along


def floor_of(gravity, carrier, body):
    """Return the Floor under a carrier, (2,) [m], of a `track.Body`; None without gravity."""
    strength = float(np.hypot(*gravity))
    if strength == 0.0:
        return None
    down = np.array(gravity) / strength
    along, place = np.array([-down[1], down[0]]), carrier + 0.5 * body.carrier * down
    head = place - _BESIDE * body.length * along
    return Floor(place, along, np.array([head - _BESIDE * body.length * down, head]))
