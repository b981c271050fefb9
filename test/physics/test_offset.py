# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""An end effector whose centre of mass is off the tip: as a stiff span that carries it."""

import numpy as np
import pytest

import timo_sim
from timo_sim.model.modes import modes_of

OFFSET, LENGTH = 0.2, 1.2
ARM = {'arm.density': 2710.0, 'arm.young_modulus': 70.5e9, 'arm.shear_modulus': 27e9,
       'carrier.mass': 5.0, 'motor.mass': 5.0, 'initial.shaft': np.pi / 4,
       'arm.length': LENGTH, 'arm.section.height': 0.01, 'arm.section.width': 0.03,
       'end_effector.mass': 0.4, 'end_effector.inertia': 0.01, 'motor.shaft_inertia': 0.05,
       'load.torque.harmonic.amplitude': [3.0], 'load.torque.harmonic.frequency': [1.0],
       'load.tip_torque.harmonic.amplitude': [0.5], 'load.tip_torque.harmonic.frequency': [2.0]}
STIFF = 1e7  # times as stiff, and as light
UNIT = {'arm.length': 1.0, 'arm.section.height': 0.01, 'arm.section.mass_per_length': 1.0,
        'arm.section.bending_stiffness': 1.0, 'arm.section.shear_stiffness': 1e9,
        'arm.section.rotary_inertia': 1e-12, 'carrier.held': 'both', 'motor.shaft': 'locked',
        'end_effector.mass': 1.0, 'end_effector.inertia': 0.01, 'model.static_modes': 'none'}


def spans(name, on_tip):
    """Return loads and bodies of an arm whose last span, beyond the tip, is light and stiff."""
    found = {'position': [0.0, LENGTH, LENGTH, LENGTH + OFFSET]}
    for part, value, beyond in (('density', 2710.0, 1.0 / STIFF), ('young_modulus', 70.5e9, STIFF),
                                ('shear_modulus', 27e9, STIFF)):
        found[part] = [value, value, beyond * value, beyond * value]
    return {**{f'arm.profile.{part}': each for part, each in found.items()},
            'arm.length': LENGTH + OFFSET, 'push.position': LENGTH, **on_tip(name)}


def force(name):
    return {f'load.{name}_y.harmonic.amplitude': [2.0],
            f'load.{name}_y.harmonic.frequency': [3.0]}


@pytest.mark.parametrize('offset, wanted', [
    (0.0, [1.54368, 13.2396, 32.0696]), (0.1, [1.37573, 11.8511, 33.7628]),
    (0.2, [1.23393, 10.6990, 33.9178])])
def test_frequencies_are_those_of_finite_elements(offset, wanted):
    """In closed form, by Galerkin's method, and of both formulations."""
    scene = timo_sim.load_scene({**UNIT, 'end_effector.offset': offset})
    varies = scene.vary({'arm.profile.position': [0.0, 0.5, 1.0],
                         'arm.profile.bending_stiffness': 3 * [1.0]})
    assert modes_of(scene.manipulator, 3).omega == pytest.approx(wanted, rel=1e-5)
    for name, each in (('exact', scene), ('newton', scene), ('exact', varies)):
        found = timo_sim.modes(each.vary({'model.formulation': name})).frequency[:3]
        assert 2.0 * np.pi * found == pytest.approx(wanted, rel=1e-5)


@pytest.mark.parametrize('name, values', [
    ('exact', {'model.axial_modes': 1, 'model.static_modes': 'force', 'hub.radius': 0.1}),
    ('newton', {'carrier.held': 'y', 'gravity': [1.0, -9.0]})], ids=str)
def test_is_a_span_beyond_the_tip_that_is_stiff_and_light(name, values):
    """Tip, efforts and energy are those of an arm that ends where the centre of mass is."""
    values = {**ARM, 'model.formulation': name, 'model.modes': 5, **values}
    body, span = (timo_sim.simulate({**values, **each}, 0.3, estimate=False) for each in (
        {'end_effector.offset': OFFSET, **force('tip_force')}, spans('push', force)))
    moved = np.ptp(span.position(LENGTH), axis=0).max()
    assert moved > 0.01
    assert body.position(LENGTH) == pytest.approx(span.position(LENGTH), abs=1e-7 * moved)
    # Accelerations are differences of speeds.
    assert body.effort == pytest.approx(span.effort, abs=1e-5 * np.abs(span.effort).max())
    assert np.diff(body.energy()) == pytest.approx(
        np.diff(span.energy()), abs=1e-7 * np.abs(span.energy()).max())


@pytest.mark.parametrize('offset', [OFFSET, -0.1])
def test_keeps_energy_and_momentum_with_any_load(offset):
    """Also where the load changes, of which one that moves with the tip takes no momentum."""
    run = timo_sim.simulate({
        **{name: value for name, value in ARM.items() if not name.startswith('load.')},
        'end_effector.offset': offset, 'initial.shaft_velocity': 3.0, 'payload.time': [0.5],
        'payload.mass': [0.8], 'payload.inertia': [0.02], 'payload.offset': [0.3],
        'integrator.step': 2e-4}, 1.0, 20, estimate=False)
    energy = run.energy()
    for part in slice(0, 126), slice(126, None):
        assert np.ptp(energy[part]) < 2e-7 * energy[0]
    momentum = run.model.momentum(run.values[:126])
    assert np.ptp(momentum, axis=0) == pytest.approx(0.0, abs=1e-12 * np.abs(momentum).max())


def test_a_rigid_arm_picks_up_a_load_that_is_off_the_tip():
    """J+ omega+ = J- omega-, and the energy lost is that of two bodies that stick together."""
    scene = timo_sim.load_scene({**ARM, **{name: [] for name in ARM if name.startswith('load.')},
                                 'carrier.held': 'both', 'model.modes': 0,
                                 'initial.shaft_velocity': 2.0, 'end_effector.offset': 0.1,
                                 'end_effector.pick_up': 'at_rest', 'payload.time': [0.3],
                                 'payload.mass': [1.0], 'payload.inertia': [0.05],
                                 'payload.offset': [OFFSET]})
    # A load of 0.6 kg whose centre of mass is beyond that of both.
    place = (1.0 * OFFSET - 0.4 * 0.1) / 0.6
    added = 0.6 * (LENGTH + place)**2 + (
        0.04 + OFFSET**2 - 0.4 * 0.1**2 - 0.6 * place**2)
    section = scene.manipulator.arm.section
    inertia = (0.05 + section.mass_per_length * LENGTH**3 / 3.0
               + section.inertia_per_length * LENGTH + 0.01 + 0.4 * (LENGTH + 0.1)**2)
    run = timo_sim.simulate(scene, 0.4, estimate=False)
    assert run.shaft_velocity[-1] == pytest.approx(2.0 * inertia / (inertia + added), rel=1e-9)
    lost = 2.0 * inertia * added / (inertia + added)
    assert run.stats['impact_loss_J'] == pytest.approx(lost, rel=1e-9)
