# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The derivatives of steps as a user sees them, and the loads that they are by."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from timo_sim.model.layout import INPUTS, LOADS, TORQUE, VOLTAGE
from timo_sim.scene.parameters import ParameterError
from timo_sim.scene.bodies import motor_constants
from timo_sim.simulation.loads import ARGUMENTS, check_arguments


class StepDerivatives(NamedTuple):
    """
    Derivatives of the motion after some steps, see `Simulator.step_derivatives`.

    `by_motion`[i, j], (2 (3 + N), 2 (3 + N)), is that of its number i by number j of the motion
    before them, `by_input`, (2 (3 + N), k), are by the inputs, each constant during the steps.
    """

    by_motion: np.ndarray
    by_input: np.ndarray


def unit_loads(values: Mapping[str, Any], inputs: Iterable[str]) -> np.ndarray:
    """Return what one of each input adds to a load, shape (k, LOADS); the names are ARGUMENTS."""
    inputs = list(inputs)
    check_arguments(inputs, 'inputs')
    columns = [column for name in inputs for column in np.ravel(ARGUMENTS[name])]
    for each in (INPUTS[column] for column in columns):
        if each.needs and not values[each.needs]:
            raise ParameterError(f'input {each.name} needs {each.needs} > 0, got 0')
    return unit_loads_of(values, columns)


def unit_loads_of(values: Mapping[str, Any], columns: Sequence[int]) -> np.ndarray:
    """Return what one in each of some columns adds to a load; a voltage adds its torque, too."""
    unit = np.zeros((len(columns), LOADS))
    unit[range(len(columns)), columns] = 1.0
    unit[:, TORQUE] += motor_constants(values)[0] * unit[:, VOLTAGE]
    return unit
