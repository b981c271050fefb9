# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Full disks, and paths where no log can be: a recorder must say so in one line."""

import os
from pathlib import Path
import resource
import shutil
import subprocess
import sys

from benchmark.stress.tally import ensure, small_disk, Tally
from oracles.logs import CHANNELS, outcome
from timo_sim.log.write import Recorder


def full_disks(folder, quick):
    """Let the disk be full at many places of a log."""
    tally = Tally('disk full while recording')
    with small_disk(folder, 4 << 20) as disk:
        ballast = disk / 'ballast' if disk else None
        for size in range(4096, 120000, 16384 if quick else 2048):
            with tally.trial(f'{size} bytes free'):
                path = (disk or folder) / f'{size}.mcap'
                if ballast:
                    ballast.unlink(missing_ok=True)
                    free = shutil.disk_usage(disk).free
                    ballast.write_bytes(bytes(free - size))
                error = _record_on(path, None if disk else size)
                ensure(error, 'the log is whole')
                if path.exists():
                    ensure(outcome(_copied(path, folder)) == 'recovered', 'nothing is left')
                    path.unlink()
    return tally.row('tmpfs' if disk else 'RLIMIT_FSIZE: mounting is not allowed')


def _copied(path, folder):
    return Path(shutil.copy(path, folder / 'copied.mcap'))


FILL = """
import os, sys
sys.path[:0] = sys.argv[2:]
import resource, signal
from oracles.logs import CHANNELS, Recorder
if sys.argv[1] != 'None':
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
try:
    recorder = Recorder(os.environ['RUN'], CHANNELS, {'timo_sim': {'parameters': '{}'}})
except OSError as error:
    print(error)
else:
    for step in range(4000):
        recorder.write(0, step, step, os.urandom(100))
    recorder.close()
    print(recorder.error or '')
"""


def _record_on(path, limit=None, **limits):
    """Record more than 400 kB in a process of its own; return the recorder's error."""
    done = subprocess.run(
        [sys.executable, '-c', FILL, str(limit), *sys.path], capture_output=True, text=True,
        timeout=60.0, env={**os.environ, 'RUN': str(path)}, **limits)
    ensure(not done.returncode, done.stderr)
    return done.stdout.strip()


def places_that_are_none(folder):
    """Record to paths where no log can be."""
    tally = Tally('log on an impossible path: a folder, read-only, below a file, no descriptor')
    (folder / 'file').write_text('a file')
    (folder / 'taken').mkdir()
    cases = {'below a file': folder / 'file' / 'run.mcap', 'a folder': folder / 'taken',
             'a name too long': folder / ('x' * 300), 'no such device': Path('/proc/run.mcap'),
             'a full device': Path('/dev/full/run.mcap')}
    for name, path in cases.items():
        with tally.trial(name):
            error = _record_on(path)
            ensure(error and '\n' not in error, f'not one line: {error!r}')
    with tally.trial('a read-only disk'), small_disk(folder, 1 << 20) as disk:
        if disk:
            subprocess.run(['mount', '-o', 'remount,ro', disk], check=True)
            ensure('Read-only' in _record_on(disk / 'run.mcap'), 'it is written')
    with tally.trial('no file descriptor'):
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        Recorder(folder / 'first.mcap', CHANNELS, {}).close()
        last = os.dup(0)
        os.close(last)
        resource.setrlimit(resource.RLIMIT_NOFILE, (last, hard))
        try:
            Recorder(folder / 'run.mcap', CHANNELS, {})
            raise RuntimeError('it is opened')
        except OSError as error:
            ensure('Too many open files' in str(error), str(error))
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    return tally.row('one line each')
