# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Tracks: what a view shows of a run."""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from timo_sim.scene.parameters import Parameter
from timo_sim.scene.scene import Scene

FPS = Parameter('--fps', 30.0, 'Hz', 'frames', low=0.0, high=1e6, open_low=True)
DEFLECTION_SCALE = Parameter('deflection_scale', 1.0, '', 'drawn deflection over the computed one',
                             low=0.0, high=1e9, open_low=True)


class Body(NamedTuple):
    """Sizes of what is drawn [m]; a cube, cylinder and ball with their masses in arm material."""

    length: float       # from the shaft's axis to the tip of the straight arm
    thickness: float
    carrier: float
    motor: float
    end_effector: float


class Track:
    """
    A Run as views show it: with a name, and a multiple of its deflection in the plane.

    `ns` are the sim times of its n samples, not descending [ns]; `body` has the sizes of what is
    drawn. `title` states `deflection_scale` if it is not 1; one that is not above 0 and at most
    1e9 is a ParameterError.
    """

    def __init__(self, run: Any, name: str = 'run', deflection_scale: float = 1.0) -> None:
        self._run, self.name = run, name
        self._scale = DEFLECTION_SCALE.check(deflection_scale)
        self.ns = np.rint(run.t * 1e9).astype(np.int64)
        self.body = body_of(run.scene)
        self.title = '' if self._scale == 1.0 else f'deflection x {self._scale:g}'

    def line(self, samples: np.ndarray | slice) -> np.ndarray:
        """Return the line from the shaft's axis to the tip at m samples, (m, p, 2) [m]."""
        return self._run.model.shape(self._run.values[samples], self._scale)

    def straight(self, samples: np.ndarray | slice) -> np.ndarray:
        """Return the ends of this line if the arm did not bend, (m, 2, 2) [m]."""
        return self._run.model.shape(self._run.values[samples], 0.0)[:, [0, -1]]

    @cached_property
    def curves(self) -> dict[str, dict[str, np.ndarray]]:
        """By panel and name, (n,); the deflection is the computed one."""
        run = self._run
        bend, effort = run.deflection(), run.effort
        panels = {
            'tip_deflection': {'w': bend[:, 1]},
            'tip_axial': {'u': bend[:, 0]},
            'tip_rotation': {'phi': run.rotation()},
            'carrier': dict(zip('xy', run.carrier.T)),
            'shaft': {'theta': run.shaft},
            'carrier_velocity': dict(zip('xy', run.carrier_velocity.T)),
            'shaft_speed': {'theta': run.shaft_velocity},
            'force': dict(zip('xy', effort.T)),
            'torque': {'torque': effort[:, 2]},
            'energy': {'energy': run.energy()},
            'modal': {f'q{n}': values for n, values in enumerate(run.q.T, 1)}}
        return {panel: curves for panel, curves in panels.items() if curves}

    def frames(self, rate: float, at: float | None = None) -> np.ndarray:
        """Return ascending samples, at most `rate` per second, and the last until `at` [s]."""
        span = self.ns[-1] - self.ns[0]
        wanted = self.ns[0] + np.round(np.arange(int(span * 1e-9 * rate) + 1) * (1e9 / rate))
        places = [*np.searchsorted(self.ns, wanted), len(self.ns) - 1]
        if at is not None:
            places.append(max(np.searchsorted(self.ns, round(1e9 * at), side='right') - 1, 0))
        return np.unique(places)


def body_of(scene: Scene) -> Body:
    """Return the sizes of what is drawn of a scene."""
    arm, body = scene.manipulator.arm, scene.manipulator
    density = np.max(arm.section.density)

    def size(mass, shape):  # visible and not in the way, whatever the mass
        return float(np.clip((mass / density / shape)**(1 / 3), 0.02 * arm.length,
                             0.1 * arm.length))

    return Body(body.hub_radius + arm.length, float(np.max(arm.section.height)),
                size(body.carrier_mass, 1.0), size(body.motor_mass, np.pi / 4),
                size(body.end_effector_mass, np.pi / 6))
