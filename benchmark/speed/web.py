# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Measures the WebAssembly of a scene in node, the size of its page and the time of an export.

It fills doc/web.md. Times in node are the least of many short runs, which take turns.
"""

import json
import os
from pathlib import Path
import resource
import subprocess
import sys
import tempfile

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


def exports(_):
    """Return the table of the processor time of exports, each in a process of its own."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, 'NUMBA_CACHE_DIR': folder}
        for line, target in (
                ('a kind of arm that is new', 'riscv64'), ('then another target', 'aarch64'),
                ('the same again', 'aarch64')):
            before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            subprocess.run([sys.executable, '-m', 'timo_sim', 'export-c', 'paper', '-o',
                            Path(folder, 'arm'), '--target', target], env=environment, check=True,
                           capture_output=True)
            spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
            rows.append((f'`export-c`, {line}', f'{spent:.1f} s'))
    return table(['', 'processor time'], rows)


if __name__ == '__main__':
    version = subprocess.run(['node', '--version'], capture_output=True, text=True).stdout.strip()
    make_page(__spec__, __doc__, 'web.md', {'Speed': steps, 'Size': sizes, 'Export': exports},
              node=lambda: version, calibrating_product=lambda: (
                  f'{1e9 * min(product() for _ in range(200)):.0f} ns'))
