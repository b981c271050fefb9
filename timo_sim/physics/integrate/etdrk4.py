# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Fourth-order exponential time differencing, ETDRK4.

For `y' = L y + n(y, t)`, with the stiff constant part L propagated exactly. Source: Cox and
Matthews, J. Comput. Phys. 176 (2002) 430-455, eqs. (26)-(29); doc/theory.md (T36).
"""

import numpy as np

from timo_sim.jit.choices import is_lanes
from timo_sim.jit.constants import local
from timo_sim.jit.decorators import entry_point, inlined, inner, strict
from timo_sim.physics.equations.functions import holds, observe, rate
from timo_sim.physics.layout import AFTER, END, LOADS, MIDDLE, START, STEP_LOADS


@inner
def copy(vector, out):
    for i in range(len(vector)):
        out[i] = vector[i]


@inner
def product(matrix, vector, out):
    """Write the product of a matrix, which for lanes is given transposed, and a vector."""
    if is_lanes(out):
        for i in range(len(out)):
            out[i] = 0.0
        _add_columns(matrix, vector, out)
    else:
        for i in range(matrix.shape[0]):
            total = 0.0
            for j in range(matrix.shape[1]):
                total += matrix[i, j] * vector[j]
            out[i] = total


@inner
def add_product(matrix, vector, out):
    """Add what `product` writes."""
    if is_lanes(out):
        _add_columns(matrix, vector, out)
    else:
        for i in range(matrix.shape[0]):
            total = 0.0
            for j in range(matrix.shape[1]):
                total += matrix[i, j] * vector[j]
            out[i] += total


@inner
def _add_columns(turned, vector, out):
    # The sums of lanes stay in registers, and each number of the vector is loaded once.
    for j in range(turned.shape[0]):
        for i in range(turned.shape[1]):
            out[i] += turned[j, i] * vector[j]


@strict
def is_finite(vector):
    for i in range(len(vector)):
        if not np.isfinite(vector[i]):
            return False
    return True


@strict
def check(state, load, loads, propagator):
    """Raise ValueError if a state or loads have other shapes than the compiled step reads."""
    if len(state) != len(propagator.whole) or len(load) != LOADS or (
            loads.shape[1] != STEP_LOADS or loads.shape[2] != LOADS):
        raise ValueError('a step takes a state of its model, a load of shape (14,) and loads of '
                         'shape (steps, 4, 14)')


@inlined
def one_step(tables, propagator, now, start, middle, end, half, following, combined,
             rate_0, rate_a, rate_b, rate_c, stage):
    """Write the state one step after `now` to `stage`, n of the four stages to `rate_*`."""
    rate(tables, now, start, rate_0)
    product(propagator.half, now, half)
    copy(half, stage)
    add_product(propagator.half_weight, rate_0, stage)

    rate(tables, stage, middle, rate_a)
    product(propagator.half, stage, following)
    copy(half, stage)
    add_product(propagator.half_weight, rate_a, stage)

    rate(tables, stage, middle, rate_b)
    for i in range(len(propagator.half)):
        combined[i] = 2.0 * rate_b[i] - rate_0[i]
    add_product(propagator.half_weight, combined, following)

    rate(tables, following, end, rate_c)
    for i in range(len(propagator.half)):
        combined[i] = rate_a[i] + rate_b[i]
    product(propagator.whole, now, stage)
    add_product(propagator.first, rate_0, stage)
    add_product(propagator.middle, combined, stage)
    add_product(propagator.last, rate_c, stage)


@entry_point
def advance(tables, propagator, state, load, loads, sample_every, done, samples, remainder):
    """
    Integrate over some equal steps, as long as the linear part of the tables is valid.

    Parameters
    ----------
    tables : packed constants
        Constants of the formulation; the names of their fields select its functions.
    propagator : packed constants
        The matrices of the step.
    state : ndarray, shape (m,)
        Advanced in place.
    load : ndarray, shape (14,)
        Load at the start, for the first sample.
    loads : ndarray, shape (steps, 4, 14)
        Load of each step at its start, middle and end, as the step itself sees it: of a jump on
        the boundary between two steps each sees its own side, and changes inside a step enter by
        their moments (T37). Then the true load at the end of the step, which samples show.
    sample_every : int
        Steps between samples; 0: none are taken.
    done : int
        Steps since the first sample.
    samples : ndarray, shape (n, 2 (3 + N))
        Receives the motions `sample_every`, 2 `sample_every`, ... steps after the first sample.
    remainder : ndarray, shape (m,)
        Receives n at the start of the last step that was done.

    Returns
    -------
    int
        Steps done; fewer than given if the state is no longer finite, or the linear part is not
        the one for it.

    """
    check(state, load, loads, propagator)
    size = propagator.whole
    now, half, stage, following = local((size,)), local((size,)), local((size,)), local((size,))
    combined = local((size,))
    rate_0, rate_a, rate_b, rate_c = local((size,)), local((size,)), local((size,)), local((size,))
    copy(state, now)
    for k in range(len(loads) + 1):
        # `Steps.motion` comes from here, too: compiled elsewhere it could be rounded differently.
        if sample_every and (done + k) % sample_every == 0:
            observe(tables, now, load, samples[(done + k) // sample_every])
        if k == len(loads):
            break
        start, middle, end = loads[k, START], loads[k, MIDDLE], loads[k, END]
        one_step(tables, propagator, now, start, middle, end, half, following, combined, rate_0,
                 rate_a, rate_b, rate_c, stage)
        if not is_finite(stage):
            copy(now, state)
            return k
        copy(rate_0, remainder)
        copy(stage, now)
        load = loads[k, AFTER]
        if k + 1 < len(loads) and not holds(tables, now, load):
            copy(now, state)
            return k + 1
    copy(now, state)
    return len(loads)
