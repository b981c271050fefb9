# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The function `simulate`: one run of a scene under its own loads."""

from __future__ import annotations

from dataclasses import replace
import sys

from tqdm import tqdm

from timo_sim.runs.accuracy import measure_error, resolve
from timo_sim.runs.run import Run, run_scene
from timo_sim.scene.parameters import Parameter, ParameterError, warn
from timo_sim.scene.scene import load_scene, SceneLike
from timo_sim.simulation.warnings import DivergenceError

_EVERY = Parameter('sample_every', 1, '', 'steps between samples', low=1)
_LEAST_COMPARED = 200  # samples at which the tips of two runs are compared


def simulate(scene: SceneLike, duration: float, sample_every: int = 1,
             estimate: bool = True) -> Run:
    """
    Simulate a scene under its own loads.

    On a terminal, a progress bar appears when the run takes more than a second. The error of the
    tip is measured by a finer run, which takes some twenty times as long, see `Run.stats`.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
        With `model.accuracy`, modes and step are chosen first, see `choose_resolution`.
    duration : float
        Sim time [s], a whole multiple of the time step.
    sample_every : int
        Steps between samples; divides the number of steps.
    estimate : bool
        Whether the error is measured.

    Returns
    -------
    Run

    Raises
    ------
    ParameterError
        If the duration does not fit the step, or `sample_every` the number of steps.
    DivergenceError
        If the state is no longer finite, or the arm is bent by more than ten times its length;
        `error.run` is the run so far.
    MemoryError
        If the samples do not fit into memory.

    Warns
    -----
    ModelWarning
        With the text of `Run.warning`, if there is one: the error is large, the shaft is too fast
        for the formulation, or a harmonic load is too fast for the step.

    Examples
    --------
    >>> import timo_sim
    >>> run = timo_sim.simulate('paper', duration=1.0)
    >>> run.deflection(2.0).shape
    (1001, 2)

    """
    scene, steps = resolve(load_scene(scene), duration)
    sample_every = _EVERY.check(sample_every)
    if steps % sample_every:
        raise ParameterError(
            f'sample_every = {sample_every} must divide the number of steps, {steps}')
    parts = _parts_of_samples(steps, sample_every) if estimate else 1
    with tqdm(total=steps, unit='step', unit_scale=True, delay=1.0, disable=None,
              leave=False) as bar:
        try:
            run = run_scene(scene, steps, sample_every // parts, bar.update, _print)
        except DivergenceError as error:
            error.run = _thin(error.run, parts)
            raise
        except MemoryError:
            raise MemoryError(f'{1 + steps // sample_every} samples do not fit into memory: take '
                              f'sample_every > {sample_every}') from None
        run = _thin(measure_error(run) if estimate else run, parts)
    if run.warning:
        warn(run.warning)
    return run


def _parts_of_samples(steps, sample_every):
    """Return by how much samples are closer in a short run, so that enough are compared."""
    parts = -(-_LEAST_COMPARED * sample_every // max(1, steps))
    return next(k for k in range(min(parts, sample_every), sample_every + 1)
                if sample_every % k == 0)


def _thin(run, every):
    return replace(run, t=run.t[::every], values=run.values[::every],
                   friction_heat=run.friction_heat[::every])


def _print(text):
    print(f'timo_sim: {text}', file=sys.stderr, flush=True)
