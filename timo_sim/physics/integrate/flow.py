# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Motions just before and after states, for differences along the flow of the equations."""

import numpy as np

from timo_sim.physics.layout import ACCELERATION, ANGLE, SPEED

_TURN = 1e-5  # largest turn of a section between a motion and those of `flow` [rad]


def flow(model, state, rate, load, observe):
    """
    Return motions just before and after states, and half the time between them.

    States and drives are extrapolated linearly over that time.

    Parameters
    ----------
    model : Formulation
        Or what `stacked` makes of many.
    state, rate, load : ndarray, shapes (..., k, m), (..., k, m), (..., k, 14)
    observe : function(ndarray, ndarray) -> ndarray
        Takes states and loads, and returns the motions, (..., k, 2 (3 + N)).

    Returns
    -------
    before, after : ndarray, shape (..., k, 2 (3 + N))
    half_time : ndarray, shape (..., k)
        [s]

    """
    drift, half = np.zeros_like(load), model.size // 2
    drift[..., ANGLE], drift[..., SPEED] = load[..., SPEED], load[..., ACCELERATION]
    speed = observe(state, load)[..., half + 2:]
    turning = np.abs(speed[..., :1] + speed[..., 1:] @ model.points.rotation).max(axis=-1)
    shift = _TURN / (_TURN + turning)
    by_rate, by_drift = shift[..., np.newaxis] * rate, shift[..., np.newaxis] * drift
    return (observe(state - by_rate, load - by_drift), observe(state + by_rate, load + by_drift),
            shift)
