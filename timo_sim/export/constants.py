# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Constants of an exported arm, from a scene; what cannot be exported is refused here by name."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from timo_sim.export.instance import Plant
from timo_sim.model.layout import INPUTS
from timo_sim.scene.parameters import ParameterError, PARAMETERS
from timo_sim.scene.scene import Scene
from timo_sim.simulation.finer import choose_parts, EstimatingSimulator
from timo_sim.simulation.loads import added_load, tip_of
from timo_sim.simulation.simulator import MOST_BENT, Simulator


class Quantity(NamedTuple):
    """An input or an output of the library."""

    title: str
    unit: str
    meaning: str
    column: int = 0  # of a load, for an input


class Limit(NamedTuple):
    """A parameter of the library that can be set: a limit of inputs or of their rates."""

    title: str
    unit: str
    meaning: str
    of_rate: bool
    begin: int  # first column of a load whose commands it limits
    end: int    # column after the last one
    start: float  # its value in the scene


class Interface(NamedTuple):
    """The inputs, outputs and parameters of a library, and the steps of its finer run."""

    inputs: list[Quantity]
    outputs: list[Quantity]
    parameters: list[Limit]
    parts: int  # of a step of the finer run; 0: there is none


def refuse(scene: Scene, estimate: bool) -> None:
    """Raise ParameterError if a scene has what an exported arm cannot do."""
    values, sectors = scene.values, scene.build().sectors
    if accuracy := values['model.accuracy']:
        raise ParameterError(f'model.accuracy must be 0 to be exported, got {accuracy}: state '
                             'model.modes and integrator.step')
    if sectors and (axial := values['model.axial_modes']):
        raise ParameterError('model.axial_modes must be 0 with one axis held and a shaft that '
                             f'turns to be exported, got {axial}: the linear parts would take '
                             'tens of megabytes')
    if estimate and sectors:
        raise ParameterError('estimate must be false with one axis of the carrier held and a '
                             'shaft that turns: linear parts of a finer model with an axial mode '
                             'would take tens of megabytes')


def interface_of(scene: Scene, estimate: bool) -> Interface:
    """Return the inputs and outputs of a scene's library."""
    held = scene.values['carrier.held']
    inputs = [Quantity(each.name, each.unit, each.meaning, column)
              for column, each in enumerate(INPUTS)
              if each.group and not (each.needs and not scene.values[each.needs])
              and (each.group != 'base' or held in (each.name[-1], 'both'))]
    position, speed = 'carrier_x carrier_y shaft'.split(), 'm m rad'.split()
    modes = range(1, 1 + len(scene.build().modes))
    outputs = [
        Quantity('time', 's', 'sim time'),
        *(Quantity(name, unit, meaning) for name, unit, meaning in zip(position, speed, (
            'carrier position along world x', 'carrier position along world y',
            'shaft angle, not wrapped'))),
        *(Quantity(f'{name}_velocity', f'{unit}/s', f'rate of {name}')
          for name, unit in zip(position, speed)),
        Quantity('tip_x', 'm', 'tip position along world x'),
        Quantity('tip_y', 'm', 'tip position along world y'),
        Quantity('tip_rotation', 'rad', 'rotation of the end effector in the world'),
        Quantity('tip_axial', 'm', 'deflection of the tip along the arm'),
        Quantity('tip_transverse', 'm', 'deflection of the tip across the arm'),
        Quantity('tip_turning', 'rad/s', 'angular velocity where the IMU is; of a gyro'),
        Quantity('encoder', 'rad', 'shaft angle; of an encoder'),
        Quantity('rotor', 'rad', 'angle of the rotor over the gear ratio; of an encoder'),
        Quantity('tip_acceleration_x', 'm/s2', 'specific force (acceleration less gravity) along '
                 'the arm where the IMU is, by default the tip; of an accelerometer'),
        Quantity('tip_acceleration_y', 'm/s2', 'the same across its axis'),
        Quantity('root_strain', '', 'strain of the outer fibre; of a strain gauge'),
        Quantity('carrier_x_force', 'N', 'force of loads along world x, of what holds it if held'),
        Quantity('carrier_y_force', 'N', 'force of loads along world y, of what holds it if held'),
        Quantity('shaft_torque', 'N m', 'torque of loads, of what holds or drives it if not free'),
        Quantity('energy', 'J', 'kinetic plus strain energy and the potential of gravity'),
        *(Quantity(f'mode_{n}', 'm sqrt(kg)', 'modal coordinate') for n in modes),
        *(Quantity(f'mode_{n}_rate', 'm sqrt(kg)/s', 'its rate') for n in modes),
        Quantity('imu_rotation', 'rad', 'rotation in the world where the IMU is')]
    if estimate:
        outputs.append(Quantity('estimated_tip_error', 'm', 'largest distance so far from the tip '
                                'of a finer run; NaN if that diverged'))
    return Interface(inputs, outputs, _limits(inputs, scene.values),
                     choose_parts(scene)[0] if estimate else 0)


def _limits(inputs, values):
    columns: dict[tuple[str, bool], list[int]] = {}
    for each in inputs:
        for name, of_rate in ((INPUTS[each.column].limit, False),
                              (INPUTS[each.column].rate_limit, True)):
            if name:
                columns.setdefault((name, of_rate), []).append(each.column)
    return [Limit(title=name.replace('.', '_'), unit=PARAMETERS[name].unit,
                  meaning=PARAMETERS[name].meaning, of_rate=of_rate, begin=min(limited),
                  end=max(limited) + 1, start=values[name])
            for (name, of_rate), limited in columns.items()]


def simulators_of(scene: Scene, estimate: bool) -> list[Simulator]:
    """Return a Simulator of a scene and, if its error is estimated, the finer one."""
    if not estimate:
        return [Simulator(scene)]
    simulator = EstimatingSimulator(scene)
    return [simulator, simulator.finer]


def plant_of(simulator: Simulator, interface: Interface) -> Plant:
    """Return the constants of a model and its start."""
    scene, model = simulator.scene, simulator.model
    tips = [tip_of(scene), *(tip for _, *tip in scene.payloads)]
    rested = scene.values['end_effector.pick_up'] == 'at_rest'
    return Plant(
        step=scene.step, length=model.tip_point.lever[0],
        most_bent=MOST_BENT * model.manipulator.arm.length, travel=model.tip_travel[3:],
        imu_rotation=model.imu_point.rotation[:, 0], points_rotation=model.points.rotation,
        gravity=model.gravity, linear=model.linear,
        start=model.state(scene.initial_motion(model)), first_load=simulator.load,
        first_friction=simulator.integration.memory.copy(),
        changes=np.array([step for step, *_ in scene.payloads], dtype=np.int64),
        added=rested * np.reshape([added_load(*each) for each in pairwise(tips)], (-1, 3)),
        columns=np.array([each.column for each in interface.inputs], dtype=np.int64),
        limits=np.array([[each.of_rate, each.begin, each.end] for each in interface.parameters],
                        dtype=np.int64).reshape(-1, 3))
