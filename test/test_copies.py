# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""All public objects can be pickled and copied, and copies of what moves go ways of their own."""

import copy
import inspect
import pickle

import numpy as np
import pytest

import timo_sim
from timo_sim.gym import ReachEnv, ReachVectorEnv
from timo_sim.simulation.finer import refine

WAYS = copy.copy, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))
HELD = {'arm.length': 1.0, 'arm.section.width': 0.02, 'arm.section.height': 0.02,
        'arm.density': 2700.0, 'arm.young_modulus': 7e10,
        'arm.shear_modulus': 2.6e10, 'arm.damping_ratio': [],
        'carrier.held': 'both', 'motor.shaft_inertia': 0.1, 'motor.mass': 1.0,
        'end_effector.mass': 0.1, 'end_effector.inertia': 1e-4, 'initial.shaft': 0.0,
        'model.static_modes': 'none'}
TIME = np.arange(0.0, 1.0, 0.01)


def diverged():
    """Return the error of a torque that no arm bears."""
    with pytest.raises(timo_sim.DivergenceError) as caught:
        timo_sim.simulate({**HELD, 'load.torque.table.time': [0.0, 1.0],
                           'load.torque.table.value': [1e7, 1e7]}, 0.1)
    return caught.value


def fitted(record):
    """Return the Fit of a rigid arm's inertia."""
    return timo_sim.fit({**HELD, 'model.modes': 0}, record, ['motor.shaft_inertia'], quick=True)


def moving(scene):
    """Return what has a state, after a step, and the function that goes on with it."""
    noisy = timo_sim.load_scene(scene, {'sensor.encoder.noise': 1e-4})
    observer, batch = timo_sim.observer(noisy), timo_sim.Batch(scene, n=9)
    rough = timo_sim.load_scene(scene, {'motor.coulomb_friction': 0.1})
    simulators = [timo_sim.EstimatingSimulator(scene), timo_sim.Simulator(rough), batch]
    yield from ((each, lambda each: each.step(torque=2.0, duration=0.02).values)
                for each in simulators)
    yield observer, lambda each: each.update(
        {'encoder': 1e-3}, {'torque': 1.0}, 0.002).values
    for each in ReachEnv(), ReachVectorEnv(3):
        each.reset(seed=1)
        yield each, lambda each: each.step(np.full(each.action_space.shape, 0.5, np.float32))[0]


def test_copies_of_what_moves_go_on_with_the_same_bits_and_share_no_state():
    for each, go_on in moving(timo_sim.load_scene(HELD)):
        go_on(each)
        copies = [way(each) for way in WAYS]
        further = go_on(each)
        for other in copies:  # the first is already further when the others begin
            assert np.array_equal(go_on(other), further), each
            go_on(other)


def test_every_public_object_can_be_pickled_and_copied(tmp_path):
    scene, truth = timo_sim.load_scene(HELD), 1.0 / (0.1 + 1.08 / 3.0 + 0.1)
    run, noise = timo_sim.simulate(scene, 0.1), np.random.default_rng(1).normal(0.0, 1e-3, 100)
    record = timo_sim.Record.of({'torque': (TIME, np.ones(100))},
                                {'shaft': (TIME, 0.5 * truth * TIME**2 + noise)})
    model = timo_sim.linearize(scene)
    plan = timo_sim.feedforward(model.select(['torque_N_m']).to_discrete(0.02),
                                {'shaft_rad': 0.1}, 1.0)
    objects = [
        scene, run, timo_sim.open_log(run.save(tmp_path / 'run.mcap')), diverged(), record,
        fitted(record), model, timo_sim.modes(scene), timo_sim.shaper(scene), plan,
        timo_sim.sensitivities(scene, 0.1, parameters=['arm.length']), run.motion,
        timo_sim.Simulator(scene).sensors, timo_sim.Simulator(scene).step_derivatives(),
        timo_sim.ParameterError('x'), timo_sim.ModelWarning('x'),
        *(each for each, _ in moving(scene))]
    lacking = {name for name in timo_sim.__all__
               if inspect.isclass(kind := getattr(timo_sim, name))
               and not any(isinstance(each, kind) for each in objects)}
    assert not lacking
    for each in objects:
        for way in WAYS:
            found = way(each)
            assert type(found) is type(each)
            if not repr(each).startswith('<timo_sim'):  # the default's, which has an address
                assert repr(found) == repr(each)


def test_a_copy_of_a_finer_scene_keeps_its_axial_vibrations():
    """The steps of the scene do not resolve them, those of the finer one do."""
    scene = timo_sim.load_scene({**HELD, 'model.axial_modes': 1, 'integrator.step': 0.001})
    for way in WAYS:
        assert way(refine(scene, 4)).fastest == np.inf > way(scene).fastest
