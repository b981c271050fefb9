# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Tracks of motions: of a run, of a log of the node, of a plain bag."""

import numpy as np

from timo_sim.scene.loads import CHANNELS
from timo_sim.simulation.energy import integral, work
from timo_sim.view.bag_track import of_bag
from timo_sim.view.track import (
    BLOCK, Body, joint_traces, POINTS, Poses, span, Trace, Track, TrackError)


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
        See `physics.layout`.
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
        *joint_traces(trace, motion[:, :3], motion[:, half:half + 3], effort),
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
    """Return the track of a `Run`."""
    if run.recording is not None:
        return of_recording(run.recording, name)
    ns = np.rint(run.t * 1e9).astype(np.int64)
    return of_motion(name, run.scene, ns, run.motion, run.effort, heat=run.friction_heat)


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
    if scene is None or scene.modal_count and '~/modal_state' not in series:
        return of_bag(recording, name, joints)
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
                size(body.motor_mass, np.pi / 4), size(body.end_effector_mass, np.pi / 6))


def _note(scene, ns):
    values = scene.values
    return (f'formulation `{values["model.formulation"]}`, {values["model.modes"]} modes, step '
            f'{1e3 * scene.step:g} ms; {span(ns)}. The shape of the arm is that of the modal '
            'coordinates.')
