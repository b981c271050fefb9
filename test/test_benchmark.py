# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The benchmarks begin: their modules can be imported, and no wait for a process is for ever."""

import importlib

import pytest

from benchmark import ROOT
from benchmark.process import arguments, running, wait
from benchmark.speed import node


def test_modules_can_be_imported():
    """What needs a package that is not installed is named; mypy checks what it uses of ours."""
    left_out = []
    for path in sorted((ROOT / 'benchmark').rglob('*.py')):
        module = '.'.join(path.relative_to(ROOT).with_suffix('').parts)
        try:
            importlib.import_module(module)
        except ModuleNotFoundError as error:
            assert error.name.split('.')[0] not in ('benchmark', 'oracles', 'timo_sim'), error
            left_out.append(f'{module} ({error.name})')
    if left_out:
        pytest.skip(f'not imported for want of packages: {", ".join(left_out)}')


def test_a_process_that_dies_ends_a_wait_with_what_it_has_said():
    with running(['-c', 'print("bad luck"); raise SystemExit(3)']) as dead:
        with pytest.raises(RuntimeError, match='code 3 .*\nbad luck'):
            wait(lambda: False, dead)


def test_a_timed_node_tells_when_it_did_each_step():
    pytest.importorskip('rclpy')
    begun, ticks, said = node.finished(*arguments(duration=0.05))
    assert 'simulated 0.05 s' in said
    assert ticks[:, 2].sum() == 50 and (ticks[:, 0] > begun).all()
    assert (ticks[:, 1] >= ticks[:, 0]).all()
