# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The integrator: its matrices against closed forms, its order, its behaviour at jumps."""

import numpy as np
import pytest
from scipy.linalg import expm

import timo_sim
from timo_sim.steps.etdrk4 import propagator


def test_matrices_of_an_oscillator_are_sines_and_cosines():
    omega, h = 30.0, 0.05
    linear = np.array([[0.0, 1.0], [-omega**2, 0.0]])
    whole = propagator(linear, h).whole
    c, s = np.cos(omega * h), np.sin(omega * h)
    assert np.allclose(whole, [[c, s / omega], [-omega * s, c]], rtol=1e-13, atol=1e-13)


def test_weights_integrate_a_constant_exactly():
    """Under a constant n the step is the exact solution, L^-1 (exp(h L) - 1) n."""
    linear = np.array([[0.0, 1.0], [-4.0, -0.3]])
    h = 0.2
    p = propagator(linear, h)
    constant = np.array([0.3, 1.7])
    step = p.start_weight @ constant + p.middle_weight @ (2 * constant) + p.end_weight @ constant
    exact = np.linalg.solve(linear, (expm(h * linear) - np.eye(2)) @ constant)
    assert np.allclose(step, exact, rtol=1e-13)


def test_stiff_and_slow_parts_keep_their_digits():
    """With ten decades of stiffness, as 40 modes have, oscillators neither grow nor decay."""
    omega = np.array([1.0, 1e3, 1e5])
    linear = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.diag(omega**2), np.zeros((3, 3))]])
    h = 0.01
    whole = propagator(linear, h).whole
    # Ten squarings of the exponential: round-off times the norm of h L, 1e3, times 25 (measured).
    assert np.diag(whole)[:3] == pytest.approx(np.cos(omega * h), abs=1e-11)
    assert np.linalg.det(whole) == pytest.approx(1.0, abs=4e-11)


def max_error(run, truth):
    half = run.values.shape[1] // 2
    return np.abs(run.values[:, :half] - truth.values[:, :half]).max()


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_order_is_four(paper, formulation):
    # The run starts from rest under the paper's smooth loads. The steps resolve the fastest of
    # three modes (30 Hz), and errors are well above round-off (1e-13).
    def run(step):
        scene = timo_sim.load_scene(paper, {'integrator.step': step,
                                            'model.formulation': formulation})
        return timo_sim.simulate(scene, 1.0, sample_every=round(0.02 / step), estimate=False)

    truth = run(0.00025)
    errors = [max_error(run(step), truth) for step in (0.01, 0.005, 0.0025)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] > 1e-12
    assert orders == pytest.approx(4.0, abs=0.2)


def test_a_jump_on_a_step_boundary_costs_no_order(paper):
    """A stage that used the torque after the jump would be wrong by 1e-2 rad."""
    def run(step):
        scene = timo_sim.load_scene({
            'integrator.step': step, 'load.torque.piecewise.time': [0.1, 0.6],
            'load.torque.piecewise.value': [20.0, -20.0]})
        return timo_sim.simulate(scene, 1.0, sample_every=round(0.02 / step), estimate=False)

    truth = run(0.00025)
    errors = [max_error(run(step), truth) for step in (0.01, 0.005, 0.0025)]
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(4.0, abs=0.3)
