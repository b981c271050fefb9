# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Derivatives of steps: of the motion after them by the motion before them and by loads."""

from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.constants import pack
from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import Array, as_vectors, Constants, inner, local
from timo_sim.model.functions import jacobian, motion_by_state, state_by_motion
from timo_sim.model.layout import AFTER, END, LOADS, MIDDLE, START, STEP_LOADS
from timo_sim.steps.etdrk4 import add_product, copy, one_step, Work
from timo_sim.steps.steps import Steps


def step_derivatives(steps: Steps, state: np.ndarray, load: np.ndarray, loads: np.ndarray,
                     unit: np.ndarray) -> np.ndarray:
    """
    Return the derivatives of the motion after some steps.

    Parameters
    ----------
    steps : Steps
        Of a model without sectors whose state has momenta alone.
    state, load, loads
        As in `Steps.advance`; the state stays.
    unit : ndarray, shape (k, LOADS)
        What one of each input adds to all loads.

    Returns
    -------
    ndarray, shape (2 (3 + N), 2 (3 + N) + k)
        Columns: by the motion before the steps, then by the inputs.

    """
    rows, part = steps.model.size + len(unit), steps.part(None)
    out = np.empty((rows, steps.model.size))
    inputs = pack(Inputs(unit, np.zeros(rows)))
    differentiate.of(*part.constants, inputs)(state, load, loads, len(loads), out)
    return out.T


class Inputs(NamedTuple):
    """The loads by which steps are differentiated; each acts during all of them."""

    unit: Annotated[np.ndarray, 'inputs', LOADS]  # a load of 1 for each
    rows: Annotated[np.ndarray, 'rows']  # its length is that of motion and inputs together


# Changes of states and rates are rows: by each number of the first motion, then by each input.

@inner
def _set_zero(out):
    changes = as_vectors(out)
    for k in range(len(changes)):
        for i in range(changes.shape[1]):
            changes[k, i] = 0.0


@inner
def _copy_changes(source, out):
    sources, changes = as_vectors(source), as_vectors(out)
    for k in range(len(changes)):
        for i in range(changes.shape[1]):
            changes[k, i] = sources[k, i]


@inner
def _set_products(turned, changes, by_input, out):
    """Write the products of a matrix, which is given transposed, and changes; add by_input."""
    results, inputs = as_vectors(out), as_vectors(by_input)
    first = len(results) - len(inputs)
    for k in range(len(results)):
        for i in range(results.shape[1]):
            results[k, i] = inputs[k - first, i] if k >= first else 0.0
    _add_products(turned, changes, out)


@inner
def _add_products(turned, changes, out):
    """Add the products of a matrix, which is given transposed, and changes."""
    for k in range(len(changes)):
        add_product(turned, changes[k], out[k])


@inner
def _set_sum(factor, left, other_factor, right, out):
    lefts, rights, sums = as_vectors(left), as_vectors(right), as_vectors(out)
    for k in range(len(sums)):
        for i in range(sums.shape[1]):
            sums[k, i] = factor * lefts[k, i] + other_factor * rights[k, i]


@entry_point(tables=Constants(), propagator=Constants(), inputs=Constants(),
             state=Array(('state',)), load=Array((LOADS,)), loads=Array((None, STEP_LOADS, LOADS)),
             count=int, out=Array(('rows', 'motion')))
def differentiate(tables, propagator, inputs, state, load, loads, count, out):
    """
    Write the derivatives of the motion after some steps, each through its stages; the state stays.

    Each row is what a unit of a number of the motion before the steps or, in the last rows, of an
    input changes. To first order a change does a step of `y' = L y + J y + b`, with the
    derivatives J and b of each stage, doc/theory.md, section 7.

    Parameters
    ----------
    tables, propagator, inputs : packed constants
    state, load, loads, count
        As in `etdrk4.advance`.
    out : ndarray, shape (2 (3 + N) + inputs, 2 (3 + N))

    """
    states, unit, padded = propagator.whole, inputs.unit, propagator.whole[0]
    work = Work(local((padded,)), local((padded,)), local((padded,)), local((padded,)),
                local((padded,)), local((padded,)), local((padded,)))
    now, stage, following = local((padded,)), local((padded,)), local((padded,))
    by_state, by_input = local((states, padded)), local((unit, padded))
    none = local((unit, padded))
    rows = inputs.rows
    changes, at_middle, at_stage, at_end = (
        local((rows, padded)), local((rows, padded)), local((rows, padded)), local((rows, padded)))
    rate_0, rate_a, rate_b, rate_c = (
        local((rows, padded)), local((rows, padded)), local((rows, padded)), local((rows, padded)))
    _set_zero(none)
    _set_zero(changes)
    state_by_motion(tables, state, load, changes)
    copy(state, now)
    for n in range(count):
        start, middle, end = loads[n, START], loads[n, MIDDLE], loads[n, END]
        one_step(tables, propagator, now, start, middle, end, work, following)

        jacobian(tables, now, start, inputs, by_state, by_input)
        _set_products(by_state, changes, by_input, rate_0)
        _set_products(propagator.half, changes, none, at_middle)

        # The step has not kept its stages a and b: they are made again.
        copy(work.half, stage)
        add_product(propagator.half_weight, work.rate_0, stage)
        jacobian(tables, stage, middle, inputs, by_state, by_input)
        _copy_changes(at_middle, at_stage)
        _add_products(propagator.half_weight, rate_0, at_stage)
        _set_products(by_state, at_stage, by_input, rate_a)
        _set_products(propagator.half, at_stage, none, at_end)

        copy(work.half, stage)
        add_product(propagator.half_weight, work.rate_a, stage)
        jacobian(tables, stage, middle, inputs, by_state, by_input)
        _add_products(propagator.half_weight, rate_a, at_middle)
        _set_products(by_state, at_middle, by_input, rate_b)

        jacobian(tables, work.third, end, inputs, by_state, by_input)
        _set_sum(2.0, rate_b, -1.0, rate_0, at_stage)
        _add_products(propagator.half_weight, at_stage, at_end)
        _set_products(by_state, at_end, by_input, rate_c)

        _set_products(propagator.whole, changes, none, at_end)
        _add_products(propagator.start_weight, rate_0, at_end)
        _set_sum(1.0, rate_a, 1.0, rate_b, rate_a)
        _add_products(propagator.middle_weight, rate_a, at_end)
        _add_products(propagator.end_weight, rate_c, at_end)
        _copy_changes(at_end, changes)
        copy(following, now)
        load = loads[n, AFTER]
    motion_by_state(tables, now, load, changes, out)
