# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Energy balance between samples of a motion: work of forces, and dissipated energy."""

from __future__ import annotations

import numpy as np

from timo_sim.scene.scene import Scene
from timo_sim.simulation.simulator import Simulator
from timo_sim.simulation.warnings import DivergenceError
from timo_sim.steps.steps import CHUNK

_MAX_DIFFERENCE = 1e-3  # relative, of integrals by all and by every second sample


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


def dissipated(scene: Scene, t: np.ndarray, motions: np.ndarray) -> tuple[np.ndarray, bool]:
    """
    Return what friction that is not dry, and modal damping, dissipate since the first sample.

    If samples are some steps apart, the run is repeated and its power integrated over each step.
    If the repeated motions differ, because commands acted, the given samples are integrated. `t`
    has the shape (n,) [s], `motions` (n, 2 (3 + N)). The result is the energy, (n,) [J], and
    whether the samples are too far apart for a reliable integral.
    """
    power, steps = scene.build().dissipation(motions), np.rint(t / scene.step).astype(int)
    every = steps[1] if len(t) > 1 else 1
    if every > 1 and power.any() and np.array_equal(steps, every * np.arange(len(t))):
        found = _power_of_steps(scene, every, motions)
        if found is not None:
            return _since_start(1e9 * scene.step * np.arange(len(found)), found)[::every], False
    ns = np.rint(t * 1e9)
    taken, coarse = _since_start(ns, power), _since_start(ns[::2], power[::2])
    doubt = np.diff(steps).max(initial=1) > 1 and (
        np.abs(taken[::2] - coarse).max() > _MAX_DIFFERENCE * taken.max())
    return taken, doubt


def _since_start(ns, power):
    return np.append(0.0, np.cumsum(integral(ns, power)))


def _power_of_steps(scene, every, motions):
    # Power at the start and after each step [W], or None if a repeated run differs from `motions`.
    simulator, last = Simulator(scene), every * (len(motions) - 1)
    simulator.warm_up()
    power = np.empty(last + 1)
    for k in range(0, last, CHUNK):
        count = min(CHUNK, last - k)
        try:
            again = simulator.advance(count, sample_every=1)[0]
        except DivergenceError:
            return None
        power[k:k + count + 1] = simulator.model.dissipation(again)
        if not np.array_equal(again[-k % every::every],
                              motions[-(-k // every):(k + count) // every + 1]):
            return None
    return power
