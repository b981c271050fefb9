# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Processor time, evenness of ticks, start and memory of the node.

CPU is user and system time of a whole process, for each time step that it published. The peers of
a comparison run in turns of one to three seconds, stopped in between, so that a busy machine is
busy for all of them; the result is the median over the turns of the ratio within a turn.
`node_processes` describes the peers.
"""

from contextlib import ExitStack
import os
from pathlib import Path
import re
import shutil
import signal
import statistics
import tempfile
import time

import numpy as np

from benchmark.process import arguments, ENVIRONMENT, install, RATES, resident, running, wait
from oracles.domains import own_domain

START_UP, SETTLE = 4.0, 0.5   # [s]
DAY = 86400.0  # [s]


def started(name, argument, *extra, environment=ENVIRONMENT, **options):
    """Start one of `node_processes`, and end it after the context."""
    return running(['-m', 'benchmark.speed.node_processes', name, str(argument), *extra],
                   env=environment, **options)


class Peer:
    """
    A process that is measured in turns, stopped in between; and its listener, if any.

    After `end`, `cpu` has the CPU time for each step in each turn [s], and `ticks` for each turn
    the begin and end of its ticks [s] and their steps, shape (n, 3).
    """

    def __init__(self, stack, folder, name, listened=True, extra=()):
        domain = str(own_domain())
        environment = {**ENVIRONMENT, 'ROS_DOMAIN_ID': domain}
        self._path, self._turns, self.cpu, self.ticks = Path(folder, f'{domain}.npy'), [], None, []
        if listened:
            listener = stack.enter_context(started('listener', '', environment=environment))
            wait(lambda: 'listening' in listener.said(), listener)
        self._process = stack.enter_context(
            started(name, self._path, *extra, environment=environment, cwd=folder))
        if listened:
            wait(lambda: 'hearing' in listener.said(), listener, self._process)
        else:
            time.sleep(START_UP)
        self._process.send_signal(signal.SIGSTOP)

    def _processor_time(self):
        # Of all threads [s].
        return 1e-9 * sum(int(path.read_text().split()[0]) for path in Path(
            f'/proc/{self._process.pid}/task').glob('*/schedstat'))

    def turn(self, seconds):
        """Let the process run, and measure."""
        self._process.send_signal(signal.SIGCONT)
        time.sleep(SETTLE)
        begin, before = time.monotonic(), self._processor_time()
        time.sleep(seconds)
        end, after = time.monotonic(), self._processor_time()
        self._process.send_signal(signal.SIGSTOP)
        self._turns.append((begin, end, after - before))

    def end(self):
        """End the process and read when its ticks were."""
        self._process.send_signal(signal.SIGCONT)
        self._process.terminate()
        self._process.finish()
        times = np.load(self._path)
        self.ticks = [times[(times[:, 0] > begin) & (times[:, 1] < end)]
                      for begin, end, _ in self._turns]
        self.cpu = np.array([cpu / ticks[:, 2].sum()
                             for (_, _, cpu), ticks in zip(self._turns, self.ticks)])

    def times_of_steps(self):
        """Return, for each turn, the time of ticks for each of their steps [s]."""
        return [(ticks[:, 1] - ticks[:, 0])[ticks[:, 2] > 0] / ticks[ticks[:, 2] > 0, 2]
                for ticks in self.ticks]


def compare(turns, seconds, **peers):
    """Run peers, each the last arguments of a `Peer`, in turns; return them by name."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        found = {name: Peer(stack, folder, *given) for name, given in peers.items()}
        order = list(found.values())
        for _ in range(turns):
            for peer in order:
                peer.turn(seconds)
            order.append(order.pop(0))
        for peer in order:
            peer.end()
    return found


def ratio(over, under):
    """Return the median of the ratios within a turn."""
    return statistics.median(np.divide(over, under))


def spread(values):
    """Return median, 99th percentile and maximum of times [s] as text, in microseconds."""
    return ' / '.join(f'{value:.0f}' for value in 1e6 * np.percentile(values, [50, 99, 100]))


def costs(peers):
    """Return the CPU time of a step of each peer as text."""
    return ', '.join(f'{name} {1e6 * statistics.median(peer.cpu):.0f} us'
                     for name, peer in peers.items())


def cpu_rows(turns, seconds):
    """Compare the node with nodes without a simulation."""
    peers = compare(turns, seconds, bare=('bare',), timer=('timer',),
                    plain=('node', True, arguments(estimate_error=False)),
                    node=('node', True, arguments()))
    bare, timer, plain, node = peers.values()
    over_bare, over_timer = ratio(plain.cpu, bare.cpu), ratio(node.cpu, timer.cpu)
    yield ('CPU over a bare node, 5 topics at 1 kHz, subscribed, without `estimate_error`',
           '1.15 is withdrawn', f'{over_bare:.2f}', None,
           f'{costs(peers)}; a bare node sends constants: commands, steps and numbers come to it')
    yield ('the same with its error, measured by a finer run', '',
           f'{ratio(node.cpu, bare.cpu):.2f}', None,
           'see [what a finer run costs](scene.md#estimated-error-and-warnings)')
    yield ('CPU over an rclpy timer in a SingleThreadedExecutor', '< 1',
           f'{over_timer:.2f}', over_timer < 1.0, '')
    between = {name: np.concatenate([np.diff(ticks[:, 0]) for ticks in peer.ticks])
               for name, peer in peers.items()}
    yield ('interval of the loops, p50 / p99 / max', '', '', None,
           ', '.join(f'{name} {spread(values)} us' for name, values in between.items()))


def log_rows(turns, seconds):
    """Compare the node with its log on and off."""
    peers = compare(turns, seconds, off=('node', True, arguments()), on=(
        'node', True, arguments(record=True, record_file='run.mcap')))
    off, on = peers.values()
    added = 1e6 * statistics.median(on.cpu - off.cpu) / len(RATES)
    times = {name: peer.times_of_steps() for name, peer in peers.items()}
    slower = ratio(*([np.percentile(turn, 99) for turn in times[name]] for name in ('on', 'off')))
    yield 'CPU of the log', '<= 10 us per message', f'{added:.1f} us', added <= 10.0, costs(peers)
    yield ('p99 of the time of a step, log on over log off', '<= 1.1',
           f'{slower:.2f}', slower <= 1.1, ', '.join(
               f'{name} {spread(np.concatenate(turns))} us' for name, turns in times.items()))


def silent_row(turns, seconds):
    """Compare topics that nobody wants at 1 kHz with topics at 1 Hz."""
    fast, slow = compare(turns, seconds, fast=('node', False, arguments()),
                         slow=('node', False, arguments(rate=1.0))).values()
    over = ratio(fast.cpu, slow.cpu)
    return ('CPU of 5 topics at 1 kHz without subscriber and log, over 1 Hz', '',
            f'{over:.2f}', None, f'{1e6 * statistics.median(fast.cpu):.0f} us a step; the target '
            'of 1.05 is withdrawn: what each step looks at is a larger part of a faster loop')


def finished(*extra, environment=ENVIRONMENT):
    """Run a node to its end; return when it was started, its ticks and its output."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.monotonic()
        with started('node', 'ticks.npy', *extra, environment=environment, cwd=folder) as process:
            process.finish()
        return begin, np.load(Path(folder) / 'ticks.npy'), process.said()


def jitter_rows(seconds, long):
    """Run alone at three tick rates; the fastest for long enough to see what is dropped."""
    for rate, duration in ((200, seconds), (500, seconds), (1000, long)):
        _, ticks, output = finished(*arguments(
            rate=100.0, duration=float(duration), **{'integrator.step': 1.0 / rate}))
        yield (f'interval at {rate} Hz, p50 / p99 / max', f'{1e6 / rate:.0f} us',
               spread(np.diff(ticks[:, 0])) + ' us', None, '')
    late, lost = (re.search(pattern, output) for pattern in (
        r'(\d+) late ticks', r'(\S+) s of sim time were lost'))
    yield (f'sim time dropped in {long:g} s at 1 kHz', '0 s', f'{lost[1] if lost else 0} s',
           not lost, f'{late[1] if late else 0} overruns')


def free_row(times, duration):
    """Run as fast as possible, with a log."""
    factors = []
    for _ in range(times):
        output = finished(*arguments(
            rate=100.0, publish_clock=False, record=True, record_file='run.mcap',
            real_time_factor=0.0, duration=float(duration)))[2]
        sim_time, wall_time = re.search(r'simulated (\S+) s in (\S+) s', output).groups()
        factors.append(float(sim_time) / float(wall_time))
    middle = statistics.median(factors)
    return ('free run, 1 ms, log on, 4 topics at 100 Hz', '>= 50 times real time',
            f'{middle:.0f}', middle >= 50.0, f'{min(factors):.0f} to {max(factors):.0f}')


def start_rows(times):
    """
    Measure from the start of the process to the first tick, just after the first message.

    Home and store of machine code are empty at the first start. The package is a copy, with the
    machine code that `make sim` adds to it, as a user has it; then without, as in a clone.
    """
    with tempfile.TemporaryDirectory() as folder:
        install(folder, 'editable')
        taken = {}
        for name in 'installed', 'clone':
            home = Path(folder, name)
            home.mkdir()
            environment = {
                **ENVIRONMENT, 'HOME': str(home), 'NUMBA_CACHE_DIR': str(home),
                'PYTHONPATH': os.pathsep.join([folder, ENVIRONMENT['PYTHONPATH']])}
            if name == 'clone':
                shutil.rmtree(Path(folder, 'timo_sim', 'compiled', 'prebuilt'))
            taken[name] = []
            for _ in range(1 + times * (name == 'installed')):
                begin, ticks, _ = finished(*arguments(duration=0.01), environment=environment)
                taken[name].append(ticks[0, 0] - begin)
    cold, *warm = taken['installed']
    middle = statistics.median(warm)
    yield ('start of a node to its first message, after an installation', '<= 2 s',
           f'{cold:.2f} s', cold <= 2.0, 'with an empty home')
    yield ('the same, in a clone that is not installed', '', f'{taken["clone"][0]:.2f} s', None,
           'the target of 6 s is withdrawn: numba compiles what an installation brings with it')
    yield ('the same, at later starts', '<= 1.5 s', f'{middle:.2f} s', middle <= 1.5,
           f'{min(warm):.2f} to {max(warm):.2f} s')


def rows(quick):
    """Return all rows (line, target, measured, met, remark)."""
    turns, seconds = (3, 1.0) if quick else (8, 1.5)
    return [*cpu_rows(turns, seconds), *log_rows(turns, 2.0), silent_row(turns, seconds),
            *(jitter_rows(3.0, 5.0) if quick else jitter_rows(5.0, 30.0)),
            free_row(1, 50.0) if quick else free_row(3, 100.0),
            *start_rows(1 if quick else 3)]


def memory(quick):
    """Return the row of the memory of a logged day, extrapolated from ten minutes of sim time."""
    duration, samples = 60.0 if quick else 600.0, []
    with tempfile.TemporaryDirectory() as folder, running(
            ['-m', 'timo_sim.cli.sim_node', *arguments(
                record=True, record_file='run.mcap', real_time_factor=0.0, duration=duration)],
            env=ENVIRONMENT, cwd=folder) as process:
        while process.poll() is None:
            samples.append((time.monotonic(), 1e-6 * resident(process.pid)))
            time.sleep(0.1)
        process.finish()
    wall = float(re.search(r'simulated \S+ s in (\S+) s', process.said())[1])
    moments, sizes = np.array([each for each in samples if each[1]]).T
    sim_time = (moments - moments[-1] + wall) / wall * duration
    late = sim_time > 0.3 * duration
    growth = np.polyfit(sim_time[late], sizes[late], 1)[0]
    day = sizes[-1] + max(growth, 0.0) * (DAY - duration)
    return [('resident memory after 24 h at 1 kHz, every step of 5 topics logged',
             '< 300 MB', f'{day:.0f} MB', day < 300.0,
             f'{sizes[late].max():.0f} MB in {duration:g} s, growth '
             f'{3600.0 * growth:.2g} MB per h of sim time')]
