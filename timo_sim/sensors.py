"""What sensors show of true quantities: bias, noise and resolution."""

from functools import lru_cache

import numpy as np

# A place in this list is part of what the random numbers of a sensor depend on.
_SENSORS = 'root_strain', 'tip_acceleration', 'gyro', 'encoder'
_BLOCK = 256  # steps whose random numbers are drawn at once
_EXACT = 2.0**53  # from here on a number is coarser than the resolution


def shown(values, sensor, step, *quantities):
    """
    Return what a sensor shows of what it measures.

    The noise is a function of seed, sensor, axis and time step alone: it does not matter what else
    is measured, nor when.

    Parameters
    ----------
    values : dict
        The scene's parameters, `sensor.gyro.noise` and so on.
    sensor : str
        'root_strain', 'tip_acceleration', 'gyro' or 'encoder'.
    step : int
    *quantities : float
        One for each axis.

    Returns
    -------
    tuple of float

    """
    noise, bias, resolution = (values[f'sensor.{sensor}.{kind}']
                               for kind in ('noise', 'bias', 'resolution'))
    result = []
    for axis, quantity in enumerate(quantities):
        quantity += bias
        if noise:
            quantity += noise * _random(values['sensor.seed'], _SENSORS.index(sensor), axis, step)
        if resolution and abs(quantity) < _EXACT * resolution:
            quantity = resolution * round(quantity / resolution)
        result.append(quantity)
    return tuple(result)


def _random(seed, sensor, axis, step):
    number, place = divmod(step, _BLOCK)
    return _block(seed, sensor, axis, number)[place]


@lru_cache(maxsize=16)
def _block(seed, sensor, axis, number):
    # Standard normal. Philox counts; a block is long before its lowest word overflows.
    bits = np.random.Philox(key=[seed, 2 * sensor + axis], counter=[0, 0, 0, number])
    return np.random.Generator(bits).standard_normal(_BLOCK).tolist()
