# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Starts and ends the Python processes and nodes that speed and stress measure."""

from contextlib import contextmanager
import os
from pathlib import Path
import re
import resource
import shutil
import signal
import subprocess
import sys
from tempfile import TemporaryFile
import time

from benchmark import ROOT
from oracles.domains import own_domain

RATES = ('joint_states', 'modal_state', 'tip_deflection', 'tip_pose', 'carrier_pose', 'clock')
# No other node shall listen; a start reads the byte code that an earlier one wrote; and
# `python -m benchmark...` is found from any folder.
ENVIRONMENT = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
               'ROS_DOMAIN_ID': str(own_domain()), 'PYTHONPATH': os.pathsep.join(
                   [str(ROOT), *filter(None, [os.environ.get('PYTHONPATH')])])}
ENVIRONMENT.pop('PYTHONDONTWRITEBYTECODE', None)
LONGEST = 300.0  # [s] that end a hang, on a busy machine, too


def arguments(rate=1000.0, **parameters):
    """Return the command line of a node with all topics at one rate [Hz]."""
    return ['--ros-args', '--params-file', str(ROOT / 'config' / 'paper.yaml'), *options(**{
        'record': False, 'publish_clock': True, **{f'rate.{topic}': rate for topic in RATES},
        **parameters})]


def options(**parameters):
    """Return the words of a command line that give parameters to a node."""
    return [word for name, value in parameters.items() for word in (
        '-p', f'{name}:={str(value).lower() if isinstance(value, bool) else value}')]


class Process(subprocess.Popen):
    """A Python process, which keeps what it prints in a file."""

    def __init__(self, arguments, **options):
        self._output = TemporaryFile()
        super().__init__([sys.executable, *arguments], stdout=self._output,
                         stderr=subprocess.STDOUT, **options)

    def said(self):
        """Return what it has printed so far."""
        file = self._output.fileno()  # the process writes where this file is: it must stay there
        return os.pread(file, os.fstat(file).st_size, 0).decode(errors='replace')

    def finish(self):
        """Wait for its end; raise RuntimeError with what it has printed if its code is not 0."""
        if self.wait():
            raise self.error()

    def error(self):
        """Return the RuntimeError of its end, with its code and what it has printed."""
        return RuntimeError(f'code {self.returncode} of {self.args!r}:\n{self.said()}')


@contextmanager
def running(arguments, **options):
    """Start a Process, and end it, even if it is stopped."""
    process = Process(arguments, **options)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGCONT)
            process.terminate()
        process.wait()


def wait(done, *needed):
    """
    Wait until `done()` is true, and return what it is.

    Raises RuntimeError with what a needed Process has printed, if one ends before that, and
    TimeoutError with what they all have, if it takes more than `LONGEST` seconds.
    """
    end = time.monotonic() + LONGEST
    while True:
        dead = [process for process in needed if process.poll() is not None]
        if found := done():
            return found
        if dead:
            raise dead[0].error()
        if time.monotonic() > end:
            raise TimeoutError('\n'.join(process.said() for process in needed))
        time.sleep(0.02)


def install(folder, *kind):
    """
    Copy the package to a folder as pip installs it, with machine code and byte code.

    `kind` may be 'editable', for the machine code of the default scene alone. Returns the
    processor time that machine code takes [s].
    """
    package = Path(folder, 'timo_sim')
    shutil.copytree(ROOT / 'config', Path(folder, 'config'))
    shutil.copytree(ROOT / 'timo_sim', package,
                    ignore=shutil.ignore_patterns('prebuilt', '__pycache__'))
    spent = processor_time(lambda: subprocess.run(
        [sys.executable, '-m', 'timo_sim.export.prebuilt', package / 'compiled' / 'prebuilt',
         *kind], check=True, cwd=ROOT,
        # The store of this user may have it already.
        env={**os.environ, 'NUMBA_CACHE_DIR': str(Path(folder, 'store'))}))
    subprocess.run([sys.executable, '-m', 'compileall', '-q', folder], check=True)
    return spent


def processor_time(work):
    """Return the processor time of the processes that a call starts, and ends [s]."""
    def spent():
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime
    begun = spent()
    work()
    return spent() - begun


def resident(pid):
    """Return the memory that a process has in use [B], 0 if it has ended."""
    try:
        found = re.search(r'VmRSS:\s+(\d+)', Path(f'/proc/{pid}/status').read_text())
    except OSError:
        return 0
    return 1024 * int(found[1]) if found else 0
