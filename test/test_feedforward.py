# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Feed-forward against closed forms of a rigid arm, the linear model, and the nonlinear arm."""

import warnings

import numpy as np
import pytest

import timo_sim

DT = 0.01
ARM = {'carrier.held': 'both', 'initial.shaft': 0.0}
FREE = {'carrier.held': 'none', 'initial.shaft': 0.5}
HANGS = {'gravity': [0.0, -9.81], 'initial.shaft': -1.5, 'initial.equilibrium': True}
DC = {'motor.dc.resistance': 2.0, 'motor.dc.torque_constant': 0.5, 'motor.dc.gear_ratio': 20.0}
FORCES = 'force_x_N', 'force_y_N', 'torque_N_m'


def model(inputs=('torque_N_m',), **values):
    """Return the discrete model of the paper's arm, on a carrier that is held."""
    scene = timo_sim.load_scene({}, {**ARM, **values})
    return timo_sim.linearize(scene).select(inputs).to_discrete(DT)


# Limits just below what the plans without limits take, so that all of them act.
@pytest.mark.parametrize('inputs, values, goal, limits', [
    (['torque_N_m'], {}, {'shaft_rad': 1.0}, {'limit': 18.0}),
    (['torque_N_m'], {}, {'tip_y_m': 1.5}, {'rate_limit': 72.0}),
    (['torque_N_m'], {'arm.damping_ratio': 0.02}, {'shaft_rad': -1.0},
     {'limit': 18.0, 'rate_limit': 200.0}),
    (['voltage_V'], DC, {'shaft_rad': 1.0}, {'limit': 9.0}),
    (FORCES, FREE, {'carrier_x_m': 0.0, 'carrier_y_m': 0.5, 'shaft_rad': 0.0},
     {'limit': [3.0, 10.0, 9.0]}),
    (['torque_N_m'], FREE, {'shaft_rad': 0.3}, {'limit': 4.5}),
    (['torque_N_m'], HANGS, {'shaft_rad': 0.1}, {'rate_limit': 7.4})],
    ids=['limit', 'rate', 'both', 'voltage', 'carrier', 'no force', 'gravity'])
def test_a_plan_is_a_motion_that_ends_at_rest_within_its_limits(inputs, values, goal, limits):
    plant = model(inputs, **values)
    for given in ({}, limits):
        plan = timo_sim.feedforward(plant, goal, 2.0, **given)
        x, u = plan.x, plan.u
        assert x[0] == pytest.approx(0.0) and u[0] == pytest.approx(0.0)
        assert x[1:] == pytest.approx(x[:-1] @ plant.A.T + u[:-1] @ plant.B.T, abs=1e-12)
        # Held, the last inputs keep the last state: it is rest.
        rest = plant.A @ x[-1] + plant.B @ u[-1]
        assert rest == pytest.approx(x[-1], abs=1e-13)
        reached = dict(zip(plant.outputs, plan.y[-1]))
        assert {name: reached[name] for name in goal} == pytest.approx(goal, abs=1e-12)
        within = [bool((np.abs(each) <= np.multiply(limits.get(name, np.inf), unit)).all())
                  for name, each, unit in (('limit', u, 1.0),
                                           ('rate_limit', np.diff(u, axis=0), DT))]
        assert all(within) == bool(given)
    assert plan.at(1.0).x == pytest.approx(x[100])
    if values is HANGS:  # the weight of an arm that hangs asks for a torque
        assert abs(u[-1, 0]) > 1.0


def test_a_plan_rests_before_its_start_and_after_its_end():
    """A shaper asks its command for earlier times: what it shapes begins at the start."""
    plan = timo_sim.feedforward(model(), {'shaft_rad': 1.0}, 2.0)
    for t, row in ((-9.0, 0), (-DT, 0), (0.0, 0), (0.5, 50), (2.0, 200), (9.0, 200)):
        assert plan.at(t).x == pytest.approx(plan.x[row]), t
    shaft = model().outputs.index('shaft_rad')
    shaped = timo_sim.shaper('paper').shape(lambda t: plan.at(t).y[shaft])
    assert (shaped(0.0), shaped(9.0)) == pytest.approx((0.0, 1.0))
    assert len(repr(plan)) < 800  # not of all its numbers
    assert f'{plan.at(0.5).u[0]:.6g}'[:5] in repr(plan.at(0.5))


def rigid():
    """Return the model of a rigid arm, and its moment of inertia [kg m2]."""
    plant = model(**{'model.modes': 0})
    return plant, DT / plant.B[1, 0]


def test_the_plan_of_a_rigid_arm_is_the_motion_of_least_jerk():
    """Held torques delay it by half a period; the remaining difference is of second order."""
    plan = timo_sim.feedforward(rigid()[0], {'shaft_rad': 1.0}, 2.0)
    s = np.clip((plan.t - 0.5 * DT) / 2.0, 0.0, 1.0)
    jerk = np.column_stack([s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 15.0 * (s * (1.0 - s))**2])
    assert plan.x == pytest.approx(jerk, abs=20.0 * (DT / 2.0)**2)


def test_the_shortest_plan_has_fewer_periods_than_states_if_the_limits_allow():
    """A rigid arm on a free carrier has six; it speeds up for a period and brakes for another."""
    plant = timo_sim.linearize({'model.modes': 0, 'initial.shaft': 0.0},
                               inputs=['torque_N_m']).to_discrete(0.1)
    plan = timo_sim.feedforward(plant, {'shaft_rad': 1.0}, limit=1e6)
    assert len(plant.A) == 6 and plan.t[-1] == pytest.approx(0.3)
    assert plan.y[-1, plant.outputs.index('shaft_rad')] == pytest.approx(1.0)


def test_the_shortest_plan_of_a_rigid_arm_is_that_of_an_s_curve():
    """
    It reaches the angle d with torques L that change at rates R: (T/2)^2 - (T/2) L/R = J d / L.

    Its trapezoids of torque, of duration T/2, are L (T/2 - L/R) in area.
    """
    plant, inertia = rigid()
    limit, rate = 30.0, 150.0
    half = np.roots([1.0, -limit / rate, -inertia / limit]).max()
    plan = timo_sim.feedforward(plant, {'shaft_rad': 1.0}, None, limit, rate)
    # Torques are held, and are 0 in the first and the last period.
    assert 2.0 * half <= plan.t[-1] < 2.0 * half + 2.5 * DT
    with pytest.raises(timo_sim.ParameterError, match=f'at least {plan.t[-1]:.6g} s .* got '):
        timo_sim.feedforward(plant, {'shaft_rad': 1.0}, plan.t[-1] - DT, limit, rate)
    # A longer plan, for which least jerk takes 1.2 times the limit, has the least rate.
    half = DT * round(np.sqrt(5.77 / 1.2 * inertia / limit) / 2.0 / DT)
    plan = timo_sim.feedforward(plant, {'shaft_rad': 1.0}, 2.0 * half, limit)
    ramp = half - inertia / (limit * half)
    assert np.abs(np.diff(plan.u[:, 0])).max() / DT == pytest.approx(limit / ramp, rel=0.03)


@pytest.mark.parametrize('given, said', [
    ({'duration': 0.01}, r'at least 0\.\d+ s to reach the goal .* got 0.01 s'),
    ({'model': FREE, 'duration': 2.0, 'goal': {'shaft_rad': 1.0, 'carrier_y_m': 0.0}},
     'goal must be reachable within the limits'),
    ({'model': HANGS, 'limit': 2.0}, 'goal must be reachable within the limits of the'),
    ({'model': None, 'duration': 1.0}, 'use model.to_discrete'),
    ({}, 'duration must be given if nothing is limited'),
    ({'duration': 1.001}, 'must be a whole multiple of dt = 0.01'),
    ({'duration': -1.0}, 'duration must be a finite number > 0 s, got -1.0'),
    ({'duration': 1.0, 'limit': 0.0}, 'limit and rate_limit must be .* > 0'),
    ({'duration': 1.0, 'goal': {'shaft': 1.0}}, 'did you mean shaft_rad'),
    ({'duration': 1.0, 'goal': {'shaft_rad': np.nan}}, 'goal must be'),
    ({'duration': 1.0, 'goal': 1.0}, 'goal must have values by name .* 1.0')])
def test_what_cannot_be_planned_is_refused(given, said):
    values = given.get('model', {})
    plant = timo_sim.linearize(ARM) if values is None else model(**values)
    with pytest.raises(timo_sim.ParameterError, match=said):
        timo_sim.feedforward(**{'goal': {'shaft_rad': 1.0}, **given, 'model': plant})


def test_the_nonlinear_arm_comes_to_rest_without_feedback():
    """Of the plan of a rigid arm, which is as fast, more than 20 times as much is left."""
    left = []
    for modes in (0, 3):
        scene = timo_sim.load_scene({}, {**ARM, 'motor.torque_limit': 18.0})
        plant = timo_sim.linearize(scene.vary({'model.modes': modes})).select(['torque_N_m'])
        plan = timo_sim.feedforward(plant.to_discrete(DT), {'shaft_rad': 1.0}, 2.0, 18.0)
        simulator, bent = timo_sim.Simulator(scene), []
        for torque in plan.u[:, 0]:
            motion = simulator.step(torque=torque, duration=DT)
        for _ in range(100):
            simulator.step(duration=DT)
            bent.append(simulator.deflection()[1])
        left.append(np.abs(bent).max())
    assert left[1] < left[0] / 20.0
    assert motion.shaft == pytest.approx(1.0, abs=1e-3)


def test_a_plan_that_bends_the_arm_too_far_says_so():
    """Half of a turn in half a second bends this arm by more than a fifth of its length."""
    scene = {**ARM, 'arm.length': 0.7, 'arm.section.height': 0.002, 'arm.section.width': 0.02,
             'arm.density': 7850.0, 'arm.young_modulus': 2.1e11, 'arm.shear_modulus': 8e10,
             'end_effector.mass': 0.1, 'end_effector.inertia': 1e-5, 'motor.shaft_inertia': 0.01}
    plant = timo_sim.linearize(scene).select(['torque_N_m'], ['tip_transverse_m']).to_discrete(DT)
    shaft = timo_sim.linearize(scene).select(['torque_N_m'], ['shaft_rad']).to_discrete(DT)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter('always')
        slow = timo_sim.feedforward(shaft, {'shaft_rad': 3.0}, 3.0)
    assert not told
    with pytest.warns(timo_sim.ModelWarning, match='bends the arm by 0.[2-9]. of its length'):
        fast = timo_sim.feedforward(shaft, {'shaft_rad': 3.0}, 0.5)
    slow, fast = (np.abs(plan.x @ plant.C[0]).max() / 0.7 for plan in (slow, fast))
    assert slow < 0.2 < fast
