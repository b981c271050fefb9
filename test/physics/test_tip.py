# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The tip of one motion, compiled, against the centre line of many."""

import numpy as np
import pytest

import timo_sim
from timo_sim.model import FORMULATIONS


@pytest.mark.parametrize('name', FORMULATIONS)
@pytest.mark.parametrize('modes', [0, 3, 5])
def test_tip_is_the_end_of_the_centre_line(name, modes):
    formulation = timo_sim.load_scene(
        {'model.formulation': name, 'model.modes': modes}).build()
    motion = np.random.default_rng(modes).normal(scale=0.3, size=formulation.size)
    end, q = formulation.at([2.0]), motion[np.newaxis, 3:3 + modes]
    along, across, rotation = formulation.tip(motion)
    # Both sum the same few terms in another order.
    assert (along, across) == pytest.approx(formulation.centre_line(q, end)[0, 0], abs=1e-14)
    assert rotation == pytest.approx(formulation.section_rotation(q, end)[0, 0], abs=1e-14)


def test_a_load_on_the_tip_does_its_work_and_gives_its_momentum():
    """Constant force and torque on the end effector of an arm that turns and bends far."""
    force, torque = np.array([6.0, -4.0]), 3.0
    scene = timo_sim.load_scene({
        'initial.shaft_velocity': 1.0, 'initial.modal_rates': [4.0, 1.0, 0.0],
        **{f'load.tip_{name}.piecewise.{key}': [value] for name, size in (
            ('force_x', force[0]), ('force_y', force[1]), ('torque', torque))
           for key, value in (('time', 0.0), ('value', size))}})
    run = timo_sim.simulate(scene, 2.0, estimate=False)
    tip = run.position(2.0)
    turn = run.shaft + run.rotation(2.0)
    assert np.abs(run.deflection(2.0)[:, 1]).max() > 0.08
    # The work of a constant load depends on its end points only; measured: 3e-12.
    work = (tip - tip[0]) @ force + torque * (turn - turn[0])
    energy = run.energy()
    assert np.abs(energy - energy[0] - work).max() < 1e-10 * energy.max()
    momentum = run.momentum() - run.momentum()[0]
    # Measured: 2e-12, the round-off of momenta computed from the motion.
    assert np.abs(momentum[:, :2] - np.outer(run.t, force)).max() < 1e-11
    moment = tip[:, 0] * force[1] - tip[:, 1] * force[0] + torque
    # Boole's rule over four steps.
    gained = sum(weight * moment[k:len(moment) - 4 + k:4] for k, weight in enumerate(
        (7.0, 32.0, 12.0, 32.0))) + 7.0 * moment[4::4]
    gained = np.cumsum(gained) * 4.0 * scene.step / 90.0
    assert np.abs(momentum[4::4, 2] - gained).max() < 1e-9
