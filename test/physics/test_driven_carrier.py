# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A carrier whose motion is given, or held by a base whose acceleration is: strip on a shaker."""

import numpy as np
from oracles.energy import work
import pytest

import timo_sim
from timo_sim.scene.loads import CHANNELS

# A strip of steel whose direction of bending is along x while the shaft is at 90 degrees.
STRIP = {'arm.length': 0.3, 'arm.section.width': 0.025, 'arm.section.height': 0.001,
         'arm.density': 7850.0, 'arm.young_modulus': 210e9, 'arm.shear_modulus': 80.8e9,
         'arm.damping_ratio': 0.01, 'motor.shaft': 'locked', 'initial.shaft': np.pi / 2}
RATIOS = {0.5: 0.51674, 0.9: 6.6292, 1.0: 78.299, 1.1: 8.9997}  # tip against base, over base
FIRST = 9.2835  # [Hz]
ARM = {'arm.length': 1.2, 'arm.section.height': 0.01, 'arm.section.width': 0.03,
       'arm.material': 'aluminium', 'initial.shaft': 0.4, 'motor.mass': 1.0, 'carrier.mass': 5.0,
       'end_effector.mass': 0.4, 'end_effector.inertia': 0.01, 'motor.shaft_inertia': 0.05,
       'model.modes': 4}
POINTS = {'carrier.drive.time': [0.0, 0.2, 0.4], 'carrier.drive.x': [0.1, 0.2, 0.25],
          'carrier.drive.x_speed': [0.0, 1.0, 0.5], 'carrier.drive.x_acceleration': 3 * [0.0]}
SHAKEN = {'carrier.drive.harmonic.frequency': [2.0], 'carrier.drive.harmonic.y': [0.05]}


@pytest.mark.parametrize('name', ['exact', 'newton'])
def test_a_strip_on_a_shaker_answers_as_its_modes_do(name):
    """By its linear model, and in motion after the vibrations of the start are gone."""
    scene = timo_sim.load_scene({**STRIP, 'carrier.held': 'both', 'model.formulation': name})
    model = timo_sim.linearize(scene).select(
        ['carrier_acceleration_x_m_per_s2'], ['tip_transverse_m'])
    for share, wanted in RATIOS.items():
        omega = 2.0 * np.pi * share * FIRST
        ratio = np.abs(model.frequency_response([share * FIRST])[0, 0, 0]) * omega**2
        assert ratio == pytest.approx(wanted, rel=2e-4)
    if name == 'newton':
        return
    run = timo_sim.simulate(
        {**STRIP, 'carrier.held': 'y', 'model.modes': 2,
         'carrier.drive.harmonic.frequency': [0.9 * FIRST],
         'carrier.drive.harmonic.x': [1e-5]}, 12.0, 2, estimate=False)
    late = run.t > 11.0
    assert np.ptp(run.carrier[late, 0]) == pytest.approx(2e-5, rel=1e-3)
    assert np.ptp(run.deflection()[late, 1]) == pytest.approx(6.6292 * 2e-5, rel=3e-3)


@pytest.mark.parametrize('values', [
    {'model.axial_modes': 1, 'hub.radius': 0.1},
    {'model.formulation': 'newton', 'carrier.held': 'y', 'gravity': [0.0, -9.81]}], ids=str)
def test_a_driven_carrier_moves_as_a_heavy_one_that_is_pushed(values):
    """A mass of 1e6 kg under the force of the given acceleration, one axis or both."""
    both = 'carrier.held' not in values
    driven = timo_sim.simulate({**ARM, **POINTS, **(SHAKEN if both else {}), **values}, 0.3,
                               estimate=False)
    table = driven.scene.load.stages(0, 300, 0.001)
    t, mass, forces = 0.001 * np.arange(301), 1e6, {}
    for axis in ('x', 'y') if both else ('x',):
        seen = table[:, :, CHANNELS[f'carrier_acceleration_{axis}']]
        forces[f'load.force_{axis}.table.time'] = t.tolist()
        forces[f'load.force_{axis}.table.value'] = (
            mass * np.append(seen[:, 0], seen[-1, 3])).tolist()
    start = driven.values[0]
    half = len(start) // 2
    free = timo_sim.simulate({
        **ARM, **values, **forces, 'carrier.mass': mass, 'initial.carrier_x': start[0],
        'initial.carrier_x_velocity': start[half], 'initial.carrier_y_velocity': start[half + 1],
        'gravity': [0.0, 0.0] if both else values['gravity']}, 0.3, estimate=False)
    moved = np.ptp(driven.position(), axis=0).max()
    assert moved > 0.03
    assert driven.carrier == pytest.approx(free.carrier, abs=1e-4 * moved)
    assert driven.position() == pytest.approx(free.position(), abs=1e-4 * moved)


def test_what_drives_the_carrier_does_the_work():
    """Its force times its speed is the rate of the energy."""
    run = timo_sim.simulate({**ARM, **POINTS, **SHAKEN, 'gravity': [0.0, -9.81],
                             'integrator.step': 2e-4}, 0.2, 2, estimate=False)
    velocity = np.column_stack([run.carrier_velocity, run.shaft_velocity])
    done = work(np.rint(run.t * 1e9), run.values[:, :3], velocity, run.effort)
    assert np.ptp(run.energy()) > 1.0
    assert np.append(0.0, np.cumsum(done)) == pytest.approx(
        run.energy() - run.energy()[0], abs=1e-6 * np.ptp(run.energy()))


def test_a_base_that_accelerates_is_gravity_the_other_way():
    """The frame moves, not the place; an accelerometer at the tip shows the same."""
    values = {**ARM, 'carrier.held': 'both'}
    falls = timo_sim.Simulator({**values, 'gravity': [0.0, -9.81]})
    lifted = timo_sim.Simulator(values)
    falls.step(duration=0.1)
    lifted.step(duration=0.1, carrier_acceleration=[0.0, 9.81])
    assert lifted.motion.values == pytest.approx(falls.motion.values, abs=1e-12)
    assert lifted.sensors.tip_acceleration == pytest.approx(
        falls.sensors.tip_acceleration, abs=1e-4)
    assert lifted.effort == pytest.approx(falls.effort, rel=1e-6, abs=1e-4)


def test_a_record_of_the_base_finds_the_damping():
    t = 0.002 * np.arange(1500)
    shaken = 3.0 * np.sin(2.0 * np.pi * (5.0 + 2.0 * t) * t)
    scene = timo_sim.load_scene({**STRIP, 'carrier.held': 'both', 'model.modes': 2,
                                 'integrator.step': 0.002})
    run = timo_sim.simulate(scene.vary({
        'load.carrier_acceleration_x.table.time': t.tolist(),
        'load.carrier_acceleration_x.table.value': shaken.tolist()}), 2.998, estimate=False)
    record = timo_sim.Record.of({'carrier_acceleration_x': (t, shaken)},
                                {'tip_transverse': (t, run.deflection()[:, 1])})
    found = timo_sim.fit(scene.vary({'arm.damping_ratio': 0.02}), record,
                         ['arm.damping_ratio', 'arm.young_modulus'], quick=True, starts=1)
    assert found.values['arm.damping_ratio'] == pytest.approx(0.01, rel=3e-3)


@pytest.mark.parametrize('values, text', [
    ({**POINTS, 'carrier.held': 'x'}, 'carrier.held = x must not be given along x'),
    ({'load.carrier_acceleration_y.piecewise.time': [0.0],
      'load.carrier_acceleration_y.piecewise.value': [1.0]}, 'held along y, got carrier.held = n'),
    ({**POINTS, 'carrier.drive.x_speed': [0.0]}, 'the same length'),
    ({'carrier.drive.harmonic.frequency': [1.0]}, 'harmonic.x or harmonic.y must be given')])
def test_a_drive_that_contradicts_the_scene_is_refused(values, text):
    with pytest.raises(timo_sim.ParameterError, match=text):
        timo_sim.load_scene({**ARM, **values})
