# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Memory of a logged day, extrapolated from ten minutes of sim time: a row of doc/speed.md."""

import re
import subprocess
import sys
import tempfile
import threading
import time

import numpy as np

from benchmark.command import parser
from benchmark.process import arguments, ENVIRONMENT

DAY = 86400.0  # [s]
LIMIT = 300.0  # [MB]


def resident(pid):
    """Return the resident memory of a process [MB]."""
    with open(f'/proc/{pid}/status', encoding='utf-8') as file:
        return int(re.search(r'VmRSS:\s+(\d+) kB', file.read())[1]) / 1024.0


def rows(quick=False):
    """Run freely with every step logged; return the row of the table."""
    duration = 60.0 if quick else 600.0
    command = [sys.executable, '-m', 'timo_sim.cli.sim_node', *arguments(
        record=True, record_file='run.mcap', real_time_factor=0.0, duration=duration)]
    seen = []
    with tempfile.TemporaryDirectory() as folder, subprocess.Popen(
            command, env=ENVIRONMENT, cwd=folder, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True) as process:
        reader = threading.Thread(target=lambda: seen.append(process.stdout.read()))
        reader.start()
        samples = []
        while process.poll() is None:
            try:
                samples.append((time.monotonic(), resident(process.pid)))
            except (OSError, TypeError):  # it ends just now
                break
            time.sleep(0.1)
        reader.join()
        if process.returncode:
            raise RuntimeError(seen[0])
    wall = float(re.search(r'simulated \S+ s in (\S+) s', seen[0])[1])
    moments, sizes = np.array(samples).T
    sim_time = (moments - moments[-1] + wall) / wall * duration
    late = sim_time > 0.3 * duration
    growth = np.polyfit(sim_time[late], sizes[late], 1)[0]
    day = sizes[-1] + max(growth, 0.0) * (DAY - duration)
    return [('resident memory after 24 h at 1 kHz, every step of 5 topics logged',
             f'< {LIMIT:g} MB', f'{day:.0f} MB', day < LIMIT,
             f'{sizes[late].max():.0f} MB in {duration:g} s, growth '
             f'{3600.0 * growth:.2g} MB per h of sim time')]


if __name__ == '__main__':
    print(rows(parser(__spec__, __doc__, 'a minute of sim time').parse_args().quick))
