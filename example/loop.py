# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A controller in a loop with the simulator, without ROS; it sees what the node publishes."""

from typing import NamedTuple

import numpy as np
import timo_sim

PERIOD = 0.002  # of the controller: `sync_period` in slew.yaml [s]


class Seen(NamedTuple):
    """What a controller may see at a time; a real arm only has encoder and strain gauge."""

    encoder: float       # shaft [rad]
    root_strain: float   # of the outer fibre
    joints: tuple        # carrier x, y [m] and shaft [rad]; their rates; efforts [N], [N m]
    tip: tuple           # deflection, axial and transverse [m]

    def row(self, t):
        """Return a row of a record: time, joints (9), tip (2)."""
        return [t, *self.joints, *self.tip]


def look(simulator):
    """Return what a controller may see of a simulator now."""
    motion, sensors = simulator.motion, simulator.sensors
    joints = (*motion.carrier, motion.shaft, *motion.carrier_velocity, motion.shaft_velocity)
    return Seen(sensors.encoder, sensors.root_strain, (*joints, *simulator.effort),
                simulator.deflection())


def command(simulator, carrier_x=0.0, carrier_y=0.0, shaft=0.0):
    """Hold efforts [N, N m] for a period."""
    simulator.step(force=(carrier_x, carrier_y), torque=shaft, duration=PERIOD)


def in_a_loop(scene, controller, duration=5.0):
    """
    Let a controller command the simulator.

    Parameters
    ----------
    scene : timo_sim.Scene
    controller
        Its method `effort(t, seen)` returns efforts by joint [N, N m] for what it sees at a time
        [s].
    duration : float
        [s].

    Returns
    -------
    ndarray, shape (n, 12)
        A row for each period, see `Seen.row`.

    """
    simulator, held, rows = timo_sim.Simulator(scene), {}, []
    for _ in range(round(duration / PERIOD) + 1):
        seen, t = look(simulator), simulator.nanoseconds / 1e9  # as in the stamps of the node
        rows.append(seen.row(t))
        held |= controller.effort(t, seen)
        command(simulator, **held)
    return np.array(rows)
