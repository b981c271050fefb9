# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The spin-up manoeuvre of Simo and Vu-Quoc: a driven shaft, faster than the first frequency."""

import numpy as np
import pytest

from oracles import references
import timo_sim
from timo_sim.model.layout import ANGLE, START

LENGTH = 10.0


def run_of(spin_up, **overrides):
    return timo_sim.simulate(timo_sim.load_scene(spin_up, overrides), 20.0, estimate=False)


@pytest.mark.parametrize('modes, step, lowest, tolerance', [
    (3, 0.01, -0.5738, 1e-4), (5, 0.002, -0.57380, 1e-5)])
def test_exact_gives_the_deflection_of_the_literature(spin_up, modes, step, lowest, tolerance):
    run = run_of(spin_up, **{'model.modes': modes, 'integrator.step': step})
    across = run.deflection(LENGTH)[:, 1]
    assert across.min() == pytest.approx(lowest, abs=tolerance)
    assert run.t[across.argmin()] == pytest.approx(6.762, abs=step)
    at = [int(np.argmin(np.abs(run.t - t))) for t in (2.5, 5.0, 7.5, 10.0, 12.5)]
    assert across[at] == pytest.approx([-0.1513, -0.4685, -0.5590, -0.3627, -0.1127], abs=2e-4)
    assert np.abs(across[run.t > 15.0]).max() == pytest.approx(3.6e-3, abs=5e-5)
    # The shaft is driven to 6 t - 45, up to the interpolation of the drive.
    assert run.shaft[-1] == pytest.approx(75.0, abs=1e-8)
    assert np.abs(run.carrier).max() == 0.0


def test_newton_diverges_beyond_its_first_frequency_with_a_warning(spin_up):
    with pytest.raises(timo_sim.DivergenceError,
                       match='axial force changes the stiffness.*newton leaves out'):
        run_of(spin_up, **{'model.formulation': 'newton'})


def test_newton_is_unstable_from_the_speed_that_its_warning_names(spin_up):
    """At constant speed just below the limit the straight arm is stable, just above it buckles."""
    peaks = []
    for share in (0.99, 1.01):
        start = timo_sim.load_scene(spin_up, {'model.formulation': 'newton'})
        speed = share * start.build().speed_limit
        scene = timo_sim.load_scene(start.values, {
            'motor.drive.time': [0.0], 'motor.drive.angle': [0.0], 'motor.drive.speed': [speed],
            'motor.drive.acceleration': [0.0], 'initial.modal_rates': [1e-3, 0.0, 0.0]})
        if share > 1:
            with pytest.warns(timo_sim.ModelWarning):
                run = timo_sim.simulate(scene, 20.0, estimate=False)
        else:
            run = timo_sim.simulate(scene, 20.0, estimate=False)
        peaks.append(np.abs(run.q[:, 0]).max())
    omega = timo_sim.load_scene(spin_up).build().modes.omega[0]
    # Below: an oscillation at sqrt(omega^2 - theta'^2); above: growth, exp(0.54 t).
    assert peaks[0] == pytest.approx(1e-3 / (omega * np.sqrt(1 - 0.99**2)), rel=0.02)
    assert peaks[1] > 1e3 * peaks[0]


def test_below_its_first_frequency_newton_gives_no_warning(paper, recwarn):
    scene = timo_sim.load_scene(paper, {'model.formulation': 'newton'})
    timo_sim.simulate(scene, 1.0, estimate=False)
    assert not [each for each in recwarn if issubclass(each.category, timo_sim.ModelWarning)]


def test_the_file_drives_along_the_formula(spin_up):
    """Its points, every 0.5 s, agree to twelve digits; between them it is within 4e-9 rad."""
    load = timo_sim.load_scene(spin_up).load
    drive, = load.terms['angle']
    theta, speed, acceleration = references.spin_up()
    for k, t in enumerate(drive.time):
        assert drive.angle[k] == pytest.approx(theta(t), abs=1e-11)
        assert drive.speed[k] == pytest.approx(speed(t), abs=1e-11)
        assert drive.acceleration[k] == pytest.approx(acceleration(t), abs=1e-11)
    times = np.arange(0.0, 20.0, 0.05)
    between = [load.stages(k, 1, 0.05)[0, START, ANGLE] for k in range(len(times))]
    assert np.abs(between - np.array([theta(t) for t in times])).max() < 1e-8
