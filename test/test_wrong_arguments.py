# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Each argument of each public function, replaced by what is wrong there, is refused by name."""

import inspect
import re

import numpy as np

import timo_sim
from timo_sim.gym import ReachEnv, ReachVectorEnv
from timo_sim.log.read import LogError

WRONG = {'None': None, 'nan': np.nan, 'inf': np.inf, '-1': -1, '0': 0, "''": '', "'x'": 'x',
         '[]': [], '{}': {}, 'complex': 1.0 + 2.0j, '1e300': 1e300, 'object': object(),
         'huge': 10**400, 'table': np.ones((2, 2))}
RIGID = {'model.modes': 0, 'carrier.held': 'both', 'initial.shaft': 0.0, 'motor.mass': 1.0,
         'motor.torque_limit': 10.0, 'sensor.encoder.noise': 1e-3, 'integrator.step': 0.001}
TIME = np.arange(0.0, 1.0, 0.01)
# Nobody but this package makes them.
RESULTS = {'Fit', 'LinearModel', 'Plan', 'Record', 'Run', 'Scene', 'Sensitivities', 'Shaper'}


def calls(folder):
    """Yield functions, arguments that are right, and which of WRONG are right by argument."""
    scene, bent = timo_sim.load_scene('paper', RIGID), timo_sim.load_scene('paper')
    run, model = timo_sim.simulate(scene, 0.01), timo_sim.linearize(scene)
    simulator, batch = timo_sim.Simulator(scene), timo_sim.Batch(scene, 2)
    shaft = simulator.step(torque=1.0, duration=1.0).shaft * TIME**2
    shaft = shaft + np.random.default_rng(1).normal(0.0, 1e-3, 100)
    record = timo_sim.Record.of({'torque': (TIME, TIME**0)}, {'shaft': (TIME, shaft)})
    (folder / 'record.csv').write_text('time_s,shaft_rad\n' + ''.join(
        f'{t},{at}\n' for t, at in zip(TIME, shaft)))
    discrete = model.select(['torque_N_m'], ['shaft_rad']).to_discrete(0.02)
    plan = timo_sim.feedforward(discrete, {'shaft_rad': 0.1}, 1.0)
    shaper, observer = timo_sim.shaper(bent), timo_sim.observer(scene)
    fit = timo_sim.fit(scene, record, ['motor.shaft_inertia'], quick=True)
    none, whole = 'None', {'count': '0', 'sample_every': '0', 'commanded': 'None'}
    time, anywhere = {'duration': 'None 0'}, {'xi': 'None 0 []'}
    number = '0 -1 1e300'

    yield timo_sim.load_scene, {'source': 'paper', 'overrides': {}}, {
        'source': '{}', 'overrides': 'None {}'}
    yield scene.vary, {'overrides': {}}, {'overrides': '{}'}
    yield scene.build, {'tip': None, 'first': None}, {'tip': none, 'first': none}
    yield scene.initial_motion, {'model': None}, {'model': none}
    yield scene.modal, {'name': 'initial.deflection'}, {}
    yield timo_sim.project_on_modes, {
        'scene': scene, 'deflection': np.sin, 'rotation': np.cos}, {'scene': '{}'}
    yield timo_sim.choose_resolution, {
        'scene': {**RIGID, 'model.accuracy': 1e-3}, 'duration': 0.001}, {'duration': '0'}
    yield timo_sim.simulate, {
        'scene': scene, 'duration': 0.001, 'sample_every': 1, 'estimate': False}, {
            'scene': '{}', 'duration': '0'}
    yield timo_sim.simulate_many, {
        'scene': scene, 'variations': [{}], 'duration': 0.001, 'workers': 1,
        'scheduler': None}, {'scene': '{}', 'variations': '[]', 'duration': '0',
                             'workers': none, 'scheduler': none}
    for of in run, simulator, observer:
        for function in of.position, of.deflection, of.rotation:
            yield function, {'xi': 0.5}, anywhere
    yield run.save, {'path': folder / 'run.mcap'}, {'path': "'x'"}
    yield run.plot, {'deflection_scale': 1.0}, {'deflection_scale': number}
    yield run.view, {'deflection_scale': 1.0}, {'deflection_scale': number}
    yield timo_sim.open_log, {'path': run.save(folder / 'log.mcap'), 'node': None}, {
        'node': "None ''"}

    yield timo_sim.Simulator, {'scene': scene}, {'scene': '{}'}
    yield timo_sim.EstimatingSimulator, {'scene': scene}, {'scene': '{}'}
    yield simulator.change, {'scene': scene}, {}
    yield simulator.warm_up, {'tell': None, 'messages': False}, {'tell': none}
    yield simulator.step, {'torque': 1.0, 'force': [0.0, 1.0], 'duration': 0.001}, {
        'torque': number, 'duration': 'None 0'}
    yield simulator.step_derivatives, {'inputs': ['torque'], 'duration': 0.001, 'torque': 1.0}, {
        'inputs': '[]', 'duration': 'None 0', 'torque': number}
    yield simulator.set_motion, {'motion': run.values[0]}, {}
    yield simulator.advance, {'count': 1, 'commanded': None, 'sample_every': 1}, whole
    estimating = timo_sim.EstimatingSimulator(scene)
    yield estimating.measure_error, {'steps': 0}, {'steps': '0'}
    yield estimating.change, {'scene': scene}, {}
    yield estimating.set_motion, {'motion': run.values[0]}, {}
    yield estimating.warm_up, {'tell': None, 'messages': False}, {'tell': none}

    yield timo_sim.Batch, {'scenes': scene, 'n': 2, 'device': 'cpu'}, {'scenes': '{}', 'n': none}
    yield batch.step, {'torque': 1.0, 'force': [0.0, 1.0], 'duration': 0.001}, {
        'torque': number, 'force': 'table', **time}
    yield batch.advance, {'count': 1, 'commanded': None, 'sample_every': 1}, whole
    yield batch.advance_tips, {'count': 1}, {}
    yield batch.reset, {'mask': [True, False], 'motion': run.values[0]}, {
        'mask': none, 'motion': none}
    yield batch.reason, {'number': 0}, {'number': '0 -1'}

    yield timo_sim.linearize, {
        'scene': scene, 'at': None, 'contact': '', 'inputs': ['torque_N_m'],
        'outputs': ['shaft_rad']}, {
        'inputs': 'None []', 'outputs': 'None []',
        'scene': '{}', 'at': none, 'contact': "''"}
    yield model.select, {'inputs': ['torque_N_m'], 'outputs': ['shaft_rad']}, {
        'inputs': 'None []', 'outputs': 'None []'}
    yield model.state, {'motion': run.values[0]}, {}
    yield model.to_motion, {'x': np.zeros(len(model.A))}, {'x': 'table'}
    yield model.to_discrete, {'dt': 0.01}, {'dt': '1e300'}
    yield model.frequency_response, {'frequency': [1.0]}, {
        'frequency': '-1 1e300 [] table'}
    yield timo_sim.modes, {'scene': bent, 'speed': 0.0, 'contact': ''}, {
        'scene': '{}', 'speed': 'None 0 -1', 'contact': "''"}
    yield timo_sim.modes(bent).shapes, {'xi': [0.5]}, {'xi': '0 [] table'}
    yield timo_sim.sensitivities, {
        'scene': scene, 'duration': 0.001, 'output': timo_sim.Batch.rotation,
        'parameters': ['motor.shaft_inertia'], 'samples': 1}, {'scene': '{}'}

    yield timo_sim.shaper, {
        'plant': bent, 'kind': 'ZV', 'modes': 1, 'tolerance': 0.05, 'contact': ''}, {
            'plant': '{}', 'contact': "''"}
    yield shaper.shape, {'command': np.sin}, {}
    yield shaper.shape_samples, {'samples': [0.0, 1.0], 'dt': 0.01}, {'dt': '1e300'}
    yield shaper.residual, {'frequency': 1.0, 'damping': 0.0}, {
        'frequency': '0 -1 [] 1e300 table', 'damping': 'None 0 []'}
    yield timo_sim.ringdown, {
        't': TIME, 'values': np.cos(60.0 * TIME) * np.exp(-TIME), 'start': 0.0, 'end': 1.0}, {
            'start': 'None 0 -1', 'end': 'None 1e300'}
    yield timo_sim.feedforward, {
        'model': discrete, 'goal': {'shaft_rad': 0.1}, 'duration': 1.0, 'limit': 20.0,
        'rate_limit': 1e3}, {
            'duration': none, 'limit': 'inf 1e300', 'rate_limit': 'inf 1e300'}
    yield plan.at, {'t': 0.1}, {'t': number}
    yield timo_sim.observer, {
        'scene': scene, 'sensors': ['encoder'], 'disturbance': {'torque': (0.1, 0.2)}}, {
            'scene': '{}', 'sensors': none, 'disturbance': 'None {}'}
    yield observer.expected, {'sensor': 'encoder'}, {}
    yield observer.update, {
        'measured': {'encoder': 0.0}, 'command': {'torque': 1.0}, 'dt': 0.001}, {
            'measured': '{}', 'command': 'None {}', 'dt': 'None 0'}

    yield timo_sim.read_record, {'path': folder / 'record.csv', 'mapping': {
        'time': 'time_s', 'columns': {'shaft_rad': 'shaft'}}}, {}
    yield timo_sim.Record.of, {
        'inputs': {'torque': (TIME, TIME)}, 'outputs': {'shaft': (TIME, TIME)},
        'source': 'a'}, {'inputs': '{}', 'source': "'' 'x'"}
    yield record.select, {'outputs': 'shaft'}, {}
    yield record.cut, {'start': 0.0, 'end': 0.5}, {'start': '0', 'end': 'inf 1e300'}
    yield timo_sim.fit, {
        'scene': scene, 'record': record, 'free': ['motor.shaft_inertia'], 'bounds': {},
        'hold_out': 0.0, 'loss': 'linear', 'mapping': None, 'starts': 1,
        'hold_out_records': [], 'quick': True, 'tell': None, 'time': None, 'auto': False,
        'keep': None}, {
            'scene': '{}', 'bounds': 'None {}', 'hold_out': '0',
            'mapping': none, 'starts': none, 'hold_out_records': '[]', 'tell': none,
            'time': 'None 1e300', 'keep': none}
    yield fit.sample, {'n': 2, 'seed': 0}, {'seed': '0'}
    yield fit.save, {'path': folder / 'fit.yaml'}, {'path': "'x'"}
    yield timo_sim.export_c, {
        'scene': scene, 'folder': folder / 'c', 'target': 'host', 'estimate': False,
        'name': 'arm'}, {'scene': '{}', 'folder': "'x'", 'name': "'x'"}
    yield timo_sim.export_fmu, {
        'scene': scene, 'path': folder / 'a.fmu', 'version': 3, 'estimate': False,
        'target': 'host'}, {'scene': '{}', 'path': "'x'"}

    envs = {'num_envs': 1, 'scene': scene, 'variations': None, 'period': 0.02, 'duration': 0.1,
            'farthest_goal': 1.0, 'force': 0.0, 'device': 'cpu', 'autoreset_mode': 'NextStep'}
    fine = {'scene': '{}', 'variations': none, 'farthest_goal': '0 1e300', 'force': '0'}
    yield ReachVectorEnv, envs, fine
    yield ReachEnv, dict([*envs.items()][1:-2]), fine
    many, one = ReachVectorEnv(**envs), ReachEnv(scene=scene)
    for env, action in (many, 'actions'), (one, 'action'):
        yield env.reset, {'seed': 1, 'options': {}}, {'seed': 'None 0', 'options': 'None {}'}
        yield env.step, {action: 0.0 * env.action_space.sample()}, {}
    yield many.reward, {'observations': np.zeros((1, 4)), 'actions': np.zeros((1, 1))}, {
        'observations': 'table', 'actions': 'table'}


def public_arguments():
    """Return public callables, by name, with their arguments, but for those of results."""
    owners = (*(getattr(timo_sim, name) for name in timo_sim.__all__), ReachEnv, ReachVectorEnv)
    callables = []
    for owner in owners:
        if inspect.isfunction(owner):
            callables.append(owner)
        elif inspect.isclass(owner) and not issubclass(owner, Exception):
            callables += [each for name, each in inspect.getmembers(owner, inspect.isfunction)
                          if name[0] != '_' and each.__module__.startswith('timo_sim')]
            if owner.__name__ not in RESULTS:
                callables.append(owner)
    return {(each.__qualname__, name) for each in callables
            for name, argument in inspect.signature(each).parameters.items()
            if name != 'self' and argument.kind is not argument.VAR_KEYWORD}


def outcomes(folder):
    """Yield by function, argument and wrong value the error, or None."""
    for function, right, fine in calls(folder):
        for argument in right:
            for label in WRONG.keys() - set(fine.get(argument, '').split()):
                given, caught = {**right, argument: WRONG[label]}, None
                try:
                    if function.__qualname__ == 'Record.select':
                        function(given[argument])
                    else:
                        function(**given)
                except Exception as error:
                    caught = error
                yield function.__qualname__, argument, label, caught


def test_wrong_arguments_are_refused_by_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = [*outcomes(tmp_path)]
    lacking = public_arguments() - {each[:2] for each in found}
    taken = [each[:3] for each in found if each[3] is None]
    deep = [each for each in found if each[3] is not None and not (
        isinstance(each[3], (timo_sim.ParameterError, LogError, OSError))
        or re.search(rf'\b{each[1]}\b', str(each[3])))]
    assert not lacking and not taken and not deep, (lacking, taken, deep)
