# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Pacing with a clock of the test: due steps, dropped steps, overruns."""

import pytest

from timo_sim.ros.pacing import Pace


def pace_of(step, factor=1.0, limit=0.1):
    pace = Pace(step)
    pace.set(factor, limit, 0, 100.0)
    return pace


def test_every_deadline_gives_one_step_without_drift():
    pace, steps = pace_of(0.001), 0
    for tick in range(1, 100001):
        assert pace.deadline(steps) == pytest.approx(100.0 + tick * 0.001, abs=1e-9)
        assert pace.due(steps, pace.deadline(steps)) == 1
        steps += 1
    assert (pace.overruns, pace.dropped_steps) == (0, 0)


@pytest.mark.parametrize('step, factor, steps, period', [
    (0.0001, 1.0, 10, 0.001),   # short steps are done ten at a time
    (0.001, 10.0, 10, 0.001),   # so are those of a fast run
    (0.001, 0.1, 1, 0.010),     # slow motion
    (0.02, 1.0, 1, 0.020)])
def test_ticks_are_at_least_a_millisecond_apart(step, factor, steps, period):
    pace = pace_of(step, factor)
    assert pace.deadline(0) == pytest.approx(100.0 + period)
    assert pace.due(0, pace.deadline(0)) == steps


def test_a_delay_is_caught_up_and_counted():
    pace = pace_of(0.001)
    assert pace.due(0, 100.0501) == 50
    assert (pace.overruns, pace.dropped_steps) == (1, 0)
    assert pace.due(50, 100.0504) == 0
    assert pace.deadline(50) == pytest.approx(100.051)


def test_steps_beyond_the_limit_are_dropped_and_counted():
    pace = pace_of(0.001, limit=0.1)
    assert pace.due(0, 102.0) == 100
    assert pace.dropped_steps == 1900
    # Sim time now lags wall time by the dropped time, and goes on at its pace.
    assert pace.due(100, 102.001) == 1
    assert pace.due(101, 103.001) == 100 and pace.dropped_steps == 1900 + 900


def test_delays_are_not_counted_where_time_waits_for_others():
    pace = Pace(0.001, waits=True)
    pace.set(1.0, 0.1, 0, 100.0)
    assert pace.due(0, 102.0) == 100 and pace.due(100, 102.001) == 1
    assert (pace.overruns, pace.dropped_steps) == (0, 0)


def test_a_new_limit_alone_keeps_the_deadlines():
    pace = pace_of(0.001)
    pace.set(1.0, 0.5, 0, 100.0007)
    assert pace.due(0, 100.001) == 1
    pace.set(2.0, 0.5, 1, 100.0017)
    assert pace.due(1, 100.0027) == 2


def test_free_running():
    assert pace_of(0.001, factor=0.0).free and not pace_of(0.001).free
