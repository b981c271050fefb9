# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Loads at the stages of a step: values, sides of jumps, sums."""

import numpy as np
import pytest

import timo_sim
from timo_sim.scene.loads import Harmonic, Piecewise, Table

STEP = 0.1


def test_harmonic():
    values = Harmonic(2.0, 0.5, 0.3).stages(3, 2, STEP)
    times = np.array([[0.3, 0.35, 0.4], [0.4, 0.45, 0.5]])
    assert values == pytest.approx(2.0 * np.sin(np.pi * times + 0.3))


def test_piecewise_shows_each_step_its_own_piece():
    # 0.3 = 3 x 0.1 only up to rounding: steps are counted, not compared as times.
    values = Piecewise((0.3, 0.5), (4.0, -1.0)).stages(2, 4, STEP)
    assert values.tolist() == [[0.0] * 3, [4.0] * 3, [4.0] * 3, [-1.0] * 3]


def test_table_is_linear_between_points_and_held_outside():
    table = Table((0.1, 0.3), (1.0, 5.0))
    assert table.stages(0, 4, STEP) == pytest.approx(
        np.array([[1, 1, 1], [1, 2, 3], [3, 4, 5], [5, 5, 5]]))


def test_table_jumps_where_a_time_stands_twice():
    table = Table((0.0, 0.3, 0.3, 0.5), (0.0, 3.0, -3.0, -5.0))
    values = table.stages(2, 2, STEP)
    assert values == pytest.approx(np.array([[2, 2.5, 3], [-3, -3.5, -4]]))
    assert table.jumps() == (0.3,)


def test_stages_do_not_depend_on_where_a_block_begins():
    terms = [Harmonic(1.0, 3.0, 0.1), Piecewise((0.2, 0.7), (1.0, 2.0)),
             Table((0.0, 0.4, 0.4, 0.9), (0.0, 1.0, 2.0, 0.0))]
    for term in terms:
        assert np.array_equal(term.stages(0, 12, STEP)[5:], term.stages(5, 7, STEP))


def test_sum_of_terms_on_a_channel():
    scene = timo_sim.load_scene({
        'integrator.step': STEP,
        'load.torque.harmonic.amplitude': [1.0, 2.0], 'load.torque.harmonic.frequency': [1.0, 2.0],
        'load.torque.piecewise.time': [0.2], 'load.torque.piecewise.value': [10.0],
        'load.torque.table.time': [0.0, 1.0], 'load.torque.table.value': [0.0, 1.0]})
    loads = scene.load.stages(3, 1, STEP)[0]
    times = np.array([0.3, 0.35, 0.4])
    expected = np.sin(2 * np.pi * times) + 2 * np.sin(4 * np.pi * times) + 10.0 + times
    assert loads[:, 4] == pytest.approx(expected)
    assert not loads[:, :4].any()


@pytest.mark.parametrize('kind, time, value', [
    ('piecewise', [0.25], [1.0]), ('table', [0.0, 0.25, 0.25, 1.0], [0.0, 1.0, 2.0, 2.0])])
def test_a_jump_inside_a_step_is_refused_with_the_ratio(kind, time, value):
    with pytest.raises(timo_sim.ParameterError, match=(
            rf'load\.force_y\.{kind}\.time\[\d\] = 0.25 must be a whole multiple of '
            r'integrator\.step = 0.1, the ratio is 2.5')):
        timo_sim.load_scene({'integrator.step': STEP, f'load.force_y.{kind}.time': time,
                             f'load.force_y.{kind}.value': value})


def test_times_that_do_not_ascend_are_refused():
    with pytest.raises(timo_sim.ParameterError, match='time must ascend'):
        timo_sim.load_scene({'load.torque.table.time': [0.0, 0.2, 0.1],
                             'load.torque.table.value': [0.0, 0.0, 0.0]})


def test_lists_of_different_length_are_refused():
    with pytest.raises(timo_sim.ParameterError, match='time: 2.*value: 1'):
        timo_sim.load_scene({'load.torque.piecewise.time': [0.0, 0.2],
                             'load.torque.piecewise.value': [1.0]})
