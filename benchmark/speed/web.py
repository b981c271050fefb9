# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Measures the WebAssembly of a scene in node, its page in browsers, their sizes, and an export.

It fills doc/web.md. Times in node are the least of many short runs, which take turns.
"""

import json
import os
from pathlib import Path
import resource
import subprocess
import sys
import tempfile
import time

from benchmark.browser import BROWSERS, missing, opened
from benchmark.report import make_page, table, targets
from benchmark.timing import product
from timo_sim.export.c import write_c
from timo_sim.export.web import export_web, link_wasm

KINDS = {'plain': ('wasm32', False), '`simd128`': ('wasm32-simd128', False),
         '`simd128`, with the estimate': ('wasm32-simd128', True)}
GOALS = {'`simd128`': 2.5, '`simd128`, with the estimate': 12.0}  # [us]
PROGRAM = """
const fs = require('fs'), STEPS = 200;
const arms = process.argv.slice(1).map(path => {
    const code = new WebAssembly.Module(fs.readFileSync(path));
    const arm = new WebAssembly.Instance(code, {}).exports;
    const size = arm.arm_size(), place = (arm.__heap_base.value + 63) & ~63;
    arm.memory.grow(Math.ceil(size / 65536) + 1);
    if (arm.arm_create(place, size)) throw 'not created';
    return () => {
        const begun = process.hrtime.bigint();
        if (arm.arm_step(place, BigInt(STEPS))) throw 'not stepped';
        return Number(process.hrtime.bigint() - begun) / STEPS / 1e3;
    };
});
const least = arms.map(() => Infinity);
for (let k = 0; k < 600; ++k) arms.forEach((run, n) => { least[n] = Math.min(least[n], run()); });
console.log(JSON.stringify(least));
"""


def steps(_):
    """Return the table of a step in node."""
    with tempfile.TemporaryDirectory() as folder:
        paths = []
        for number, (target, estimate) in enumerate(KINDS.values()):
            content = write_c('paper', Path(folder, str(number)), target, estimate,
                              derivatives=False) / 'arm.o'
            paths.append(Path(folder, f'{number}.wasm'))
            paths[-1].write_bytes(link_wasm(content.read_bytes()))
        found = json.loads(subprocess.run(['node', '-e', PROGRAM, *paths], check=True,
                                          capture_output=True).stdout)
    return targets([
        (f'a step of the paper, N = 3, {kind}', f'{GOALS[kind]:g} us' if kind in GOALS else '',
         f'{time:.3g} us', time <= GOALS[kind] if kind in GOALS else None, '')
        for kind, time in zip(KINDS, found)])


# Notes when the first picture is there.
FIRST = """<script>requestAnimationFrame(function look() {
  if (typeof drawn === 'number' && drawn) window.first = performance.now();
  else requestAnimationFrame(look);
});</script>"""
# Measures frames: what is between them, their script and, since a browser paints later, the script
# until a pixel of each canvas can be read.
WATCH = """
const own = frame, paint = arguments[0];
window.frames = [];
window.frame = now => {
  const begin = performance.now();
  own(now);
  if (paint) for (const id of ['plane', 'curves'])
    byId(id).getContext('2d').getImageData(0, 0, 1, 1);
  window.frames.push([now, performance.now() - begin]);
};
"""
READ = """
window.frame = own => {};
const [times, spent] = [0, 1].map(place => window.frames.map(each => each[place]));
spent.sort((a, b) => a - b);
return [spent[spent.length >> 1], spent[Math.floor(0.95 * spent.length)],
        1000 * (times.length - 1) / (times[times.length - 1] - times[0])];
"""
CLOSE = "byId('loads').click(); byId('reset').click(); byId('forth').click()"
SECONDS = 5.0  # that each is watched


def frames(_):
    """Return the table of frames in the browsers that are installed, none is shown."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        page = export_web({'paper': 'paper'}, Path(folder, 'arm.html'))
        page.write_text(page.read_text().replace('<head>', f'<head>{FIRST}'))
        for name in BROWSERS:
            if missing(name):
                continue
            found = []
            with opened(name, Path(folder, name)) as window:
                for paint in False, True:
                    window.open(page)
                    first = window.until('return window.first')
                    window.run(CLOSE)
                    time.sleep(11.0)  # the curves are full
                    window.run(WATCH, paint)
                    time.sleep(SECONDS)
                    found += [first, *window.run(READ)]
            first, script, _, rate, _, painted, most, _ = found
            rows.append((name, f'{first / 1e3:.2f} s', f'{rate:.0f}', f'{script:.1f} ms',
                         f'{painted:.1f} ms', f'{most:.1f} ms'))
    return table(['browser', 'first picture', 'frames a second', 'script of a frame',
                  'and its picture', '95 % of them below'], rows)


def sizes(_):
    """Return the table of the sizes of pages."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for names in ['paper'], ['arm'], ['paper', 'arm', 'standing']:
            for estimate in False, True:
                page = export_web({name: name for name in names}, Path(folder, 'arm.html'),
                                  estimate)
                rows.append((', '.join(names), 'yes' if estimate else 'no',
                             f'{page.stat().st_size / 1e3:.0f} kB'))
    return table(['scenes', 'estimate', 'size'], rows)


WEB = ['export-web', 'paper']


def exports(_):
    """Return the table of the processor time of exports, each in a process of its own."""
    rows = []
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as out:
        for line, kept, command in (
                ('`export-web`, a clone, nothing compiled', 'none', WEB),
                ('`export-web`, new to an installed package', '[!t]*.bc', WEB),
                ('`export-web`, the same again', '*', WEB),
                ('`export-c`, new to an installed package', '[!t]*.bc', ['export-c', 'paper']),
                ('`export-c`, then another target', '*', [
                    'export-c', 'paper', '--target', 'aarch64']),
                ('`export-c`, the same again', '*', [
                    'export-c', 'paper', '--target', 'aarch64'])):
            for file in {*Path(folder).glob('*/*')} - {*Path(folder).glob(f'*/{kept}')}:
                file.unlink()
            before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            subprocess.run([sys.executable, '-m', 'timo_sim', *command, '-o',
                            Path(out, command[0])],
                           env={**os.environ, 'NUMBA_CACHE_DIR': folder}, check=True,
                           capture_output=True)
            spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
            rows.append((line, f'{spent:.1f} s'))
    return table(['', 'processor time'], rows)


if __name__ == '__main__':
    version = subprocess.run(['node', '--version'], capture_output=True, text=True).stdout.strip()
    make_page(__spec__, __doc__, 'web.md', {
        'Speed': steps, 'Frames': frames, 'Size': sizes, 'Export': exports},
        node=lambda: version, calibrating_product=lambda: (
                  f'{1e9 * min(product() for _ in range(200)):.0f} ns'))
