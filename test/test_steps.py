# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Steps: estimates of their errors, warnings, divergence, rest."""

import tracemalloc

import numpy as np
import pytest

import timo_sim
from timo_sim.model import FORMULATIONS
from timo_sim.model.layout import LOADS, TORQUE
from timo_sim.simulation.simulator import Simulator


def error_of(step, every, duration=4.0, axial=1, **values):
    """Return the true error of the tip, the estimate and the run."""
    scene = timo_sim.load_scene({}, {'integrator.step': step, 'model.modes': 5, **values})
    run = timo_sim.simulate(scene, duration, every)
    # As many modes as the run that gives the estimate: no other size is compiled.
    finest = {'integrator.step': 0.001, 'model.modes': 8, 'model.axial_modes': axial}
    fine = timo_sim.simulate(scene.vary(finest), duration, round(1000 * step) * every,
                             estimate=False)
    error = np.linalg.norm(run.position(2.0) - fine.position(2.0), axis=1).max()
    return error, run.stats['estimated_tip_error_m'], run


TORQUE_STEPS = {'load.torque.piecewise.time': [0.0, 0.5, 1.0],
                'load.torque.piecewise.value': [60.0, -40.0, 0.0]}
SHAKEN = {'load.torque.harmonic.amplitude': [50.0], 'load.torque.harmonic.frequency': [3.0]}


@pytest.mark.parametrize('values', [
    {**SHAKEN, **TORQUE_STEPS, 'carrier.held': 'x'},
    {**SHAKEN, 'carrier.held': 'both', 'initial.shaft_velocity': 5.0},
    {'load.torque.table.time': [0.0, 0.203, 1.1, 1.517, 2.0],
     'load.torque.table.value': [0.0, 60.0, -60.0, 20.0, 0.0]},
    {'motor.shaft': 'driven', 'motor.drive.time': [0.0, 1.0, 2.03],
     'motor.drive.angle': [0.0, 3.0, 1.0], 'motor.drive.speed': [0.0, 5.0, 0.0],
     'motor.drive.acceleration': [0.0, 0.0, 0.0]}])
def test_the_estimate_is_the_error_where_steps_cause_it(values):
    error, estimate, run = error_of(0.02, 1, **values)
    assert estimate == pytest.approx(error, rel=0.5)
    assert (run.warning is not None) == (estimate > 1.4e-3)


def test_the_error_of_a_single_event_is_estimated():
    """A spike inside one of 100 steps."""
    error, estimate, _ = error_of(0.01, 1, 1.0, axial=0, **{
        'load.torque.table.time': [0.501, 0.504, 0.508], 'model.modes': 3,
        'load.torque.table.value': [0.0, 8000.0, 0.0], 'carrier.held': 'both'})
    assert error > 5e-4 and estimate == pytest.approx(error, rel=0.5)


def test_memory_does_not_grow_with_the_steps():
    scene = timo_sim.load_scene({'initial.shaft_velocity': 1.0})
    timo_sim.simulate(scene, 1.0, 1000, estimate=False)
    tracemalloc.start()
    try:
        timo_sim.simulate(scene, 100.0, 100000, estimate=False)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 4e6


def test_divergence_names_place_time_and_remedy_and_keeps_the_last_good_state():
    scene = timo_sim.load_scene({'integrator.step': 0.02, 'initial.shaft_velocity': 300.0})
    told = (r'diverges after t = \S+ s \(step \d+\), at [a-z ]+\d* = \S+ with the arm bent by '
            r'\S+ m: take a smaller integrator.step, fewer model.modes or loads that bend it less')
    single, block = Simulator(scene), Simulator(scene)
    with pytest.raises(timo_sim.DivergenceError, match=told) as first:
        while True:
            single.advance(1)
    with pytest.raises(timo_sim.DivergenceError, match=told) as second:
        block.advance(1000)
    # The time of other warnings depends on how many steps are done at once.
    assert str(first.value).split(';')[0] == str(second.value).split(';')[0]
    assert single.steps == block.steps > 0
    assert single.motion.values.tobytes() == block.motion.values.tobytes()
    reach, length = block.model.tip_travel, 2.0
    assert np.abs(block.motion.values[3:6]) @ reach[3:] < 10.0 * length


@pytest.mark.parametrize('formulation', FORMULATIONS)
@pytest.mark.parametrize('held', ['none', 'x'])
def test_an_arm_at_rest_stays_there_to_the_last_bit(formulation, held):
    motions, _ = Simulator(timo_sim.load_scene({}, {
        'model.formulation': formulation, 'carrier.held': held, 'initial.shaft': 0.7,
        'initial.carrier_x': 0.3, 'initial.carrier_y': -1.7, 'arm.damping_ratio': [0.01]})
    ).advance(700, sample_every=1)
    assert len(motions) == 701 and (motions == motions[0]).all()


SPINNING = {'carrier.held': 'y', 'integrator.step': 0.002, 'initial.shaft_velocity': 10.0,
            'initial.modal_rates': [0.5, 0.0, 0.0]}  # through all sectors
DRIVEN = {'motor.shaft': 'driven', 'initial.shaft_velocity': 0.0, 'motor.drive.time': [0.0, 0.4],
          'motor.drive.angle': [0.0, 4.0], 'motor.drive.speed': [0.0, 5.0],
          'motor.drive.acceleration': [0.0, 0.0]}
# All three joints slide, stop, stick and break away, and the arm vibrates.
RUBBING = {
    'carrier.coulomb_friction': 12.0, 'motor.coulomb_friction': 15.0, 'integrator.step': 0.005,
    'initial.carrier_x_velocity': 0.1, 'initial.carrier_y_velocity': -0.05,
    'initial.shaft_velocity': 0.1, 'initial.modal_coordinates': [0.1, 0.01, 0.0],
    **{f'load.{name}.piecewise': {'time': [0.0], 'value': [value]}
       for name, value in (('force_x', 6.0), ('force_y', -7.0), ('torque', 9.0))}}
# The load of the tip changes at a sample, and between two.
PICKED = {'payload.time': [0.203, 0.5], 'payload.mass': [5.0, 1.0], 'payload.inertia': [0.5, 0.5],
          'end_effector.pick_up': 'at_rest', 'load.torque.harmonic.amplitude': [5.0],
          'load.torque.harmonic.frequency': [1.0]}


@pytest.mark.parametrize('values', [
    SPINNING, {**SPINNING, 'motor.coulomb_friction': 1.0}, {**SPINNING, **DRIVEN},
    {**SPINNING, 'model.axial_modes': 1, 'initial.modal_rates': [0.5, 0.0, 0.0, 0.0]}, RUBBING,
    {**RUBBING, 'carrier.coulomb_presliding': 0.005, 'motor.coulomb_presliding': 0.02},
    {**SPINNING, 'motor.coulomb_friction': 1.0, 'motor.coulomb_presliding': 0.01},
    {**PICKED, 'initial.shaft_velocity': 1.0},
    {**PICKED, 'carrier.held': 'both', 'gravity': [0.0, -9.81]}],
    ids=['sectors', 'sectors, friction', 'sectors, driven', 'sectors, stretch', 'friction',
         'presliding', 'sectors, presliding', 'payload', 'payload, held'])
def test_bits_do_not_depend_on_how_many_steps_are_done_at_once(values):
    """Of motions and of the heat of friction, also after a reset."""
    scene = timo_sim.load_scene({}, values)
    whole, parts = Simulator(scene), Simulator(scene)
    motions, heat = whole.advance(630, sample_every=7)
    found, heats = [parts.motion.values], [0.0]
    for k in range(90):
        for count in (1, 4, 2) if k % 2 else (7,):
            samples, so_far = parts.advance(count, sample_every=count)
        found.append(samples[-1])
        heats.append(so_far[-1])
    assert np.array(found).tobytes() == motions.tobytes()
    assert np.array(heats).tobytes() == heat.tobytes()
    assert np.ptp(motions[:, 2]) > 0.02
    whole.reset()
    assert whole.advance(630, sample_every=7)[0].tobytes() == motions.tobytes()


def test_memory_of_commands_that_a_caller_frees_is_not_read():
    simulator, other = (timo_sim.Simulator('paper') for _ in range(2))
    commanded = np.zeros(LOADS)
    for torque in 1.0, -2.0:
        commanded[TORQUE] = torque
        simulator.advance(1, commanded)
        assert np.array_equal(simulator.motion.values, other.step(torque=torque).values)
        commanded.resize(10**6, refcheck=False)  # this frees what was passed
        commanded.resize(LOADS, refcheck=False)
