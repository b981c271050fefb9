# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What else a user might take for this manipulator: MuJoCo, in its own way."""

import math
import time

import mujoco
from mujoco import rollout
import numpy as np

from timo_sim.model.layout import END, FORCE_X, FORCE_Y, MIDDLE, START, TORQUE

_CHANNELS = [FORCE_X, FORCE_Y, TORQUE]
_NUMBERS = 2**22  # that a call of `rollout` returns
_DRIVEN = 1e9  # inertia that makes a shaft follow its drive, whatever the arm does [kg m2]


def longest_step(scene, links):
    """Return about the longest stable step of `chain` [s], by its highest frequency."""
    section, length = scene.manipulator.arm.section, scene.manipulator.arm.length / links
    return 1.4 * length**2 / 4.0 * math.sqrt(
        section.mass_per_length / section.bending_stiffness)


def chain(scene, links, step, duration, every, drive=None):
    """
    Simulate a scene by MuJoCo, as a chain of rigid links whose hinges have springs.

    A spring has the bending stiffness over the length of a link, at root and tip over half of it;
    hinges know no shear and no stretch. (The cable of MuJoCo 3, a chain of ball joints, is no
    longer in MuJoCo 4.) Runge-Kutta steps, because the implicit integrators of
    MuJoCo are of first order and damp. Calls of `rollout` do many steps each.

    Parameters
    ----------
    scene : Scene
        At rest and straight at first, with a carrier and shaft both free, or the carrier held.
    links : int
    step, duration : float
        [s]
    every : int
        Steps from sample to sample.
    drive : tuple of function(float) -> float, optional
        theta(t) and its derivatives; theta(0) = 0.

    Returns
    -------
    seconds : float
        CPU time of the steps [s].
    theta, carrier, along, across : ndarray, shapes (n,), (n, 2), (n,), (n,)
        At the samples after the start; the tip in axes of the shaft.

    """
    locked = scene.values['motor.shaft'] == 'locked'
    model = mujoco.MjModel.from_xml_string(_chain_xml(scene, links, step, bool(drive or locked)))
    data, count = mujoco.MjData(model), round(duration / step)
    loads = _mean_loads(scene, count, step)
    if locked:
        loads = np.zeros((count, 1))
    elif drive:
        middle = (np.arange(count) + 0.5) * step
        loads = _DRIVEN * np.array([[drive[2](t)] for t in middle])
    elif len(scene.constraints.free_axes) == 0:
        loads = loads[:, 2:]
    data.qpos[len(loads[0]) - 1] = 0.0 if drive else scene.values['initial.shaft']
    state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    kept, seconds, part = [], 0.0, every * max(1, _NUMBERS // (every * len(state)))
    for first in range(0, count, part):
        begun = time.process_time()
        found, _ = rollout.rollout(model, data, state[np.newaxis],
                                   loads[np.newaxis, first:first + part])
        seconds += time.process_time() - begun
        kept.append(found[0, every - 1::every, 1:1 + model.nq])
        state = found[0, -1]
    position = np.concatenate(kept)
    shaft = loads.shape[1] - 1
    angle = np.cumsum(position[:, shaft + 1:shaft + 1 + links], axis=1)
    length = scene.manipulator.arm.length / links
    carrier = position[:, :2] if shaft else np.zeros((len(position), 2))
    return (seconds, position[:, shaft], carrier, length * np.cos(angle).sum(axis=1),
            length * np.sin(angle).sum(axis=1))


def _mean_loads(scene, count, step):
    # Over each step, (steps, 3).
    loads = scene.load.stages(0, count, step)[:, :, _CHANNELS]
    return (loads[:, START] + 4.0 * loads[:, MIDDLE] + loads[:, END]) / 6.0


def _inertial(mass, inertia, x=0.0):
    inertia = ' '.join(3 * [repr(float(inertia))])
    return f'<inertial pos="{x!r} 0 0" mass="{float(mass)!r}" diaginertia="{inertia}"/>'


def _chain_xml(scene, links, step, driven):
    body, arm = scene.manipulator, scene.manipulator.arm
    section, length = arm.section, arm.length / links
    mass = section.mass_per_length * length
    inertia = section.inertia_per_length * length + mass * length**2 / 12.0
    joint = '<joint type="hinge" axis="0 0 1" stiffness="{!r}"/>'.format
    root = tip = 2.0 * section.bending_stiffness / length
    inner = (f'<body pos="{length!r} 0 0">' + joint(tip) * (body.end_effector_inertia > 0.0)
             + _inertial(max(body.end_effector_mass, 1e-9), max(body.end_effector_inertia, 1e-9))
             + '</body>')
    for link in reversed(range(links)):
        inner = (f'<body pos="{length if link else 0.0!r} 0 0">'
                 + joint(section.bending_stiffness / length if link else root)
                 + _inertial(mass, inertia, length / 2.0) + inner + '</body>')
    slides = [f'<joint name="{name}" type="slide" axis="{axis}"/>' for name, axis in zip(
        'xy', ('1 0 0', '0 1 0'))] if len(scene.constraints.free_axes) else []
    armature = _DRIVEN if driven else 0.0
    gravity = ' '.join(map(repr, map(float, scene.values['gravity'])))
    motors = ''.join(f'<motor joint="{name}"/>' for name in [*'xy'[:len(slides)], 'shaft'])
    return f"""<mujoco><compiler angle="radian"/>
<option timestep="{step!r}" integrator="RK4" gravity="{gravity} 0">
<flag contact="disable" autoreset="disable" energy="disable"/></option>
<worldbody><body>{''.join(slides)}{_inertial(body.base_mass, 1.0)}
<body><joint name="shaft" type="hinge" axis="0 0 1" armature="{armature!r}"/>
{_inertial(1e-9, max(body.shaft_inertia, 1e-9))}{inner}</body></body></worldbody>
<actuator>{motors}</actuator></mujoco>"""
