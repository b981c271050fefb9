# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""What the benchmarks compare with agrees with this package; their pictures show all of it."""

import json

import numpy as np
import pytest

from benchmark.accuracy.links import rigid_links
from oracles import peers
from oracles.references import ROOT, spin_up, world
import timo_sim

SCENE = {'model.formulation': 'newton', 'model.modes': 2, 'initial.shaft_velocity': 1.0,
         'initial.modal_rates': [0.3, 0.0],
         'load.torque.harmonic.amplitude': [5.0], 'load.torque.harmonic.frequency': [1.0],
         'load.force_x.piecewise.time': [0.2], 'load.force_x.piecewise.value': [4.0]}
DURATION = 0.4


@pytest.fixture(scope='module')
def truth():
    scene = timo_sim.load_scene(SCENE, {'integrator.step': 0.0005})
    return timo_sim.simulate(scene, DURATION).values[-1]


def test_scipy_agrees(truth):
    scene = timo_sim.load_scene(SCENE)
    load, jumps = peers.load_function(scene)
    motions = peers.adaptive('DOP853', scene.build(), scene.initial_motion(), load, jumps,
                             np.array([0.0, 0.1, DURATION]), 1e-11)
    assert jumps == [0.2]
    assert np.abs(motions[-1] - truth).max() < 1e-9


@pytest.mark.parametrize('method, order', [
    ('RK4', 4.0), ('implicit midpoint', 2.0), ('generalized-alpha', 2.0)])
def test_methods_with_fixed_steps_have_their_order(method, order, truth):
    """Generalized-alpha keeps the state's rate, which it must renew where the load jumps."""
    errors = []
    for step in (0.008, 0.004, 0.002):
        scene = timo_sim.load_scene(SCENE, {'integrator.step': step})
        steps = round(DURATION / step)
        motions = peers.fixed_step(method, scene.build(), scene.initial_motion(),
                                   scene.load.stages(0, steps, step), step, steps,
                                   compiled=False)
        errors.append(np.abs(motions[-1] - truth).max())
    observed = np.log2(np.array(errors[:-1]) / errors[1:])
    assert observed == pytest.approx(order, abs=0.3)


def test_a_chain_of_links_tends_to_the_arm():
    """An arm that hardly shears is the limit of its chains, with errors of second order."""
    scene = timo_sim.load_scene(ROOT / 'config' / 'paper.yaml', {
        'model.modes': 6, 'arm.shear_modulus': 27e12, 'integrator.step': 0.005})
    truth = timo_sim.simulate(scene, 0.25, sample_every=2, estimate=False)
    errors = []
    for links in (4, 8):  # for each of which the equations are compiled
        _, theta, carrier, along, across = rigid_links(
            scene, links, 2e-4, 0.25, 50, gauss=False, matched=0, compiled=False)
        tip = world(theta, carrier, along, across)
        errors.append(np.abs(tip - truth.position(2.0)[1:]).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize('source, drive', [('paper', None), ('spin_up', spin_up())])
def test_exponential_steps_of_links_have_their_order(source, drive):
    """The shaft is free, or driven; short Runge-Kutta steps are the truth."""
    scene = timo_sim.load_scene(ROOT / 'config' / f'{source}.yaml', {'initial.shaft': 0.0})

    def across(step, **more):
        return rigid_links(scene, 4, step, 2.0, round(0.04 / step), drive,
                           compiled=False, **more)[-1]

    truth = across(0.0005)
    errors = [np.abs(across(step, exponential=True) - truth).max() for step in (0.04, 0.02, 0.01)]
    observed = np.log2(np.array(errors[:-1]) / errors[1:])
    assert observed == pytest.approx(4.0, abs=0.5)


def test_pictures_of_the_benchmark_show_the_fastest_method_of_each_family():
    from benchmark.figures.work_precision import draw, FAMILIES, FOLDER  # takes a second
    stored = json.loads((FOLDER / 'work_precision.json').read_text(encoding='utf-8'))
    runs = [each[-1] for each in stored.values() if 'methods' in each[-1]]
    assert len(runs) == 4
    for run in runs:
        axes, = draw(run).axes
        drawn = {line.get_label(): list(line.get_ydata()) for line in axes.lines}
        assert {*drawn} == {words for _, words, *_ in FAMILIES}
        for kinds, words, *_ in FAMILIES:
            found = [method['best'] for method in run['methods'].values()
                     if method['kind'] in kinds]
            for k, seconds in enumerate(drawn[words]):
                assert seconds == min(best[k]['seconds'] for best in found if best[k])
        named = {text.get_text(): text.xyann[1] for text in axes.texts}
        assert {*named} == {*drawn}
        heights = sorted(named.values())  # in those of the axes
        assert heights[0] >= 0.0 and heights[-1] <= 1.0 and np.diff(heights).min() > 0.04
        assert sorted(named, key=named.get) == sorted(named, key=lambda name: drawn[name][0])
