# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The metadata records of a run's log: its parameters and versions, resets, changes, summary."""

from __future__ import annotations

from importlib.metadata import version
import json
import math
import platform
from typing import Any, TYPE_CHECKING

import numpy as np

from timo_sim.version import __version__

if TYPE_CHECKING:  # the import of its module takes longer than `timo_sim info`
    from timo_sim.scene.scene import Scene

START, RESET, SUMMARY = 'timo_sim', 'timo_sim.reset', 'timo_sim.summary'
CHANGE = 'timo_sim.change'
# Versions and hardware that the last bits of a run depend on.
_ENVIRONMENT = ('timo_sim', 'python', 'numpy', 'scipy', 'numba', 'machine', 'processor')


def start_note(node: str, values: dict, changed: dict, scene: Scene) -> dict[str, str]:
    """Return the metadata for the start of a run; `changed` are values other than defaults."""
    return {
        'node': node, 'parameters': _json(values), 'changed': _json(changed),
        'initial_motion': json.dumps(scene.initial_motion().tolist()), **_environment()}


def change_note(step: int, values: dict) -> dict[str, str]:
    """Return the metadata for parameters of the scene that were set while the node runs."""
    return {'step': str(step), 'values': _json(values)}


def names_note(channels: list) -> dict[str, str]:
    """Return the metadata for the names of topics before they were remapped."""
    return {'topics': _json({channel.topic: channel.name for channel in channels})}


def _json(values):
    # A limit may be infinite, and JSON has no infinity; the text is read as a number again.
    return json.dumps({name: str(value) if value in (math.inf, -math.inf) else value
                       for name, value in values.items()})


def step_of(note: dict[str, str]) -> int:
    """Return the step of a reset or change; raise ValueError or KeyError if it has none."""
    if not note['step'].isdecimal() or len(note['step']) > 18:
        raise ValueError('it is not a number of steps')
    return int(note['step'])


def values_of(note: dict[str, str]) -> dict[str, Any]:
    """Return the values of a change by name; raise an error if they cannot be read."""
    return dict(json.loads(note['values']))


def original_names(facts: dict[str, str]) -> dict[str, str]:
    """Return the names of topics before they were remapped, by topic; {} if a log has none."""
    try:
        return {topic: str(name) for topic, name in json.loads(facts['topics']).items()}
    except (KeyError, AttributeError, ValueError, RecursionError):
        return {}


def other_ground(facts: dict[str, str]) -> str:
    """Return in words which versions and hardware differ from those of a log, or ''."""
    return ', '.join(f'{name} {facts[name][:40]} (here {value})'
                     for name, value in _environment().items() if facts.get(name, value) != value)


def made_with(facts: dict[str, str]) -> str:
    """Return in words the versions and hardware that a log was made with."""
    return ', '.join(f'{name} {facts[name][:40]}' for name in _ENVIRONMENT if name in facts)


def _environment():
    from llvmlite.binding import get_host_cpu_name  # steps are compiled for this processor
    return dict(zip(_ENVIRONMENT, (
        __version__, platform.python_version(),
        *(version(package) for package in ('numpy', 'scipy', 'numba')),
        platform.machine(), get_host_cpu_name())))


class Peak:
    """The largest transverse deflection of the tip that was published."""

    def __init__(self) -> None:
        self._found = 0.0, 0.0

    def see(self, numbers: np.ndarray, nanoseconds: int) -> None:
        """Take account of a tip deflection, axial and transverse [m], at a time [ns]."""
        if not abs(numbers[1]) <= self._found[0]:
            self._found = abs(numbers[1]), 1e-9 * nanoseconds

    def note(self) -> dict[str, str]:
        """Return the metadata for it."""
        return {'peak_tip_deflection_m': str(self._found[0]),
                'peak_tip_deflection_at_s': f'{self._found[1]:.9f}'}
