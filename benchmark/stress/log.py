"""
Faults that logs and other files must survive: `python -m benchmark.stress.log`.

Each fault is tried so many times; one that is survived has left the simulation unharmed, what was
written readable, or has been refused in one line. `--quick` tries a few of each. The seed is shown
and can be given, for what was found to be found again.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
import os
from pathlib import Path
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time

from benchmark import ROOT
from benchmark.speed.node import arguments, ENVIRONMENT
from benchmark.stress import files
from benchmark.stress.tally import ensure, small_disk, Tally
from oracles import hostile_logs
from oracles.hostile_logs import decoded, limited, outcome, places
import timo_sim
from timo_sim.log.reader import LogError
from timo_sim.log.recorder import Recorder
from timo_sim.log.recover import recover

NODES = 4              # that live at the same time
LIFE = 3.0             # [s] of a node, at most, from its first message; of some, from their start
PATIENCE = 60.0        # [s] until a node is heard
MOST_LOST = 1.0        # [s] of sim time that a killed node may cost
MEMORY = 1200          # [MB] of address space for hostile files
MEMORY_DISK = '/dev/shm' if os.access('/dev/shm', os.W_OK) else None  # three times as fast
# Shared memory would stay behind when a node is killed.
ON_THE_WIRE = {**ENVIRONMENT, 'FASTDDS_BUILTIN_TRANSPORTS': 'UDPv4'}


@contextmanager
def _listening():
    """Yield a function that says until which time a node of a namespace has been heard [s]."""
    os.environ.update(ON_THE_WIRE)
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import JointState
    rclpy.init()
    node, executor = rclpy.create_node('listener'), SingleThreadedExecutor()
    executor.add_node(node)
    heard = {}

    def listen(name):
        def hear(state):
            heard[name] = state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec
        node.create_subscription(JointState, f'/{name}/joint_states', hear, 100)
        return lambda: heard.get(name)

    with ThreadPoolExecutor(1) as thread:
        spinning = thread.submit(executor.spin)
        yield listen
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
        path, heard = Path(folder) / f'{name}.mcap', listen(name)
        command = [sys.executable, '-m', 'timo_sim.ros.sim_node', *arguments(
            rate=100.0, record=True, record_file=str(path)), '-r', f'__ns:=/{name}']
        with subprocess.Popen(command, env=ON_THE_WIRE, cwd=folder, stdout=subprocess.DEVNULL,
                              stderr=subprocess.DEVNULL) as process:
            end = time.monotonic() + PATIENCE
            while number % 5 and heard() is None and time.monotonic() < end:
                time.sleep(0.01)
            time.sleep(moments[number])
            process.kill()
        time.sleep(0.2)  # what was on its way
        return number, path, heard()

    with tempfile.TemporaryDirectory() as folder, _listening() as listen:
        with ThreadPoolExecutor(NODES) as pool:
            for number, path, heard in pool.map(kill, range(count)):
                with tally.trial(f'after {moments[number]:.3f} s'):
                    latest = _latest(path)
                    early += latest is None
                    if heard is not None:
                        ensure(latest is not None, f'heard until {heard} s, no log')
                        lost.append(heard - latest)
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
        return 1e-9 * hostile_logs.make_reader(stream).get_summary().statistics.message_end_time


def cuts(folder, quick):
    """Cut a log within and between its records."""
    tally = Tally('log cut anywhere')
    intact = hostile_logs.record(folder / 'intact.mcap')
    step = 97 if quick else 23
    for cut in sorted({*range(0, len(intact), step),
                       *(place for place, _, _ in places(intact))}):
        with tally.trial(f'at byte {cut}'):
            path = folder / 'cut.mcap'
            path.write_bytes(intact[:cut])
            ensure(outcome(path) != 'complete', 'it is said to be complete')
    return tally.row('recovered or, without any record, refused')


def flips(folder, count, generator):
    """Flip bits of a log."""
    tally, seen = Tally('one bit or some of a log flipped'), {}
    intact = hostile_logs.record(folder / 'whole.mcap')
    for number in range(count):
        damaged = bytearray(intact)
        bits = [generator.randrange(8 * len(damaged)) for _ in range(1 + number % 4 * number % 9)]
        for bit in bits:
            damaged[bit // 8] ^= 1 << bit % 8
        with tally.trial(f'bits {bits}'):
            path = folder / 'flipped.mcap'
            path.write_bytes(damaged)
            what = outcome(path)
            ensure(what != 'complete' or damaged == intact, 'it is said to be complete')
            seen[what] = seen.get(what, 0) + 1
    return tally.row(', '.join(f'{number} {what}' for what, number in seen.items()))


def hostile(folder, quick):
    """Read files that lie, with little memory."""
    tally, paths, most = Tally('file that lies, pretends or explodes'), [], 0
    for name, content in hostile_logs.hostile(large=not quick).items():
        paths.append(folder / f'{name}.mcap')
        paths[-1].write_bytes(content)
    hole = folder / 'a hole of 10 GB.mcap'
    with open(hole, 'wb') as stream:
        stream.write(hostile_logs.hostile()['a length of 10 GB'])
        stream.truncate(11 * hostile_logs.GIGABYTE)
    for path in [*paths, hole]:
        with tally.trial(path.stem):
            _, memory = limited([path], MEMORY, timeout=300.0)
            most = max(most, memory)
    for path in ('/dev/zero', folder):
        with tally.trial(path):
            try:
                recover(path)
            except LogError:
                continue
            raise RuntimeError('it is read')
    return tally.row(f'at most {most} MB of memory')


def full_disks(folder, quick):
    """Let the disk be full at many a place of a log."""
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
from oracles.hostile_logs import CHANNELS, Recorder
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
    """Record where one cannot."""
    tally = Tally('log where none can be: folder, read-only, below a file, no descriptor')
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
        Recorder(folder / 'first.mcap', hostile_logs.CHANNELS, {}).close()
        last = os.dup(0)
        os.close(last)
        resource.setrlimit(resource.RLIMIT_NOFILE, (last, hard))
        try:
            Recorder(folder / 'run.mcap', hostile_logs.CHANNELS, {})
            raise RuntimeError('it is opened')
        except OSError as error:
            ensure('Too many open files' in str(error), str(error))
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    return tally.row('one line each')


def rows(quick=False, seed=None):
    """
    Try all faults.

    Yields
    ------
    what : str
    tried, survived : int
    remark : str

    """
    generator = random.Random(seed)
    sync, os.fsync = os.fsync, lambda number: None  # thousands of logs need not wait for the disk
    try:
        with tempfile.TemporaryDirectory(dir=MEMORY_DISK) as name:
            folder = Path(name)
            yield kills(4 if quick else 100, generator)
            yield cuts(folder, quick)
            yield flips(folder, 300 if quick else 10000, generator)
            yield hostile(folder, quick)
            yield full_disks(_made(folder / 'full'), quick)
            yield places_that_are_none(_made(folder / 'none'))
            yield from files.rows(_made(folder / 'files'), quick, generator)
    finally:
        os.fsync = sync


def _made(folder):
    folder.mkdir()
    return folder


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description='What a log survives.')
    parser.add_argument('--quick', action='store_true')
    parser.add_argument('--seed', type=int, default=random.SystemRandom().randrange(1 << 30))
    given = parser.parse_args()
    print(f'timo_sim {timo_sim.__version__}, seed {given.seed}\n')
    print('| fault | tried | survived | remark |\n|---|---|---|---|')
    fallen = 0
    for what, tried, survived, remark in rows(given.quick, given.seed):
        fallen += tried - survived
        print(f'| {what} | {tried} | {survived} | {remark} |', flush=True)
    return fallen > 0


if __name__ == '__main__':
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    sys.exit(main())
