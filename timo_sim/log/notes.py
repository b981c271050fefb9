# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Metadata records of a log, `timo_sim` and others: facts about a run besides its messages."""

from importlib.metadata import version
import json
import math
import platform
from typing import NamedTuple

from timo_sim.log.records import LogError
from timo_sim.scene.values import current
from timo_sim.version import __version__

START, RESET, SUMMARY = 'timo_sim', 'timo_sim.reset', 'timo_sim.summary'
CHANGE = 'timo_sim.change'
# Versions and hardware that the last bits of a run depend on.
_ENVIRONMENT = ('timo_sim', 'python', 'numpy', 'scipy', 'numba', 'machine', 'processor')


class LogNotes(NamedTuple):
    """The metadata of a log."""

    facts: dict    # texts noted at the start of the run; empty if there are none
    summary: dict  # texts noted at its end; empty if there are none
    resets: list   # (step, place in the file) of each
    changes: list  # (step, place, values by name) of each setting of the scene's parameters


def read_notes(index):
    """Return the LogNotes of an Index; raise LogError if they cannot be read."""
    starts, summary, resets, changes = [], {}, [], []
    for place, record in index.metadata():
        content = record.metadata
        try:
            if record.name == START:
                starts.append(content)
            elif record.name == SUMMARY:
                summary = content
            elif record.name == RESET:
                resets.append((_step(content), place))
            elif record.name == CHANGE:
                changes.append((_step(content), place, current(dict(
                    json.loads(content['values'])))))
        except (KeyError, TypeError, ValueError, RecursionError):
            raise LogError(f'{index.name} has a malformed metadata record {record.name}: '
                           f'{str(content)[:80]!r}') from None
    if any(content != starts[0] for content in starts):
        raise LogError(f'{index.name} has the notes of several runs')
    return LogNotes(starts[0] if starts else {}, summary, sorted(resets),
                    sorted(changes, key=lambda entry: entry[:2]))


def _step(content):
    step = content['step']
    if not step.isdecimal() or len(step) > 18:
        raise ValueError('it is not a number of steps')
    return int(step)


def change_note(step, values):
    """Return the metadata for parameters of the scene that were set while the node runs."""
    return {'step': str(step), 'values': _json(values)}


def _json(values):
    # A limit may be infinite, and JSON has no infinity; the text is read as a number again.
    return json.dumps({name: str(value) if value in (math.inf, -math.inf) else value
                       for name, value in values.items()})


def start_note(node, values, changed, scene):
    """Return the metadata for the start of a run; `changed` are values other than defaults."""
    return {
        'node': node, 'parameters': _json(values), 'changed': _json(changed),
        'initial_motion': json.dumps(scene.initial_motion().tolist()), **_here()}


def names_note(channels):
    """Return the metadata for the names of topics before they were remapped."""
    return {'topics': _json({channel.topic: channel.name for channel in channels})}


def read_names(facts):
    """Return the names of topics before they were remapped, by topic; {} if a log has none."""
    try:
        return {topic: str(name) for topic, name in json.loads(facts['topics']).items()}
    except (KeyError, AttributeError, ValueError, RecursionError):
        return {}


def other_ground(facts):
    """Return in words which versions and hardware differ from those of a log, or ''."""
    return ', '.join(f'{name} {facts[name][:40]} (here {value})'
                     for name, value in _here().items() if facts.get(name, value) != value)


def made_with(facts):
    """Return in words the versions and hardware that a log was made with."""
    return ', '.join(f'{name} {facts[name][:40]}' for name in _ENVIRONMENT if name in facts)


class Peak:
    """The largest transverse deflection of the tip that was published."""

    def __init__(self):
        self._found = 0.0, 0.0

    def see(self, numbers, nanoseconds):
        """Take account of a tip deflection, axial and transverse [m], at a time [ns]."""
        if not abs(numbers[1]) <= self._found[0]:
            self._found = abs(numbers[1]), 1e-9 * nanoseconds

    def note(self):
        """Return the metadata for it, a dictionary of str."""
        return {'peak_tip_deflection_m': str(self._found[0]),
                'peak_tip_deflection_at_s': f'{self._found[1]:.9f}'}


def _here():
    from llvmlite.binding import get_host_cpu_name  # steps are compiled for this processor
    return dict(zip(_ENVIRONMENT, (
        __version__, platform.python_version(),
        *(version(package) for package in ('numpy', 'scipy', 'numba')),
        platform.machine(), get_host_cpu_name())))
