# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A push, a force within the arm: statics in closed form, its work, its limits root and tip."""

import numpy as np
import pytest

import timo_sim
from timo_sim.fitting.record import OUTPUTS

LENGTH, PLACE, FORCE = 2.0, 1.3, 0.5
MOVING = {'initial.shaft_velocity': 1.5, 'initial.modal_rates': [0.5, 0.1, 0.0]}


def pushed(name, x=0.0, y=FORCE):
    """Return the parameters of constant forces along world x and y."""
    return {f'load.{name}_{axis}.piecewise': {'time': [0.0], 'value': [value]}
            for axis, value in (('x', x), ('y', y))}


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_a_clamped_arm_bends_as_a_beam_under_a_point_load(formulation):
    """Its tip: w = F a^2 (3 l - a) / (6 E I) + F a / (kappa G A), phi = F a^2 / (2 E I)."""
    errors = []
    for modes in (3, 8):
        scene = timo_sim.load_scene({}, {
            'carrier.held': 'both', 'motor.shaft': 'locked', 'initial.shaft': 0.0,
            'model.formulation': formulation, 'model.modes': modes, 'push.position': PLACE,
            'initial.equilibrium': True, **pushed('push')})
        model, section = scene.build(), scene.manipulator.arm.section
        _, across, rotation = model.tip(scene.initial_motion())
        bent = FORCE * PLACE**2 / (2.0 * section.bending_stiffness)
        sheared = FORCE * PLACE / section.shear_stiffness
        errors.append([across / (bent * (LENGTH - PLACE / 3.0) + sheared) - 1.0,
                       rotation / bent - 1.0])
    # Measured: 9e-4 with three modes, 3e-6 with eight.
    assert np.abs(errors[1]).max() < 1e-5
    assert np.abs(errors[1]).max() < 0.1 * np.abs(errors[0]).max()


@pytest.mark.parametrize('values', [
    {}, {'model.axial_modes': 1, 'carrier.held': 'y', 'integrator.step': 2e-4,
         'initial.modal_rates': [0.5, 0.1, 0.0, 0.0]}], ids=str)
def test_the_energy_grows_by_the_work_of_the_push(values):
    """A constant force in world axes does the work F times the way of its point."""
    scene = timo_sim.load_scene({}, {
        **MOVING, **pushed('push', x=-2.0, y=3.0), 'push.position': PLACE, **values})
    run = timo_sim.simulate(scene, 0.5, estimate=False)
    way = run.position(PLACE) - run.position(PLACE)[0]
    work, gained = way @ [-2.0, 3.0], run.energy() - run.energy()[0]
    assert np.abs(work).max() > 0.1
    # The error of the steps, which falls as h^4, is 1e-8 J; without the push it is as large.
    assert gained == pytest.approx(work, abs=1e-6)


@pytest.mark.parametrize('values', [
    {}, {'model.formulation': 'newton'}, {'carrier.held': 'x'},
    {'model.formulation': 'newton', 'carrier.held': 'y', 'gravity': [0.0, -9.81]},
    {'carrier.held': 'y', 'model.axial_modes': 1, 'initial.modal_rates': [0.5, 0.1, 0.0, 0.0]}],
    ids=str)
def test_at_the_tip_it_is_a_force_on_the_tip(values):
    """Motions, efforts, strain at the root as sensor and in fits, and linear models."""
    values = {**MOVING, 'push.position': LENGTH, **values}
    runs = [timo_sim.simulate(timo_sim.load_scene({}, {**values, **pushed(name, x=0.3)}), 0.2,
                              estimate=False) for name in ('push', 'tip_force')]
    for seen in (lambda run: run.values, lambda run: run.effort, lambda run: run.root_strain(),
                 OUTPUTS['root_strain'].of_run):
        ours, theirs = map(seen, runs)
        assert ours == pytest.approx(theirs, abs=1e-9 * np.abs(theirs).max())
    still = {name: value for name, value in values.items() if name not in MOVING}
    if 'gravity' not in still:
        model = timo_sim.linearize(timo_sim.load_scene(still))
        ours, theirs = (model.select([f'{name}_y_N']) for name in ('push', 'tip_force'))
        assert ours.B == pytest.approx(theirs.B, abs=1e-9 * np.abs(theirs.B).max())


def test_commands_push_as_loads_do_also_in_a_batch():
    values = {**MOVING, 'push.position': PLACE}
    scene = timo_sim.load_scene({}, values)
    wanted = timo_sim.simulate(timo_sim.load_scene({}, {**values, **pushed('push', x=0.3)}), 0.1,
                               estimate=False).values[-1]
    simulator, batch = timo_sim.Simulator(scene), timo_sim.Batch(scene, n=2)
    assert np.array_equal(simulator.step(push=(0.3, FORCE), duration=0.1).values, wanted)
    found = batch.step(push=[(0.3, FORCE), (0.0, 0.0)], duration=0.1).values
    assert found[0] == pytest.approx(wanted, abs=1e-10)
    assert np.abs(found[1] - wanted).max() > 1e-4


def test_commands_without_a_place_are_refused():
    with pytest.raises(timo_sim.ParameterError, match='push_y = 1 N needs push.position > 0'):
        timo_sim.Simulator({}).step(push=(0.0, 1.0))
