# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A run of a scene: motions at sampled times, and the quantities and tables made of them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property
import math
from pathlib import Path
import time
from typing import Any, TYPE_CHECKING

import numpy as np

from timo_sim.extras import optional
from timo_sim.model.formulation import Formulation, PointsOfArm
from timo_sim.model.layout import LOADS, Motion, MotionFields, TORQUE
from timo_sim.scene.parameters import checked, DEFAULTS, PATH, warn
from timo_sim.scene.scene import Scene
from timo_sim.simulation.loads import pieces
from timo_sim.simulation.simulator import Simulator
from timo_sim.simulation.snapshot import add_bristles, applied, Joints, Snapshot
from timo_sim.simulation.warnings import DivergenceError
from timo_sim.steps.steps import Samples
from timo_sim.topics.outputs import with_angles

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    import pandas


_MAX_DIFFERENCE = 1e-3  # relative, of integrals by all and by every second sample
# Parameters of what `Run.dissipated` sums up that may be set while a node runs.
_LOSSES = 'arm.damping_ratio', 'carrier.viscous_friction', 'motor.viscous_friction'
_BLOCK = 1024     # samples whose loads are worked out at once
_CHECKED = 1024  # steps from one check for warnings to the next


@dataclass(frozen=True, repr=False)
class Run(MotionFields, PointsOfArm):
    """
    A run of n samples with N modes, simulated or read from a log.

    Attributes
    ----------
    scene : Scene
    model : Formulation
    t : ndarray, shape (n,)
        Sim time [s].
    values : ndarray, shape (n, 2 (3 + N))
        The motion, see `model.layout`; `carrier`, `shaft`, `q` and their rates are parts of it.
    friction_heat : ndarray, shape (n,)
        Energy that dry friction has taken since the start [J]: heat, and what springs of its
        presliding hold; NaN for the log of a scene with dry friction, which does not contain it.
    warning : str or None
        Why the run should not be trusted, and what to do.
    stats : dict
        Steps, wall time, and `estimated_tip_error_m` and `estimated_deflection_error_m`, the
        largest distances of the tip from that of a finer run, in the world and seen from the shaft
        [m], see `simulation.finer`; NaN if they were not measured.
    recording : Recording or None
        The log that the run was read from, with all its topics, commands included.
    payloads : tuple of (int, float, float, float)
        Changes of the load at the tip: step, then mass [kg], inertia [kg m2], offset [m]. The
        sample of that step is from before it.

    Examples
    --------
    >>> import timo_sim
    >>> run = timo_sim.simulate(timo_sim.load_scene('paper'), 1.0)
    >>> run.t.shape, run.carrier.shape, run.q.shape, run.position([1.0, 2.0]).shape
    ((1001,), (1001, 2), (1001, 3), (1001, 2, 2))

    """

    scene: Scene
    model: Formulation
    t: np.ndarray
    values: np.ndarray
    friction_heat: np.ndarray
    warning: str | None = None
    stats: dict = field(default_factory=dict)
    recording: Any = None
    payloads: tuple = ()

    @property
    def motion(self) -> Motion:
        """The motions, see `Motion`."""
        return Motion(self.values)

    @property
    def message(self) -> str:
        """One sentence about the run: its warning, or that there is none."""
        found = 'no warnings' if self.recording is None else (
            'read from a log, which does not say whether there were warnings')
        error = self.stats.get('estimated_tip_error_m', math.nan)
        if not math.isnan(error):
            bend = self.stats.get('estimated_deflection_error_m', 0.0)
            found += (f', estimated errors: tip {error:.1g} m, deflection {bend:.1g} m'
                      if bend > 2.0 * error else f', estimated tip error {error:.1g} m')
        if self.scene.fastest < math.inf:
            found += (', axial vibrations slowed down to '
                      f'{self.scene.fastest / (2.0 * math.pi):.3g} Hz, since steps do not '
                      'resolve them')
        text = self.warning or f'{len(self.t)} samples until t = {self.t[-1]:.6g} s, {found}'
        return '; '.join(filter(None, (text, self.scene.left_out)))

    def __repr__(self) -> str:
        return f'<Run: {self.message}; {self.scene!r}>'

    def energy(self) -> np.ndarray:
        """Return kinetic plus strain energy and the potential of gravity, shape (n,) [J]."""
        return np.concatenate([model.energy(self.values[part]) for model, part in self._pieces])

    def dissipated(self) -> np.ndarray:
        """
        Return the energy dissipated by friction and modal damping so far, shape (n,) [J].

        Dry friction is not part of it, but friction that builds up over a speed is. It is
        integrated from sample to sample, with a ModelWarning if they are too far apart for a
        relative error of 1e-3.
        """
        def power(model):
            taken, body = model.dissipation(self.values), model.manipulator
            if body.motor_limit:  # at which the back-EMF takes less (T66)
                speed = self.rotor_velocity
                taken += body.excess(self.effort[:, 2], speed) * speed
            return taken

        steps, scene = np.rint(self.t / self.scene.step), self.scene
        powers = [(0, power(self.model))]  # from these steps on
        for step, _, given in self.recording.changes if self.recording else ():
            if losses := {name: given[name] for name in _LOSSES if name in given}:
                scene = scene.vary(losses)
                powers.append((step, power(scene.build())))
        taken, coarse = (np.append(0.0, np.cumsum(np.select(
            [steps[::k][:-1] >= step for step, _ in reversed(powers)],
            [_integral(self.t[::k], each[::k]) for _, each in reversed(powers)])))
            for k in (1, 2))
        if np.diff(steps).max(initial=1.0) > 1.0 and (
                np.abs(taken[::2] - coarse).max() > _MAX_DIFFERENCE * taken.max()):
            warn('the dissipated energy is not accurate, because samples are too far apart: take '
                 'more samples')
        return taken

    def momentum(self) -> np.ndarray:
        """
        Return the momentum of the whole manipulator, shape (n, 3).

        Linear in world x and y [kg m/s], and angular about the world's origin [kg m2/s].
        """
        return np.concatenate([model.momentum(self.values[part]) for model, part in self._pieces])

    @property
    def rotor_velocity(self) -> np.ndarray:
        """Speed of the rotor of an elastic gear over the gear ratio, else of the shaft, (n,)."""
        return self.values[:, len(self.model.rotor):] @ self.model.rotor

    @cached_property
    def _pieces(self):
        return pieces(self.scene, np.rint(self.t / self.scene.step).astype(int), self.payloads)

    @cached_property
    def effort(self) -> np.ndarray:
        """
        Efforts of the joints, shape (n, 3).

        Forces on the carrier in world axes [N] and torque on the shaft [N m] at the end of the
        step before a sample; at the first sample, at the beginning of its step. For a free joint
        these are the loads and commands. For one that is held, locked or driven, this is the
        reaction of its constraint, in addition to the loads: what a brake or drive must be able to
        give.
        """
        if self.recording is not None:
            return self.recording.motion()[2]
        loads = self.loads()
        effort = applied(self.model, self.values, loads)
        effort[:, 2] = self.model.manipulator.effort(loads[:, TORQUE], self.rotor_velocity)
        constrained = self.model.constrained
        if not constrained.any():
            return effort
        return np.where(constrained, self._of_joints('reactions'), effort)

    def root_moment(self) -> np.ndarray:
        """
        Return the bending moment in the arm at its root, shape (n,) [N m].

        It follows from the torque balance of the shaft (T45), which converges much faster with the
        number of modes than the curvature. A log, which does not contain all loads, is a
        ValueError.
        """
        return self._of_joints('root_moment')

    def root_strain(self) -> np.ndarray:
        """Return the strain of the outer fibre at the root, (n,); raises as `root_moment`."""
        return self._of_joints('root_strain')

    def tip_acceleration(self) -> np.ndarray:
        """
        Return specific force at the tip, acceleration less gravity, in its axes, (n, 2) [m/s2].

        It is what an accelerometer shows; raises as `root_moment`.
        """
        return self._of_joints('tip_acceleration')

    @cached_property
    def _joints(self):
        if self.recording is not None:
            raise ValueError('a log does not contain all loads: replay it with record_sensors = '
                             'true for ~/root_strain')
        loads = self.loads()
        add_bristles(self.scene, self.model, self.values, loads)
        return [Joints(model, self.values[part], loads[part])
                for model, part in self._pieces]

    def _of_joints(self, name):
        return np.concatenate([getattr(joints, name) for joints in self._joints])

    def loads(self) -> np.ndarray:
        """Return the scene's loads at the samples, (n, LOADS), see `model.layout`."""
        load, step = self.scene.load, self.scene.step
        loads = np.empty((len(self.t), LOADS))
        first, last = np.rint(self.t[[0, -1]] / step).astype(int)
        every = (last - first) // max(len(self.t) - 1, 1) or 1
        for k in range(0, len(self.t), _BLOCK):
            count = min(_BLOCK, len(self.t) - k)
            table = load.stages(first + k * every - 1, (count - 1) * every + 1, step)
            loads[k:k + count] = table[::every, -1]
        loads[0] = load.stages(first, 1, step)[0, 0]
        return loads

    def columns(self) -> dict[str, np.ndarray]:
        """Return what the node publishes, except sensors, as columns named with units, (n,)."""
        from timo_sim.log.tables import column_names
        snapshots, found = list(self._snapshots()), {'time_s': self.t}
        for output in self._outputs():
            values = np.array([output.numbers(snapshot) for snapshot in snapshots])
            names, values = with_angles(output.columns, values)
            found.update(zip(column_names(output.name, names), values.T, strict=True))
        return found

    def to_pandas(self) -> pandas.DataFrame:
        """Return `columns` as a pandas.DataFrame with the time as index."""
        with optional():
            import pandas
        return pandas.DataFrame(self.columns()).set_index('time_s')

    @checked(path=PATH)
    def save(self, path: str | Path) -> Path:
        """
        Write the run to a file; return the Path that was written.

        `*.mcap` is a log, as the node writes it, which `timo_sim.open_log` reads; `*.parquet` or
        `*.csv` is a table. Existing logs are never overwritten; `_1`, `_2`, ... is appended. An
        existing table is a FileExistsError; a log of a run that was read from one, a ValueError.
        """
        from timo_sim.log.new_log import NewLog
        from timo_sim.log.tables import check_table, write_table
        path = Path(path)
        if path.suffix != '.mcap':
            check_table(path, also='.mcap, ')
            write_table(self.columns(), path)
            return path
        if self.recording:
            raise ValueError(f'the run was read from {self.recording.path}: copy this file, since '
                             'a log made of its motion would lack commands, resets and settings')
        values, outputs = {**DEFAULTS, **self.scene.values}, self._outputs()
        with closing(NewLog(path, self.scene, values, saved_by='Run.save')) as log:
            log.summary = {name: str(value) for name, value in self.stats.items()}
            for snapshot in self._snapshots():
                for output in outputs:
                    log.output(output.name, snapshot, output.numbers(snapshot))
        return log.path

    def plot(self, deflection_scale: float = 1.0) -> Figure:
        """Draw curves and the arm, with a multiple of its deflection; needs matplotlib."""
        with optional():
            from timo_sim.view.plot import plot
        return plot(self, deflection_scale)

    def view(self, deflection_scale: float = 1.0) -> None:
        """Show the run in rerun until its window is closed; needs rerun-sdk."""
        with optional():
            from timo_sim.view.rerun import show_tracks
        from timo_sim.view.track import Track
        show_tracks([Track(self, deflection_scale=deflection_scale)])

    def _outputs(self):
        # These topics follow from the motion alone; sensors need the simulator.
        return [output for output in self.scene.outputs
                if output.columns and not output.delay]

    def _snapshots(self):
        steps = np.rint(self.t / self.scene.step).astype(int).tolist()
        for model, part in self._pieces:
            # Of all samples in one call: one by one they would take most of the time.
            motions = self.values[part]
            for step, motion, tip, effort in zip(
                    steps[part], motions, model.tips(motions), self.effort[part]):
                found = Snapshot(self.scene, model, step, motion)
                found.tip, found.effort = tip.tolist(), tuple(effort.tolist())
                yield found


def run_scene(scene: Scene, steps: int, sample_every: int = 1,
              tell: Callable[[str], object] | None = None) -> Run:
    """Return the Run of a resolved scene, quietly; `tell` is told of compilations."""
    simulator = Simulator(scene)
    simulator.warm_up(tell)
    motion = np.empty((steps // sample_every + 1, simulator.model.size))
    heat, begun = np.zeros(len(motion)), time.monotonic()

    def run_until(step):
        samples = slice(step // sample_every + 1)
        stats = {'steps': step, 'wall_time_s': time.monotonic() - begun,
                 'estimated_tip_error_m': math.nan, 'estimated_deflection_error_m': math.nan,
                 'impact_loss_J': simulator.tip_load.lost}
        return Run(scene=scene, model=scene.build(),
                   t=np.arange(samples.stop) * sample_every * scene.step, values=motion[samples],
                   friction_heat=heat[samples], warning=simulator.warning, stats=stats,
                   payloads=scene.payloads)

    block = max(1, _CHECKED // sample_every) * sample_every
    try:
        for first in range(0, max(1, steps), block):
            count = min(block, steps - first)
            part = slice(first // sample_every, (first + count) // sample_every + 1)
            simulator._advance(count, None, Samples(sample_every, motion[part], heat[part]))
    except DivergenceError as error:
        error.run = run_until(simulator.steps // sample_every * sample_every)
        raise
    return run_until(steps)


def _integral(t, power):
    """
    Return the integral of a power, (n,) [W], from each sample to the next, (n - 1,) [J].

    The trapezoidal rule is corrected by the slopes at both ends, which gives fourth order for
    equally spaced samples, at the times `t`, (n,) [s].
    """
    duration = np.diff(t)
    done = 0.5 * duration * (power[1:] + power[:-1])
    if len(t) > 2 and duration.all():
        done -= duration**2 / 12.0 * np.diff(np.gradient(power, t, edge_order=2))
    return done
