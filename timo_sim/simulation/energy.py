# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Integrals of power between samples of a motion."""

from __future__ import annotations

import numpy as np


def work(ns: np.ndarray, position: np.ndarray, velocity: np.ndarray, force: np.ndarray,
         jumps: np.ndarray | bool = False) -> np.ndarray:
    """
    Return the work done from each sample to the next.

    Simpson's rule on cubics through neighbouring samples; exact for constant forces. From a jump
    on, the force is the straight line through the next two samples, or the next sample's if the
    force jumps there, too. `ns`, (n,), are times [ns]; `position`, `velocity` and `force` have the
    shape (n, k). `jumps`, (n, 1) or (n, k), says where the force jumps at a sample, whose own
    force is that before the jump. The result has the shape (n - 1,) [J].
    """
    duration = np.diff(ns)[:, np.newaxis] * 1e-9
    still = duration == 0.0
    span = np.where(still, 1.0, duration)
    jumps = np.broadcast_to(jumps, force.shape)
    ends = np.vstack([jumps[1:-1], np.ones_like(jumps[:1])])  # whether a piece ends with a span
    onward = np.vstack([np.diff(force[1:], axis=0) / span[1:], np.zeros_like(force[:1])])
    start = np.where(jumps[:-1], force[1:] - np.where(ends, 0.0, span * onward), force[:-1])
    slope = (force[1:] - start) / span
    # Slopes of the force at the ends of each span, where it is smooth from both sides.
    mean = 0.5 * (slope[1:] + slope[:-1])
    last = np.where(ends, slope, np.vstack([mean, slope[-1:]]))
    first = np.where(np.vstack([np.ones_like(jumps[:1]), jumps[1:-1]]), slope,
                     np.vstack([slope[:1], mean]))
    middle = 0.5 * (force[1:] + start) - span * (last - first) / 8.0
    pace = 1.5 * np.diff(position, axis=0) / span - 0.25 * (velocity[1:] + velocity[:-1])
    power = force[1:] * velocity[1:] + 4.0 * middle * pace + start * velocity[:-1]
    return np.sum(np.where(still, 0.0, span * power / 6.0), axis=1)


def integral(ns: np.ndarray, power: np.ndarray) -> np.ndarray:
    """
    Return the integral of a power, (n,) [W], from each sample to the next, (n - 1,) [J].

    The trapezoidal rule is corrected by the slopes at both ends, which gives fourth order for
    equally spaced samples. `ns`, (n,), are their times [ns].
    """
    duration = np.diff(ns) * 1e-9
    done = 0.5 * duration * (power[1:] + power[:-1])
    if len(ns) > 2 and duration.all():
        slope = np.gradient(power, np.asarray(ns) * 1e-9, edge_order=2)
        done -= duration**2 / 12.0 * np.diff(slope)
    return done
