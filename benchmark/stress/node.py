"""
Everything that may go wrong around a node, done to it: `python -m benchmark.stress.node`.

Real processes over real DDS. A fault is survived if the node goes on (or ended cleanly, with code
0), answers a service, counted what it should, and left a log that can be read to its end.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
import os
from pathlib import Path
import random
import re
import signal
import subprocess
import sys
import tempfile
import time

from diagnostic_msgs.msg import DiagnosticArray
from mcap.reader import make_reader
import numpy as np
from rclpy.serialization import deserialize_message

from benchmark import ROOT
from benchmark.speed.node import ENVIRONMENT, running

READY, END = 60.0, 60.0   # [s] patience with a busy machine
MEMORY = 5e6              # [B] that a run may grow by after its start


class Node:
    """A node in a process and a folder of its own."""

    def __init__(self, folder, *arguments, environment=ENVIRONMENT, **parameters):
        self.folder, self.log = Path(folder), Path(folder) / 'run.mcap'
        self._output = open(self.folder / 'output.txt', 'w+', encoding='utf-8')
        values = {'record_file': self.log.name, **parameters}
        words = [word for name, value in values.items() for word in (
            '-p', f'{name}:={str(value).lower() if isinstance(value, bool) else value}')]
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'timo_sim.ros.sim_node', '--ros-args', *arguments, *words],
            cwd=folder, env=environment, stdout=self._output, stderr=subprocess.STDOUT)

    def output(self):
        """Return what the node has said so far."""
        self._output.flush()
        return (self.folder / 'output.txt').read_text(errors='replace')

    def ready(self):
        """Wait until the log is there, or the end."""
        end = time.monotonic() + READY
        while 'logging to' not in self.output() and self.process.poll() is None:
            if time.monotonic() > end:
                raise TimeoutError(self.output())
            time.sleep(0.05)
        return self

    def memory(self):
        """Return the memory that the process has in use [B]."""
        status = Path(f'/proc/{self.process.pid}/status').read_text()
        return 1024 * int(re.search(r'VmRSS:\s+(\d+)', status)[1])

    def handles_signals(self):
        """Return whether the process has its handlers, or has ended."""
        status = Path(f'/proc/{self.process.pid}/status').read_text()
        caught = re.search(r'SigCgt:\s*(\w+)', status)[1]
        return bool(int(caught, 16) >> signal.SIGTERM - 1 & 1) or self.process.poll() is not None

    def end(self, number=signal.SIGTERM):
        """End the node; return its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            return self.process.wait(END)
        finally:
            if self.process.poll() is None:
                self.process.kill()
                self.process.wait()

    def health(self):
        """Return the counters of the last diagnostics in the log, and the messages' count."""
        with open(self.log, 'rb') as stream:
            counters, count = {}, 0
            for _, channel, message in make_reader(stream).iter_messages():
                count += 1
                if channel.topic.endswith('/diagnostics'):
                    status = deserialize_message(message.data, DiagnosticArray).status[0]
                    counters = {pair.key: pair.value for pair in status.values}
        return counters, count


def attack(name, *arguments, environment=ENVIRONMENT, **options):
    """Run an attacking process."""
    return running(['-m', 'benchmark.stress.attackers', name, *arguments], env=environment,
                   stdout=subprocess.PIPE, **options)


def survived(node, number=signal.SIGTERM):
    """End a node that should be alive; return whether all is well, and its counters."""
    alive = node.process.poll() is None
    well = node.end(number) == 0 and alive and 'Traceback' not in node.output()
    counters, count = node.health()
    return well and count > 0, counters


def attacked(what, seconds, attackers, killed=0, check=None, **parameters):
    """Run a node for some seconds among attackers, of which the first few are killed."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        node = Node(folder, **parameters).ready()
        processes = [stack.enter_context(attack(name)) for name in attackers]
        if 'bad' in attackers:
            processes[attackers.index('bad')].stdout.readline()
        time.sleep(2.0 + 0.3 * seconds)
        before = node.memory()
        for process in processes[:killed]:
            process.kill()
        time.sleep(seconds)
        growth = node.memory() - before
        well, counters = survived(node)
        well = well and growth < MEMORY and (check is None or check(counters, node.output()))
    shown = {key: counters[key] for key in ('refused_commands', 'failed_calls', 'overruns')
             if counters.get(key, '0') != '0'}
    remark = ', '.join(f'{value} {key.replace("_", " ")}' for key, value in shown.items())
    return what, 1, int(well), f'{remark or "nothing to count"}; {growth / 1e6:+.1f} MB'


def counted(counters, output):
    """Whether exactly what `bad` sent was refused."""
    return counters['refused_commands'] == '100'


def warned_once(counters, output):
    """Whether the other clock was seen, and said once."""
    return output.count('somebody else publishes /clock') == 1


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


def deaf_row(seconds):
    """A reliable subscriber is stopped and never reads."""
    with tempfile.TemporaryDirectory() as folder, attack('reader') as reader:
        rates = {f'rate.{topic}': 1000.0 for topic in ('joint_states', 'tip_deflection')}
        node = Node(folder, **rates).ready()
        reader.stdout.readline()
        reader.send_signal(signal.SIGSTOP)
        time.sleep(2.0)
        before = node.memory()
        time.sleep(seconds)
        growth = node.memory() - before
        well, counters = survived(node)
    return ('a reliable subscriber that never reads, 1 kHz', 1, int(well and growth < MEMORY),
            f'{counters["dropped_time_s"]} s dropped; {growth / 1e6:+.1f} MB')


def namespace_rows(number):
    """Several nodes at once."""
    with tempfile.TemporaryDirectory() as folder:
        with attack('two', cwd=folder, stderr=subprocess.DEVNULL) as process:
            code = process.wait(READY)
        logs = len(list(Path(folder).glob('*.mcap')))
    yield 'two nodes in one process', 2, logs if code == 0 else 0, ''
    with ExitStack() as stack:
        nodes = [Node(stack.enter_context(tempfile.TemporaryDirectory()), '-r', f'__ns:=/n{k}')
                 for k in range(number)]
        for node in nodes:
            node.ready()
        time.sleep(3.0)
        results = [survived(node) for node in nodes]
    yield f'nodes in {number} namespaces', number, sum(well for well, _ in results), ''


def signal_row(number, cold):
    """SIGINT or SIGTERM at a random moment, from the start of the process to its own end."""
    rng = random.Random(1)
    trials = [(trial < cold, rng.uniform(0.0, 8.0 if trial < cold else 3.0),
               rng.choice((signal.SIGINT, signal.SIGTERM))) for trial in range(number)]
    with ThreadPoolExecutor(3) as pool:
        results = list(pool.map(lambda trial: _signalled(*trial), trials))
    early = [moment for (_, moment, _), (_, killed) in zip(trials, results) if killed]
    return ('SIGINT or SIGTERM at a random moment', number, sum(well for well, _ in results),
            f'{len(early)} before Python could take it, at most {max(early, default=0.0):.2f} s '
            f'after the start; {cold} while compiling')


def _signalled(cold, moment, sent):
    """Send a node a signal; return whether all is well, and whether it could not take it yet."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**ENVIRONMENT, **({'NUMBA_CACHE_DIR': folder} if cold else {})}
        node = Node(folder, environment=environment, duration=1.0)
        time.sleep(moment)
        early = not node.handles_signals()
        code = node.end(sent)
        if code and early:
            return not node.log.exists(), True
        readable = not node.log.exists() or node.health()[1] > 0
        return code == 0 and 'Traceback' not in node.output() and readable, False


def overload_row(stops):
    """All cores busy, and the process stopped again and again."""
    import timo_sim
    paper = ROOT / 'config' / 'paper.yaml'
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        for _ in range(2 * (os.cpu_count() or 1)):
            stack.enter_context(attack('busy'))
        node = Node(folder, '--params-file', str(paper), catch_up_limit=0.05).ready()
        for _ in range(stops):
            time.sleep(0.5)
            node.process.send_signal(signal.SIGSTOP)
            time.sleep(0.3)
            node.process.send_signal(signal.SIGCONT)
        time.sleep(2.0)
        well, counters = survived(node)
        with open(node.log, 'rb') as stream:
            states = [(message.sequence, message.data)
                      for _, channel, message in make_reader(stream).iter_messages()
                      if channel.topic == '/joint_states']
    scene = timo_sim.load_scene(paper)
    run = timo_sim.simulate(scene, 0.01 * np.ceil(0.1 * states[-1][0]))
    exact = sum(run.motion[step, :3].tobytes() in data and run.motion[step, 6:9].tobytes() in data
                for step, data in states)
    dropped = float(counters['dropped_time_s'])
    return ('joint states on busy cores, stopped now and then: equal to `simulate` to the bit',
            len(states), exact if well and dropped > 0.2 * stops else 0,
            f'{dropped:.2f} s dropped and counted')


def soak_row(what, seconds, **parameters):
    """A long run; memory is compared after a tenth of it and at its end."""
    with tempfile.TemporaryDirectory() as folder:
        node = Node(folder, '--params-file', str(ROOT / 'config' / 'paper.yaml'),
                    **parameters).ready()
        time.sleep(0.1 * seconds)
        before = node.memory()
        time.sleep(0.9 * seconds)
        growth = node.memory() - before
        well, _ = survived(node)
        done = re.search(r'simulated (\S+) s in .*', node.output())
    return what, 1, int(well and growth < MEMORY), f'{done[0]}'.split('; log')[0] + (
        f'; {growth / 1e6:+.1f} MB')


FILES = {
    'empty': (b'', 0), 'of other bytes': (b'timo_sim: {ros__parameters: {record_file: \xe9}}', 2),
    'cut': (b'timo_sim: {ros__parameters: {arm: [', 2),
    'with a NUL': (b'timo_sim: {ros__parameters: {arm.length: 1\0}}', 2),
    'with an alias': (b'timo_sim: {ros__parameters: {arm.length: &a 1.0, arm.width: *a}}', 2),
    'with a tag': (b'timo_sim: {ros__parameters: {arm.length: !!python/object/apply:os.system '
                   b'[touch tag]}}', 2),
    'nested a thousand deep': (b'timo_sim: {ros__parameters: {a: ' + 1000 * b'[' + b'}}', 2),
    'with a list of 20000': (b'timo_sim: {ros__parameters: {arm.profile.width: ['
                             + b'1.0, ' * 20000 + b'1.0]}}', 2),
    'with a huge number': (b'timo_sim: {ros__parameters: {arm.length: 1.0e+400}}', 2),
    'with a nonsense scene': (b'timo_sim: {ros__parameters: {arm.height: 1.0e+300}}', 2)}
VALUES = (
    'arm.length:=-1.0', 'arm.length:=.nan', 'arm.length:=[1, a]', 'arm.length:=1.0e+300',
    'rate.joint_states:=1.0e+13', 'duration:=1.0e-13', 'duration:=1.0e+308',
    'integrator.step:=1.0e-300', 'command_timeout:=.inf', 'model.modes:=99999999999999999999',
    'initial.shaft:=1.0e+100', 'no.such:=1', 'record_file:=7', 'arm.length:={a: 1}', 'arm:=')


def parameter_rows(quick):
    """Parameters that must be refused in one line with code 2, in the process itself."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'scene.yaml'
        good = 0
        for content, expected in list(FILES.values())[::3 if quick else 1]:
            path.write_bytes(content)
            good += _ends_with(expected, folder, '--params-file', path.name)
        yield ('parameter files ' + ', '.join(list(FILES)[::3 if quick else 1]),
               len(list(FILES)[::3 if quick else 1]), good, 'a line, code 2; no tag is executed')
        values = VALUES[::5 if quick else 1]
        good = sum(_ends_with(2, folder, '-p', value) for value in values)
        yield 'bad parameters on the command line', len(values), good, 'a line, code 2'


def _ends_with(code, folder, *arguments):
    result = subprocess.run(
        [sys.executable, '-m', 'timo_sim.ros.sim_node', '--ros-args', '-p', 'duration:=0.01',
         '-p', 'record:=false', *arguments], cwd=folder, env=ENVIRONMENT, capture_output=True,
        text=True, timeout=READY)
    lines = [line for line in result.stderr.splitlines() if line.startswith('timo_sim: ')]
    return (result.returncode == code and len(lines) == (code == 2)
            and 'Traceback' not in result.stderr and not (Path(folder) / 'tag').exists())


def rows(quick=False, soak=60.0):
    """Do everything; yield tuples of what, how many tried, how many survived, and a remark."""
    yield from attack_rows(2.0 if quick else 20.0)
    yield deaf_row(2.0 if quick else 20.0)
    yield from namespace_rows(3 if quick else 10)
    yield signal_row(*((4, 1) if quick else (200, 10)))
    yield overload_row(2 if quick else 20)
    yield from parameter_rows(quick)
    if not quick:
        yield soak_row('free run at 1 ms', soak, real_time_factor=0.0, record=True)
        yield soak_row('real time at 1 kHz, all topics logged', soak, **{
            f'rate.{topic}': 1000.0 for topic in (
                'joint_states', 'modal_state', 'tip_deflection', 'tip_pose', 'carrier_pose')})


def main():
    """Do everything and print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--quick', action='store_true')
    parser.add_argument('--soak', type=float, default=60.0, help='seconds of each of two soaks')
    arguments = parser.parse_args()
    print('| fault | tried | survived | remark |\n|---|---|---|---|')
    for row in rows(arguments.quick, arguments.soak):
        print('| ' + ' | '.join(map(str, row)) + ' |', flush=True)


if __name__ == '__main__':
    main()
