# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Input shapers against closed forms, published ones, and the nonlinear arm."""

import numpy as np
import pytest

import timo_sim

POLE = 20.0 * np.exp(1j * (0.5 * np.pi + 0.05))  # damping ratio sin(0.05)
HERTZ, DAMPING = 20.0 / (2.0 * np.pi), np.sin(0.05)
KINDS = 'ZV', 'ZVD', 'EI'


def test_zv_leaves_nothing_at_the_mode_and_zvd_has_no_slope_there():
    near = np.array([1.0, 1.001, 1.002]) * HERTZ
    zv, zvd = (timo_sim.shaper([POLE], kind).residual(near, DAMPING) for kind in ('ZV', 'ZVD'))
    assert max(zv[0], zvd[0]) < 1e-15
    # Beside it ZV grows in proportion to the error of the frequency, ZVD to its square.
    assert zv[2] / zv[1] == pytest.approx(2.0, rel=2e-3)
    assert zvd[2] / zvd[1] == pytest.approx(4.0, rel=4e-3)


def test_a_residual_has_the_damping_of_the_nearest_mode_that_is_shaped():
    found = timo_sim.shaper([POLE, 100j], 'ZV')
    near = np.array([[HERTZ, 1.1 * HERTZ], [100.0 / (2.0 * np.pi), 15.0]])
    assert found.residual(near[:, 0]) == pytest.approx(0.0, abs=1e-13)  # zero is ZV's definition
    assert found.residual(near) == pytest.approx(
        found.residual(near, [[DAMPING], [0.0]]), abs=1e-14)
    assert found.residual(HERTZ, 0.0) > 0.05


@pytest.mark.parametrize('tolerance', [0.05, 0.2])
def test_ei_of_an_undamped_mode_is_the_one_of_singhose(tolerance):
    """Its formulas, and the two frequencies without vibration that follow from them."""
    v, found = tolerance, timo_sim.shaper([20j], 'EI', tolerance=tolerance)
    assert found.amplitudes == pytest.approx([(1.0 + v) / 4.0, (1.0 - v) / 2.0, (1.0 + v) / 4.0])
    assert found.times == pytest.approx(np.array([0.0, 0.5, 1.0]) / HERTZ)
    zero = np.arccos((v - 1.0) / (v + 1.0)) / np.pi
    assert found.residual([zero * HERTZ, (2.0 - zero) * HERTZ]) == pytest.approx(0.0, abs=1e-15)
    between = np.linspace(zero, 2.0 - zero, 101) * HERTZ
    assert found.residual(between).max() == pytest.approx(v, abs=1e-15)
    assert found.residual(HERTZ) == pytest.approx(v, abs=1e-15)


@pytest.mark.parametrize('ratio, close', [(0.02, 1e-3), (0.1, 0.008)])
def test_ei_of_a_damped_mode_is_near_the_fit_of_singhose(ratio, close):
    """The polynomials of the 1994 paper for 5 %; ours keeps the decay rate, theirs the ratio."""
    v, z = 0.05, ratio
    pole = 20.0 * complex(-z, np.sqrt(1.0 - z * z))
    found = timo_sim.shaper([pole], 'EI')
    first = 0.24968 + 0.24961 * v + (0.80008 + 1.23328 * v + (0.49599 + 3.17316 * v) * z) * z
    last = 0.25149 + 0.21474 * v + (-0.83249 + 1.41498 * v + (0.85181 - 4.90094 * v) * z) * z
    assert found.amplitudes == pytest.approx([first, 1.0 - first - last, last], abs=close)
    assert found.residual(HERTZ, z) == pytest.approx(v, abs=1e-15)
    # Poles with its decay rate that do not vibrate at all, as far from it on either side.
    half = np.pi / pole.imag
    roots = np.roots(found.amplitudes[::-1] * np.exp(-pole.real * found.times[::-1]))
    zeros = np.array([np.angle(roots).max(), 2.0 * np.pi - np.angle(roots).max()]) / half
    assert np.abs(np.exp(np.multiply.outer(-pole.real - 1j * zeros, found.times))
                  @ found.amplitudes) == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize('kind', KINDS)
def test_the_shaper_of_two_modes_is_their_convolution(kind):
    both = timo_sim.shaper('paper', kind, modes=2)
    vibrations = timo_sim.modes('paper')
    single = [timo_sim.shaper([pole], kind) for pole in vibrations.poles[:2]]
    hertz = np.linspace(1.0, 40.0, 50)
    assert both.residual(hertz, 0.1) == pytest.approx(
        np.prod([each.residual(hertz, 0.1) for each in single], axis=0), abs=1e-14)
    assert both.residual(vibrations.frequency[:2]).max() < (0.0500001 if kind == 'EI' else 1e-14)
    assert (np.diff(both.times) >= 0.0).all() and both.amplitudes.sum() == pytest.approx(1.0)


def test_a_command_is_shaped_as_a_function_and_as_samples():
    shaper, dt = timo_sim.shaper([POLE], 'ZVD'), 0.002
    t = dt * np.arange(300)
    ramp = np.clip(t / 0.3, 0.0, 1.0)
    shaped = shaper.shape_samples(1.0 + ramp, dt)
    assert len(shaped) == len(t) + np.ceil(shaper.times[-1] / dt)
    assert shaped[[0, -1]] == pytest.approx([1.0, 2.0])
    by_hand = shaper.shape(lambda at: (1.0 + np.clip(at / 0.3, 0.0, 1.0), 5.0))
    # The ramp is linear between the samples.
    assert [by_hand(at)[0] for at in t] == pytest.approx(shaped[:len(t)], abs=1e-12)
    assert by_hand(0.1)[1] == pytest.approx(5.0)


def vibration_left(scene, shaper, dt=0.002):
    """Return the amplitude of the tip after a shaped doublet of torque, of one mode [m]."""
    torque = np.repeat([0.0, 15.0, -15.0, 0.0], [1, 60, 60, 1])
    if shaper:
        torque = shaper.shape_samples(torque, dt)
    simulator = timo_sim.Simulator(scene)
    for each in torque:
        simulator.step(torque=each, duration=dt)
    bent = []
    for _ in range(150):  # 0.3 s, more than a period
        simulator.step(duration=dt)
        bent.append(simulator.deflection()[1])
    return np.ptp(bent) / 2.0


def test_what_a_shaper_leaves_in_the_nonlinear_arm_is_its_residual():
    """With the true frequency, and with one that is 20 % too large, where EI < ZVD < ZV."""
    scene = timo_sim.load_scene({'carrier.held': 'both', 'model.modes': 1, 'initial.shaft': 0.0})
    mode = timo_sim.modes(scene)
    unshaped = vibration_left(scene, None)
    for error in (1.0, 1.2):
        left = []
        for kind in KINDS:
            shaper = timo_sim.shaper(error * mode.poles, kind)
            left.append(vibration_left(scene, shaper) / unshaped)
            # Measured: terms of second order in the motion are 3e-4 of the unshaped vibration.
            assert left[-1] == pytest.approx(shaper.residual(mode.frequency[0]), abs=1e-3)
    assert left[2] < left[1] < left[0]


@pytest.mark.parametrize('given, said', [
    ({'plant': [-20.0 + 0j]}, 'imaginary part > 0'),
    ({'plant': [1.0 + 20j]}, 'no real part > 0, got 1\\+20j'),
    ({'plant': [-1.0 - 20j]}, 'imaginary part > 0'),
    ({'plant': 'paper', 'modes': 4}, 'modes must be a whole number >= 1 and <= 3, got 4'),
    ({'plant': 'paper', 'kind': 'zv'}, 'kind must be one of ZV, ZVD, EI'),
    ({'plant': 'paper', 'tolerance': 1.5}, 'tolerance must be'),
    ({'plant': [-1.0 + 1j], 'kind': 'EI', 'tolerance': 0.3}, 'tolerance must be less')])
def test_what_cannot_be_shaped_is_refused(given, said):
    with pytest.raises(timo_sim.ParameterError, match=said):
        timo_sim.shaper(**given)


def test_a_mode_that_does_not_vibrate_has_no_residual():
    with pytest.raises(timo_sim.ParameterError, match='damping must be >= 0 and < 1, got 1'):
        timo_sim.shaper('paper').residual(1.0, 1.0)
