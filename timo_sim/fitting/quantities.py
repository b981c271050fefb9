# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The quantities of a record: inputs, which act on the manipulator, and outputs, which show it."""

from typing import Callable, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from timo_sim.physics.layout import rotate, TIP_TORQUE, TIP_X, TIP_Y
from timo_sim.scene.loads import CHANNELS
from timo_sim.simulation.joints import root_strain

DRIVE = 'drive'


class Output(NamedTuple):
    """A measured quantity."""

    unit: str
    meaning: str
    of_run: Callable  # from a Run to the quantity at its samples, shape (n,)


def _tip(run, axis):
    return run.deflection(run.scene.manipulator.arm.length)[:, axis]


def _tip_angle(run):
    length = run.scene.manipulator.arm.length
    return np.arctan2(_tip(run, 1), length + _tip(run, 0))


def _place(run, axis):
    return run.position(run.scene.manipulator.arm.length)[:, axis]


def _rate(run, values):
    # Of a spline through the samples: a run has thousands, and no friction needs to be known.
    return CubicSpline(run.t, values).derivative()(run.t) if len(run.t) > 3 else np.gradient(
        values, run.t, axis=0)


def _root_strain(run):
    """Return the strain at the root from the arm's angular momentum about it, shape (n,)."""
    model, half = run.model, run.motion.shape[1] // 2
    velocity, turning = model.velocities(run.motion, model.points)
    place = model.world(run.motion, model.points) - run.carrier[:, np.newaxis]
    linear = np.einsum('p,npi->ni', model.point_mass, velocity)
    angular = (_cross(place, velocity) @ model.point_mass + turning @ model.point_inertia)
    load = run.loads()
    tip = np.column_stack([load[:, TIP_X], load[:, TIP_Y]])
    moment = (_rate(run, angular) + _cross(run.motion[:, half:half + 2], linear)
              - _cross(np.einsum('p,npi->ni', model.point_mass, place), model.gravity)
              - _cross(place[:, -1], tip) - load[:, TIP_TORQUE])
    per_moment, per_q, per_rate = root_strain(model)
    return run.q @ per_q + run.qdot @ per_rate - per_moment * moment


def _tip_acceleration(run):
    """Return the specific force across the tip, shape (n,) [m/s2]."""
    model = run.model
    x, y = (_rate(run, model.velocities(run.motion, model.tip_point)[0][:, 0])
            - model.gravity).T
    turned = run.shaft + run.rotation(run.scene.manipulator.arm.length)
    return rotate(-turned, x, y)[1]


def _cross(first, second):
    return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]


# By name, the unit of an input.
INPUTS = {**{name: 'N m' if 'torque' in name else 'N' for name in CHANNELS}, 'voltage': 'V',
          DRIVE: 'rad'}
OUTPUTS = {
    'shaft': Output('rad', 'angle of the shaft', lambda run: run.shaft),
    'shaft_velocity': Output('rad/s', 'speed of the shaft', lambda run: run.shaft_velocity),
    'carrier_x': Output('m', 'position of the carrier', lambda run: run.carrier[:, 0]),
    'carrier_y': Output('m', 'position of the carrier', lambda run: run.carrier[:, 1]),
    'tip_x': Output('m', 'position of the tip, world axes', lambda run: _place(run, 0)),
    'tip_y': Output('m', 'position of the tip, world axes', lambda run: _place(run, 1)),
    'tip_transverse': Output('m', 'deflection of the tip across the arm',
                             lambda run: _tip(run, 1)),
    'tip_angle': Output('rad', 'direction of the tip as seen from the root, straight arm: 0',
                        _tip_angle),
    'tip_rotation': Output('rad', 'rotation of the end effector relative to the shaft',
                           lambda run: run.rotation(run.scene.manipulator.arm.length)),
    'root_strain': Output('', 'strain of the outer fibre at the root',
                          _root_strain),
    'tip_acceleration': Output('m/s2', 'specific force on the tip across it, as an accelerometer '
                               'shows it', _tip_acceleration),
}
UNITS = {
    'rad': {'rad': 1.0, 'mrad': 1e-3, 'deg': np.pi / 180.0, 'turn': 2.0 * np.pi},
    'rad/s': {'rad/s': 1.0, 'deg/s': np.pi / 180.0, 'rpm': np.pi / 30.0},
    'm': {'m': 1.0, 'cm': 1e-2, 'mm': 1e-3, 'um': 1e-6},
    'm/s2': {'m/s2': 1.0, 'g': 9.80665},
    's': {'s': 1.0, 'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9},
    'N': {'N': 1.0, 'mN': 1e-3}, 'N m': {'N m': 1.0, 'mN m': 1e-3}, 'V': {'V': 1.0, 'mV': 1e-3},
    '': {'': 1.0, 'strain': 1.0, 'microstrain': 1e-6},
}


def unit_of(name):
    """Return the unit of a quantity, of which all numbers inside are."""
    return INPUTS[name] if name in INPUTS else OUTPUTS[name].unit
