# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""Coulomb friction that builds up over a speed: closed forms, limits, another integrator."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import timo_sim
from timo_sim.physics.layout import FORCE_X, FORCE_Y, TORQUE

RIGID = {'model.modes': 0, 'carrier.held': 'both', 'initial.shaft_velocity': 1.5,
         'motor.coulomb_friction': 2.0, 'motor.coulomb_speed': 0.3}
BOTH = {'motor.coulomb_friction': 2.0, 'motor.coulomb_speed': 0.3,
        'carrier.coulomb_friction': 1.0, 'carrier.coulomb_speed': 0.05}


def test_a_rigid_arm_stops_as_the_closed_form():
    """`J v' = -T tanh(v / s)` gives `sinh(v / s) = sinh(v_0 / s) exp(-T t / (J s))`."""
    scene = timo_sim.load_scene(RIGID)
    inertia = scene.build().mass_matrix(scene.initial_motion())[0][2, 2]
    run = timo_sim.simulate(scene, 20.0, 10, compare=False)
    speed = 0.3 * np.arcsinh(np.sinh(5.0) * np.exp(-2.0 * run.t / (inertia * 0.3)))
    assert run.shaft_velocity == pytest.approx(speed, abs=1e-11)
    lost = 0.5 * inertia * (1.5**2 - speed**2)
    assert run.friction_heat == pytest.approx(lost, abs=1e-10)


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_the_order_stays_four(formulation):
    runs = [timo_sim.simulate(timo_sim.load_scene('paper', {
        **BOTH, 'integrator.step': step, 'model.formulation': formulation}), 1.0,
        round(0.1 / step), compare=False) for step in (0.01, 0.005, 0.000625)]
    for of_run in (lambda run: run.deflection(2.0)[:, 1], lambda run: run.friction_heat):
        coarse, fine = (np.abs(of_run(run) - of_run(runs[-1])).max() for run in runs[:2])
        assert 12.0 < coarse / fine < 24.0
    # The estimate of the error of steps holds for it, too.
    errors = [np.abs(run.deflection(2.0) - runs[-1].deflection(2.0)).max() for run in runs[:2]]
    for run, error in zip(runs, errors):
        assert 0.1 * error < run.stats['step_error_m'] < 200.0 * error


def test_over_a_large_speed_it_is_viscous():
    viscous = timo_sim.load_scene('paper', {'motor.viscous_friction': 0.7,
                                            'carrier.viscous_friction': 1.3})
    smooth = timo_sim.load_scene('paper', {
        'motor.coulomb_friction': 0.7e5, 'motor.coulomb_speed': 1e5,
        'carrier.coulomb_friction': 1.3e5, 'carrier.coulomb_speed': 1e5})
    one, other = (timo_sim.simulate(scene, 2.0, 20, compare=False) for scene in (viscous, smooth))
    assert other.motion == pytest.approx(one.motion, abs=1e-9)
    assert other.friction_heat == pytest.approx(one.dissipated(), abs=1e-4)


def test_over_a_small_speed_it_is_dry_friction():
    """The distance from a run whose joints stick falls with the speed."""
    def run(speed, step):
        scene = timo_sim.load_scene('paper', {
            'motor.coulomb_friction': 2.0, 'motor.coulomb_speed': speed,
            'integrator.step': step})
        return timo_sim.simulate(scene, 2.0, round(0.02 / step), compare=False).shaft
    dry = run(0.0, 0.001)
    far, near = (np.abs(run(speed, 0.001) - dry).max() for speed in (0.02, 0.004))
    assert near < 0.4 * far < 0.01


def test_energy_is_the_heat_of_friction():
    scene = timo_sim.load_scene({**BOTH, 'initial.shaft_velocity': 2.0,
                                 'initial.carrier_x_velocity': 0.5, 'model.modes': 3})
    run = timo_sim.simulate(scene, 4.0, 4, compare=False)
    total = run.energy() + run.friction_heat
    assert total == pytest.approx(np.full(len(run.t), total[0]), rel=1e-9)
    assert run.friction_heat[-1] > 0.5 * total[0]


@pytest.mark.parametrize('more', [{'gravity': [0.0, -9.81]}, {'carrier.held': 'x'}])
def test_another_integrator_finds_the_same_motion(more):
    """The rate of a state under a load that friction is added to, by SciPy's DOP853."""
    scene = timo_sim.load_scene({
        **BOTH, 'initial.carrier_y_velocity': 0.3, 'integrator.step': 0.0005,
        'initial.modal_coordinates': [0.2, 0.0, 0.0], **more})
    simulator = timo_sim.Simulator(scene)
    model, own = simulator.model, scene.load_at_start()

    def rate(_, state):
        motion = simulator.integration.motion(state, own)
        speed, load = motion[len(motion) // 2:][:3], own.copy()
        load[[FORCE_X, FORCE_Y, TORQUE]] -= scene.friction * np.tanh(
            speed / np.where(scene.friction > 0.0, scene.friction_speed, 1.0))
        return model.rate(state, load)

    found = solve_ivp(rate, (0.0, 0.3), model.state(scene.initial_motion()), 'DOP853',
                      rtol=1e-10, atol=1e-12).y[:, -1]
    simulator.advance(600)
    wanted = simulator.integration.motion(found, own)
    assert simulator.motion.values == pytest.approx(wanted, abs=1e-6)


def test_sensors_and_efforts_know_it():
    scene = timo_sim.load_scene('paper', BOTH)
    simulator, strain = timo_sim.Simulator(scene), []
    for _ in range(100):
        simulator.advance(5)
        strain.append(simulator.sensors.root_strain)
    run = timo_sim.simulate(scene, 0.5, 5, compare=False)
    assert run.root_strain()[1:] == pytest.approx(strain, abs=1e-9)
    body = scene.manipulator  # the shaft's own balance, with its friction
    before, after = (timo_sim.simulate(scene, t, compare=False).shaft_velocity[-1]
                     for t in (0.499, 0.501))
    moment = run.root_moment()[-1]
    friction = -2.0 * np.tanh(run.shaft_velocity[-1] / 0.3)
    balance = body.shaft_inertia * (after - before) / 0.002 - run.loads()[-1, TORQUE] - friction
    assert moment == pytest.approx(balance, abs=2e-4 * abs(run.root_moment()).max())


def test_pieces_of_a_run_have_its_bits():
    scene = timo_sim.load_scene('paper', BOTH)
    whole, parts = timo_sim.Simulator(scene), timo_sim.Simulator(scene)
    whole.advance(200)
    for count in (1, 2, 3, 94, 100):
        parts.advance(count)
    assert np.array_equal(whole.motion.values, parts.motion.values)
    assert np.array_equal(whole.integration.memory, parts.integration.memory)


@pytest.mark.parametrize('values, message', [
    ({'carrier.coulomb_friction': 1.0, 'motor.coulomb_friction': 1.0, 'motor.coulomb_speed': 0.1},
     'must both be 0 or both > 0 .*got 0 and 0.1'),
    ({'motor.coulomb_friction': 1.0, 'motor.coulomb_speed': 1e-4},
     'integrator.step = 0.001 s must be at most .* s for Coulomb friction with this slope'),
])
def test_refused(values, message):
    with pytest.raises(timo_sim.ParameterError, match=message):
        timo_sim.load_scene(values)
