# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Measures processor time, evenness of ticks and start of the node: `python -m benchmark.speed.node`.

CPU is user and system time of a whole process, for each time step that it published. The peers of
a comparison run in turns of one to three seconds, stopped in between, so that a busy machine is
busy for all of them; the result is the median over the turns of the ratio within a turn.
node_processes.py describes the peers.
"""

from pathlib import Path
import re
import signal
import statistics
import subprocess
import tempfile
import time

import numpy as np

from benchmark.command import parser
from benchmark.process import arguments, ENVIRONMENT, RATES
from benchmark.speed.turns import compare, START_UP, started


def ratio(over, under):
    """Return the median of the ratios within a turn."""
    return statistics.median(np.divide(over, under))


def spread(values, factor=1e6):
    """Return median, 99th percentile and maximum as text, in microseconds."""
    return ' / '.join(f'{value:.0f}' for value in factor * np.percentile(values, [50, 99, 100]))


def cpu_rows(turns, seconds):
    """Compare the node with nodes without a simulation."""
    peers = compare(turns, seconds, bare=('bare', True, ()), timer=('timer', True, ()),
                    node=('node', True, arguments()))
    bare, timer, node = peers.values()
    over_bare, over_timer = ratio(node.cpu, bare.cpu), ratio(node.cpu, timer.cpu)
    yield ('CPU over a bare node, 5 topics at 1 kHz, subscribed', '<= 1.15',
           f'{over_bare:.2f}', over_bare <= 1.15, costs(peers))
    yield ('CPU over an rclpy timer in a SingleThreadedExecutor', '< 1',
           f'{over_timer:.2f}', over_timer < 1.0, '')
    yield ('interval of the loops, p50 / p99 / max', '', '', None,
           ', '.join(f'{name} {spread(intervals(peer))} us' for name, peer in peers.items()))


def log_rows(turns, seconds):
    """Compare the node with its log on and off."""
    peers = compare(turns, seconds, off=('node', True, arguments()), on=(
        'node', True, arguments(record=True, record_file='run.mcap')))
    off, on = peers.values()
    added = 1e6 * statistics.median(on.cpu - off.cpu) / len(RATES)
    durations = {name: [np.divide(*_durations(ticks)) for ticks in peer.ticks]
                 for name, peer in peers.items()}
    p99 = {name: [np.percentile(turn, 99) for turn in turns] for name, turns in durations.items()}
    slower = ratio(p99['on'], p99['off'])
    yield 'CPU of the log', '<= 10 us per message', f'{added:.1f} us', added <= 10.0, costs(peers)
    yield ('p99 of the time of a step, log on over log off', '<= 1.1',
           f'{slower:.2f}', slower <= 1.1,
           ', '.join(f'{name} {spread(np.concatenate(durations[name]))} us' for name in peers))


def costs(peers):
    """Return the CPU time of a step of each peer as text."""
    return ', '.join(f'{name} {1e6 * statistics.median(peer.cpu):.0f} us'
                     for name, peer in peers.items())


def _durations(ticks):
    # Durations of ticks that did steps, and the steps of each: a late tick does several.
    done = ticks[ticks[:, 2] > 0]
    return done[:, 1] - done[:, 0], done[:, 2]


def intervals(peer):
    """Return the times between beginnings of ticks [s]."""
    return np.concatenate([np.diff(ticks[:, 0]) for ticks in peer.ticks])


def silent_rows(turns, seconds):
    """Compare topics that nobody wants at 1 kHz with topics at 1 Hz."""
    fast, slow = compare(turns, seconds, fast=('node', False, arguments()),
                         slow=('node', False, arguments(rate=1.0))).values()
    over = ratio(fast.cpu, slow.cpu)
    yield ('CPU of 5 topics at 1 kHz without subscriber and log, over 1 Hz', '1 within 5 %',
           f'{over:.2f}', over <= 1.05, f'{1e6 * statistics.median(fast.cpu):.0f} us a step')


def finished(*extra, environment=ENVIRONMENT):
    """Run a node to its end; return when it was started, its ticks and its output."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.monotonic()
        with started('node', 'ticks.npy', environment, *extra, cwd=folder,
                     stdout=subprocess.PIPE) as process:
            output = process.communicate()[0]
            if process.returncode:
                raise RuntimeError(output)
        return begin, np.load(Path(folder) / 'ticks.npy'), output


def jitter_rows(seconds, long):
    """Run alone at three tick rates; the fastest for long enough to see what is dropped."""
    for rate, duration in ((200, seconds), (500, seconds), (1000, long)):
        _, ticks, output = finished(*arguments(
            rate=100.0, duration=float(duration), **{'integrator.step': 1.0 / rate}))
        yield (f'interval at {rate} Hz, p50 / p99 / max', f'{1e6 / rate:.0f} us',
               spread(np.diff(ticks[:, 0])) + ' us', None, '')
    dropped = re.search(r'(\d+) overruns, (\S+) s dropped', output)
    yield (f'sim time dropped in {long:g} s at 1 kHz', '0 s', f'{dropped[2]} s',
           float(dropped[2]) == 0.0, f'{dropped[1]} overruns')


def free_rows(times, duration):
    """Run as fast as possible, with a log."""
    factors = []
    for _ in range(times):
        _, _, output = finished(*arguments(
            rate=100.0, publish_clock=False, record=True, record_file='run.mcap',
            real_time_factor=0.0, duration=float(duration)))
        sim_time, wall_time = re.search(r'simulated (\S+) s in (\S+) s', output).groups()
        factors.append(float(sim_time) / float(wall_time))
    middle = statistics.median(factors)
    yield ('free run, 1 ms, log on, 4 topics at 100 Hz', '>= 50 times real time',
           f'{middle:.0f}', middle >= 50.0, f'{min(factors):.0f} to {max(factors):.0f}')


def start_rows(times):
    """Measure from the start of the process to the first tick, just after the first message."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**ENVIRONMENT, 'NUMBA_CACHE_DIR': cache}
        taken, said = [], []
        for _ in range(1 + times):
            begin, ticks, output = finished(*arguments(duration=0.01), environment=environment)
            taken.append(ticks[0, 0] - begin)
            said.append('compiling once' in output)
    cold, *warm = taken
    middle = statistics.median(warm)
    rightly = said == [True] + times * [False]
    yield ('start to first message, cold', '<= 6 s', f'{cold:.1f} s', cold <= 6.0 and rightly,
           f'says "compiling once"{"" if rightly else " wrongly"}; without machine code on disk, '
           f'whose compilation takes {cold - middle:.1f} s')
    yield ('start to first message, warm', '<= 1.5 s', f'{middle:.2f} s', middle <= 1.5,
           f'{min(warm):.2f} to {max(warm):.2f} s')


def overload_rows():
    """Start a node that is too slow for real time, and end it by signals."""
    heavy = arguments(**{'model.modes': 20, 'integrator.step': 1e-5})
    finished(*heavy, '-p', 'duration:=0.001')  # compiles
    for number in (signal.SIGINT, signal.SIGTERM):
        with tempfile.TemporaryDirectory() as folder, started(
                'node', 'ticks.npy', ENVIRONMENT, *heavy, cwd=folder,
                stdout=subprocess.PIPE) as process:
            time.sleep(2 * START_UP)
            begin = time.monotonic()
            process.send_signal(number)
            output = process.communicate()[0]
            dropped = re.search(r'(\S+) s dropped', output)
            yield (f'{number.name} to the end of an overloaded node', 'code 0',
                   f'code {process.returncode}, {time.monotonic() - begin:.2f} s',
                   process.returncode == 0,
                   f'{dropped[1]} s dropped')


def rows(quick=False):
    """Measure everything; return tuples of line, target, measured, met and a remark."""
    turns, seconds = (3, 1.0) if quick else (12, 1.5)
    return [*cpu_rows(turns, seconds), *log_rows(turns, 2 * seconds), *silent_rows(turns, seconds),
            *(jitter_rows(3.0, 5.0) if quick else jitter_rows(10.0, 60.0)),
            *(free_rows(1, 50.0) if quick else free_rows(5, 100.0)),
            *start_rows(2 if quick else 5), *overload_rows()]


def main():
    """Measure and print a Markdown table."""
    quick = parser(__spec__, __doc__, 'fewer and shorter turns').parse_args().quick
    print('| | target | measured | met | |\n|---|---|---|---|---|')
    for row in rows(quick):
        print('| ' + ' | '.join(map(str, row)) + ' |', flush=True)


if __name__ == '__main__':
    main()
