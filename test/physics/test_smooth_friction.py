# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Coulomb friction that builds up over a speed: closed forms, limits, another integrator."""

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from oracles.energy import inertia_of
import timo_sim
from timo_sim.model.layout import FORCE_X, FORCE_Y, TORQUE
from timo_sim.steps.steps import Steps

RIGID = {'model.modes': 0, 'carrier.held': 'both', 'initial.shaft_velocity': 1.5,
         'motor.coulomb_friction': 2.0, 'motor.coulomb_speed': 0.3}
BOTH = {'motor.coulomb_friction': 2.0, 'motor.coulomb_speed': 0.3,
        'carrier.coulomb_friction': 1.0, 'carrier.coulomb_speed': 0.05}
NONE = {'motor.coulomb_friction': 0.0, 'carrier.coulomb_friction': 0.0}


def coasting(inertia, t, limit=2.0, slow=0.3, first=1.5):
    """`J v' = -T tanh(v / s)` gives `sinh(v / s) = sinh(v_0 / s) exp(-T t / (J s))`."""
    return slow * np.arcsinh(np.sinh(first / slow) * np.exp(-limit * t / (inertia * slow)))


def test_a_rigid_arm_stops_as_the_closed_form():
    scene = timo_sim.load_scene({}, RIGID)
    inertia = inertia_of(scene)
    run = timo_sim.simulate(scene, 20.0, 10, estimate=False)
    speed = coasting(inertia, run.t)
    assert run.shaft_velocity == pytest.approx(speed, abs=1e-11)
    assert run.dissipated() == pytest.approx(0.5 * inertia * (1.5**2 - speed**2), abs=1e-9)
    assert not run.friction_heat.any()


def test_sensitivities_are_derivatives_of_the_closed_form():
    """Derivatives by a complex step, exact to round-off."""
    scene = timo_sim.load_scene({}, RIGID)
    inertia, names = inertia_of(scene), {'motor.coulomb_friction': 'limit',
                                         'motor.coulomb_speed': 'slow',
                                         'initial.shaft_velocity': 'first'}
    found = timo_sim.sensitivities(scene, 10.0, lambda batch: batch.motion.shaft_velocity,
                                   list(names), samples=4)
    for k, (name, argument) in enumerate(names.items()):
        value = scene.values[name] + 1e-30j
        expected = coasting(inertia, found.t, **{argument: value}).imag / 1e-30
        assert found.jacobian[:, k] == pytest.approx(expected, rel=1e-8, abs=1e-10)


def by_dop853(scene, duration):
    """Return the motion at the end: equations without friction, which is added to the load."""
    simulator = timo_sim.Simulator(scene.vary(NONE))
    model, own = simulator.model, scene.load_at_start()
    speeds = [scene.values[f'{body}.coulomb_speed'] for body in ('carrier', 'carrier', 'motor')]
    limits = [scene.values[f'{body}.coulomb_friction'] for body in ('carrier', 'carrier', 'motor')]

    def rate(_, state):
        motion, load = simulator.integration.motion(state, own), own.copy()
        load[[FORCE_X, FORCE_Y, TORQUE]] -= limits * np.tanh(
            motion[len(motion) // 2:][:3] / speeds)
        return model.rate(state, load)

    found = solve_ivp(rate, (0.0, duration), model.state(scene.initial_motion()), 'DOP853',
                      rtol=1e-11, atol=1e-13).y[:, -1]
    return simulator.integration.motion(found, own)


@pytest.mark.parametrize('more', [
    {}, {'model.formulation': 'newton', 'gravity': [0.0, -9.81]}, {'carrier.held': 'x'},
    {'carrier.held': 'y', 'model.axial_modes': 1}], ids=str)
def test_another_integrator_finds_the_same_motion(more):
    """By SciPy's DOP853; of fourth order where steps resolve all vibrations."""
    scene = timo_sim.load_scene({}, {
        **BOTH, 'initial.shaft_velocity': 0.5, 'arm.damping_ratio': [0.02],
        'initial.modal_coordinates': [0.2, *(2 + more.get('model.axial_modes', 0)) * [0.0]],
        **more})
    axial = 'model.axial_modes' in more
    steps = (1.2e-4, 6e-5, 3e-5) if axial else (0.004, 0.002, 0.0005)
    wanted, errors = by_dop853(scene.vary({'integrator.step': steps[0]}), 0.24), []
    for step in steps:
        simulator = timo_sim.Simulator(scene.vary({'integrator.step': step}))
        simulator.advance(round(0.24 / step))
        errors.append(np.abs(simulator.motion.values - wanted).max())
    # Measured: ratios of 15.5 to 15.9, 1.1e-10 at 0.5 ms; with axial vibrations 4.0 and 3.9e-9.
    assert 12.0 < errors[0] / errors[1] < 20.0 or axial
    assert errors[2] < (2e-8 if axial else 1e-9)


def test_over_a_large_speed_it_is_viscous():
    viscous = timo_sim.load_scene('paper', {'motor.viscous_friction': 0.7,
                                            'carrier.viscous_friction': 1.3})
    smooth = timo_sim.load_scene('paper', {
        'motor.coulomb_friction': 0.7e5, 'motor.coulomb_speed': 1e5,
        'carrier.coulomb_friction': 1.3e5, 'carrier.coulomb_speed': 1e5})
    one, other = (timo_sim.simulate(scene, 2.0, 20, estimate=False) for scene in (viscous, smooth))
    assert other.values == pytest.approx(one.values, abs=1e-9)
    assert other.dissipated() == pytest.approx(one.dissipated(), abs=1e-7)


def test_over_a_small_speed_it_is_dry_friction():
    """The distance from a run whose shaft rests, while the carrier creeps, falls with it."""
    def run(speed, step, way=0.0):
        scene = timo_sim.load_scene('paper', {
            **BOTH, 'motor.coulomb_speed': speed, 'motor.coulomb_presliding': way,
            'integrator.step': step})
        return timo_sim.simulate(scene, 2.0, round(0.02 / step), estimate=False).shaft
    dry = run(0.0, 1e-4, 1e-6)
    far, near = (np.abs(run(speed, 0.001) - dry).max() for speed in (0.02, 0.004))
    assert near < 0.4 * far < 0.01


def test_energy_is_the_heat_of_friction():
    scene = timo_sim.load_scene({}, {**BOTH, 'initial.shaft_velocity': 2.0,
                                     'initial.carrier_x_velocity': 0.5, 'model.modes': 3})
    run = timo_sim.simulate(scene, 4.0, estimate=False)
    heat = run.dissipated()
    total = run.energy() + heat
    assert total == pytest.approx(np.full(len(run.t), total[0]), rel=1e-9)
    assert heat[-1] > 0.5 * total[0]


def test_sensors_and_efforts_know_it():
    scene = timo_sim.load_scene('paper', BOTH)
    simulator, strain = timo_sim.Simulator(scene), []
    for _ in range(100):
        simulator.advance(5)
        strain.append(simulator.sensors.root_strain)
    run = timo_sim.simulate(scene, 0.5, 5, estimate=False)
    assert run.root_strain()[1:] == pytest.approx(strain, abs=1e-9)
    body = scene.manipulator  # the shaft's own balance, with its friction
    before, after = (timo_sim.simulate(scene, t, estimate=False).shaft_velocity[-1]
                     for t in (0.499, 0.501))
    moment = run.root_moment()[-1]
    friction = -2.0 * np.tanh(run.shaft_velocity[-1] / 0.3)
    balance = body.shaft_inertia * (after - before) / 0.002 - run.loads()[-1, TORQUE] - friction
    assert moment == pytest.approx(balance, abs=2e-4 * abs(run.root_moment()).max())


def test_the_linear_model_has_its_slope_at_rest():
    """It is that of a viscous friction, the limit over the speed."""
    at_rest = {'initial.shaft': 0.3, 'initial.shaft_velocity': 0.0}
    with pytest.warns(timo_sim.ModelWarning, match='well below coulomb_speed'):
        smooth = timo_sim.linearize(timo_sim.load_scene({}, {**BOTH, **at_rest}))
    viscous = timo_sim.linearize(timo_sim.load_scene({}, {
        'motor.viscous_friction': 2.0 / 0.3, 'carrier.viscous_friction': 1.0 / 0.05, **at_rest}))
    for name in 'ABCD':
        one, other = getattr(smooth, name), getattr(viscous, name)
        assert one == pytest.approx(other, rel=1e-9, abs=1e-9 * np.abs(other).max())


def test_longer_steps_than_are_refused_are_unstable():
    """The method amplifies a small speed from 2.785 times the step over the time constant on."""
    scene = timo_sim.load_scene({}, {**RIGID, 'initial.shaft_velocity': 1e-6})
    rate = 2.0 / (0.3 * inertia_of(scene))
    for product, grows in ((2.75, False), (2.82, True)):
        model = scene.build()
        steps = Steps(model, product / rate)
        state, load = model.state(scene.initial_motion()), scene.load_at_start()
        steps.advance(state, load, np.tile(load, (40, 4, 1)), steps.samples(0, 0))
        speed = abs(steps.motion(state, load)[-1])
        assert (speed > 1e-6) == grows


@pytest.mark.parametrize('friction', [1.0, 1.03, 1.07, 1.1])
def test_steps_that_are_unstable_are_refused(friction):
    """The text has a step and a speed, each of which is possible as it stands there."""
    steep = {'motor.coulomb_friction': friction, 'motor.coulomb_speed': 1e-4}
    with pytest.raises(timo_sim.ParameterError, match='integrator.step = 0.001 s must be at most '
                       '.* s for Coulomb friction with this slope: take that, or') as caught:
        timo_sim.load_scene({}, steep)
    step, factor = re.search('most (.*) s for .* coulomb_speed (.*) times', str(caught.value)
                             ).groups()
    timo_sim.load_scene({}, {**steep, 'integrator.step': float(step)})
    timo_sim.load_scene({}, {**steep, 'motor.coulomb_speed': 1e-4 * float(factor)})
