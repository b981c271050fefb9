# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Starts and ends the Python processes and nodes that speed and stress measure."""

from contextlib import contextmanager
import os
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
    values = {'record': False, 'publish_clock': True,
              **{f'rate.{topic}': rate for topic in RATES}, **parameters}
    given = [f'{name}:={str(value).lower() if isinstance(value, bool) else value}'
             for name, value in values.items()]
    return ['--ros-args', '--params-file', str(ROOT / 'config' / 'paper.yaml'),
            *(word for value in given for word in ('-p', value))]


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
