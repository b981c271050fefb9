# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Observed arms whose first motion and disturbance are drawn from what their observer expects."""

import numpy as np

import timo_sim


def observe(scene, seed, disturbance, period, updates):
    """
    Yield Observer, Simulator and the torque that disturbs its shaft [N m], after each update.

    `disturbance` is (deviation [N m], correlation time [s]), and `period` is that of updates [s].
    The observer is told the sensors and a sine of torque; the first update is at the start.
    """
    random, (size, time) = np.random.default_rng(seed), disturbance
    observer = timo_sim.observer(scene, disturbance={'torque': disturbance})
    arm = timo_sim.Simulator(scene.vary({'sensor.seed': seed}))
    places = arm.model.free_places
    first, count = arm.motion.values, len(places)
    first[places] = random.multivariate_normal(
        first[places], observer.covariance[:count, :count])
    arm.set_motion(first)
    acting, fade = size * random.standard_normal(), np.exp(-period / time)
    for k in range(updates + 1):
        torque = 5.0 * np.sin(6.0 * k * period)
        if k:
            acting = fade * acting + size * np.sqrt(1.0 - fade**2) * random.standard_normal()
            arm.step(torque=torque + acting, duration=period)
        seen = arm.sensors
        observer.update({name: getattr(seen, name) for name in observer.sensors},
                        {'torque': torque}, period if k else 0.0)
        yield observer, arm, acting
