# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""What a log says of its run: metadata, the messages of ~/scene, and texts that can be printed."""

from collections.abc import Sequence
from functools import cache
from importlib.metadata import version
import json
import math
import os
from pathlib import Path
import platform

from timo_sim.scene.parameters import changed
from timo_sim.topics.cdr import pack
from timo_sim.version import __version__

TEXT = 'std_msgs/msg/String'
START, RESET, SUMMARY = 'timo_sim', 'timo_sim.reset', 'timo_sim.summary'
CHANGE = 'timo_sim.change'
# Versions and hardware that the last bits of a run depend on.
ENVIRONMENT = ('timo_sim', 'python', 'numpy', 'scipy', 'numba', 'machine', 'processor', 'log')
LOG_VERSION = 2  # of what rows hold, see doc/log.md; the first one is not noted


def start_note(node: str, values: dict, channels: Sequence = ()) -> dict[str, str]:
    """Return the metadata for the start of a run of a node with these parameters and channels."""
    return {name: fact if isinstance(fact, str) else json.dumps(fact)
            for name, fact in _facts(node, values, channels).items()}


def change_note(step: int, values: dict) -> dict[str, str]:
    """Return the metadata for what was set while the node runs, as in `Recording.changes`."""
    return {'step': str(step), 'values': json.dumps(_plain(values))}


def scene_message(event: str, step: int, node: str, channels: list, values: dict,
                  given: dict) -> bytes:
    """
    Return what ~/scene says of an event at a step, JSON in a serialised message.

    The event is a start, a reset, or that the values `given` were set, as in `change_note`;
    `values` are the node's parameters from this step on.
    """
    return pack(TEXT, {'data': json.dumps({
        'event': event, 'step': step, 'set': _plain(given), **_facts(node, values, channels)
    }, indent=1)})


def _facts(node, values, channels):
    # Topics have here the names that they had before they were remapped.
    return {'node': node, **_environment(), 'parameters': _plain(values),
            'changed': _plain(changed(values)),
            'topics': {channel.topic: channel.name for channel in channels}}


def _plain(values):
    # A limit may be infinite, and JSON has no infinity; the text is read as a number again.
    return {name: str(value) if value in (math.inf, -math.inf) else value
            for name, value in values.items()}


def original_names(facts: dict[str, str]) -> dict[str, str]:
    """Return the names of topics before they were remapped, by topic; {} if a log has none."""
    try:
        return {topic: str(name) for topic, name in json.loads(facts['topics']).items()}
    except (KeyError, AttributeError, ValueError, RecursionError):
        return {}


def environment_differences(facts: dict[str, str]) -> str:
    """Return in words which versions and hardware differ from those of a log, or ''."""
    return ', '.join(f'{name} {facts[name][:40]} (here {value})'
                     for name, value in _environment().items() if facts.get(name, value) != value)


@cache
def _environment():
    from llvmlite.binding import get_host_cpu_name  # steps are compiled for this processor
    return dict(zip(ENVIRONMENT, (
        __version__, platform.python_version(),
        *(version(package) for package in ('numpy', 'scipy', 'numba')),
        platform.machine(), get_host_cpu_name(), str(LOG_VERSION))))


def printable(path: Path | str) -> str:
    """Return a path as text that can be printed anywhere; on Linux a name may be any bytes."""
    return os.fsencode(path).decode(errors='replace')


def plain(text: str) -> str:
    """Return a text of a file without control characters, which a terminal would obey."""
    return ''.join(char if char.isprintable() else ' ' for char in text)
