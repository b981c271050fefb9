"""A controller in a loop with the simulator, without ROS: what it sees is what the node shows."""

from typing import NamedTuple

import numpy as np

from timo_sim.outputs import outputs, Snapshot
from timo_sim.physics.formulation import FORCE_X, FORCE_Y, LOADS, TORQUE
from timo_sim.simulation import Simulator

PERIOD = 0.002  # of the controller: `sync_period` in slew.yaml [s]
_INPUTS = {'carrier_x': FORCE_X, 'carrier_y': FORCE_Y, 'shaft': TORQUE}


class Seen(NamedTuple):
    """What there is to see at a time; on a real arm the encoder and the strain gauge."""

    encoder: float       # shaft [rad]
    root_strain: float   # of the outer fibre
    joints: tuple        # carrier x, y [m] and shaft [rad]; their rates; efforts as applied
    tip: tuple           # deflection, axial and transverse [m]

    def row(self, t):
        """Return what a record has of it: time, joints (9), tip (2)."""
        return [t, *self.joints, *self.tip]


def in_a_loop(scene, controller, duration=5.0):
    """
    Let a controller command the simulator.

    Parameters
    ----------
    scene : timo_sim.scene.Scene
    controller
        Has a method `effort(t, seen)`: the efforts by joint [N, N m] that answer what is seen at a
        time [s].
    duration : float
        [s].

    Returns
    -------
    ndarray, shape (n, 12)
        A row for each period, see `Seen.row`.

    """
    simulator, held, rows = Simulator(scene), np.zeros(LOADS), []
    topics = {output.name: output.numbers for output in outputs(scene.values['model.modes'])}
    for _ in range(round(duration / PERIOD) + 1):
        snapshot = Snapshot(simulator, simulator.load.tolist())
        seen = Seen(*topics['~/encoder'](snapshot), *topics['~/root_strain'](snapshot),
                    topics['joint_states'](snapshot), topics['~/tip_deflection'](snapshot))
        t = snapshot.nanoseconds / 1e9
        rows.append(seen.row(t))
        for joint, effort in controller.effort(t, seen).items():
            held[_INPUTS[joint]] = effort
        simulator.advance(round(PERIOD / scene.step), held.copy())
    return np.array(rows)
