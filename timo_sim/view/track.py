# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Tracks: what a view shows of a run, made of a `Run` or of a log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from timo_sim.scene.parameters import Parameter
from timo_sim.scene.scene import Scene

FPS = Parameter('--fps', 30.0, 'Hz', 'frames', low=0.0, high=1e6, open_low=True)
DEFLECTION_SCALE = Parameter('deflection_scale', 1.0, '', 'drawn deflection over the computed one',
                             low=0.0, high=1e9, open_low=True)
_BLOCK = 1024    # samples that are computed at once: their arrays stay in the processor's cache
_BESIDE = 0.08   # from the carrier to the arrow of gravity, and its length, in arm lengths


class Body(NamedTuple):
    """Sizes of what is drawn [m]; a cube, cylinder and ball with their masses in arm material."""

    length: float       # from the shaft's axis to the tip of the straight arm
    thickness: float
    carrier: float
    motor: float
    end_effector: float


class Poses(NamedTuple):
    """Places at m times, in world axes."""

    line: np.ndarray    # from the shaft's axis to the tip, (m, p, 2) [m]
    shaft: np.ndarray   # (m,) [rad]


class Floor(NamedTuple):
    """A line normal to gravity through the underside of the carrier at its first position."""

    place: np.ndarray   # under the carrier, (2,) [m]
    along: np.ndarray   # unit vector, to the right for who stands on the floor, (2,)
    arrow: np.ndarray   # from tail to head, which is on the floor, (2, 2) [m]

    def line(self, bounds: np.ndarray) -> np.ndarray:
        """Return the ends of a line that crosses a rectangle with the corners `bounds`, (2, 2)."""
        return self.place + np.linalg.norm(bounds[1] - bounds[0]) * np.array([-1.0, 1.0])[
            :, np.newaxis] * self.along


class Trace(NamedTuple):
    """Curves of one panel."""

    panel: str          # key, as in 'tip_deflection'
    names: tuple        # of the k curves
    ns: np.ndarray      # sim time (n,) [ns]
    values: np.ndarray  # (n, k)


@dataclass(frozen=True)
class Track:
    """
    A run in the form that views take.

    `ns` are the sim times of n samples, not descending [ns]; `poses` returns the Poses at some of
    them; `note` describes it in Markdown. `floor` is None without gravity. `title` states the
    factor of the deflection of poses if it is not 1; that of traces is not multiplied.
    """

    name: str
    ns: np.ndarray
    poses: Callable[[np.ndarray | slice], Poses]
    traces: list[Trace]
    body: Body
    note: str
    floor: Floor | None = None
    title: str = ''

    def trace(self, panel: str) -> Trace | None:
        """Return the trace of a panel, or None."""
        return next((trace for trace in self.traces if trace.panel == panel), None)

    def frames(self, rate: float, at: float | None = None) -> np.ndarray:
        """Return ascending samples, at most `rate` per second, and the last until `at` [s]."""
        span = self.ns[-1] - self.ns[0]
        wanted = self.ns[0] + np.round(np.arange(int(span * 1e-9 * rate) + 1) * (1e9 / rate))
        places = [*np.searchsorted(self.ns, wanted), len(self.ns) - 1]
        if at is not None:
            places.append(max(np.searchsorted(self.ns, round(1e9 * at), side='right') - 1, 0))
        return np.unique(places)


def track_of_run(run: Any, name: str = 'run', deflection_scale: float = 1.0) -> Track:
    """
    Return the track of a `Run`.

    Poses have `deflection_scale` times the deflection; one that is not above 0 and at most 1e9 is
    a ParameterError.
    """
    scale = DEFLECTION_SCALE.check(deflection_scale)
    scene, motion, effort = run.scene, run.values, run.effort
    ns = np.rint(run.t * 1e9).astype(np.int64)
    formulation, half = scene.build(), motion.shape[1] // 2
    modal, tip = motion[:, 3:half], formulation.tip_point
    bend = _in_blocks(formulation.centre_line, modal, tip)[:, 0] - [tip.lever[0], 0.0]
    traces = [
        Trace('tip_deflection', ('w',), ns, bend[:, 1:]),
        Trace('tip_axial', ('u',), ns, bend[:, :1]),
        Trace('tip_rotation', ('phi',), ns, _in_blocks(formulation.section_rotation, modal, tip)),
        Trace('carrier', ('x', 'y'), ns, motion[:, :2]),
        Trace('shaft', ('theta',), ns, motion[:, 2:3]),
        Trace('carrier_velocity', ('x', 'y'), ns, motion[:, half:half + 2]),
        Trace('shaft_speed', ('theta',), ns, motion[:, half + 2:half + 3]),
        Trace('force', ('x', 'y'), ns, effort[:, :2]),
        Trace('torque', ('torque',), ns, effort[:, 2:]),
        Trace('energy', ('energy',), ns, run.energy()[:, np.newaxis])]
    if half > 3:
        traces.append(Trace('modal', tuple(f'q{n}' for n in range(1, half - 2)), ns, modal))

    def poses(part):
        return Poses(formulation.shape(motion[part], scale), motion[part, 2])

    note = (f'formulation `{scene.values["model.formulation"]}`, {scene.values["model.modes"]} '
            f'modes, step {1e3 * scene.step:g} ms; {len(ns)} samples, sim time '
            f'{1e-9 * ns[0]:g} to {1e-9 * ns[-1]:g} s. The shape of the arm is that of the modal '
            'coordinates.')
    body, gravity = body_of(scene), scene.values['gravity']
    floor = floor_of(gravity, motion[0, :2], body)
    note += f' Gravity is {np.hypot(*gravity):.4g} m/s2.' if floor else ''
    title = '' if scale == 1.0 else f'deflection x {scale:g}'
    note += f' The plane shows {title}.' if title else ''
    return Track(name=name, ns=ns, poses=poses, traces=traces, body=body, note=note, floor=floor,
                 title=title)


def floor_of(gravity: tuple[float, float], carrier: np.ndarray, body: Body) -> Floor | None:
    """Return the Floor under a carrier, (2,) [m], of a `track.Body`; None without gravity."""
    strength = float(np.hypot(*gravity))
    if strength == 0.0:
        return None
    down = np.array(gravity) / strength
    along, place = np.array([-down[1], down[0]]), carrier + 0.5 * body.carrier * down
    head = place - _BESIDE * body.length * along
    return Floor(place, along, np.array([head - _BESIDE * body.length * down, head]))


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


def _in_blocks(function, values, *more):
    return np.concatenate([function(values[k:k + _BLOCK], *more)
                           for k in range(0, len(values), _BLOCK)])
