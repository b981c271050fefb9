# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Errors of sensors, of a scene's values."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from timo_sim.compiled.constants import pack, Packed
from timo_sim.steps.sensors import SensorErrors
from timo_sim.topics.outputs import SENSORS, title


def errors_of(values: Mapping[str, Any]) -> Packed:
    """Return the `SensorErrors` of the axes of SENSORS, in their order."""
    axes = [(2 * number + axis, f'sensor.{sensor.name}', f'sensor.{title(sensor.topic)}.delay')
            for number, sensor in enumerate(SENSORS) for axis in range(len(sensor.columns))]
    keys, names, delays = zip(*axes)
    noise, bias, resolution = (np.array([values[f'{name}.{kind}'] for name in names])
                               for kind in ('noise', 'bias', 'resolution'))
    late = np.array([values[delay] for delay in delays]) / values['integrator.step']
    return pack(SensorErrors(seed=values['sensor.seed'], key=np.array(keys), noise=noise,
                             bias=bias, resolution=resolution, delay=np.rint(late)))
