# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Deflections far from small: a tip turned by more than 60 degrees, against the elastica."""

import numpy as np
import pytest

from oracles import elastica
import timo_sim

LOAD = 3.2


def test_the_boundary_value_solver_gives_the_closed_form():
    section = timo_sim.load_scene(elastica.ARM).manipulator.arm.section
    load = LOAD * section.bending_stiffness / elastica.LENGTH**2
    found, closed = elastica.boundary_value(section, load, 0.0), elastica.elastica(LOAD)
    # Shear adds EI / (kappa G A l^2) = 1.6e-6 of the deflection.
    assert np.abs(found - closed).max() < 5e-6


@pytest.mark.parametrize('modes, rotation, deflection', [
    (3, 5e-2, 5e-5), (5, 5e-3, 2e-6)])
def test_exact_agrees_with_the_elastica(modes, rotation, deflection):
    run, truth = elastica.compare(modes, LOAD)
    assert np.degrees(truth[0]) > 60.0
    error = np.abs(run - truth)
    assert np.degrees(error[0]) < rotation
    assert elastica.LENGTH * error[1] < deflection
    assert elastica.LENGTH * error[2] < 2.0 * deflection + 2e-6


def test_newton_does_not_agree_and_warns():
    with pytest.warns(timo_sim.ModelWarning, match='take model.formulation exact'):
        run, truth = elastica.compare(3, LOAD, 'newton')
    assert elastica.LENGTH * np.abs(run - truth)[1] > 0.5
