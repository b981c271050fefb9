# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Starts and ends the Python processes and nodes that speed and stress measure."""

from contextlib import contextmanager
import os
from pathlib import Path
import re
import signal
import subprocess
import sys

from benchmark import ROOT
from oracles.domains import own_domain

RATES = ('joint_states', 'modal_state', 'tip_deflection', 'tip_pose', 'carrier_pose', 'clock')
# No other node shall listen; a start reads the byte code that an earlier one wrote; and
# `python -m benchmark...` is found from any folder.
ENVIRONMENT = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
               'ROS_DOMAIN_ID': str(own_domain()), 'PYTHONPATH': os.pathsep.join(
                   [str(ROOT), *filter(None, [os.environ.get('PYTHONPATH')])])}
ENVIRONMENT.pop('PYTHONDONTWRITEBYTECODE', None)


def arguments(rate=1000.0, **parameters):
    """Return the command line of a node with all topics at one rate [Hz]."""
    return ['--ros-args', '--params-file', str(ROOT / 'config' / 'paper.yaml'), *options(**{
        'record': False, 'publish_clock': True, **{f'rate.{topic}': rate for topic in RATES},
        **parameters})]


def options(**parameters):
    """Return the words of a command line that give parameters to a node."""
    return [word for name, value in parameters.items() for word in (
        '-p', f'{name}:={str(value).lower() if isinstance(value, bool) else value}')]


@contextmanager
def running(arguments, **options):
    """Start a Python process, and end it, even if it is stopped."""
    process = subprocess.Popen([sys.executable, *arguments], text=True, **options)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)
            process.terminate()
        if process.stdout is None or not process.stdout.closed:  # a reader closes it at its end
            process.communicate()
        process.wait()


def resident(pid):
    """Return the memory that a process has in use [B], 0 if it has ended."""
    try:
        found = re.search(r'VmRSS:\s+(\d+)', Path(f'/proc/{pid}/status').read_text())
    except OSError:
        return 0
    return 1024 * int(found[1]) if found else 0
