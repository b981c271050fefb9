# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Measure the error of a run by its distance from a finer run of the scene."""

from dataclasses import replace

from timo_sim.jit.constants import of_any_size
from timo_sim.runs.sampled import sampled_run
from timo_sim.simulation.finer import finer, has_finer, parts_of, tip_distance
from timo_sim.simulation.model_warnings import (
    DivergenceError, inaccurate, MOST_APART, NO_FINER_RUN, unseen_load)

_POINTS = 200  # least number of samples at which the tips of two runs are compared


def samples_between(steps, sample_every):
    """Return into how many parts samples are divided, so that a comparison has enough of them."""
    parts = -(-_POINTS * sample_every // max(1, steps))
    return next(k for k in range(min(parts, sample_every), sample_every + 1)
                if sample_every % k == 0)


def measured(run):
    """
    Return a run with its measured error, and the warning that this calls for.

    If a finer run diverges, one with shorter steps is tried.

    Parameters
    ----------
    run : Run
        Of `sampled_run`.

    Returns
    -------
    Run
        With `estimated_tip_error_m` in `stats`, unless the scene has no finer one or all diverge.

    """
    scene = run.scene
    if not has_finer(scene) or len(run.t) < 2:
        return run
    for parts in parts_of(scene):
        fine = finer(scene, parts)
        error = _distance(run, fine, parts)
        if error is not None:
            break
    else:
        return replace(run, warning=run.warning or NO_FINER_RUN)
    # The finer run has seen a load that is too fast for the steps of the run. What `newton` leaves
    # out may make a motion unstable that both runs do not leave.
    earlier = run.warning if scene.values['model.formulation'] != 'exact' else unseen_load(fine)
    large = error > MOST_APART * scene.manipulator.arm.length
    remedy = _remedy(run, parts, error) if large else None
    return replace(run, stats={**run.stats, 'estimated_tip_error_m': error},
                   warning=earlier or inaccurate(scene, error, remedy))


def _distance(run, fine, parts):
    # The distance of a run's tip from that of a finer scene [m], or None if this diverges.
    steps = parts * run.stats['steps']
    try:
        other = sampled_run(fine, steps, steps // (len(run.t) - 1), pack=of_any_size)
    except DivergenceError:
        return None
    return tip_distance(run.model, run.values, other.model, other.values)


def _remedy(run, parts, error):
    """
    Return a change of the scene that mends most of its error.

    Of steps, modes and equations, in this order, the first one that moves the tip by half of the
    error, else the one that moves it most: axial modes that the steps do not resolve would move it, too.
    """
    scene = run.scene
    own = scene.values['model.formulation']
    changes = {'a smaller integrator.step': (parts, 0, 0, own),
               'more model.modes': (1, None, 0, own)}
    if own == 'exact':
        changes['model.axial_modes 1'] = 1, 0, 1, own
    else:
        changes['model.formulation exact'] = 1, 0, 0, 'exact'
    moved = {}
    for text, change in changes.items():
        moved[text] = _distance(run, finer(scene, *change), change[0]) or 0.0
        if moved[text] > 0.5 * error:
            return text
    return max(moved, key=lambda text: moved[text])
