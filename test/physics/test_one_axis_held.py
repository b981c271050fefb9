# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A carrier held along one axis: inertia and linear part depend on the shaft angle."""

import numpy as np
import pytest
import timo_sim
from timo_sim.model.exact_code import BAND, BANDS, SECTORS
from timo_sim.model.functions import rate_once
from timo_sim.model.layout import ANGLE, LOADS

HEAVY = {'end_effector.mass': 60.0, 'end_effector.inertia': 12.0, 'initial.shaft_velocity': 2.0,
         'model.modes': 5, 'initial.modal_rates': [0.5, 0.0, 0.0, 0.0, 0.0]}
SPINNING = {'initial.shaft_velocity': 10.0, 'initial.modal_rates': [0.5, 0.0, 0.0]}


def scene_of(held, step, values):
    return timo_sim.load_scene({}, {'carrier.held': held, 'integrator.step': step, **values})


def straight(model, angle, speed):
    """Return the state of a straight arm that turns."""
    motion = np.zeros(model.size)
    motion[2], motion[model.size // 2 + 2] = angle, speed
    return model.state(motion)


def jacobian(model, angle, speed):
    """Return the Jacobian of a model's rate at a straight arm that turns."""
    state, load = straight(model, angle, speed), np.zeros(LOADS)
    half = len(state) // 2
    size = 1e-6 * np.concatenate([np.ones(half - len(model.modes)), 1.0 / model.modes.omega,
                                  np.ones(half)])
    return np.column_stack([
        (model.rate(state + shift, load) - model.rate(state - shift, load)) / (2.0 * shift.sum())
        for shift in np.diag(size)])


def assert_is_jacobian(linear, model, angle, speed=0.0):
    found = jacobian(model, angle, speed)
    found[:, len(model.axes)] = 0.0  # the linear part is for a constant shaft angle
    np.testing.assert_allclose(linear, found, rtol=1e-6, atol=1e-6 * np.abs(found).max())


@pytest.mark.parametrize('held', ['x', 'y'])
@pytest.mark.parametrize('damping', [0.0, 0.02])
def test_the_linear_part_of_a_sector_is_that_of_the_equations(held, damping):
    model = scene_of(held, 0.001, {'arm.damping_ratio': [damping]}).build()
    for number in range(model.sectors):
        angle = (number + 0.5) * np.pi / model.sectors
        assert model.sector(model.state(np.r_[0.0, 0.0, angle, np.zeros(model.size - 3)]),
                            np.zeros(LOADS)) == number
        assert_is_jacobian(model.in_sector(number)[1], model, angle)


@pytest.mark.parametrize('speed', [-12.0, 0.2, 12.0])
def test_the_linear_part_of_an_arm_that_stretches_is_that_at_its_speed(speed):
    """With that of an arm at rest, eight modes at 1 ms diverge, see `test_stretch.py`."""
    model = scene_of('x', 0.001, {'model.axial_modes': 1, 'arm.damping_ratio': [0.02]}).build()
    band = BAND * model.modes.omega[0]
    for angle in (0.3, 2.0):
        number = model.sector(straight(model, angle, speed), np.zeros(LOADS))
        tables, linear = model.in_sector(number)
        # p_0 is that at the mean angle, within some percent of that at others.
        middle = ((number // SECTORS) + 0.5 - BANDS) * band
        assert abs(middle - speed) < band
        assert_is_jacobian(linear, model, (number % SECTORS + 0.5) * np.pi / SECTORS, middle)
        # The compiled rate lacks just this linear part.
        state, rest = straight(model, angle, speed), np.empty(len(linear))
        state += 1e-3 * np.arange(len(state))
        rate_once(model.pack(tables), state, np.zeros(LOADS), rest)
        np.testing.assert_allclose(linear @ state + rest, model.rate(state, np.zeros(LOADS)),
                                   rtol=0, atol=1e-9 * np.abs(linear @ state).max())


@pytest.mark.parametrize('angle', [0.0, 0.4, 2.0])
def test_the_linear_part_of_a_locked_shaft_is_that_of_the_equations(angle):
    model = scene_of('x', 0.001, {'motor.shaft': 'locked', 'initial.shaft': angle}).build()
    assert model.sectors == 0
    load, state = np.zeros(LOADS), np.zeros(len(model.linear))
    load[ANGLE], state[len(model.axes)] = angle, 1e-6 / model.modes.omega[0]
    np.testing.assert_allclose(model.rate(state, load), model.linear @ state, rtol=1e-6,
                               atol=1e-6 * np.abs(model.linear @ state).max())


# With y held the tip throws the light carrier along x, and the arm bends by a tenth of its length.
@pytest.mark.parametrize('held, limit', [('x', 1e-6), ('y', 2e-4)])
def test_a_heavy_tip_does_not_need_small_steps(held, limit):
    """With momenta in the state, runs at 5 ms would diverge within a few steps."""
    tips = [timo_sim.simulate(scene_of(held, step, HEAVY), 0.3, estimate=False).position(2.0)[-1]
            for step in (0.005, 0.0005)]
    assert np.linalg.norm(tips[1] - tips[0]) < limit


def test_steps_are_of_fourth_order_through_the_sectors():
    tips = [timo_sim.simulate(scene_of('x', step, SPINNING), 1.0, estimate=False).position(2.0)[-1]
            for step in (0.004, 0.002, 0.0002)]
    errors = [np.linalg.norm(tip - tips[-1]) for tip in tips[:-1]]
    assert errors[0] < 1e-5
    assert 9.0 < errors[0] / errors[1] < 40.0


def test_a_state_that_is_not_finite_is_no_crash():
    """Found by `make stress`: a finer run diverged, and its error was estimated before that."""
    model = timo_sim.load_scene({'carrier.held': 'y'}).build()
    assert model.sector(np.full(len(model.linear), np.nan), np.zeros(LOADS)) == 0
