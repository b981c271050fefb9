"""A track: what a view shows of a run, whatever the run comes from."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from timo_sim.energy import integral, work
from timo_sim.physics.formulation import FORCE_X, FORCE_Y, TORQUE
from timo_sim.physics.load import CHANNELS

POINTS = 41     # of the centre line that is drawn
BLOCK = 1024    # samples that are worked out at once: what they need stays near the processor


class TrackError(ValueError):
    """What a view needs is missing; the text says what."""


class Body(NamedTuple):
    """Sizes of what is drawn [m]: bodies of the arm's material, cube, cylinder and ball."""

    length: float
    thickness: float
    carrier: float
    motor: float
    tip: float


class Poses(NamedTuple):
    """Where everything is at m times, world axes."""

    line: np.ndarray    # centre line from root to tip, (m, p, 2) [m]
    shaft: np.ndarray   # (m,) [rad]
    effort: np.ndarray  # force x, y [N] and torque [N m] as applied, (m, 3)


class Trace(NamedTuple):
    """Curves of one panel."""

    panel: str          # key, as in 'tip_deflection'
    names: tuple        # of the k curves
    ns: np.ndarray      # sim time (n,) [ns]
    values: Callable    # from a slice to (m, k)


@dataclass(frozen=True)
class Track:
    """
    A run as a view takes it.

    Attributes
    ----------
    name : str
    ns : ndarray, shape (n,)
        Sim times of the samples [ns], not descending.
    poses : function(ndarray of int or slice) -> Poses
        At these samples.
    traces : list of Trace
    body : Body
    note : str
        What it is and how its shape is known, Markdown.

    """

    name: str
    ns: np.ndarray
    poses: Callable
    traces: list
    body: Body
    note: str

    def trace(self, panel):
        """Return the trace of a panel, or None."""
        return next((trace for trace in self.traces if trace.panel == panel), None)

    def frames(self, rate, at=None):
        """
        Return the samples that make at most so many frames per second, ascending.

        Where a sim time `at` [s] is given, the last sample until then is one of them.
        """
        span = self.ns[-1] - self.ns[0]
        wanted = self.ns[0] + np.round(np.arange(int(span * 1e-9 * rate) + 1) * (1e9 / rate))
        wanted = np.concatenate([np.searchsorted(self.ns, wanted), [len(self.ns) - 1]])
        if at is not None:
            place = np.searchsorted(self.ns, round(1e9 * at), side='right') - 1
            wanted = np.append(wanted, max(place, 0))
        return np.unique(wanted)


def of_motion(name, scene, ns, motion, effort, resets=(), balanced=True, heat=None):
    """
    Return the track of a known motion.

    Parameters
    ----------
    name : str
    scene : Scene
    ns : ndarray, shape (n,)
        Sim time [ns].
    motion : ndarray, shape (n, 2 (3 + N))
        See `physics.formulation`.
    effort : ndarray, shape (n, 3)
        Force on the carrier, world x and y [N], torque on the shaft [N m].
    resets : array_like of int
        Samples that don't follow from the one before.
    balanced : bool
        Whether work and losses are worked out, too; the work of a load on the tip is not known,
        nor what friction takes when it was set to something else on the way.
    heat : ndarray, shape (n,), optional
        What Coulomb friction has taken so far [J], needed for the balance where there is any.

    Returns
    -------
    Track

    """
    formulation, half = scene.build(), motion.shape[1] // 2
    length = scene.manipulator.arm.length
    line, tip = formulation.at(np.linspace(0.0, length, POINTS)), formulation.at([length])

    def poses(part):
        return Poses(formulation.world(motion[part], line), motion[part, 2], effort[part])

    def trace(panel, names, values):
        return Trace(panel, names, ns, values)

    modes = tuple(f'q{n}' for n in range(1, half - 2))
    bend = _in_blocks(formulation.centre_line, motion[:, 3:half], tip)[:, 0] - [length, 0.0]
    traces = [
        trace('tip_deflection', ('w',), bend[:, 1:].__getitem__),
        trace('tip_axial', ('u',), bend[:, :1].__getitem__),
        trace('tip_rotation', ('phi',),
              lambda part: formulation.section_rotation(motion[part, 3:half], tip)),
        *_joint_traces(trace, motion[:, :3], motion[:, half:half + 3], effort),
        trace('modal', modes, lambda part: motion[part, 3:half])]
    energy = _in_blocks(formulation.energy, motion)
    pushed = any(scene.load.terms[channel] for channel in CHANNELS if channel.startswith('tip'))
    known = scene.values['motor.shaft'] != 'driven' and (
        heat is not None or not scene.friction.any())
    if balanced and known and not pushed:
        done = work(ns, motion[:, :3], motion[:, half:half + 3], effort)
        done -= integral(ns, _in_blocks(formulation.dissipation, motion))
        done -= 0.0 if heat is None else np.diff(heat)
        gained = np.diff(energy)
        gained[np.asarray(resets, dtype=int) - 1] = 0.0
        done[np.asarray(resets, dtype=int) - 1] = 0.0
        curves = np.column_stack([energy, energy[0] + np.append(0.0, np.cumsum(done))])
        balance = np.append(0.0, np.cumsum(gained - done))[:, np.newaxis]
        traces += [trace('energy', ('energy', 'first energy + work - losses'),
                         curves.__getitem__),
                   trace('balance', ('energy - work + losses',), balance.__getitem__)]
    else:  # also because the torque of a driven shaft is not known, nor Coulomb friction's heat
        traces.append(trace('energy', ('energy',), energy[:, np.newaxis].__getitem__))
    return Track(name, ns, poses, [entry for entry in traces if entry.names], body_of(scene),
                 _note(scene, ns))


def of_run(run, name='run'):
    """Return the track of a `Run` under the scene's own loads."""
    first, last = np.rint(run.t[[0, -1]] / run.scene.step).astype(int)
    every = (last - first) // max(len(run.t) - 1, 1) or 1
    effort = np.empty((len(run.t), 3))
    for k in range(0, len(run.t), BLOCK):
        count = min(BLOCK, len(run.t) - k)
        # What acts at the end of the last step; at the start, at the beginning of the first.
        steps = (first + (k + np.arange(count)) * every)
        block = run.scene.load.stages(steps[0] - 1, (count - 1) * every + 1, run.scene.step)
        effort[k:k + count] = block[::every, -1, :][:, [FORCE_X, FORCE_Y, TORQUE]]
    effort[0] = run.scene.load.stages(first, 1, run.scene.step)[0, 0, [FORCE_X, FORCE_Y, TORQUE]]
    ns = np.rint(run.t * 1e9).astype(np.int64)
    return of_motion(name, run.scene, ns, run.motion, effort, heat=run.friction_heat)


def of_recording(recording, name):
    """
    Return the track of a recording.

    Parameters
    ----------
    recording : Recording
        Of `log.recording`; without modal coordinates the shape is a cubic from root to tip.
    name : str

    Returns
    -------
    Track

    Raises
    ------
    TrackError
        If what a shape needs is not on it.

    """
    scene, series = recording.scene, recording.read(
        'joint_states', '~/modal_state', '~/tip_wrench')
    joints = series.get('joint_states')
    if joints is None or not len(joints.ns):
        raise TrackError(f'{recording.path} has no joint_states: there is nothing to show')
    if scene is None or scene.values['model.modes'] and '~/modal_state' not in series:
        return _of_bag(recording, name, joints)
    step, ns, motion = recording.motion(series)
    if not len(ns):
        raise TrackError(f'{recording.path}: joint_states and modal_state are never of the same '
                         'time: choose rates of which one is a multiple of the other')
    place = slice(None) if len(ns) == len(joints.ns) else (
        np.searchsorted(joints.ns, ns, side='right') - 1)
    resets = np.searchsorted(step, recording.resets, side='right') - 1
    resets += step[resets] < recording.resets
    return of_motion(name, scene, ns, motion, joints.values[place, 6:9],
                     resets[(0 < resets) & (resets < len(ns))],
                     not recording.changes and ('~/tip_wrench' not in series
                                                or not len(series['~/tip_wrench'].ns)))


def unique_names(names):
    """Return names with a number after those that are there before."""
    return [name if names.index(name) == place else f'{name}_{place}'
            for place, name in enumerate(names)]


def _in_blocks(function, values, *more):
    return np.concatenate([function(values[k:k + BLOCK], *more)
                           for k in range(0, len(values), BLOCK)])


def body_of(scene):
    """Return the sizes of what is drawn of a scene."""
    arm, body = scene.manipulator.arm, scene.manipulator
    density = np.max(arm.section.density)

    def size(mass, shape):  # visible and not in the way, whatever the mass
        return float(np.clip((mass / density / shape)**(1 / 3), 0.02 * arm.length,
                             0.1 * arm.length))

    return Body(arm.length, float(np.max(arm.section.height)), size(body.carrier_mass, 1.0),
                size(body.motor_mass, np.pi / 4), size(body.tip_mass, np.pi / 6))


def _joint_traces(trace, position, velocity, effort):
    return [trace('carrier', ('x', 'y'), lambda part: position[part, :2]),
            trace('shaft', ('theta',), lambda part: position[part, 2:]),
            trace('carrier_velocity', ('x', 'y'), lambda part: velocity[part, :2]),
            trace('shaft_speed', ('theta',), lambda part: velocity[part, 2:]),
            trace('force', ('x', 'y'), lambda part: effort[part, :2]),
            trace('torque', ('torque',), lambda part: effort[part, 2:])]


def _note(scene, ns):
    values = scene.values
    return (f'formulation `{values["model.formulation"]}`, {values["model.modes"]} modes, step '
            f'{1e3 * scene.step:g} ms; {_span(ns)}. The shape of the arm is that of the modal '
            'coordinates.')


def _span(ns):
    return f'{len(ns)} samples, sim time {1e-9 * ns[0]:g} to {1e-9 * ns[-1]:g} s'


def _of_bag(recording, name, joints):
    # The shape from what is published: a cubic along the shaft at the root, along the section at
    # the tip.
    topics = '~/tip_pose', '~/tip_deflection'
    tip, bend = map(recording.read(*topics).get, topics)
    if tip is None or bend is None or not len(tip.ns) or not len(bend.ns):
        raise TrackError(f'{recording.path}: the shape of the arm needs tip_pose and '
                         'tip_deflection, or a log of the node with modal_state')

    # Messages may have come in another order.
    (joint_ns, joints), (tip_ns, place), (bend_ns, bend) = (
        (series.ns[order], series.values[order]) for series, order in (
            (series, np.argsort(series.ns, kind='stable')) for series in (joints, tip, bend)))

    def at_tip(ns, values):
        return np.column_stack([np.interp(tip_ns, ns, column) for column in values.T])

    motion, across = at_tip(joint_ns, joints), at_tip(bend_ns, bend)
    rotation = 2.0 * np.arctan2(place[:, 2], place[:, 3]) - motion[:, 2]
    rotation = (rotation + np.pi) % (2.0 * np.pi) - np.pi
    cosine, sine = np.cos(motion[:, 2]), np.sin(motion[:, 2])
    offset = place[:, :2] - motion[:, :2]
    along = np.column_stack([cosine * offset[:, 0] + sine * offset[:, 1],
                             cosine * offset[:, 1] - sine * offset[:, 0]])
    length = float(np.median(along[:, 0] - across[:, 0]))
    share = np.linspace(0.0, 1.0, POINTS)
    reach, begin, end = 3 * share**2 - 2 * share**3, share - 2 * share**2 + share**3, (
        share**3 - share**2)

    def poses(part):
        slope = length * np.column_stack([np.cos(rotation[part]), np.sin(rotation[part])])
        bent = (along[part][:, np.newaxis] * reach[:, np.newaxis]
                + np.array([length, 0.0]) * begin[:, np.newaxis]
                + slope[:, np.newaxis] * end[:, np.newaxis])
        c, s = cosine[part][:, np.newaxis], sine[part][:, np.newaxis]
        line = np.stack([c * bent[..., 0] - s * bent[..., 1],
                         s * bent[..., 0] + c * bent[..., 1]], axis=-1)
        return Poses(motion[part, np.newaxis, :2] + line, motion[part, 2], motion[part, 6:9])

    def trace(panel, names, values):
        return Trace(panel, names, joint_ns, values)

    traces = [
        Trace('tip_deflection', ('w',), bend_ns, lambda part: bend[part, 1:2]),
        Trace('tip_axial', ('u',), bend_ns, lambda part: bend[part, :1]),
        Trace('tip_rotation', ('phi',), tip_ns, rotation[:, np.newaxis].__getitem__),
        *_joint_traces(trace, joints[:, :3], joints[:, 3:6],
                       joints[:, 6:9])]
    body = Body(length, 0.01 * length, 0.06 * length, 0.066 * length, 0.056 * length)
    note = (f'{_span(tip_ns)}. No modal coordinates are on this bag: **the shape of the arm is a '
            'cubic from root to tip pose**, its bodies have no true size, energy is not known.')
    return Track(name, tip_ns, poses, traces, body, note)
