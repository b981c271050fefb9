# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What else a user might take for this manipulator: MuJoCo and PyElastica, in their own ways."""

import math
import time

import elastica
import mujoco
from mujoco import rollout
import numpy as np

from timo_sim.physics.layout import END, FORCE_X, FORCE_Y, MIDDLE, START, TORQUE

_CHANNELS = [FORCE_X, FORCE_Y, TORQUE]
_NUMBERS = 2**22  # that a call of `rollout` returns
_DRIVEN = 1e9  # inertia that makes a shaft follow its drive, whatever the arm does [kg m2]


def longest_step(scene, hinged, parts):
    """Return about the longest stable step of `chain` (hinged) or `rod` [s]."""
    section, length = scene.manipulator.arm.section, scene.manipulator.arm.length / parts
    if hinged:  # the highest frequency of the chain
        return 1.4 * length**2 / 4.0 * math.sqrt(
            section.mass_per_length / section.bending_stiffness)
    # A wave of stretch from node to node, or a section that turns against the centre line.
    return min(0.9 * length * math.sqrt(
        section.mass_per_length / (section.young_modulus * section.area)),
        1.8 * math.sqrt(section.inertia_per_length / section.shear_stiffness))


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
        At rest and straight at first.
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
    model = mujoco.MjModel.from_xml_string(_chain_xml(scene, links, step, drive is not None))
    data, count = mujoco.MjData(model), round(duration / step)
    loads = _mean_loads(scene, count, step)
    if drive:
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
    motors = ''.join(f'<motor joint="{name}"/>' for name in [*'xy'[:len(slides)], 'shaft'])
    return f"""<mujoco><compiler angle="radian"/>
<option timestep="{step!r}" integrator="RK4" gravity="0 0 0">
<flag contact="disable" autoreset="disable" energy="disable"/></option>
<worldbody><body>{''.join(slides)}{_inertial(body.base_mass, 1.0)}
<body><joint name="shaft" type="hinge" axis="0 0 1" armature="{armature!r}"/>
{_inertial(1e-9, max(body.shaft_inertia, 1e-9))}{inner}</body></body></worldbody>
<actuator>{motors}</actuator></mujoco>"""


class _Rods(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing,
            elastica.CallBacks):
    """What the simulation is made of."""


class _Loads(elastica.NoForces):
    """Forces on the root and a torque on the first element, with a value for each step."""

    def __init__(self, loads, step):
        self._loads, self._step = loads.tolist(), step

    def apply_forces(self, system, time=0.0):
        """Add the forces of the step in whose middle this is called."""
        x, y, _ = self._loads[int(time / self._step)]
        system.external_forces[0, 0] += x
        system.external_forces[1, 0] += y

    def apply_torques(self, system, time=0.0):
        """Add the torque; the first director is normal to the plane."""
        system.external_torques[0, 0] += self._loads[int(time / self._step)][2]


class _Root(elastica.ConstraintBase):
    """Holds the first node; its element, too, if the shaft is driven."""

    def __init__(self, position, director, drive, **given):
        super().__init__(**given)
        self._drive = drive

    def constrain_values(self, system, time):
        """Set position and directors."""
        system.position_collection[:, 0] = 0.0
        if self._drive:
            angle = self._drive[0](float(time))
            cosine, sine = math.cos(angle), math.sin(angle)
            system.director_collection[:, :, 0] = [[0.0, 0.0, 1.0], [-sine, cosine, 0.0],
                                                   [cosine, sine, 0.0]]

    def constrain_rates(self, system, time):
        """Set velocity and angular velocity."""
        system.velocity_collection[:, 0] = 0.0
        if self._drive:
            system.omega_collection[:, 0] = self._drive[1](float(time)), 0.0, 0.0


class _Samples(elastica.CallBackBaseClass):
    """Keeps root, directors of the first element and tip."""

    def __init__(self, every, kept):
        self._every, self._kept = every, kept

    def make_callback(self, system, time, current_step):
        """Keep a sample."""
        if current_step and current_step % self._every == 0:
            self._kept.append(np.concatenate([
                system.position_collection[:2, 0], system.position_collection[:2, -1],
                system.director_collection[2, :2, 0]]))


def rod(scene, elements, step, duration, every, drive=None):
    """
    Simulate a scene by PyElastica, a Cosserat rod with all strains in explicit steps.

    Carrier and end effector are mass added to the outer nodes, shaft and end effector inertia
    added to the outer elements. Parameters and results are those of `chain`.
    """
    body, arm = scene.manipulator, scene.manipulator.arm
    section, angle = arm.section, 0.0 if drive else scene.values['initial.shaft']
    along = np.array([math.cos(angle), math.sin(angle), 0.0])
    one = elastica.CosseratRod.straight_rod(
        elements, np.zeros(3), along, np.array([0.0, 0.0, 1.0]), arm.length,
        math.sqrt(section.area / math.pi), section.mass_per_length / section.area,
        youngs_modulus=section.young_modulus, shear_modulus=section.young_modulus / 3.0)
    length = arm.length / elements
    stretch = section.young_modulus * section.area
    one.shear_matrix[:] = np.diag([section.shear_stiffness, section.shear_stiffness, stretch]
                                  )[:, :, np.newaxis]
    one.bend_matrix[0, 0] = section.bending_stiffness
    inertia = one.mass_second_moment_of_inertia
    inertia[0, 0] = section.inertia_per_length * length
    inertia[0, 0, 0] += body.shaft_inertia
    inertia[0, 0, -1] += body.end_effector_inertia
    for element in range(elements):
        one.inv_mass_second_moment_of_inertia[:, :, element] = np.linalg.inv(
            inertia[:, :, element])
    one.mass[0] += body.base_mass
    one.mass[-1] += body.end_effector_mass
    count, kept, rods = round(duration / step), [], _Rods()
    rods.append(one)
    if len(scene.constraints.free_axes) == 0:
        rods.constrain(one).using(_Root, constrained_position_idx=(0,),
                                  constrained_director_idx=(0,), drive=drive)
    if not drive:
        rods.add_forcing_to(one).using(_Loads, _mean_loads(scene, count, step), step)
    rods.collect_diagnostics(one).using(_Samples, every, kept)
    rods.finalize()
    stepper = elastica.PositionVerlet()
    begun = time.process_time()
    with np.errstate(all='ignore'):
        for k in range(count):
            stepper.step(rods, k * step, step)
    seconds = time.process_time() - begun
    root, tip, tangent = np.split(np.array(kept), 3, axis=1)
    cosine, sine = tangent.T
    theta = np.unwrap(np.arctan2(sine, cosine))
    x, y = (tip - root).T
    return seconds, theta, root, cosine * x + sine * y, cosine * y - sine * x
