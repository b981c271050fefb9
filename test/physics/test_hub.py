# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A hub between shaft and arm: as a stiff span, as a rigid body, and in an arm that spins."""

import numpy as np
from numpy.polynomial import Polynomial
from oracles.linear_beam import WRIGHT
import pytest
import scipy.linalg

import timo_sim
from timo_sim.model.layout import LOADS, SPEED

RADIUS, LENGTH = 0.3, 1.2
ARM = {'arm.density': 2710.0, 'arm.young_modulus': 70.5e9, 'arm.shear_modulus': 27e9,
       'carrier.mass': 5.0, 'motor.mass': 5.0, 'initial.shaft': np.pi / 4,
       'arm.length': LENGTH, 'arm.section.height': 0.01, 'arm.section.width': 0.03,
       'end_effector.mass': 0.4,
       'end_effector.inertia': 0.01, 'motor.shaft_inertia': 0.05}
LOADED = {**ARM, 'load.torque.harmonic.amplitude': [3.0], 'load.torque.harmonic.frequency': [1.0],
          'load.tip_force_x.harmonic.amplitude': [2.0],
          'load.tip_force_x.harmonic.frequency': [3.0]}
STIFF = 1e7  # times as stiff, and as light


def with_stiff_span(values):
    """Return the values of an arm without a hub whose first span is light and stiff."""
    spans = {'position': [0.0, RADIUS, RADIUS, RADIUS + LENGTH]}
    for name, value, of_hub in (('density', 2710.0, 1.0 / STIFF), ('young_modulus', 70.5e9, STIFF),
                                ('shear_modulus', 27e9, STIFF)):
        spans[name] = [of_hub * value, of_hub * value, value, value]
    return {**values, **{f'arm.profile.{name}': each for name, each in spans.items()},
            'arm.length': RADIUS + LENGTH,
            'push.position': values.get('push.position', -RADIUS) + RADIUS}


PUSHED = {'push.position': 0.5, 'load.push_y.harmonic.amplitude': [2.0],
          'load.push_y.harmonic.frequency': [2.0]}


@pytest.mark.parametrize('name, values', [
    ('exact', {**PUSHED, 'carrier.held': 'x', 'gravity': [1.0, -9.0]}),
    ('exact', {'model.axial_modes': 1, 'carrier.held': 'both'}),
    ('newton', {**PUSHED, 'carrier.held': 'y', 'gravity': [1.0, -9.0]})], ids=str)
def test_is_a_span_that_is_stiff_and_light(name, values):
    """Tip, efforts and energy are those of an arm that begins at the shaft's axis."""
    values = {**LOADED, 'model.formulation': name, **values}
    hub, span = (timo_sim.simulate(each, 0.3, estimate=False) for each in (
        {**values, 'hub.radius': RADIUS}, with_stiff_span(values)))
    moved = np.ptp(span.position(RADIUS + LENGTH), axis=0).max()
    assert moved > 0.01
    assert hub.position(LENGTH) == pytest.approx(
        span.position(RADIUS + LENGTH), abs=1e-6 * moved)
    assert hub.position(0.0) == pytest.approx(span.position(RADIUS), abs=1e-6 * moved)
    bent = np.ptp(span.deflection(RADIUS + LENGTH)[:, 1])
    assert hub.deflection(LENGTH) == pytest.approx(
        span.deflection(RADIUS + LENGTH), abs=1e-5 * bent)
    # Accelerations are differences of speeds.
    assert hub.effort == pytest.approx(span.effort, abs=3e-4 * np.abs(span.effort).max())
    assert np.diff(hub.energy()) == pytest.approx(
        np.diff(span.energy()), abs=1e-5 * np.abs(span.energy()).max())


def test_turns_about_the_shaft_as_a_rigid_body():
    values = {**ARM, 'hub.radius': RADIUS, 'model.modes': 0, 'carrier.held': 'both',
              'load.torque.piecewise.time': [0.0], 'load.torque.piecewise.value': [2.0]}
    for name in ('exact', 'newton'):
        run = timo_sim.simulate({**values, 'model.formulation': name}, 1.0, estimate=False)
        end, area = RADIUS + LENGTH, 0.01 * 0.03
        inertia = (0.05 + 0.4 * end**2 + 0.01 + 2710.0 * area * (end**3 - RADIUS**3) / 3.0
                   + 2710.0 * area * 0.01**2 / 12.0 * LENGTH)
        turned = run.shaft - run.shaft[0]
        assert turned == pytest.approx(run.t**2 / inertia, rel=1e-9)


@pytest.mark.parametrize('axial', [0, 1])
def test_keeps_energy_and_momentum(axial):
    run = timo_sim.simulate({
        **ARM, 'hub.radius': RADIUS, 'model.axial_modes': axial, 'initial.shaft_velocity': 3.0,
        'initial.carrier_x_velocity': 0.5, 'initial.modal_rates': [1.0] + (2 + axial) * [0.0],
        'integrator.step': 5e-5}, 1.0, 20, estimate=False)  # which resolves axial vibrations
    energy, momentum = run.energy(), run.model.momentum(run.values)
    assert np.ptp(energy) < 2e-7 * energy[0]
    assert np.ptp(momentum, axis=0) == pytest.approx(0.0, abs=1e-12 * np.abs(momentum).max())


def spinning(ratio, speed, terms=12):
    """
    Return the first frequency of a spinning cantilever in its plane, a slender uniform one.

    Hub radius over length, speed and frequency over sqrt(EI / rho A l^4). Ritz with powers from
    x^2 on: bending, the tension of what is outboard, and the centrifugal force across.
    """
    x, one = Polynomial([0.0, 1.0]), Polynomial([1.0])
    tension = ((ratio * one + x)**2 * -0.5) + 0.5 * (ratio + 1.0)**2
    shapes = [x**(2 + k) for k in range(terms)]

    def integrals(left, right, weight=one):
        return np.array([[(weight * a * b).integ()(1.0) for b in right] for a in left])
    slopes, bends = ([each.deriv(order) for each in shapes] for order in (1, 2))
    mass = integrals(shapes, shapes)
    stiffness = integrals(bends, bends) + speed**2 * (
        integrals(slopes, slopes, tension) - mass)
    return np.sqrt(scipy.linalg.eigh(stiffness, mass, eigvals_only=True)[0])


def test_reference_of_a_spinning_arm_is_that_of_the_literature():
    """Out of the plane w^2 is greater by speed^2: Wright et al., J. Appl. Mech. 49 (1982) 197."""
    for speed in (1.0, 6.0, 12.0):
        assert np.hypot(spinning(0.0, speed), speed) == pytest.approx(WRIGHT[speed][0], abs=6e-4)
    assert np.hypot(spinning(1.0, 2.0), 2.0) == pytest.approx(4.8337, abs=1e-4)


@pytest.mark.parametrize('ratio', [0.0, 0.5, 2.0])
def test_stiffens_a_spinning_arm(ratio):
    """Southwell's coefficient grows with the hub: frequencies of `exact`, linear at each speed."""
    values = {'arm.length': 1.0, 'arm.section.height': 1e-3, 'end_effector.mass': 0.0,
              'model.modes': 8,
              'end_effector.inertia': 0.0, 'hub.radius': ratio, 'carrier.held': 'both',
              'motor.shaft': 'driven', 'motor.drive.time': [0.0], 'motor.drive.angle': [0.0],
              'motor.drive.speed': [0.0], 'motor.drive.acceleration': [0.0]}
    model = timo_sim.load_scene({}, values).build()
    section = model.manipulator.arm.section
    unit = np.sqrt(section.bending_stiffness / section.mass_per_length)
    for speed in (2.0, 6.0):
        load, motion = np.zeros(LOADS), np.zeros(model.size)
        load[SPEED] = motion[model.size // 2 + 2] = speed * unit
        state = model.state(motion)
        assert model.rate(state, load)[:8] == pytest.approx(0.0, abs=1e-12)
        slopes = np.array([model.rate(state + shift, load) - model.rate(state - shift, load)
                           for shift in 1e-4 * np.eye(len(state))]).T / 2e-4
        found = np.abs(np.linalg.eigvals(slopes).imag).min() / unit
        assert found == pytest.approx(spinning(ratio, speed), rel=1e-4)
