# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Faults that logs must survive: killed nodes, damage, full disks.

A fault is survived if the simulation goes on unharmed and what was written is readable, or if the
file is refused in one line. Tests try some of each, and files that were forged, rewritten by other
tools, or are on impossible paths.
"""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
import os
from pathlib import Path
import random
import shutil
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

from mcap.reader import make_reader

from benchmark import ROOT
from benchmark.process import arguments, ENVIRONMENT
from oracles.logs import decoded, outcome, record
import timo_sim
from timo_sim.log.read import LogError, recover

NODES = 4              # that live at the same time
LIFE = 3.0             # [s] of a node, at most, from its first message; of some, from their start
PATIENCE = 300.0       # [s] until a node is heard; it ends a hang
MOST_LOST = 1.0        # [s] of sim time that a killed node may cost
# Shared memory would stay behind when a node is killed.
ON_THE_WIRE = {**ENVIRONMENT, 'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4'}
MEMORY_DISK = '/dev/shm' if os.access('/dev/shm', os.W_OK) else None  # three times as fast


class Tally:
    """How often a fault was tried and survived, and what the first failure was."""

    def __init__(self, what):
        self._what, self._tried, self._survived, self._first = what, 0, 0, None

    @contextmanager
    def trial(self, which):
        """Count what is done in the context as survived unless it raises."""
        self._tried += 1
        try:
            yield
        except Exception as error:
            text = f'{which}: {type(error).__name__}: {error}'
            self._first = self._first or ' '.join(text.split())
        else:
            self._survived += 1

    def row(self, remark=''):
        """Return the row of the table."""
        return self._what, self._tried, self._survived, self._first or remark


def ensure(condition, text):
    """Raise an error if a condition does not hold."""
    if not condition:
        raise RuntimeError(text)


@contextmanager
def small_disk(folder, size):
    """Yield a folder on a disk of its own, of a size [B], or None where one may not mount."""
    mounted = folder / 'disk'
    mounted.mkdir()
    if subprocess.run(['mount', '-t', 'tmpfs', '-o', f'size={size},mode=0700', 'tmpfs', mounted],
                      capture_output=True).returncode:
        yield None
        return
    try:
        yield mounted
    finally:
        subprocess.run(['umount', '-l', mounted], check=True)


@contextmanager
def _listening(names):
    """Yield the latest sim times that are heard in namespaces, a dict [s]."""
    os.environ.update(ON_THE_WIRE)
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import JointState
    rclpy.init()
    node, executor = rclpy.create_node('listener'), SingleThreadedExecutor()
    heard = {}

    def hear(name, state):
        heard[name] = state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec

    for name in names:  # before the executor spins, which may wait for them for ever
        node.create_subscription(JointState, f'/{name}/joint_states', partial(hear, name), 100)
    executor.add_node(node)
    with ThreadPoolExecutor(1) as thread:
        spinning = thread.submit(executor.spin)
        yield heard
        executor.shutdown()
        spinning.result()
    node.destroy_node()
    rclpy.try_shutdown()


def kills(count, generator):
    """Kill nodes: every fifth maybe before its first message, the others after it."""
    tally, lost, early = Tally('`kill -9` of the node at a random moment'), [0.0], 0
    moments = [generator.uniform(0.0, LIFE) for _ in range(count)]
    timo_sim.simulate(timo_sim.load_scene(ROOT / 'config' / 'paper.yaml'), 0.1)  # compiles

    def kill(number):
        name = f'n{number}'
        path = Path(folder) / f'{name}.mcap'
        command = [sys.executable, '-m', 'timo_sim.cli.sim_node', *arguments(
            rate=100.0, record=True, record_file=str(path)), '-r', f'__ns:=/{name}']
        with subprocess.Popen(command, env=ON_THE_WIRE, cwd=folder, stdout=subprocess.DEVNULL,
                              stderr=subprocess.DEVNULL) as process:
            end = time.monotonic() + PATIENCE
            while number % 5 and name not in heard and time.monotonic() < end:
                time.sleep(0.01)
            time.sleep(moments[number])
            process.kill()
        time.sleep(0.2)  # for messages under way
        return number, path, heard.get(name)

    with TemporaryDirectory() as folder, _listening(map('n{}'.format, range(count))) as heard:
        with ThreadPoolExecutor(NODES) as pool:
            for number, path, last in pool.map(kill, range(count)):
                with tally.trial(f'after {moments[number]:.3f} s'):
                    latest = _latest(path)
                    early += latest is None
                    if last is not None:
                        ensure(latest is not None, f'heard until {last} s, no log')
                        lost.append(last - latest)
                        ensure(lost[-1] < MOST_LOST, f'{lost[-1]:.3f} s were lost')
    return tally.row(f'at most {max(lost):.2f} s lost; {early} before there was a log')


def _latest(path):
    """Recover a log; return its last time [s], or None if there is nothing."""
    if not path.exists():
        return None
    try:
        recover(path)
    except LogError as error:
        ensure('empty' in str(error) or 'nothing in it' in str(error), str(error))
        return None
    new = path.with_stem(path.stem + '_recovered')
    decoded(new)
    with open(new, 'rb') as stream:
        return 1e-9 * make_reader(stream).get_summary().statistics.message_end_time


def flips(folder, count, generator):
    """Flip bits of a log."""
    tally, seen, path = Tally('one or more bits of a log flipped'), {}, folder / 'flipped.mcap'
    intact = record(folder / 'whole.mcap')
    for number in range(count):
        damaged = bytearray(intact)
        bits = [generator.randrange(8 * len(damaged)) for _ in range(1 + number % 4 * number % 9)]
        for bit in bits:
            damaged[bit // 8] ^= 1 << bit % 8
        with tally.trial(f'bits {bits}'):
            path.write_bytes(damaged)
            what = outcome(path)
            ensure(what != 'complete' or damaged == intact, 'it is said to be complete')
            seen[what] = seen.get(what, 0) + 1
    return tally.row(', '.join(f'{number} {what}' for what, number in seen.items()))


FILL = """
import os, sys
sys.path[:0] = sys.argv[3:]
import resource, signal
from oracles.logs import CHANNELS, Recorder
if sys.argv[2] != 'None':
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
try:
    recorder = Recorder(sys.argv[1], CHANNELS, {'timo_sim': {'parameters': '{}'}})
except OSError as error:
    print(error)
else:
    for step in range(4000):  # more than 400 kB
        recorder.write(0, step, step, os.urandom(100))
    recorder.close()
    print(recorder.error or '')
"""


def full_disks(folder, step):
    """Let the disk be full at many places of a log, which a process of its own writes."""
    tally = Tally('disk full while recording')
    with small_disk(folder, 4 << 20) as disk:
        ballast = disk / 'ballast' if disk else None
        for size in range(4096, 120000, step):
            with tally.trial(f'{size} bytes free'):
                path = (disk or folder) / f'{size}.mcap'
                if ballast:
                    ballast.unlink(missing_ok=True)
                    ballast.write_bytes(bytes(shutil.disk_usage(disk).free - size))
                done = subprocess.run(
                    [sys.executable, '-c', FILL, path, str(None if disk else size), *sys.path],
                    capture_output=True, text=True, timeout=PATIENCE)
                ensure(not done.returncode, done.stderr)
                ensure(done.stdout.strip(), 'the log is whole')
                if path.exists():
                    copied = Path(shutil.copy(path, folder / 'copied.mcap'))
                    ensure(outcome(copied) == 'recovered', 'nothing is left')
                    path.unlink()
    return tally.row('tmpfs' if disk else 'RLIMIT_FSIZE: mounting is not allowed')


def rows(quick):
    """Try all faults; yield (what, how many tried, how many survived, remark)."""
    generator = random.Random(1)
    sync, os.fsync = os.fsync, lambda number: None  # thousands of logs need not wait for the disk
    try:
        with TemporaryDirectory(dir=MEMORY_DISK) as name:
            folder = Path(name)
            yield kills(4 if quick else 100, generator)
            yield flips(folder, 300 if quick else 10000, generator)
            yield full_disks(folder, 16384 if quick else 2048)
    finally:
        os.fsync = sync
