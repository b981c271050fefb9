# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A clamp that gives, and a spring on the shaft: closed forms, a soft span, balance of energy."""

import numpy as np
from oracles.energy import balance
import pytest
from scipy.optimize import brentq

import timo_sim
from timo_sim.model.modes import compliance, modes_of

LENGTH = 1.2
ARM = {'arm.length': LENGTH, 'arm.section.height': 0.01, 'arm.section.width': 0.03,
       'arm.material': 'aluminium', 'carrier.mass': 5.0, 'initial.shaft': 0.4,
       'end_effector.mass': 0.4, 'end_effector.inertia': 0.01, 'motor.shaft_inertia': 0.05,
       'model.modes': 4}
TORQUE = {'load.torque.harmonic.amplitude': [3.0], 'load.torque.harmonic.frequency': [1.0]}
LOADED = {**TORQUE, 'load.tip_force_x.harmonic.amplitude': [2.0],
          'load.tip_force_x.harmonic.frequency': [3.0]}
SPRING = {'motor.spring.stiffness': 20.0, 'motor.spring.rest': 0.1}
UNIT = {'arm.length': 1.0, 'arm.section.height': 0.01, 'arm.section.mass_per_length': 1.0,
        'arm.section.bending_stiffness': 1.0, 'arm.section.shear_stiffness': 1e9,
        'carrier.held': 'both', 'motor.shaft': 'locked',
        'model.static_modes': 'none', 'model.modes': 4}


@pytest.mark.parametrize('stiffness', [1e-3, 0.5, 30.0, 1e9])
def test_frequencies_of_a_beam_on_a_clamp_that_gives(stiffness):
    """k (1 + cos x cosh x) = x (sin x cosh x - cos x sinh x) for a slender beam, w = x^2."""
    def lacking(x):
        return (stiffness * (1.0 / np.cosh(x) + np.cos(x))
                - x * (np.sin(x) - np.cos(x) * np.tanh(x)))
    x = np.linspace(1e-3, 15.0, 3000)
    change = np.flatnonzero(np.diff(np.sign([lacking(each) for each in x])))[:4]
    wanted = np.array([brentq(lacking, x[k], x[k + 1], xtol=1e-13) for k in change])**2
    scene = timo_sim.load_scene({**UNIT, 'arm.root_stiffness': stiffness})
    varies = scene.vary({'arm.profile.position': [0.0, 0.5, 1.0],
                         'arm.profile.bending_stiffness': 3 * [1.0]})
    for each in scene, varies:  # in closed form, and by Galerkin's method
        assert modes_of(each.manipulator, 4).omega == pytest.approx(wanted, rel=1e-5)


@pytest.mark.parametrize('name, values', [
    ('exact', {'model.axial_modes': 1, 'model.static_modes': 'both'}),
    ('newton', {'carrier.held': 'y', 'gravity': [1.0, -9.0], 'hub.radius': 0.1})], ids=str)
def test_a_clamp_that_gives_is_a_short_soft_span(name, values):
    """Tip and energy are those of an arm that bends there within 0.1 mm."""
    short, stiffness, section = 1e-4, 60.0, {'young_modulus': 70e9, 'shear_modulus': 26e9,
                                             'density': 2700.0}
    soft = stiffness * short / (0.03 * 0.01**3 / 12.0)
    profile = {'position': [0.0, short, short, LENGTH]}
    for part, value in section.items():
        first = soft if part == 'young_modulus' else 1e3 * value if 'shear' in part else value
        profile[part] = [first, first, value, value]
    given = {**ARM, **LOADED, 'model.formulation': name, **values, 'arm.material': 'none',
             **{f'arm.{part}': value for part, value in section.items()}}
    clamp, span = (timo_sim.simulate({**given, **each}, 0.3, estimate=False) for each in (
        {'arm.root_stiffness': stiffness},
        {f'arm.profile.{part}': each for part, each in profile.items()}))
    moved = np.ptp(span.position(LENGTH), axis=0).max()
    assert moved > 0.01
    assert clamp.position(LENGTH) == pytest.approx(span.position(LENGTH), abs=2e-5 * moved)
    assert np.diff(clamp.energy()) == pytest.approx(
        np.diff(span.energy()), abs=1e-5 * np.abs(span.energy()).max())
    rigid = timo_sim.simulate(given, 0.3, estimate=False)
    assert np.abs(rigid.position(LENGTH) - clamp.position(LENGTH)).max() > 1e-3 * moved


def test_a_clamp_that_gives_adds_its_turn_to_what_a_force_does():
    """The response of the tip is l^3 / 3 EI + l^2 / k, and shapes have all of it."""
    body = timo_sim.load_scene({**UNIT, 'arm.root_stiffness': 2.0}).manipulator
    modes = modes_of(body, 3, ('force', 'torque'))
    whole, shapes = compliance(body, modes, 1.0)
    assert whole[0, 0] == pytest.approx(1.0 / 3.0 + 0.5, rel=1e-5)
    for place in 0, 2:
        assert shapes[place]**2 @ modes.omega**-2.0 == pytest.approx(
            whole[place, place], rel=1e-10)


@pytest.mark.parametrize('name', ['exact', 'newton'])
def test_a_rigid_arm_on_a_spring_is_an_oscillator(name):
    """About the angle at which its weight and the spring balance, as cos w t."""
    values = {**ARM, **SPRING, 'model.modes': 0, 'carrier.held': 'both', 'initial.shaft': 0.101,
              'integrator.step': 0.01, 'model.formulation': name}
    run = timo_sim.simulate(values, 2.0, estimate=False)
    section = run.scene.manipulator.arm.section
    inertia = (0.05 + 0.01 + 0.4 * LENGTH**2 + section.mass_per_length * LENGTH**3 / 3.0
               + section.inertia_per_length * LENGTH)
    wanted = 0.1 + 0.001 * np.cos(np.sqrt(20.0 / inertia) * run.t)
    assert run.shaft == pytest.approx(wanted, abs=1e-11)
    assert timo_sim.modes(values).frequency == pytest.approx(
        [np.sqrt(20.0 / inertia) / (2.0 * np.pi)], rel=1e-9)


@pytest.mark.parametrize('values', [
    {'carrier.held': 'x'}, {'model.formulation': 'newton', 'carrier.held': 'x'},
    {'motor.gear.stiffness': 300.0, 'motor.rotor.inertia': 0.02}], ids=str)
def test_a_spring_takes_and_gives_back_work(values):
    """With one axis held, with an elastic gear between motor and shaft, and in `newton`."""
    run = timo_sim.simulate({**ARM, **TORQUE, **SPRING, 'integrator.step': 2e-4, **values},
                            0.5, 5, estimate=False)
    energy = run.energy()
    assert np.abs(balance(run)).max() < (2e-3 if 'model.formulation' in values else 2e-6) * (
        np.ptp(energy))


@pytest.mark.parametrize('name', ['exact', 'newton'])
def test_a_drive_works_against_the_spring(name):
    run = timo_sim.simulate({
        **ARM, **SPRING, 'carrier.held': 'both', 'motor.shaft': 'driven', 'model.modes': 1,
        'model.static_modes': 'none', 'motor.drive.time': [0.0], 'motor.drive.angle': [0.5],
        'motor.drive.speed': [0.0], 'motor.drive.acceleration': [0.0],
        'model.formulation': name}, 0.01, estimate=False)
    assert run.effort[:, 2] == pytest.approx(20.0 * 0.4, rel=1e-9)


def test_a_free_shaft_on_a_spring_goes_to_its_rest():
    """An arm at rest begins to move without any load; in gravity it finds its equilibrium."""
    simulator = timo_sim.Simulator({**ARM, **SPRING, 'carrier.held': 'both'})
    assert simulator.step(duration=0.05).shaft < 0.39
    scene = timo_sim.load_scene({**ARM, **SPRING, 'carrier.held': 'both', 'model.modes': 0,
                                 'gravity': [0.0, -2.0], 'initial.equilibrium': True})
    angle, body = scene.initial_motion()[2], scene.manipulator
    weight = 2.0 * (0.4 * LENGTH + body.arm.section.mass_per_length * LENGTH**2 / 2.0)
    assert 20.0 * (0.1 - angle) == pytest.approx(weight * np.cos(angle), rel=1e-9)
