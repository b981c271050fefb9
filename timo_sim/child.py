# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Processes that do a part of the work of this one."""

import os
import subprocess
import sys

from timo_sim.version import __version__

_SAME_VERSION = f"""\
import sys
from timo_sim.version import __version__ as found
if found != {__version__!r}:
    sys.exit(f'timo_sim: this run began with version {__version__}, and {{found}} is installed '
             'now: start it anew')
"""


def start_python(code, *arguments, env=None, **options):
    """
    Start a process of Python that executes `code` and imports from where this process does.

    It imports nothing from the working directory, unless this process does, and ends at once with
    code 1 if it finds another version of this package than that of this process.

    Parameters
    ----------
    code : str
    *arguments : str
        Its `sys.argv[1:]`.
    env : dict, optional
        Variables of the environment besides those of this process.
    **options
        Of `subprocess.Popen`.

    Returns
    -------
    subprocess.Popen

    """
    path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    return subprocess.Popen([sys.executable, '-P', '-c', _SAME_VERSION + code, *arguments],
                            env={**os.environ, **(env or {}), 'PYTHONPATH': path}, **options)
