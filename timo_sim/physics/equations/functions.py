# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Declarations of the compiled functions of a formulation, for which each formulation has bodies.

An integrator calls `rate` and `observe` by these names. numba chooses the body by the type of the
constants, for which `@rate.of(Tables)` registers it.
"""

from timo_sim.jit.choices import some
from timo_sim.jit.decorators import dispatch, entry_point, inlined, optional
from timo_sim.physics.equations.sincos import tanh


@dispatch
def rate(tables, state, load, out):
    """
    Write n(y, load), the state's rate less its linear part; loads are included.

    Parameters
    ----------
    tables : packed constants
        The formulation's.
    state, out : ndarray, shape (m,)
    load : ndarray, shape (14,)
        Columns as in `layout`.

    """


@optional
def holds(tables, state, load):
    """Return whether the linear part that belongs to the constants is the one for this state."""
    return True


@dispatch
def observe(tables, state, load, out):
    """Write the motion (see `base.Formulation`) that belongs to a state and a load."""


@inlined
def coulomb(tables, joint, speed):
    """Return the Coulomb friction against a speed of the carrier, joint 0, or of the shaft, 1."""
    friction = 0.0
    if some(tables.coulomb[joint, 0] != 0.0):
        friction = tables.coulomb[joint, 0] * tanh(speed / tables.coulomb[joint, 1])
    return friction


@dispatch
def tip(tables, motion, out):
    """
    Write the position and rotation of the tip in a motion.

    Parameters
    ----------
    tables : packed constants
        The formulation's.
    motion : ndarray
        See `base.Formulation`.
    out : ndarray, shape (3,)
        Along axes I and II from the root [m], rotation relative to the shaft [rad].

    """


@entry_point
def rate_once(tables, state, load, out):
    """Call `rate` from Python."""
    rate(tables, state, load, out)


@entry_point
def tip_once(tables, motion, out):
    """Call `tip` from Python."""
    tip(tables, motion, out)
