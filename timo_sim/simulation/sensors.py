# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Readings of sensors: true quantities with bias, noise and resolution."""

from functools import lru_cache

import numpy as np

from timo_sim.messages.sensors import SENSORS

_BLOCK = 256  # steps whose random numbers are drawn at once
_EXACT = 2.0**53  # number of resolutions from which on a float is coarser than one


class Sensors:
    """
    The sensors at one step, by name: a float, or an array for a sensor of several axes.

    Parameters
    ----------
    snapshot : Snapshot

    """

    def __init__(self, snapshot):
        self._snapshot = snapshot

    def __dir__(self):
        return [sensor.name for sensor in SENSORS]

    def __getattr__(self, name):
        if name not in dir(self):
            raise AttributeError(f'there is no sensor {name!r}, but {", ".join(dir(self))}')
        axes = self._snapshot.sensor(name)
        return axes[0] if len(axes) == 1 else np.array(axes)


def reading(values, name, number, step, quantities):
    """
    Return the reading of a sensor for the true quantities.

    The noise is a function of seed, sensor, axis and time step alone; other measurements do not
    change it.

    Parameters
    ----------
    values : dict
        The scene's parameters, `sensor.gyro.noise` and so on.
    name : str
    number : int
        Position of the sensor in `SENSORS`.
    step : int
        Number of the time step.
    quantities : tuple of float
        True value on each axis, in the unit of the sensor.

    Returns
    -------
    tuple of float

    """
    noise, bias, resolution = (values[f'sensor.{name}.{kind}']
                               for kind in ('noise', 'bias', 'resolution'))
    result = []
    for axis, quantity in enumerate(quantities):
        quantity += bias
        if noise:
            quantity += noise * _random(values['sensor.seed'], number, axis, step)
        if resolution and abs(quantity) < _EXACT * resolution:
            quantity = resolution * round(quantity / resolution)
        result.append(quantity)
    return tuple(result)


def variance(values, name):
    """Return the variance of a sensor's reading, with a uniform error of rounding."""
    noise, resolution = (values[f'sensor.{name}.{kind}'] for kind in ('noise', 'resolution'))
    return noise**2 + resolution**2 / 12.0


def _random(seed, sensor, axis, step):
    block, place = divmod(step, _BLOCK)
    return _block(seed, sensor, axis, block)[place]


@lru_cache(maxsize=16)
def _block(seed, sensor, axis, block):
    # Standard normal numbers. Each block has its own highest word of Philox's counter, which the
    # count of the lower words never reaches.
    bits = np.random.Philox(key=[seed, 2 * sensor + axis], counter=[0, 0, 0, block])
    return np.random.Generator(bits).standard_normal(_BLOCK).tolist()
