# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A whole run of a scene: `simulate`."""

import sys
import time
import warnings

import numpy as np
from tqdm import tqdm

from timo_sim.runs.run import Run
from timo_sim.scene.parameter import ModelWarning, ParameterError
from timo_sim.scene.scene import Scene
from timo_sim.simulation.resolution import resolved
from timo_sim.simulation.model_warnings import DivergenceError
from timo_sim.simulation.simulator import Simulator

_REPORTED = 1024  # steps from one report to the next


def simulate(scene: Scene, duration: float, sample_every: int = 1) -> Run:
    """
    Simulate a scene under its own loads.

    On a terminal, a progress bar appears when the run takes more than a second.

    Parameters
    ----------
    scene : Scene
        With `model.accuracy`, modes and step are chosen first, see `choose_resolution`.
    duration : float
        [s], a whole multiple of the time step.
    sample_every : int
        Steps between samples; divides the number of steps.

    Returns
    -------
    Run

    Raises
    ------
    ParameterError
        If the duration does not fit the step, or `sample_every` the number of steps.
    DivergenceError
        If the state stops being that of an arm, or finite; `error.run` is the run so far.

    Warns
    -----
    ModelWarning
        If the shaft becomes too fast for a formulation without centrifugal stiffening, or steps
        are too long for what happens or for a harmonic load.

    Examples
    --------
    >>> import timo_sim
    >>> run = timo_sim.simulate(timo_sim.load_scene('paper'), duration=1.0)
    >>> run.deflection(2.0).shape
    (1001, 2)

    """
    scene, steps = resolved(scene, duration)
    if sample_every < 1 or steps % sample_every:
        raise ParameterError(
            f'sample_every = {sample_every} must divide the number of steps, {steps}')
    with tqdm(total=steps, unit='step', unit_scale=True, delay=1.0, disable=None,
              leave=False) as bar:
        run = sampled_run(scene, steps, sample_every, bar.update, _tell)
    if run.warning:
        warnings.warn(run.warning, ModelWarning, stacklevel=2)
    return run


def _tell(text):
    print(f'timo_sim: {text}', file=sys.stderr, flush=True)


def sampled_run(scene, steps, sample_every=1, report=lambda count: None, tell=None):
    """
    Return the Run of a resolved scene, as `simulate` does but without bar and warning.

    `report` receives how many further steps are done; `tell` is for `Simulator.warm_up`.
    """
    simulator = Simulator(scene)
    simulator.warm_up(tell)
    motion = np.empty((steps // sample_every + 1, simulator.model.size))
    motion[0], heat = simulator.motion.values, np.zeros(len(motion))
    begun = time.monotonic()

    def run(count):
        samples, integration = slice(count // sample_every + 1), simulator.integration
        stats = {'steps': simulator.steps, 'wall_time_s': time.monotonic() - begun,
                 'estimated_tip_error_m': simulator.estimated_error,
                 'step_error_m': integration.errors.tip,
                 'modes_error_m': integration.errors.modes.tip,
                 'stretch_error_m': simulator.stretch.tip,
                 'split_steps': integration.splits, 'unresolved_steps': integration.unresolved,
                 'friction_drift_m': integration.friction_drift}
        return Run(scene, simulator.model, np.arange(samples.stop) * sample_every * scene.step,
                   motion[samples], heat[samples], simulator.warning, stats)

    while simulator.steps < steps:
        first = simulator.steps
        count = min(max(1, _REPORTED // sample_every) * sample_every, steps - first)
        samples = slice(first // sample_every, (first + count) // sample_every + 1)
        try:
            motion[samples], heat[samples] = simulator.advance(count, sample_every=sample_every)
        except DivergenceError as error:
            error.run = run(first)
            raise
        report(count)
    return run(steps)
