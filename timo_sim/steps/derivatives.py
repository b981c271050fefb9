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

from timo_sim.compiled.constants import local_arrays, pack
from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import Array, as_vectors, Constants, inner
from timo_sim.model import exact_derivatives  # noqa: F401  bodies of the functions below
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


class Changes(NamedTuple):
    """Work arrays: changes of states and rates by those of the motion and by the inputs."""

    stage: Annotated[np.ndarray, 'padded_state']              # a state at which rates are taken
    by_state: Annotated[np.ndarray, 'state', 'padded_state']  # J there, transposed
    by_input: Annotated[np.ndarray, 'inputs', 'padded_state']  # b there
    none: Annotated[np.ndarray, 'inputs', 'padded_state']     # zeros
    changes: Annotated[np.ndarray, 'rows', 'padded_state']    # of the state
    at_a: Annotated[np.ndarray, 'rows', 'padded_state']       # of the stages, see `etdrk4.Work`
    middle: Annotated[np.ndarray, 'rows', 'padded_state']
    end: Annotated[np.ndarray, 'rows', 'padded_state']
    rate_0: Annotated[np.ndarray, 'rows', 'padded_state']
    rate_a: Annotated[np.ndarray, 'rows', 'padded_state']
    rate_b: Annotated[np.ndarray, 'rows', 'padded_state']
    rate_c: Annotated[np.ndarray, 'rows', 'padded_state']


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
    work, here = local_arrays(Work, propagator), local_arrays(Changes, propagator)
    stage, by_state, by_input, none = here.stage, here.by_state, here.by_input, here.none
    changes, middle, end = here.changes, here.middle, here.end
    rate_0, rate_a, rate_b, rate_c = here.rate_0, here.rate_a, here.rate_b, here.rate_c
    _set_zero(none)
    _set_zero(changes)
    state_by_motion(tables, state, load, changes)
    copy(state, work.now)
    for n in range(count):
        load_0, load_ab, load_c = loads[n, START], loads[n, MIDDLE], loads[n, END]
        one_step(tables, propagator, load_0, load_ab, load_c, work)

        jacobian(tables, work.now, load_0, inputs, by_state, by_input)
        _set_products(by_state, changes, by_input, rate_0)
        _set_products(propagator.half, changes, none, middle)

        # The step has not kept its stages a and b: they are made again.
        copy(work.half, stage)
        add_product(propagator.half_weight, work.rate_0, stage)
        jacobian(tables, stage, load_ab, inputs, by_state, by_input)
        _copy_changes(middle, here.at_a)
        _add_products(propagator.half_weight, rate_0, here.at_a)
        _set_products(by_state, here.at_a, by_input, rate_a)

        copy(work.half, stage)
        add_product(propagator.half_weight, work.rate_a, stage)
        jacobian(tables, stage, load_ab, inputs, by_state, by_input)
        _add_products(propagator.half_weight, rate_a, middle)
        _set_products(by_state, middle, by_input, rate_b)

        jacobian(tables, work.third, load_c, inputs, by_state, by_input)
        _set_products(propagator.half, here.at_a, none, end)
        _set_sum(2.0, rate_b, -1.0, rate_0, middle)
        _add_products(propagator.half_weight, middle, end)
        _set_products(by_state, end, by_input, rate_c)

        _set_products(propagator.whole, changes, none, end)
        _add_products(propagator.start_weight, rate_0, end)
        _set_sum(1.0, rate_a, 1.0, rate_b, rate_a)
        _add_products(propagator.middle_weight, rate_a, end)
        _add_products(propagator.end_weight, rate_c, end)
        _copy_changes(end, changes)
        copy(work.following, work.now)
        load = loads[n, AFTER]
    motion_by_state(tables, work.now, load, changes, out)
