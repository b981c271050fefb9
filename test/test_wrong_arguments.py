# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Arguments of public functions, replaced by what is wrong there, are refused by name."""

import re

import numpy as np
import pytest

import timo_sim

WRONG = {'None': None, 'nan': np.nan, 'inf': np.inf, '-1': -1, '0': 0, "''": '', "'x'": 'x',
         '[]': [], '{}': {}, 'complex': 1.0 + 2.0j, '1e300': 1e300, 'object': object(),
         'huge': 10**400}
TIME = np.arange(0.0, 1.0, 0.01)


def calls(folder):
    """Yield functions, arguments that are right, and which of WRONG are right by argument."""
    scene = timo_sim.load_scene('paper')
    run, model, shaper = (function(scene) for function in (
        lambda scene: timo_sim.simulate(scene, 0.01), timo_sim.linearize, timo_sim.shaper))
    record = timo_sim.Record.of({'torque': (TIME, TIME)}, {'shaft': (TIME, TIME)})
    yield timo_sim.load_scene, {'overrides': {}}, {'overrides': 'None {}'}
    yield model.select, {'inputs': ['torque_N_m'], 'outputs': ['shaft_rad']}, {
        'inputs': 'None []', 'outputs': 'None []'}
    yield shaper.shape, {'command': np.sin}, {}
    yield shaper.residual, {'frequency': 1.0, 'damping': 0.0}, {
        'frequency': '0 -1 [] 1e300', 'damping': 'None 0 []'}
    yield timo_sim.simulate, {'scene': scene, 'duration': 0.001, 'estimate': False}, {
        'duration': '0', 'scene': '{}'}
    yield timo_sim.sensitivities, {'scene': scene, 'duration': 0.001, 'commands': {}}, {
        'commands': 'None {}', 'scene': '{}'}
    yield timo_sim.modes, {'scene': scene, 'speed': 0.0}, {'scene': '{}', 'speed': 'None 0 -1'}
    yield timo_sim.Record.of, {
        'inputs': {}, 'outputs': {'shaft': (TIME, TIME)}, 'noise': {}, 'source': 'a'}, {
            'inputs': '{}', 'noise': 'None {}', 'source': "'' 'x'"}
    yield record.cut, {'start': 0.0, 'end': 0.5}, {'start': '0', 'end': 'inf 1e300'}
    yield lambda count: timo_sim.Batch(scene, 2).advance_tips(count), {'count': 1}, {}
    yield run.save, {'path': folder / 'run.mcap'}, {'path': "'x'"}
    yield timo_sim.open_log, {'path': run.save(folder / 'log.mcap'), 'node': None}, {
        'node': "None ''"}
    yield timo_sim.read_record, {'path': folder / 'record.csv'}, {}


def test_wrong_arguments_are_refused_by_name(tmp_path):
    taken, deep, count = [], [], 0
    for function, right, fine in calls(tmp_path):
        for argument in right:
            for label, wrong in WRONG.items():
                if label in fine.get(argument, '').split() or function is timo_sim.load_scene and (
                        argument == 'source'):
                    continue
                given = {**({'source': 'paper'} if function is timo_sim.load_scene else {}),
                         **right, argument: wrong}
                count += 1
                with pytest.raises(BaseException) as caught:
                    function(**given)
                    taken.append((function, argument, label))
                    raise timo_sim.ParameterError('taken')
                if not isinstance(caught.value, (timo_sim.ParameterError, OSError)) and not (
                        re.search(rf'\b{argument}\b', str(caught.value))):
                    deep.append((function, argument, label, caught.value))
    assert not taken and len(deep) < 0.04 * count, (taken, deep)
