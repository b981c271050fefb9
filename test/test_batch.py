# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Many manipulators at once do what each does alone, whatever the others do."""

import subprocess
import sys
import threading

import numpy as np
import pytest

import timo_sim
from timo_sim.model.layout import FORCE_Y, LOADS, TIP_X, TORQUE, VOLTAGE

HELD = {'carrier.held': 'both'}
MOTOR = {'motor.dc.resistance': 2.0, 'motor.dc.torque_constant': 0.5, 'motor.dc.gear_ratio': 3.0,
         'motor.dc.voltage_limit': 20.0}
SWING = {'load.torque.harmonic.amplitude': [40.0], 'load.torque.harmonic.frequency': [1.3]}
STATIC = {'model.static_modes': 'torque', 'load.tip_torque.harmonic.amplitude': [9.0],
          'load.tip_torque.harmonic.frequency': [3.0]}
SCENES = {
    'free': {**SWING, 'arm.damping_ratio': [0.01], 'motor.viscous_friction': 2.0,
             'carrier.viscous_friction': 5.0},
    'driven, held': {**HELD, 'motor.shaft': 'driven', 'motor.drive.time': [0.0, 0.3, 0.8],
                     'motor.drive.angle': [0.0, 0.4, 0.1], 'motor.drive.speed': [0.0, 0.5, 0.0],
                     'motor.drive.acceleration': [0.0, 2.0, 0.0], 'gravity': [0.0, -9.81]},
    'friction that builds up': {
        **SWING, 'motor.coulomb_friction': 3.0, 'motor.coulomb_speed': 0.3,
        'carrier.coulomb_friction': 2.0, 'carrier.coulomb_speed': 0.1},
    'stretches, static mode': {
        **SWING, **STATIC, 'hub.radius': 0.2, 'model.axial_modes': 1,
        'initial.shaft_velocity': 6.0},
    'gear': {**SWING, 'motor.gear.stiffness': 900.0, 'motor.gear.backlash': 0.01,
             'motor.gear.damping': 2.0, 'motor.rotor.inertia': 0.5,
             'motor.rotor.viscous_friction': 0.2, 'motor.rotor.coulomb_friction': 1.0,
             'motor.rotor.coulomb_speed': 0.3, 'motor.rotor.coulomb_asymmetry': 0.5},
    'limits': {'motor.torque_limit': 12.0, 'carrier.force_limit': 30.0},
    'limits of rates': {'motor.torque_limit': 12.0, 'motor.torque_rate_limit': 170.0,
                        'carrier.force_rate_limit': 3e3},
    'DC motor': MOTOR,
    'limited current': {**MOTOR, 'motor.dc.current_limit': 5.0, 'initial.shaft_velocity': 2.0},
    'limited current, static mode': {**MOTOR, **STATIC, 'motor.dc.current_limit': 5.0,
                                     'initial.shaft_velocity': 2.0},
    'a kink inside a step': {'load.torque.table.time': [0.0, 0.1234, 0.3],
                             'load.torque.table.value': [0.0, 60.0, -20.0]},
    'payload': {**SWING, 'payload.time': [0.05, 0.2], 'payload.mass': [3.0, 1.0],
                'payload.inertia': [0.6, 0.2], 'end_effector.pick_up': 'at_rest'},
    'one axis held': {**SWING, 'carrier.held': 'x', 'initial.shaft_velocity': 8.0},
}


def scene_of(name, formulation, **more):
    """Return a scene of `SCENES` at a step of 2 ms."""
    return timo_sim.load_scene({}, {'integrator.step': 0.002, 'model.formulation': formulation,
                                    'initial.shaft': 0.2, **SCENES[name], **more})


def commands(scene, lanes, random):
    """Return commands of some lanes that suit a scene, (lanes, LOADS)."""
    load = np.zeros((lanes, LOADS))
    load[:, TORQUE], load[:, FORCE_Y], load[:, TIP_X] = random.normal(
        0.0, [[20.0], [40.0], [5.0]], (3, lanes))
    if scene.values['motor.dc.resistance']:
        load[:, VOLTAGE] = random.normal(0.0, 15.0, lanes)
    return load


def size_of(motions):
    """Return the size of each number of a motion, to compare others with."""
    return np.abs(motions).max(axis=tuple(range(motions.ndim - 1))) + 1e-3


@pytest.mark.parametrize('formulation, name', [
    *(('exact', name) for name in SCENES if name != 'limited current, static mode'),
    *(('newton', name) for name in SCENES if name not in (
        'stretches, static mode', 'driven, held', 'gear', 'one axis held', 'limited current'))])
def test_agrees_with_simulator(formulation, name):
    """Eleven manipulators, of two masses of the tip, under three commands in turn."""
    one = scene_of(name, formulation)
    other = scene_of(name, formulation, **{'end_effector.mass': 3.0, 'arm.young_modulus': 5e10})
    scenes, random = [one, *5 * [other], *5 * [one]], np.random.default_rng(1)
    batch = timo_sim.Batch(scenes)
    simulators = [timo_sim.Simulator(scene) for scene in scenes]
    for count in (60, 1, 90):
        commanded = commands(one, len(scenes), random)
        together = batch.advance(count, commanded, sample_every=10)
        for lane, simulator in enumerate(simulators):
            alone, _ = simulator.advance(count, commanded[lane], sample_every=10)
            assert np.abs((together[lane] - alone) / size_of(together)).max() < 1e-11
    for lane, simulator in enumerate(simulators):
        now = simulator.motion.values
        assert np.abs((batch.motion.values[lane] - now) / size_of(together)).max() < 1e-11
        for field in 'position', 'deflection', 'rotation':
            alone = getattr(simulator, field)()
            assert getattr(batch, field)()[lane] == pytest.approx(alone, abs=1e-11)
    assert not batch.failed.any() and batch.t == pytest.approx(0.302)


def test_an_axial_mode_that_is_slowed_down_moves_as_in_simulator():
    """Its inertia depends on the step and on the frequency of each scene."""
    scene = scene_of('stretches, static mode', 'exact', **{'integrator.step': 0.005})
    scenes = [scene, *(scene.vary(each) for each in (
        {'end_effector.mass': 3.0}, {'arm.young_modulus': 2e11}))]
    together = timo_sim.Batch(scenes).advance(100, sample_every=10)
    for each, found in zip(scenes, together):
        alone, _ = timo_sim.Simulator(each).advance(100, sample_every=10)
        assert each.fastest == 100.0
        assert np.abs((found - alone) / size_of(together)).max() < 1e-10


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_bits_are_a_lanes_own(formulation):
    """Number of lanes, place, neighbours, their bodies and the steps per call change no bit."""
    scene, random = scene_of('free', formulation), np.random.default_rng(2)
    others = [scene_of('free', formulation, **{'arm.length': 1.0 + 0.1 * k}) for k in range(5)]
    commanded = commands(scene, 1, random)
    alone = timo_sim.Batch(scene).advance(100, commanded, sample_every=1)[0]
    alike, several = timo_sim.Batch(scene, n=21), timo_sim.Batch([*others, scene, *others])
    around = commands(scene, 21, random)
    around[17] = commanded[0]
    assert (alike.advance(100, around, sample_every=1)[17] == alone).all()
    around[5], parts = commanded[0], []
    for count in (1, 37, 62):
        parts.append(several.advance(count, around[:11], sample_every=1)[5])
    assert (np.concatenate([parts[0], parts[1][1:], parts[2][1:]]) == alone).all()
    assert not (several.motion.values[6] == alone[-1]).any()


def test_one_fails_and_the_others_go_on():
    """A torque that breaks any arm stops one lane at its last good state, until a reset."""
    scene = timo_sim.load_scene({}, {'integrator.step': 0.01, 'arm.length': 2.0})
    calm, batch = timo_sim.Batch(scene, n=3), timo_sim.Batch(scene, n=3)
    calm.step(torque=5.0, duration=2.0)
    batch.step(torque=[5.0, 2000.0, 5.0], duration=2.0)
    assert batch.failed.tolist() == [False, True, False]
    same = batch.motion.values == calm.motion.values
    assert same[[0, 2]].all() and not same[1].any() and np.isfinite(batch.motion.values).all()
    assert 0.0 < batch.t[1] < 2.0 and batch.t[0] == 2.0
    simulator = timo_sim.Simulator(scene)
    with pytest.raises(timo_sim.DivergenceError) as error:
        simulator.step(torque=2000.0, duration=2.0)
    at = f't = {batch.t[1]:g} s'
    assert at in batch.reason(1) and at in str(error.value) and not batch.reason(0)
    stopped = batch.motion.values[1]
    # Round-off grows while the arm breaks: 5e-12 measured.
    assert stopped == pytest.approx(simulator.motion.values, rel=1e-9)
    batch.step(torque=5.0, duration=0.1)
    assert (batch.motion.values[1] == stopped).all()
    batch.reset(batch.failed)
    assert not batch.failed.any() and batch.t.tolist() == pytest.approx([2.1, 0.0, 2.1])
    calm.reset()
    batch.step(torque=5.0, duration=2.0)
    calm.step(torque=5.0, duration=2.0)
    assert (batch.motion.values[1] == calm.motion.values[1]).all()


def test_reset_starts_loads_again():
    """A lane that begins later does what it did at first, and one may begin elsewhere."""
    scene = scene_of('a kink inside a step', 'exact')
    batch = timo_sim.Batch(scene, n=10)
    first = batch.advance(100, sample_every=1)
    mask = np.arange(10) % 3 == 0
    batch.reset(mask)
    again = batch.advance(100, sample_every=1)
    assert (again[mask] == first[mask]).all()
    assert not (again[~mask, 1:] == first[~mask, 1:]).all(axis=(1, 2)).any()
    batch.reset(motion=first[0, 50])
    assert (batch.motion.values == first[0, 50]).all()
    simulator = timo_sim.Simulator(scene)
    simulator.set_motion(batch.motion[3])
    assert batch.deflection()[3] == pytest.approx(simulator.deflection(), abs=1e-14)
    batch.reset(mask, first[:, 20])
    assert (batch.motion.values == np.where(mask[:, np.newaxis], first[:, 20], first[0, 50])).all()


def test_payloads_begin_again_in_a_lane_that_is_reset():
    """The last lane fills its group, and a sample is from before a change."""
    scene = scene_of('payload', 'exact')
    batch = timo_sim.Batch([scene, scene.vary({'payload.time': [0.06, 0.3]}), scene])
    first = batch.advance(60, sample_every=5)
    batch.reset(np.array([False, True, True]))
    again = batch.advance(60, sample_every=5)
    assert np.array_equal(again[1:], first[1:])
    alone = [timo_sim.Simulator(each).advance(120, sample_every=5)[0] for each in batch.scenes]
    assert again[0] == pytest.approx(alone[0][12:], rel=1e-10, abs=1e-12)
    assert again[1:] == pytest.approx(np.array(alone)[1:, :13], rel=1e-10, abs=1e-12)


def test_what_a_batch_cannot_do():
    """The error names the parameter."""
    for scenes, n, text in (
            ([{}, {'model.modes': 4}], None, 'model.modes must be the same'),
            ([{'model.modes': 4}, {'model.axial_modes': 1}], None, 'axial_modes must be the'),
            ([{}, {'integrator.step': 0.005}], None, 'integrator.step must be the same'),
            ([{}, HELD], None, 'carrier.held must be the same'),
            ([MOTOR, {**MOTOR, 'motor.dc.current_limit': 5.0}], None,
             'motor.dc.current_limit < .inf must be the same'),
            ([], None, 'at least one'), ('paper', 0, 'n must be .*, got 0'),
            ([{}, {}], 3, 'n must be the number of scenes')):
        with pytest.raises(timo_sim.ParameterError, match=text):
            timo_sim.Batch(scenes, n)


def test_bad_commands_and_resets_change_nothing():
    batch = timo_sim.Batch('paper', n=3)
    for given, text in (
            ({'torque': [1.0, 2.0]}, r'torque must be a finite number or 3 finite'),
            ({'force': np.ones((2, 3))}, r'of shape \(3, 2\)'),
            ({'torque': [0.0, np.nan, 0.0]}, 'torque must be'),
            ({'voltage': [0.0, 5.0, 0.0]}, 'voltage = 5 V needs motor.dc.resistance > 0'),
            ({'carrier_acceleration': [[0.0, 1.0]] * 3}, 'a carrier that is held along y')):
        with pytest.raises(timo_sim.ParameterError, match=text):
            batch.step(**given)
    for given, text in (([[0, 1, 1]], 'mask must be 3 times true or false'),
                        ([None, np.zeros(5)], 'motion must be finite')):
        with pytest.raises(timo_sim.ParameterError, match=text):
            batch.reset(*given)
    with pytest.raises(ValueError, match='shape'):
        batch.advance(1, np.zeros((3, 13)))
    assert batch.steps == 0
    assert (batch.motion.values == timo_sim.Batch('paper').motion.values).all()
    # One with a motor may stand beside one without, which takes no voltage.
    batch = timo_sim.Batch([scene_of('free', 'exact'), scene_of('DC motor', 'exact')])
    with pytest.raises(timo_sim.ParameterError, match='voltage = -3 V needs motor.dc.resistance'):
        batch.step(voltage=-3.0)
    simulator = timo_sim.Simulator(scene_of('DC motor', 'exact'))
    alone, together = simulator.step(voltage=9.0), batch.step(voltage=[0.0, 9.0])
    assert together.values[1] == pytest.approx(alone.values, abs=1e-13)


@pytest.mark.parametrize('n', [1, 5, 8, 9, 20])
def test_what_a_batch_hands_out_are_values(n):
    """They stay as they are while it goes on, and changing them does not change it."""
    batch, other = timo_sim.Batch('paper', n=n), timo_sim.Batch('paper', n=n)
    seen = [batch.step(torque=1.0, duration=0.1).shaft for _ in range(5)]
    assert all((later != earlier).all() for earlier, later in zip(seen, seen[1:]))
    for given in (batch.motion.values, batch.position(), batch.deflection(), batch.rotation(),
                  batch.t, batch.failed, batch.advance(10, sample_every=5)):
        given[:] = 0
    other.step(torque=1.0, duration=0.5)
    other.advance(10)
    assert (batch.motion.values == other.motion.values).all()
    assert (batch.position() == other.position()).all()
    assert (batch.step().values == other.step().values).all()


@pytest.mark.parametrize('make', [timo_sim.Simulator, timo_sim.Batch])
def test_threads_take_turns(make):
    """Four threads do what one does, in whatever order."""
    together, alone = make('paper'), make('paper')
    for one in (together, alone):
        one.advance(1)
    torque = np.eye(LOADS)[TORQUE]
    threads = [threading.Thread(target=lambda: [together.advance(1, torque) for _ in range(200)])
               for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for _ in range(800):
        alone.advance(1, torque)
    assert together.steps == alone.steps == 801
    assert (together.motion.values == alone.motion.values).all()


def test_steps_are_whole_numbers_from_0():
    for one in timo_sim.Simulator('paper'), timo_sim.Batch('paper'):
        for given in (-5,), (2.5,), (5, None, -1), ('5',), (True,):
            with pytest.raises(timo_sim.ParameterError, match='must be a whole number >= 0'):
                one.advance(*given)
        assert one.steps == 0
        assert one.advance(np.int64(3)) is not None and one.steps == 3


FORK = """
import os, threading
import timo_sim
simulator = timo_sim.EstimatingSimulator({})
def step():
    while True:
        simulator.advance(1000)
        simulator.measure_error()
threading.Thread(target=step, daemon=True).start()
for _ in range(20):
    child = os.fork()
    if not child:
        simulator.advance(1)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
"""


def test_a_process_that_is_forked_while_another_thread_steps_can_step():
    subprocess.run([sys.executable, '-c', FORK], check=True, timeout=300)
