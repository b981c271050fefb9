# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Attacks and faults that a node must survive, in real processes over real DDS.

A fault is survived if the node goes on (or ended cleanly, with code 0), counted what it should,
and left a log that can be read to its end.
"""

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
import random
import re
import signal
import subprocess
import tempfile
import time

import numpy as np

from benchmark import ROOT
from benchmark.process import ENVIRONMENT, LONGEST, running, wait
from benchmark.stress.node_process import LEAKY, Node, survived
from timo_sim.log.tables import Recording

SOAK = 60.0  # [s] of each of two


def attack(name, *arguments, environment=ENVIRONMENT, **options):
    """Run an attacking process."""
    return running(['-m', 'benchmark.stress.attackers', name, *arguments], env=environment,
                   **options)


def attacked(what, seconds, attackers, killed=0, check=None, planted=False, **parameters):
    """Run a node for some seconds among attackers, of which the first few are killed."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        node = Node(folder, **parameters).ready()
        processes = [stack.enter_context(attack(name)) for name in attackers]
        if 'bad' in attackers:
            bad = processes[attackers.index('bad')]
            wait(lambda: 'sent' in bad.said(), bad)
        time.sleep(2.0)
        for process in processes[:killed]:
            process.kill()
        leak, grown = node.leak(seconds)
        well, counters = survived(node)
        well = well and leak == planted and (check is None or check(counters, node.output()))
    shown = {key: counters[key] for key in ('refused_commands', 'failed_calls', 'overruns')
             if counters.get(key, '0') != '0'}
    remark = ', '.join(f'{value} {key.replace("_", " ")}' for key, value in shown.items())
    return what, 1, int(well), f'{remark or "nothing to count"}; {grown}'


def counted(counters, output):
    """Return whether exactly the commands of `bad` were refused."""
    return counters['refused_commands'] == '100'


def warned_once(counters, output):
    """Return whether the node warned of the other clock exactly once."""
    return output.count('/clock has another publisher') == 1


def attack_rows(seconds):
    """One attack after the other, then all of them at once."""
    yield attacked('100 commands with NaN, Inf, wrong frames, 1 MB, cut or garbage CDR', 2.0,
                   ['bad'], check=counted)
    yield attacked('command storm from three processes, one killed', seconds, 3 * ['storm'],
                   killed=1)
    yield attacked('parameters at 100 Hz, most of them bad', seconds, ['setter'])
    yield attacked('pause, reset and step from three processes', seconds, 3 * ['caller'])
    yield attacked('another /clock', 2.0, ['clock'], publish_clock=True, check=warned_once)
    yield attacked('all of these at once on busy cores', seconds, [
        'storm', 'storm', 'setter', 'caller', 'clock', 'busy', 'busy'], killed=1)
    yield attacked('command storm on a node that keeps 10 kB of each: a leak is seen', seconds,
                   3 * ['storm'], planted=True, program=LEAKY)


def deaf_row(seconds):
    """Stop a reliable subscriber, so that it never reads."""
    with tempfile.TemporaryDirectory() as folder, attack('reader') as reader:
        rates = {f'rate.{topic}': 1000.0 for topic in ('joint_states', 'tip_deflection')}
        node = Node(folder, **rates).ready()
        wait(lambda: 'hearing' in reader.said(), reader)
        reader.send_signal(signal.SIGSTOP)
        leak, grown = node.leak(seconds)
        well, counters = survived(node)
    return ('a reliable subscriber that never reads, 1 kHz', 1, int(well and not leak),
            f'{counters["dropped_time_s"]} s dropped; {grown}')


def lock_step_row(periods):
    """Run lock step with stamps out of order and two rivals; each period must have one answer."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        node = Node(folder, sync='wait', sync_period=0.01, sync_timeout=LONGEST, duration=(
            0.01 * periods), real_time_factor=0.0).ready()
        for name in ('controller', 'rival', 'rival'):
            stack.enter_context(attack(name))
        with suppress(subprocess.TimeoutExpired):
            node.process.wait(LONGEST + 0.1 * periods)
        well = node.end() == 0
        log = Recording(node.log)
        answers = log.topics['~/joint_command']
    good = {step for step, values in zip(answers.step.tolist(), answers.values)
            if np.nanmax(values) == 1.0}
    alone = len(good) == len(answers.step) and not len(log.topics['~/tip_wrench'].step)
    return ('stamps out of order, and two rivals, in lock step: periods', periods,
            len(good & set(range(0, 10 * periods, 10))) if well and alone else 0,
            ', '.join(f'{log.summary[name + "_commands"]} {name}'
                      for name in ('missed', 'mismatched')))


def signal_row(number, cold):
    """Send SIGINT or SIGTERM at a random moment, from the start of the process to its own end."""
    rng = random.Random(1)
    trials = [(trial < cold, rng.uniform(0.0, 8.0 if trial < cold else 3.0),
               rng.choice((signal.SIGINT, signal.SIGTERM))) for trial in range(number)]
    with ThreadPoolExecutor(3) as pool:
        results = list(pool.map(lambda trial: _signalled(*trial), trials))
    early = [moment for (_, moment, _), (_, killed) in zip(trials, results) if killed]
    wrong = [text for text, _ in results if text]
    return ('SIGINT or SIGTERM at a random moment', number, number - len(wrong),
            '; '.join([f'{len(early)} before Python could take it, at most '
                       f'{max(early, default=0.0):.2f} s after the start',
                       f'{cold} while compiling', *wrong[:1]]))


def _signalled(cold, moment, sent):
    """Send a node a signal; return what is wrong or '', and whether it could not take it yet."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**ENVIRONMENT, **({'NUMBA_CACHE_DIR': folder} if cold else {})}
        # An installation has no machine code of nine modes.
        node = Node(folder, environment=environment, duration=1.0,
                    **({'model.modes': 9} if cold else {}))
        time.sleep(moment)
        early = not node.handles_signals()
        code = node.end(sent)
        if code and early:
            return 'it left a log' * node.log.exists(), True
        readable = not node.log.exists() or node.health()[1] > 0
        well = code == 0 and 'Traceback' not in node.output() and readable
        return '' if well else (f'code {code} after {moment:.3f} s, log readable: {readable}, '
                                f'last words: {" ".join(node.output().split())[-200:]}'), False


def soak_row(what, seconds, **parameters):
    """Run for long, and look for leaks."""
    with tempfile.TemporaryDirectory() as folder:
        node = Node(folder, '--params-file', str(ROOT / 'config' / 'paper.yaml'),
                    **parameters).ready()
        leak, grown = node.leak(seconds)
        well, _ = survived(node)
        done = re.search(r'simulated (\S+) s in .*', node.output())
    return what, 1, int(well and not leak), f'{done[0]}'.split('; log')[0] + f'; {grown}'


def rows(quick):
    """Do everything; yield (what, how many tried, how many survived, remark)."""
    yield from attack_rows(2.0 if quick else 20.0)
    yield deaf_row(2.0 if quick else 20.0)
    yield lock_step_row(200 if quick else 3000)
    yield signal_row(*((4, 1) if quick else (200, 10)))
    if not quick:
        yield soak_row('free run at 1 ms', SOAK, real_time_factor=0.0, record=True)
        yield soak_row('real time at 1 kHz, all topics logged', SOAK, **{
            f'rate.{topic}': 1000.0 for topic in (
                'joint_states', 'modal_state', 'tip_deflection', 'tip_pose', 'carrier_pose')})
