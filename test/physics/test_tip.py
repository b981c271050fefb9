"""The tip of one motion, compiled, against the centre line of many."""

import numpy as np
import pytest

import timo_sim
from timo_sim.physics import FORMULATIONS


@pytest.mark.parametrize('name', FORMULATIONS)
@pytest.mark.parametrize('modes', [0, 1, 3, 10])
def test_tip_is_the_end_of_the_centre_line(name, modes):
    formulation = timo_sim.load_scene(
        {'model.formulation': name, 'model.modes': modes}).build()
    motion = np.random.default_rng(modes).normal(scale=0.3, size=formulation.size)
    end, q = formulation.at([2.0]), motion[np.newaxis, 3:3 + modes]
    along, across, rotation = formulation.tip(motion)
    # Sums of ten terms in another order.
    assert (along, across) == pytest.approx(formulation.centre_line(q, end)[0, 0], abs=1e-14)
    assert rotation == pytest.approx(formulation.section_rotation(q, end)[0, 0], abs=1e-14)
