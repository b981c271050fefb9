# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Each effect in one use, and each use with one effect; `make composition` tries all pairs."""

from pathlib import Path

import pytest

from benchmark.composition import (
    batch, c_and_fmu, derivatives, gym, latin_square, observer, STEP, try_cell)
from conftest import code_for_any_size, OF_SNAPSHOTS
import timo_sim

ROOT = Path(__file__).resolve().parents[1]


# Uses that compare the bits of two programs.
EXACT = 'Batch on a GPU', 'C, FMU', 'ros2_control'


@pytest.mark.parametrize('use, effect', latin_square())
def test_an_effect_works_in_a_use(use, effect):
    with code_for_any_size(OF_SNAPSHOTS if use in EXACT else ''):
        found = try_cell(use, effect)
    assert found.state in ('works', 'without meaning'), found.text


def test_a_fitted_arm_with_presliding_and_an_elastic_gear_works_in_all_uses():
    """The arm of Lisbon, by the values of doc/real_arm.md."""
    scene = timo_sim.load_scene(ROOT / 'example/real_arm/lisbon.yaml', {
        'motor.rotor.inertia': 1.775e-7, 'motor.rotor.coulomb_friction': 0.0014714,
        'motor.rotor.coulomb_presliding': 0.18591, 'motor.gear.stiffness': 41.2,
        'motor.gear.damping': 0.0053188, 'motor.coulomb_friction': 0.0,
        'motor.torque_limit': 1.0, 'integrator.step': STEP})
    for use in batch, gym, derivatives, observer, c_and_fmu:
        with code_for_any_size(OF_SNAPSHOTS if use is c_and_fmu else ''):
            use(timo_sim.load_scene(scene.values))
