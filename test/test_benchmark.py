# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The benchmarks begin: modules can be imported, no wait is for ever; pictures obey a rule."""

import importlib

import numpy as np
import pytest

from benchmark import drawing, ROOT
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


@pytest.mark.parametrize('spoil, told', [
    (lambda axes: axes.set_xlabel('time', fontsize=6), "'time' is smaller than 9 px"),
    (lambda axes: axes.plot(np.ones((2, 5))), '7 curves in one of its axes, above 6'),
    (lambda axes: axes.figure.text(0.9, 0.5, 'beyond the edge'), 'something is outside')])
def test_a_picture_that_breaks_the_rule_is_refused(spoil, told, tmp_path, monkeypatch):
    monkeypatch.setattr(drawing, 'ROOT', tmp_path)
    (tmp_path / 'doc').mkdir()
    figure, axes = drawing.sheet()
    for height in 1.0, 1.001:
        axes.plot([0.0, 1.0], [0.0, height], label=f'to {height}')
    drawing.name_ends(axes)
    # Apart by more than a letter is high.
    low, high = sorted(text.xyann[1] * axes.bbox.height for text in axes.texts)
    assert high - low > axes.texts[0].get_fontsize() * drawing.DPI / 72.0
    assert drawing.save(figure, 'good') and not drawing.save(figure, 'good')
    spoil(axes)
    for line in axes.lines:
        line.set_label('named')
    with pytest.raises(ValueError, match=told):
        drawing.save(figure, 'bad')
    assert [each.name for each in (tmp_path / 'doc').iterdir()] == ['good.png']
