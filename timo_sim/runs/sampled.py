# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Run a resolved scene once, and sample its motion."""

import math
import time

import numpy as np

from timo_sim.runs.run import Run
from timo_sim.simulation.model_warnings import DivergenceError
from timo_sim.simulation.simulator import Simulator

_REPORTED = 1024  # steps from one report to the next


def sampled_run(scene, steps, sample_every=1, report=lambda count: None, tell=None, pack=None):
    """
    Return the Run of a resolved scene; without the progress bar and ModelWarning of `simulate`.

    `report(count)` is called after each `count` further steps. `tell` goes to `Simulator.warm_up`,
    `pack` to `Simulator`.
    """
    simulator = Simulator(scene, pack=pack)
    simulator.warm_up(tell)
    motion = np.empty((steps // sample_every + 1, simulator.model.size))
    motion[0], heat = simulator.motion.values, np.zeros(len(motion))
    begun = time.monotonic()

    def run(count):
        samples = slice(count // sample_every + 1)
        stats = {'steps': simulator.steps, 'wall_time_s': time.monotonic() - begun,
                 'estimated_tip_error_m': math.nan, 'impact_loss_J': simulator.tip_load.lost}
        return Run(scene, scene.build(), np.arange(samples.stop) * sample_every * scene.step,
                   motion[samples], heat[samples], simulator.warning, stats,
                   payloads=scene.payloads)

    while simulator.steps < steps:
        first = simulator.steps
        count = min(max(1, _REPORTED // sample_every) * sample_every, steps - first)
        samples = slice(first // sample_every, (first + count) // sample_every + 1)
        try:
            motion[samples], heat[samples] = simulator.advance(count, sample_every=sample_every)
        except DivergenceError as error:
            last = simulator.steps // sample_every * sample_every
            again = Simulator(scene, pack=pack)  # a batch that fails returns no samples
            again.advance(first)
            samples = slice(samples.start, last // sample_every + 1)
            motion[samples], heat[samples] = again.advance(last - first, sample_every=sample_every)
            error.run = run(last)
            raise
        report(count)
    return run(steps)
