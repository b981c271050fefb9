# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Other integrators for the equations of this package: peers of its own in the benchmarks."""

import bisect
import ctypes
import math
from typing import Any, NamedTuple

import numba
import numpy as np
from scipy.integrate import solve_ivp

from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import Array, Constants
from timo_sim.model.functions import observe, rate_once
from timo_sim.model.layout import ACCELERATION, ANGLE, LOADS, SPEED
from timo_sim.scene.loads import CHANNELS, Harmonic
from timo_sim.steps.steps import Steps

TOLERANCE, ITERATIONS = 1e-12, 50  # of the implicit methods, relative
SPECTRAL_RADIUS = 0.9              # of generalized-alpha


@entry_point(tables=Constants(), state=Array(('state',)), load=Array((LOADS,)),
             out=Array(('motion',)))
def observe_once(tables, state, load, out):
    """Call `observe` from Python."""
    observe(tables, state, load, out)


class System(NamedTuple):
    """A model as numba's functions see it: machine code, which takes addresses of arrays."""

    rate: Any     # ctypes function
    observe: Any  # ctypes function
    tables: int   # address of the constants of both
    linear: np.ndarray  # transposed: products run over its rows


def system_of(model):
    """Return the System of a formulation; its tables live as long as the formulation."""
    kind = ctypes.CFUNCTYPE(ctypes.c_int64, *4 * [ctypes.c_void_p])
    rate, observed = (ctypes.cast(entry.of(model.packed)._code, kind)
                      for entry in (rate_once, observe_once))
    return System(rate, observed, model.packed.memory.ctypes.data,
                  np.ascontiguousarray(model.linear.T))


# Arrays whose addresses are taken are arguments, which live until the function returns.

@numba.njit
def _nonlinear(system, state, load, out):
    system.rate(system.tables, state.ctypes.data, load.ctypes.data, out.ctypes.data)


@numba.njit
def _full(system, state, load, out):
    _nonlinear(system, state, load, out)
    _add_product(system.linear, state, out)


@numba.njit
def _add_product(transposed, vector, out):
    # Of a small matrix, in less time than a call of BLAS.
    for j in range(len(vector)):
        for i in range(len(out)):
            out[i] += transposed[j, i] * vector[j]


@numba.njit
def _move(state, step, rate, out):
    for i in range(len(out)):
        out[i] = state[i] + step * rate[i]


@numba.njit
def _record(system, state, load, k, every, samples):
    """Sample the motion after step k where that is due; return whether the state is finite."""
    if not np.all(np.isfinite(state)):
        return False
    if (k + 1) % every == 0:
        system.observe(system.tables, state.ctypes.data, load.ctypes.data,
                       samples[(k + 1) // every - 1].ctypes.data)
    return True


@numba.njit
def rk4(system, state, loads, step, every, samples):
    """Integrate by the classical Runge-Kutta method; return the steps done."""
    stage, k1, k2, k3, k4 = np.zeros((5, len(state)))
    for k in range(len(loads)):
        _full(system, state, loads[k, 0], k1)
        _move(state, 0.5 * step, k1, stage)
        _full(system, stage, loads[k, 1], k2)
        _move(state, 0.5 * step, k2, stage)
        _full(system, stage, loads[k, 1], k3)
        _move(state, step, k3, stage)
        _full(system, stage, loads[k, 2], k4)
        for i in range(len(state)):
            state[i] += step / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
        if not _record(system, state, loads[k, 2], k, every, samples):
            return k
    return len(loads)


@numba.njit
def implicit_midpoint(system, state, loads, step, every, samples):
    """Integrate by the implicit midpoint rule, linear part implicit; return the steps done."""
    inverse = np.linalg.inv(np.eye(len(state)) - 0.5 * step * system.linear)
    middle = state.copy()
    nonlinear, right, following = np.zeros((3, len(state)))
    for k in range(len(loads)):
        for _ in range(ITERATIONS):
            _nonlinear(system, middle, loads[k, 1], nonlinear)
            _move(state, 0.5 * step, nonlinear, right)
            following[:] = 0.0
            _add_product(inverse, right, following)
            change = np.abs(following - middle).max()
            middle[:] = following
            if not change > TOLERANCE * np.abs(middle).max():
                break
        state[:] = 2.0 * middle - state
        if not _record(system, state, loads[k, 2], k, every, samples):
            return k
    return len(loads)


@numba.njit
def generalized_alpha(system, state, loads, step, every, samples):
    """
    Integrate by generalized-alpha for first-order systems; return the steps done.

    Source: Jansen, Whiting and Hulbert, Comput. Methods Appl. Mech. Eng. 190 (2000) 305-319.
    """
    alpha_m = 0.5 * (3.0 - SPECTRAL_RADIUS) / (1.0 + SPECTRAL_RADIUS)
    alpha_f = 1.0 / (1.0 + SPECTRAL_RADIUS)
    gamma = 0.5 + alpha_m - alpha_f
    linear = system.linear
    inverse = np.linalg.inv(alpha_m * np.eye(len(state)) - alpha_f * gamma * step * linear)
    old, new, nonlinear, following = np.zeros((4, len(state)))
    for k in range(len(loads)):
        if k == 0 or np.any(loads[k, 0] != loads[k - 1, 2]):
            _full(system, state, loads[k, 0], old)
        # The parabola through the three values of the load.
        s = alpha_f
        load = ((1.0 - s) * (1.0 - 2.0 * s) * loads[k, 0] + 4.0 * s * (1.0 - s) * loads[k, 1]
                + s * (2.0 * s - 1.0) * loads[k, 2])
        base = state + alpha_f * step * (1.0 - gamma) * old
        known = (alpha_m - 1.0) * old
        _add_product(linear, base, known)
        new[:] = old
        for _ in range(ITERATIONS):
            _nonlinear(system, base + alpha_f * gamma * step * new, load, nonlinear)
            following[:] = 0.0
            _add_product(inverse, known + nonlinear, following)
            change = np.abs(following - new).max()
            new[:] = following
            if not change > TOLERANCE * np.abs(new).max():
                break
        state += step * ((1.0 - gamma) * old + gamma * new)
        old[:] = new
        if not _record(system, state, loads[k, 2], k, every, samples):
            return k
    return len(loads)


FIXED_STEP = {'RK4': rk4, 'implicit midpoint': implicit_midpoint,
              'generalized-alpha': generalized_alpha}


def is_constant(table):
    """Return whether a Table is constant but for its jumps."""
    return table.time[::2] == table.time[1::2] and table.value[1:-1:2] == table.value[2::2]


def load_function(scene, drive=None):
    """
    Return the load of a scene at any time, shape (LOADS,), and the times at which it jumps.

    Parameters
    ----------
    scene : Scene
        With harmonic and piecewise terms only.
    drive : tuple of function(float) -> float, optional
        theta(t) and its derivatives.

    """
    terms = [(column, term) for channel, column in CHANNELS.items()
             for term in scene.load.terms[channel]]
    if not all(isinstance(term, Harmonic) or is_constant(term) for _, term in terms):
        raise ValueError('only harmonic and piecewise loads are known at any time')
    jumps = sorted({jump for _, term in terms if not isinstance(term, Harmonic)
                    for jump in term.jumps()})

    def load(t):
        values = np.zeros(LOADS)
        for column, term in terms:
            if isinstance(term, Harmonic):
                values[column] += term.amplitude * math.sin(
                    2.0 * math.pi * term.frequency * t + term.phase)
            else:
                values[column] += (0.0, *term.value)[bisect.bisect_right(term.time, t)]
        if drive is not None:
            values[[ANGLE, SPEED, ACCELERATION]] = [part(t) for part in drive]
        return values
    return load, jumps


def adaptive(method, model, start, load, jumps, times, tolerance):
    """
    Integrate by a method of `scipy.integrate.solve_ivp`, anew after each jump of the load.

    Returns
    -------
    ndarray, shape (len(times) - 1, 2 (3 + N))
        Motions after the first time.

    """
    motion_of = Steps(model, times[1] - times[0]).motion  # independent of the step
    state, motions = model.state(start), []
    edges = [times[0], *(jump for jump in jumps if times[0] < jump < times[-1]), times[-1]]
    for begin, end in zip(edges, edges[1:]):
        inside = times[(times > begin + 1e-9) & (times <= end + 1e-9)]
        # A stage at the end of a piece uses the load of that piece.
        solution = solve_ivp(
            lambda t, y: model.rate(np.ascontiguousarray(y), load(min(t, end - 1e-9))),
            (begin, end), state, method, np.append(inside[inside < end - 1e-9], end),
            rtol=tolerance, atol=1e-3 * tolerance)
        if not solution.success:
            raise ArithmeticError(solution.message)
        motions += [motion_of(np.ascontiguousarray(y), load(t))
                    for t, y in zip(inside, solution.y.T)]
        state = np.ascontiguousarray(solution.y[:, -1])
    return np.array(motions)


def fixed_step(method, model, start, loads, step, every, compiled=True):
    """
    Integrate by one of `FIXED_STEP`; return motions, or None if the state diverges.

    Of a method that is not `compiled`, which takes seconds, only the functions that it calls are.
    """
    state, integrate = model.state(start), FIXED_STEP[method]
    samples = np.empty((len(loads) // every, model.size))
    integrate = integrate if compiled else integrate.py_func
    done = integrate(system_of(model), state, loads, step, every, samples)
    return samples if done == len(loads) else None
