# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Loads that the end effector picks up and drops while it moves."""

from types import SimpleNamespace

import numpy as np
import pytest

from oracles import spectral_elements
from oracles.energy import work
import timo_sim
from timo_sim.log.tables import Recording
from timo_sim.model.layout import rotate
from timo_sim.runs.replay import replay
from timo_sim.runs.run import run_scene
from timo_sim.simulation.loads import pieces
from timo_sim.simulation.simulator import Simulator

TORQUE = {'load.torque.harmonic.amplitude': [5.0], 'load.torque.harmonic.frequency': [1.0]}
HELD, FREE = {'carrier.held': 'both', **TORQUE}, {'initial.shaft_velocity': 1.0, **TORQUE}
PICKED = {'payload.time': [0.3], 'payload.mass': [4.0], 'payload.inertia': [0.6]}
DROPPED = {'payload.time': [0.3], 'payload.mass': [0.5], 'payload.inertia': [0.2]}
BOTH = {'payload.time': [0.2, 0.5], 'payload.mass': [5.0, 1.0], 'payload.inertia': [0.5, 0.5],
        'end_effector.pick_up': 'at_rest'}


@pytest.mark.parametrize('values', [{**HELD, **PICKED}, {**FREE, **DROPPED}],
                         ids=['held', 'free, dropped'])
def test_a_load_that_changes_in_flight_against_spectral_elements(values):
    scene = timo_sim.load_scene({}, {**values, 'model.modes': 5, 'model.axial_modes': 1,
                                     'integrator.step': 1e-4})  # resolves the axial vibration
    run = timo_sim.simulate(scene, 1.0, sample_every=1000, estimate=False)
    carrier, shaft, tip, _ = spectral_elements.simulate(scene, 0.1, 10, order=8, courant=0.9)
    assert np.abs(run.carrier - carrier).max() < 1e-6
    assert np.abs(run.position(2.0) - tip).max() < 3e-6
    # What it would be without the change is far from it.
    same = timo_sim.simulate(scene.vary({'payload.time': [], 'payload.mass': [],
                                         'payload.inertia': []}), 1.0, 1000, estimate=False)
    assert np.abs(same.position(2.0) - tip).max() > 1e-3


def test_the_estimate_knows_of_vibrations_that_the_modes_leave_out():
    """Let go in gravity all modes vibrate; a load takes the momentum of all at the tip."""
    scene = timo_sim.load_scene({}, {**HELD, **PICKED, 'gravity': [0.0, -9.81], 'model.modes': 5,
                                     'model.axial_modes': 1})
    run = timo_sim.simulate(scene, 1.0, sample_every=100)
    tip = spectral_elements.simulate(scene, 0.1, 10, courant=0.9)[2]
    error = np.abs(run.position(2.0) - tip).max()
    assert error < 5e-5
    assert 0.5 < run.stats['estimated_tip_error_m'] / error < 2.0


def test_a_load_picked_up_from_rest_against_spectral_elements():
    """The impact makes all modes vibrate, of which the model has five."""
    scene = timo_sim.load_scene({}, {
        'initial.shaft_velocity': 0.5, **PICKED, 'end_effector.pick_up': 'at_rest',
        'model.modes': 5, 'model.axial_modes': 1})
    run = timo_sim.simulate(scene, 0.6, sample_every=100, estimate=False)
    carrier, shaft, tip, _ = spectral_elements.simulate(scene, 0.1, 6, courant=0.9)
    assert np.abs(run.carrier - carrier).max() < 1e-5
    assert np.abs(run.position(2.0) - tip).max() < 2e-5


def test_the_deflection_of_an_arm_on_a_light_shaft_has_an_estimate_of_its_own():
    """The heavy load keeps the tip in its place, while shaft and deflection are off."""
    scene = timo_sim.load_scene({}, {
        'carrier.held': 'both', 'initial.shaft_velocity': 0.5, 'motor.shaft_inertia': 0.01,
        'end_effector.mass': 0.0, 'end_effector.inertia': 0.0, **PICKED,
        'end_effector.pick_up': 'at_rest'})
    with pytest.warns(timo_sim.ModelWarning, match='error of the tip deflection is 0.02'):
        run = timo_sim.simulate(scene, 0.6, sample_every=10)
    _, shaft, tip, _ = spectral_elements.simulate(scene, 0.01, 60, courant=0.9)
    off = np.linalg.norm(run.position(2.0) - tip, axis=1).max()
    bend = np.linalg.norm(
        run.deflection(2.0) + [2.0, 0.0] - np.stack(rotate(-shaft, *tip.T), -1), axis=1).max()
    assert off < 5e-4 and 0.8 < run.stats['estimated_tip_error_m'] / off < 1.25
    assert bend > 1e-2 and 0.8 < run.stats['estimated_deflection_error_m'] / bend < 1.25


def test_a_rigid_arm_picks_up_a_load_at_rest():
    """J+ omega+ = J- omega-, and the energy lost is that of two bodies that stick together."""
    scene = timo_sim.load_scene({}, {
        'carrier.held': 'both', 'model.modes': 0, 'initial.shaft_velocity': 2.0, **PICKED,
        'end_effector.pick_up': 'at_rest'})
    body, section = scene.manipulator, scene.manipulator.arm.section
    inertia = (body.shaft_inertia + section.mass_per_length * 8.0 / 3.0
               + section.inertia_per_length * 2.0 + body.end_effector_inertia + 8.0)
    added = 0.1 + 2.0 * 4.0
    run = timo_sim.simulate(scene, 0.6, estimate=False)
    speed = 2.0 * inertia / (inertia + added)
    # The sample of the impact is from before it.
    assert run.shaft_velocity[300] == pytest.approx(2.0, rel=1e-12)
    assert run.shaft_velocity[301:] == pytest.approx(speed, rel=1e-9)
    lost = 0.5 * inertia * 4.0 * added / (inertia + added)
    assert run.stats['impact_loss_J'] == pytest.approx(lost, rel=1e-9)
    assert run.energy()[300] - run.energy()[-1] == pytest.approx(lost, rel=1e-9)


@pytest.mark.parametrize('values', [
    {'motor.gear.stiffness': 2000.0, 'motor.rotor.inertia': 0.3, 'arm.damping_of': 'clamped',
     'initial.modal_rates': [0.4]},
    {'model.axial_modes': 1, 'integrator.step': 0.0001}], ids=['gear', 'axial mode'])
def test_an_arm_that_does_not_bend_loses_the_energy_of_its_own_inertia(values):
    """Also beside coordinates of a gear or of stretch: the arm hits the load as a whole."""
    scene = timo_sim.load_scene({}, {
        'carrier.held': 'both', 'model.modes': 0, 'initial.shaft_velocity': 2.0, **PICKED,
        'end_effector.pick_up': 'at_rest', **values})
    simulator = Simulator(scene)
    simulator.step(duration=PICKED['payload.time'][0])
    before, speed = simulator.snapshot().energy, float(simulator.motion.shaft_velocity)
    simulator.step()
    lost, mass = simulator.tip_load.lost, scene.build().mass_matrix(np.zeros(scene.build().size))
    inertia, added = mass[0][2, 2], 0.1 + 2.0 * 4.0
    assert lost == pytest.approx(before - simulator.snapshot().energy, rel=1e-6)
    if not values.get('motor.gear.stiffness'):  # the rotor is not part of the impact
        assert lost == pytest.approx(
            0.5 * inertia * speed**2 * added / (inertia + added), rel=1e-4)


PLASTIC = {
    'carrier.held': 'both', 'gravity': [0.0, -9.81], 'initial.shaft': -0.6,
    'end_effector.mass': 1.0, 'end_effector.inertia': 0.05, 'end_effector.pick_up': 'at_rest',
    'payload.time': [0.2, 0.5], 'payload.mass': [3.0, 1.0], 'payload.inertia': [0.15, 0.05],
    'load.torque.piecewise.time': [0.0, 0.8, 1.6],
    'load.torque.piecewise.value': [60.0, 70.0, 40.0], 'integrator.step': 0.0005}


def test_the_energy_lost_in_an_impact_is_that_of_two_bodies():
    """What the momenta of N modes lose tends to the loss of the two bodies at the tip as 1/N."""
    excess = []
    for modes in (5, 10, 20):
        scene = timo_sim.load_scene({}, {**PLASTIC, 'gravity': [0.0, 0.0], 'model.modes': modes})
        run = timo_sim.simulate(scene, 0.25, estimate=False)
        velocity, spin = (part[0, 0] for part in run.model.velocities(
            run.values[400:401], run.model.tip_point))
        lost = 0.5 * (2.0 / 3.0 * velocity @ velocity + 0.05 * 0.1 / 0.15 * spin**2)
        assert run.stats['impact_loss_J'] == pytest.approx(lost, rel=1e-6)
        motions = run.values[400:402]
        after = scene.build((3.0, 0.15)).energy(motions[1:])[0]
        torque = 60.0 * (motions[1, 2] - motions[0, 2])  # its work in the step of the impact
        excess.append(scene.build().energy(motions[:1])[0] + torque - after - lost)
    assert 0.4 < excess[1] / excess[0] < 0.6 and 0.4 < excess[2] / excess[1] < 0.6


def test_the_estimate_of_a_plastic_impact():
    """Errors fall as 1/N: four times the modes see three quarters of the error."""
    scene = timo_sim.load_scene({}, {**PLASTIC, 'model.modes': 5, 'integrator.step': 0.001})
    fine = timo_sim.load_scene({}, {**PLASTIC, 'model.modes': 40, 'integrator.step': 0.00025})
    run = timo_sim.simulate(scene, 0.8, 10)
    true = run_scene(fine, 3200, 40)
    error = np.linalg.norm(run.position(2.0) - true.position(2.0), axis=1).max()
    assert 0.5 * error < run.stats['estimated_tip_error_m'] < 2.0 * error


@pytest.mark.parametrize('values', [{}, {'carrier.held': 'x'}, {'motor.shaft': 'locked'}],
                         ids=['free', 'x held', 'locked'])
def test_momentum_is_kept_by_an_impact(values):
    scene = timo_sim.load_scene({}, {
        'initial.carrier_y_velocity': 0.4, 'initial.modal_rates': [0.5, 0.1, 0.0], **PICKED,
        'end_effector.pick_up': 'at_rest', **values})
    run = timo_sim.simulate(scene, 0.4, estimate=False)
    momentum = run.momentum()
    kept = [axis for axis in range(2) if values.get('carrier.held') != 'xy'[axis]]
    kept += [2] * (not values)
    jump = np.abs(momentum[301] - momentum[300])[kept]
    # To what a step does; about the origin a free manipulator's is kept, too.
    assert jump.max() < 1e-9 * np.abs(momentum).max()
    assert run.stats['impact_loss_J'] > 1e-3


def test_nothing_is_lost_by_loads_that_move_with_the_tip():
    """Sections keep place and velocity to the last bit but round-off of momenta."""
    scene = timo_sim.load_scene({}, {**FREE, **PICKED, 'initial.modal_rates': [0.5, 0.1, 0.0]})
    simulator = Simulator(scene)
    simulator.advance(300)
    before = simulator.motion.values
    simulator.change(scene.vary({'end_effector.mass': 4.0, 'end_effector.inertia': 0.6}))
    assert np.abs(simulator.motion.values - before).max() < 1e-13
    assert simulator.tip_load.lost == 0.0


def test_a_change_by_hand_is_that_of_the_scene():
    scene = timo_sim.load_scene({}, {**FREE, **PICKED})
    by_hand = Simulator(scene.vary({'payload.time': [], 'payload.mass': [],
                                    'payload.inertia': []}))
    by_hand.advance(300)
    by_hand.change(by_hand.scene.vary({'end_effector.mass': 4.0, 'end_effector.inertia': 0.6}))
    by_hand.advance(200)
    whole = Simulator(scene)
    whole.advance(500)
    np.testing.assert_array_equal(by_hand.motion.values, whole.motion.values)


def test_a_log_tells_the_loads_of_a_simulator():
    """The scene's and those that are set; what is set to the same value again changes nothing."""
    scene = timo_sim.load_scene({}, {**FREE, **BOTH})
    simulator, loads, changes = Simulator(scene), [], []
    for step, mass in ((100, 3.0), (300, 3.0), (400, 4.0), (600, None), (650, 4.0)):
        while simulator.steps < step:
            simulator.advance(1)
            loads.append(simulator.tip_load.tip)
        if mass is None:
            simulator.reset()
        else:
            changes.append((step, 0, {'end_effector.mass': mass}))
            simulator.change(simulator.scene.vary(changes[-1][-1]))
    told = Recording.payloads.fget(
        SimpleNamespace(scene=scene, changes=changes, resets=np.array([600])))
    assert [each[:2] for each in told] == [
        (100, 3.0), (200, 5.0), (400, 4.0), (500, 1.0), (600, 4.0), (800, 5.0), (1100, 1.0)]
    for step, tip in enumerate(loads):
        assert tip == [(2.0, 0.5, 0.0), *(each[1:] for each in told if each[0] <= step)][-1]


def test_of_two_samples_at_the_step_of_a_reset_the_second_is_from_after_it():
    scene = timo_sim.load_scene({})
    found = pieces(scene, np.array([0, 1, 2, 3, 3, 4]), ((1, 5.0, 0.6), (3, 2.0, 0.5)))
    assert [(model.manipulator.end_effector_mass, part.start, part.stop)
            for model, part in found] == [(2.0, 0, 2), (5.0, 2, 4), (2.0, 4, 6)]


@pytest.mark.parametrize('values', [
    {'carrier.coulomb_friction': 3.0, 'motor.coulomb_friction': 1.0},
    {'model.axial_modes': 1}, {'motor.shaft': 'locked'}, {'model.formulation': 'newton'},
    {'carrier.held': 'x', 'model.formulation': 'newton'}], ids=str)
def test_energy_is_balanced_between_impacts(values):
    """All that a scene may have: what is lost at impacts and to friction is counted."""
    scene = timo_sim.load_scene({}, {**FREE, **BOTH, 'gravity': [0.5, -1.0], **values, **{
        'initial.shaft_velocity': 0.0 if 'motor.shaft' in values else 1.0,
        'load.torque.harmonic.amplitude': [0.0 if 'motor.shaft' in values else 5.0]}})
    run = timo_sim.simulate(scene, 0.7, estimate=False)
    # Steps of 1 ms do not resolve an axial vibration, so it is slowed down and damped.
    lost = run.dissipated() if 'model.axial_modes' in values else run.friction_heat
    energy = run.energy() + lost
    done = work(np.rint(run.t * 1e9), run.values[:, :3],
                np.column_stack([run.carrier_velocity, run.shaft_velocity]), run.effort)
    left = np.append(0.0, np.cumsum(done)) - energy
    # From after the impact at 0.2 s, with its own rates, to that at 0.5 s.
    bound = 1e-6 if values.get('model.formulation', 'exact') == 'exact' else 2e-2
    assert np.ptp(left[201:501]) < bound * np.ptp(energy)


def test_a_saved_run_knows_its_loads(tmp_path):
    run = timo_sim.simulate({**FREE, **BOTH}, 0.7, sample_every=10, estimate=False)
    again = timo_sim.open_log(run.save(tmp_path / 'run.mcap'))
    assert again.payloads == run.payloads == (
        (200, 5.0, 0.5, 0.0), (500, 1.0, 0.5, 0.0))
    np.testing.assert_array_equal(again.energy(), run.energy())
    np.testing.assert_array_equal(again.momentum(), run.momentum())
    lines = []
    assert replay(again.recording.path, show=lines.append)
    assert any('all are the same to the last bit' in line for line in lines)


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
@pytest.mark.parametrize('static, bound', [('none', 7e-6), ('both', 2e-8)])
def test_modes_of_another_end_effector(formulation, static, bound):
    """Natural frequencies with a load that the five modes were not made for."""
    values = {'model.formulation': formulation, 'carrier.held': 'both', 'motor.shaft': 'locked'}
    model = timo_sim.load_scene({}, {
        **values, 'model.modes': 5, 'model.static_modes': static}).build((4.0, 0.5))
    truth = timo_sim.load_scene({}, {**values, 'end_effector.mass': 4.0}).build().modes.omega
    half = len(model.linear) // 2
    square = -model.linear[:half, half:] @ model.linear[half:, :half]
    found = np.sqrt(np.sort(np.linalg.eigvals(square).real))
    assert np.abs(found[:3] / truth - 1.0).max() < bound


def test_the_refused_load_of_a_simulator_leaves_it_as_it_was():
    simulator = Simulator(FREE)
    simulator.advance(10)
    before = simulator.scene, simulator.tip_load.tip, simulator.motion.values.tolist()
    with pytest.raises(timo_sim.ParameterError, match='arm.length = 1.0 cannot be set while'):
        simulator.change(simulator.scene.vary({'end_effector.mass': 2.5, 'arm.length': 1.0}))
    assert before == (simulator.scene, simulator.tip_load.tip, simulator.motion.values.tolist())
    simulator.change(simulator.scene.vary({'motor.viscous_friction': 1.0}))
    assert simulator.model.own_modes  # friction changes no modes
