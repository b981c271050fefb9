# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A log of version 0.1.0, with old names of parameters and limits of 0, is read and replayed."""

import math
from pathlib import Path

import timo_sim
from timo_sim.log.tables import Recording
from timo_sim.runs.replay import replay

LOG = Path(__file__).parents[1] / 'data' / 'log_0_1_0.mcap'


def test_its_parameters_have_their_present_names_and_meanings():
    recording = Recording(LOG)
    assert recording.facts['timo_sim'] == '0.1.0'
    assert 'motor.dc.gear"' in recording.facts['changed']
    values = recording.scene.values
    assert values['motor.dc.gear_ratio'] == 3.0 and values['motor.torque_rate_limit'] == 5.0
    assert values['motor.torque_limit'] == math.inf
    assert recording.parameters['steps_per_call'] == 1


def test_it_is_replayed(tmp_path, monkeypatch):
    """To the last bit on the machine that made it; others round differently."""
    monkeypatch.chdir(tmp_path)
    told = []
    good = replay(LOG, show=told.append)
    if not good:
        assert 'differ' in told[1] and 'logged with' in told[-1]
    old, new = timo_sim.open_log(LOG), Recording(LOG).scene
    again = timo_sim.simulate(new.vary({'motor.dc.resistance': 0.0}), 0.1)
    assert again.motion.shape[1] == old.motion.shape[1]
