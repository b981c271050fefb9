# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The work of loads between samples, what the balance of energy of a run lacks, and inertia."""

import numpy as np

from timo_sim.scene.loads import Table


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


def balance(run):
    """
    Return the energy of a `Run` less its first, less the work of its loads, plus losses, (n,) [J].

    Loads act on the carrier, and on the shaft unless that is driven. The error is of fourth order
    in the samples' distance, and up to half a sample's work where a load jumps between two.
    """
    ns, model, half = np.rint(run.t * 1e9), run.model, run.values.shape[1] // 2
    steps = np.rint(run.t / run.scene.step)
    jumps = np.rint([time / run.scene.step for terms in run.scene.load.terms.values()
                     for term in terms if isinstance(term, Table) for time in term.jumps()])
    position, velocity = (run.values[:, part] @ model.joint_turns[:, :3]
                          for part in (slice(half), slice(half, None)))
    done = work(ns, position, velocity, run.effort, np.isin(steps, jumps)[:, np.newaxis])
    energy = run.energy() + run.friction_heat + run.dissipated()
    return energy - energy[0] - np.append(0.0, np.cumsum(done))


def inertia_of(scene):
    """Return the moment of inertia of shaft and arm about the shaft, at the start [kg m2]."""
    return scene.build().mass_matrix(scene.initial_motion())[0][2, 2]
