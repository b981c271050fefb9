# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The class Batch: many manipulators of one size, advanced together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import math
from typing import Any

import numpy as np

from timo_sim.model.layout import (
    AFTER, INPUTS, LOADS, Motion, rotate, START, STEP_LOADS, TORQUE, VOLTAGE)
from timo_sim.scene.bodies import motor_constants
from timo_sim.scene.loads import CURVES, Load, SHAFT_DRIVE
from timo_sim.scene.parameters import (
    fixed_axes, numbers, Parameter, ParameterError, steps_in)
from timo_sim.scene.scene import load_scene, Scene, scene_from, SceneLike
from timo_sim.simulation.cuda import Cuda
from timo_sim.simulation.loads import (
    Actuators, ARGUMENTS, check_arguments, commanded_load, limits_of, tip_of, TipLoad, whole_load)
from timo_sim.simulation.simulator import COUNT, MOST_BENT, SAMPLE_EVERY, Stateful
from timo_sim.simulation.warnings import divergence, unseen_load
from timo_sim.steps.bristles import HEAT, MEMORY, memory_at, swing_of
from timo_sim.steps.lanes import from_lanes, LaneSteps, to_lanes
from timo_sim.steps.steps import CHUNK, NO_LOADS
from timo_sim.steps.threads import ThreadSteps


class LaneLoads:
    """
    Loads of n scenes with the same time step, for their lanes.

    `kinds` are the different scenes, and `which`, (n,), says which of them each is. `origin`,
    (n,), is the number of the step at which the scene's own loads begin, in each lane.
    """

    def __init__(self, kinds: list[Scene], which: np.ndarray, lanes: LaneSteps) -> None:
        self._step, self._kinds, self._which, self._lanes = kinds[0].step, kinds, which, lanes
        # What varies by itself, the terms of a channel: its columns, all different
        # loads, and which of them each lane has. Lanes share what does not differ among them.
        self._parts = []
        for name in CURVES:
            own = [scene.load.terms.get(name, ()) for scene in kinds]
            keys = own if name == SHAFT_DRIVE else [id(terms) for terms in own]
            loads = [Load({name: each}) for each in dict(zip(keys, own)).values()]
            columns = sorted({column for load in loads for column in load.columns})
            if columns:
                place = {key: k for k, key in enumerate(dict.fromkeys(keys))}
                self._parts.append((columns, loads, np.array([place[key] for key in keys])[which]))
        limits = np.array([limits_of(scene.values) for scene in kinds])
        slow = np.isfinite(limits[:, 1])
        gain = np.array([motor_constants(scene.values)[0] for scene in kinds])
        rows = which if len(kinds) > 1 else [0]  # one for all
        self._limit, self._gain, self._held = map(lanes.xp.asarray, (
            limits[rows, 0], gain[rows], slow[rows]))
        self._slow: dict[int, Any] = dict.fromkeys(
            np.flatnonzero(slow.any(axis=1)[which]).tolist())
        varying = (columns for columns, _, _ in self._parts)
        self.columns = np.array(sorted({*np.flatnonzero(slow.any(axis=0)).tolist()}.union(
            *varying)), dtype=np.int64)
        self._room, self.origin = NO_LOADS, np.zeros(len(which), dtype=int)
        self.reset(np.arange(len(which)), 0)

    def reset(self, lanes: np.ndarray, first: int) -> None:
        """Begin with the own loads at step `first`, and let no command act, in some lanes."""
        self.origin[lanes] = first
        padded = np.minimum(
            np.arange(self._lanes.groups * self._lanes.width), len(self._which) - 1)
        # Lanes with equal loads that began at the same step; complex numbers are sorted fast.
        self._equal = []
        for _, _, which in self._parts:
            each, place = np.unique(which + 1j * self.origin, return_inverse=True)
            self._equal.append((each, self._lanes.xp.asarray(
                place[padded].reshape(-1, self._lanes.width))))
        for lane in self._slow.keys() & set(lanes if self._slow else ()):
            self._slow[lane] = Actuators(self._kinds[self._which[lane]].values, first)

    def command(self, commanded: np.ndarray) -> np.ndarray:
        """
        Take the commands, shape (n, LOADS), of the next steps.

        Return what acts of them and does not vary with time, of the same shape.
        """
        acting = self._lanes.xp.clip(commanded, -self._limit, self._limit)
        acting[:, TORQUE] += self._gain * acting[:, VOLTAGE]
        if self._slow:
            self._commanded = self._lanes.host(commanded)
            acting = self._lanes.xp.where(self._held, 0.0, acting)
        return acting

    def room(self, count: int) -> int:
        """Return how many numbers `varying` needs in each lane, a copy of a part included."""
        copied = max((len(columns) for (columns, *_), (kinds, _) in zip(self._parts, self._equal)
                      if len(kinds) > 1), default=0)
        return (1 + count) * STEP_LOADS * (len(self.columns) + copied)

    def varying(self, first: int, count: int) -> np.ndarray:
        """
        Return what varies with time of the loads of some steps, see `LaneSteps.advance`.

        The shape is (groups, 1 + count, 4, len(columns), WIDTH).
        """
        groups, width, xp = self._lanes.groups, self._lanes.width, self._lanes.xp
        found = xp.zeros((groups, 1 + count, STEP_LOADS, len(self.columns), width))
        for (columns, loads, _), (kinds, kind) in zip(self._parts, self._equal):
            own = np.zeros((len(kinds), 1 + count, STEP_LOADS, len(columns)))
            for each, rows in zip(kinds, own):
                load, begin = loads[int(each.real)], first - int(each.imag)
                if begin:  # from the step before, whose end is the beginning of these
                    rows[:] = self._own(load, columns, begin - 1, count + 1)
                else:
                    rows[1:] = self._own(load, columns, 0, count)
                    after = rows[1] if count else self._own(load, columns, 0, 1)[0]
                    rows[0, AFTER] = after[START]
            at = np.searchsorted(self.columns, columns[0])
            own = xp.asarray(own)
            found[..., at:at + len(columns), :] = (
                own[kind].transpose(0, 2, 3, 4, 1) if len(kinds) > 1 else own[0, ..., np.newaxis])
        if self._slow:
            found = self._lanes.host(found)
        for lane, actuators in self._slow.items():
            acting, rows = np.zeros((count, STEP_LOADS, LOADS)), found[lane // width, 1:]
            actuators.add(self._commanded[lane], first, acting)
            among = np.isin(self.columns, actuators.slow)
            rows[..., among, lane % width] += acting[..., actuators.slow]
        return found

    def _own(self, load, columns, first, count):
        if len(self._room) < count:
            self._room = np.empty((count, STEP_LOADS, LOADS))
        found = load.stages(first, count, self._step, self._room)
        return found[..., columns[0]:columns[-1] + 1]


MOST_ARMS = 10**7  # of a Batch
_DEVICE = Parameter('device', 'cpu', '', 'what steps', choices=('cpu', 'cuda'))
DEVICES = {'cuda': Cuda}
_COUNT = Parameter('n', 1, '', 'number of manipulators', low=1, high=MOST_ARMS)


class Batch(Stateful):
    """
    Many manipulators of one size, each with its own loads, commands and state, advanced together.

    They are as many runs of `Simulator`, several times faster: the numbers of eight manipulators
    are one vector of the processor, see `compiled.lanes`. Formulation, numbers of modes,
    constraints and time step are the same for all; masses, stiffness, damping, limits, loads and
    initial state may differ. With one axis of the carrier held and a shaft that turns a step takes
    several times as long, as it does in a `Simulator`. All have the static shapes that any of them
    needs. What one manipulator does depends on these, its own scene and its commands alone, to the
    last bit; a `Simulator` does the same to about 1e-11. There is no estimate of the
    error: try some of the scenes with `simulate`, which has one.

    Parameters
    ----------
    scenes : list of Scene, or a Scene, or what `load_scene` takes
    n : int, optional
        Number of manipulators, if one scene is given.
    device : str, optional
        'cpu'; or 'cuda', an NVIDIA GPU, with the extra `cuda`: each manipulator is a thread there,
        with the same results as on a CPU that fuses products and sums.

    Attributes
    ----------
    n : int
    scenes : list of Scene
        One for each manipulator.
    steps : int
        Steps done since the batch was made.

    Raises
    ------
    ParameterError
        If the scenes differ in size, or have a `model.accuracy`; or there is no GPU for them, or
        they do not fit into its memory.
    MissingPackage
        If a GPU is asked for without the extra.

    Examples
    --------
    >>> import numpy as np, timo_sim
    >>> batch = timo_sim.Batch('paper', n=100)
    >>> motion = batch.step(torque=np.linspace(-1.0, 1.0, 100), duration=0.1)
    >>> motion.shaft.shape, batch.deflection().shape, batch.failed.any()
    ((100,), (100, 2), np.False_)

    """

    def __init__(self, scenes: SceneLike | Sequence[Scene], n: int | None = None,
                 device: str = 'cpu') -> None:
        device = _DEVICE.check(device)
        self._device: Any = None if device == 'cpu' else DEVICES[device]()
        if isinstance(scenes, Sequence) and not isinstance(scenes, str):
            self.scenes = [load_scene(scene) for scene in scenes]
            if n not in (None, len(scenes)):
                raise ParameterError(f'n must be the number of scenes, {len(scenes)}, got {n}')
        else:
            self.scenes = [load_scene(scenes)] * (1 if n is None else _COUNT.check(n))
        if not self.scenes:
            raise ParameterError('scenes must have at least one element, got none')
        self.n = len(self.scenes)
        self.scenes = _with_equal_shapes(self.scenes)
        _check(self.scenes)
        kinds = list({id(scene): scene for scene in self.scenes}.values())
        places = {id(scene): k for k, scene in enumerate(kinds)}
        which = np.array([places[id(scene)] for scene in self.scenes])
        models = [scene.build() for scene in kinds]
        self._models = [models[k] for k in which]
        self._straight, self._initial, self._bristles, self._swing = (
            np.array(each)[which] for each in zip(*(
                ([model.tip_point.lever[0], 0.0], scene.initial_motion(), scene.bristles,
                 swing_of(model, scene.bristles)) for scene, model in zip(kinds, models))))
        first = np.unique(which, return_index=True)[1]  # lane of each kind
        self._which, self._at_start = which, self._start_of(first, self._initial[first])
        self._needed = {name: np.array([scene.values[name] for scene in kinds])[which]
                        for name in ('carrier.held', *(each.needs for each in INPUTS)) if name}
        # Of manipulators whose load at the tip changes.
        self._tips = {k: TipLoad(tip_of(scene)) for k, scene in enumerate(self.scenes)
                      if scene.payloads}
        given = self._models, kinds[0].step, MOST_BENT, self._bristles, not self._tips
        self._lanes = ThreadSteps(self._device, *given) if self._device else LaneSteps(*given)
        self._loads = LaneLoads(kinds, which, self._lanes)
        self.steps = 0
        self.reset()

    def __repr__(self) -> str:
        return f'<Batch of {self.n}, {self.failed.sum()} failed, of {self.scenes[0]!r}>'

    @property
    def t(self) -> np.ndarray:
        """Sim time of each since its start or reset, shape (n,) [s]; of one that failed, until."""
        return self._rows('progress')[:, 1] * self.scenes[0].step

    @property
    def failed(self) -> np.ndarray:
        """Which have diverged, shape (n,); they stay at their last good state until a reset."""
        return self._rows('progress')[:, 0] == 0.0

    @property
    def motion(self) -> Motion:
        """The motions now, whose parts have the shapes (n, ...), see `Motion`."""
        return Motion(self._rows('motion'))

    def _rows(self, field):
        with self._lock:
            return self._lanes.host(from_lanes(getattr(self._lanes, field), self.n))

    def on_device(self) -> dict[str, Any]:
        """
        Return arrays in the memory of the device, which DLPack hands on without a copy, by name.

        They are the `values` of `motion`, (n, 2 (3 + N)), `tip`, (n, 3), its place along and
        across the shaft [m] and its rotation [rad], and `failed`, (n,).
        """
        with self._lock:
            return {'motion': from_lanes(self._lanes.motion, self.n),
                    'tip': from_lanes(self._lanes.tip, self.n),
                    'failed': from_lanes(self._lanes.progress, self.n)[:, 0] == 0.0}

    def position(self) -> np.ndarray:
        """Return positions of the tips in world axes, shape (n, 2) [m]."""
        with self._lock:
            motion, tip = self.motion, self._rows('tip')
        return motion.carrier + np.column_stack(rotate(motion.shaft, *tip[:, :2].T))

    def deflection(self) -> np.ndarray:
        """Return axial and transverse deflection of the tips in the arm frame, (n, 2) [m]."""
        return self._rows('tip')[:, :2] - self._straight

    def rotation(self) -> np.ndarray:
        """Return rotations of the tips relative to the shaft, shape (n,) [rad]."""
        return self._rows('tip')[:, 2]

    @property
    def friction_heat(self) -> np.ndarray:
        """Energy that dry friction has taken, as in `Run.friction_heat`, shape (n,) [J]."""
        return self._rows('friction')[:, HEAT]

    def reason(self, number: int) -> str:
        """Return why a manipulator has failed, as the text of a DivergenceError, or ''."""
        number = Parameter('number', 0, '', '', low=0, high=self.n - 1).check(number)
        if not self.failed[number]:
            return ''
        scene = self.scenes[number]
        return divergence(scene, self._models[number], round(self.t[number] / scene.step),
                          self.motion.values[number], unseen_load(scene))

    def reset(self, mask: Any = None, motion: Any = None) -> None:
        """
        Return to the initial motion and the start of the loads, all or some.

        `mask`, of bool, shape (n,), says which; `motion`, shape (2 (3 + N),) or (n, 2 (3 + N)), is
        where to start instead. Raises ParameterError for other shapes.
        """
        chosen = np.ones(self.n, dtype=bool) if mask is None else np.asarray(
            self._lanes.host(mask))
        if chosen.shape != (self.n,) or chosen.dtype != bool:
            raise ParameterError(f'mask must be {self.n} times true or false, got an array of '
                                 f'{chosen.dtype} of shape {chosen.shape}')
        motions = self._initial if motion is None else numbers(
            'motion', motion, self._initial.shape, self._initial.shape[1:])
        rows = np.flatnonzero(chosen)
        with self._lock:
            self._reset(rows, np.broadcast_to(motions, self._initial.shape)[rows],
                        given=motion is not None)

    def _reset(self, rows, motions, given):
        """Return some lanes to the start of their loads; the motions are initial or given."""
        lanes = self._lanes
        for number in self._tips.keys() & {*rows.tolist()}:
            self._tips[number] = TipLoad(tip_of(self.scenes[number]))
            self._set_model(number, self.scenes[number].build())
        states, memory = self._start_of(rows, motions) if given else (
            each[self._which[rows]] for each in self._at_start)
        for field, new in (
                (lanes.state, states), (lanes.motion, motions), (lanes.friction, memory),
                (lanes.progress, np.tile([1.0, 0.0], (len(rows), 1)))):
            every = from_lanes(field, self.n)
            every[rows] = lanes.xp.asarray(new)
            field[:] = to_lanes(every, lanes.width)
        # No step: the tips of the states are set; so are the motions, but without loads.
        motion_lanes = lanes.motion.copy()
        lanes.advance(np.empty(0, dtype=np.int64),
                      np.empty((lanes.groups, 1, STEP_LOADS, 0, lanes.width)))
        lanes.motion[:] = motion_lanes
        self._loads.reset(rows, self.steps)

    def _start_of(self, lanes, motions):
        """Return states and memories of some lanes at the start, with a motion for each."""
        states = np.zeros((len(lanes), len(self._models[0].linear)))
        memory = np.zeros((len(lanes), MEMORY))
        rows_of = {}
        for row, lane in enumerate(lanes):
            rows_of.setdefault(id(self._models[lane]), []).append(row)
        for rows in rows_of.values():
            model, among = self._models[lanes[rows[0]]], lanes[rows]
            # Each is a product of its own, so that no bit of a row depends on the other rows.
            states[rows] = model.state(motions[rows][:, np.newaxis])[:, 0]
            memory[rows] = memory_at(
                self._bristles[among], self._swing[among],
                (motions[rows, np.newaxis, motions.shape[1] // 2:] @ model.joint_turns)[:, 0])
        return states, memory

    def step(self, *, duration: float | None = None, **commands: Any) -> Motion:
        """
        Advance under constant commands as `Simulator.step` does, with its ParameterErrors.

        Commands are for all or for each: float or array_like, shape (n,), (2,) or (n, 2); or
        arrays of the device that DLPack takes, for each. Returns the Motion at the end; after such
        commands its `values` are an array of the device.
        """
        commanded = commanded_load(self._needed, (self.n,), **commands) if (
            self._device is None) else self._on_device(commands)
        count = 1 if duration is None else steps_in(duration, self.scenes[0].step)
        stays = self._device is not None and any(map(self._device.owns, commands.values()))
        with self._lock:
            self.advance(count, commanded)
            return Motion(self.on_device()['motion']) if stays else self.motion

    def _on_device(self, commands):
        """Return commands as loads on the device, (n, LOADS)."""
        load = self._lanes.xp.zeros((self.n, LOADS))
        check_arguments(commands, 'step')
        for name, given in commands.items():
            columns = ARGUMENTS[name]
            if self._device.owns(given):
                given = self._device.array(name, given, (self.n, *np.shape(columns)))
                for each in (INPUTS[column] for column in np.ravel(columns)):
                    if each.needs and not self._needed[each.needs].all():
                        raise ParameterError(f'{name} needs {each.needs} > 0 in all scenes, got 0')
            else:
                given = self._lanes.xp.asarray(commanded_load(
                    self._needed, (self.n,), **{name: given})[:, columns])
            load[:, columns] = given
        return load

    def advance(self, count: int, commanded: np.ndarray | None = None,
                sample_every: int = 0) -> np.ndarray:
        """
        Advance by `count` steps; return motions, (n, 1 + count // sample_every, 2 (3 + N)).

        `commanded`, (n, LOADS) or (LOADS,), are commands during all of them, see `model.layout`.
        The motions are those at the start and after each `sample_every` steps; with 0 none.
        """
        if not type(count) is type(sample_every) is int or (count | sample_every) >> 53:
            count, sample_every = COUNT.check(count), SAMPLE_EVERY.check(sample_every)
        if self._device and self._device.owns(commanded):
            commanded = self._device.array('commanded', commanded, (self.n, LOADS))
        elif commanded is not None:
            commanded = whole_load(commanded, (self.n, LOADS), (LOADS,))
        with self._lock:
            return self._lanes.host(from_lanes(
                self._advance(count, commanded, sample_every)[0], self.n))

    def advance_tips(self, count: int) -> np.ndarray:
        """Advance by `count` > 0 steps; return the tip after each, (n, count, 3), as `tip`."""
        count = replace(COUNT, low=1).check(count)
        with self._lock:
            tips = self._advance(count, None, 0, with_tips=True)[1]
            return self._lanes.host(from_lanes(np.concatenate(tips, axis=1), self.n))

    def _advance(self, count, commanded, sample_every, with_tips=False):
        lanes, loads = self._lanes, self._loads
        rows = 1 + count // sample_every if sample_every else 0
        most = max(1, min(CHUNK, lanes.most_numbers // (4 * self.n * max(1, len(loads.columns)))))
        # What is returned; then loads of steps, or copies of it with lanes as rows.
        kept = rows * lanes.motion.shape[1] + 3 * count * with_tips
        lanes.make_room(kept + max(kept * (1 + with_tips), loads.room(min(most, count))))
        commanded = lanes.xp.asarray(0.0 if commanded is None else commanded)
        acting = loads.command(lanes.xp.broadcast_to(commanded, (self.n, LOADS)))
        lanes.constant_load[:] = to_lanes(acting, lanes.width)
        samples = lanes.room(rows, lanes.motion.shape[1])
        tips = [lanes.room(0, 3)]
        first = 0
        while first < count:
            now, changes = self.steps + first, self._changes
            before = lanes.motion.copy() if changes else None
            part = min(most, count - first, self._change_tips(now) - now)
            at_starts = lanes.room(part if with_tips else 0, 3)
            varying = loads.varying(now, part)
            lanes.advance(loads.columns, varying, sample_every, first, samples, at_starts)
            if self._changes != changes and sample_every and first % sample_every == 0:
                samples[:, first // sample_every] = before  # a sample is from before a change
            if with_tips:
                tips += [at_starts[:, 1:], lanes.tip[:, np.newaxis].copy()]
            first += part
        self.steps += count
        return samples, tips

    @property
    def _changes(self):
        return [tip.changes for tip in self._tips.values()]

    def _change_tips(self, now):
        # Make the changes of loads at tips that are due; return the step of the next one.
        lanes, following = self._lanes, math.inf
        for number, tip in self._tips.items():
            scene, (group, lane) = self.scenes[number], divmod(number, lanes.width)
            place = group, slice(None), lane
            while (tip.changes < len(scene.payloads) and self._loads.origin[number]
                   + scene.payloads[tip.changes][0] <= now and not self.failed[number]):
                load = scene.payloads[tip.changes][1:]
                model = scene.build(load)
                tip, motion = tip.replaced(load, scene, model, lanes.host(lanes.motion[place]))
                tip = tip._replace(changes=tip.changes + 1)
                self._set_model(number, model)
                for field, new in (lanes.state, model.state(motion)), (lanes.motion, motion):
                    field[place] = lanes.xp.asarray(new)
            self._tips[number] = tip
            if tip.changes < len(scene.payloads):
                due = self._loads.origin[number] + scene.payloads[tip.changes][0]
                following = min(following, due if due > now else math.inf)
        return following

    def _set_model(self, number, model):
        if self._models[number] is not model:
            self._models[number] = model
            self._lanes.change_model(number, model)


def _with_equal_shapes(scenes):
    wanted = {load for scene in scenes for load in scene.static}
    static, made = tuple(sorted(wanted)), {}
    for scene in scenes:
        if id(scene) not in made:
            made[id(scene)] = (scene if scene.static == static else
                               scene_from(scene.values, static))
    return [made[id(scene)] for scene in scenes]


def _check(scenes):
    """Raise ParameterError for scenes that a batch cannot do."""
    wanted = lane_size(scenes[0])
    for number, scene in enumerate(scenes):
        if scene is scenes[0] and number:
            continue
        if accuracy := scene.values['model.accuracy']:
            raise ParameterError('model.accuracy must be 0 m in a Batch, whose scenes share modes '
                                 f'and step, got {accuracy}: use choose_resolution')
        for name, value in lane_size(scene).items():
            if value != wanted[name]:
                raise ParameterError(f'{name} must be the same in all scenes of a Batch, got '
                                     f'{wanted[name]} and {value} (scene {number})')


def lane_size(scene: Scene) -> dict[str, Any]:
    """Return what all scenes of a Batch have in common, by name."""
    values = scene.values
    return {**{name: values[name] for name in (
        'model.formulation', 'model.axial_modes', 'model.modes', 'integrator.step',
        'motor.shaft')}, 'carrier.drive or carrier.held': fixed_axes(values),
        **{f'{name} > 0': values[name] > 0.0 for name in (
            'push.position', 'hub.radius', 'motor.gear.stiffness', 'motor.spring.stiffness')},
        'the static shapes': scene.static,
        'end_effector.offset or payload.offset not 0': scene.manipulator.off_tip,
        'motor.dc.current_limit < .inf': bool(scene.manipulator.motor_limit),
        'the number of nodes': len(scene.build().quadrature.nodes)}
