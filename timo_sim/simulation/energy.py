# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Where energy goes between samples of a motion: work of forces, and what friction takes."""

import numpy as np


def work(ns, position, velocity, force):
    """
    Return the work done from each sample to the next.

    Simpson's rule on cubics through neighbouring samples; exact for constant forces.

    Parameters
    ----------
    ns : ndarray, shape (n,)
        [ns]
    position, velocity, force : ndarray, shape (n, k)

    Returns
    -------
    ndarray, shape (n - 1,)
        [J]

    """
    if len(ns) < 3:
        return np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(position, axis=0), axis=1)
    duration = np.diff(ns)[:, np.newaxis] * 1e-9
    still = duration == 0.0
    span = np.where(still, 1.0, duration)
    slope = np.diff(force, axis=0) / span
    # Slope of the force at the samples, from both sides.
    slopes = 0.5 * (np.vstack([slope[:1], slope]) + np.vstack([slope, slope[-1:]]))
    middle = 0.5 * (force[1:] + force[:-1]) - span * np.diff(slopes, axis=0) / 8.0
    pace = 1.5 * np.diff(position, axis=0) / span - 0.25 * (velocity[1:] + velocity[:-1])
    power = force[1:] * velocity[1:] + 4.0 * middle * pace + force[:-1] * velocity[:-1]
    return np.sum(np.where(still, 0.0, span * power / 6.0), axis=1)


def integral(ns, power):
    """
    Return the integral of a power from each sample to the next.

    The trapezoidal rule with the slopes at its ends, of fourth order for even samples.

    Parameters
    ----------
    ns : ndarray, shape (n,)
        [ns]
    power : ndarray, shape (n,)
        [W]

    Returns
    -------
    ndarray, shape (n - 1,)
        [J]

    """
    duration = np.diff(ns) * 1e-9
    done = 0.5 * duration * (power[1:] + power[:-1])
    if len(ns) > 2 and duration.all():
        slope = np.gradient(power, np.asarray(ns) * 1e-9, edge_order=2)
        done -= duration**2 / 12.0 * np.diff(slope)
    return done
