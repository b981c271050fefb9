# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Measure the error of a run by its distance from a second, finer run of the scene.

The second run has three more bending modes, one more axial mode, half the step or less and the
`exact` formulation. Unless it is long, it uses machine code for any number of modes: three times
slower, but nothing has to be compiled. If even the last try has a large error of its own, it is
used all the same: as a rule the distance is then too large, not too small.
"""

from dataclasses import replace
import math

import numpy as np

from timo_sim.jit.constants import of_any_size
from timo_sim.runs.sampled import sampled_run
from timo_sim.scene.scene import scene_from
from timo_sim.simulation import model_warnings

MORE_MODES, MORE_AXIAL, MOST_AXIAL = 3, 1, 3
TRIES = 2, 8, 32   # parts of a step
DRY_TRIES = 8, 32  # with dry friction, whose own estimate can miss errors
_OWN_SHARE = 0.3      # largest part of the distance that steps of the second run may cause
DOUBT = 5e-6          # estimated error above which a run is compared [arm lengths]
COMPILED = 300_000    # steps from which on a second run saves more time than compilation takes
_POINTS = 200         # least number of samples at which the tips of two runs are compared
_LISTS = 'initial.modal_coordinates', 'initial.modal_rates', 'arm.damping_ratio'


def in_doubt(run):
    """Return whether the error of a run is large or uncertain."""
    values, error = run.scene.values, run.stats['estimated_tip_error_m']
    return (
        # The error of a formulation itself is not estimated; with a rigid arm all are the same.
        values['model.formulation'] != 'exact' and values['model.modes'] > 0
        or run.warning is not None or not error <= DOUBT * values['arm.length']
        or _unresolved_axial_vibration(run.scene))


def samples_between(steps, sample_every):
    """Return into how many parts samples are divided, so that a comparison has enough of them."""
    parts = -(-_POINTS * sample_every // max(1, steps))
    return next(k for k in range(min(parts, sample_every), sample_every + 1)
                if sample_every % k == 0)


def _unresolved_axial_vibration(scene):
    """Return whether steps, whose estimated error then misses it, exceed half of its period."""
    axial = scene.values['model.axial_modes']
    if not axial:
        return False
    return scene.step * scene.build().modes.omega[-axial:].min() > math.pi


def finer(scene, parts):
    """Return the scene with more modes, its step divided by `parts`, and `exact` equations."""
    values = scene.values
    bending, axial = values['model.modes'], values['model.axial_modes']
    more = min(MORE_AXIAL, MOST_AXIAL - axial) if bending else 0
    further = MORE_MODES if bending else 0  # a rigid arm stays rigid
    lists = {name: values[name] for name in _LISTS}
    for name in _LISTS:
        if len(values[name]) > (name == 'arm.damping_ratio'):  # a single ratio is for all modes
            own, stretching = values[name][:bending], values[name][bending:]
            kept = name == 'arm.damping_ratio'  # further modes have the ratio of the last one
            lists[name] = [*own, *further * [kept * (own or stretching)[-1]], *stretching,
                           *more * [kept * (stretching or own)[-1]]]
    return scene_from({**values, **lists, 'model.formulation': 'exact', 'model.accuracy': 0.0,
                       'model.static_modes': 'none',
                       'model.modes': bending + further, 'model.axial_modes': axial + more,
                       'integrator.step': scene.step / parts})


def compared(run, tell=None):
    """
    Return a run with its error, measured by a second, finer run.

    Parameters
    ----------
    run : Run
        Of `sampled_run`.
    tell : function, optional
        See `Simulator.warm_up`.

    Returns
    -------
    Run
        With `compared` in `stats`, the measured `estimated_tip_error_m`, and the warning that this
        calls for. If all finer runs diverge, with a warning only; without a second run, unchanged.

    """
    scene, length = run.scene, run.scene.manipulator.arm.length
    # The coordinates of static modes have no meaning in the second run.
    bent = scene.values['model.static_modes'] != 'none' and any(
        any(scene.values[name]) for name in _LISTS[:2])
    if bent or len(run.t) < 2:
        return run
    second, error = None, 0.0
    for parts in DRY_TRIES if scene.friction.any() else TRIES:
        try:
            second = _run(finer(scene, parts), parts, run, tell)
        except model_warnings.DivergenceError:
            continue
        error = float(np.linalg.norm(
            second.position(length) - run.position(length), axis=1).max())
        if scene.values['end_effector.pick_up'] == 'at_rest' and scene.payloads:
            # Few more modes show little of what an impact does to those beyond them.
            error = max(error, run.stats['step_error_m'])
        if second.stats['step_error_m'] <= max(_OWN_SHARE * error, DOUBT * length) and (
                not model_warnings.unseen_load(second.scene)):
            break
    if second is None:
        return replace(run, warning=run.warning or model_warnings.NO_SECOND_RUN)
    return replace(run, stats={**run.stats, 'estimated_tip_error_m': error, 'compared': True},
                   warning=model_warnings.after_second_run(
                       scene, second.scene, error, run.stats, run.warning))


def _run(scene, parts, run, tell):
    steps = parts * run.stats['steps']
    return sampled_run(scene, steps, steps // (len(run.t) - 1), tell=tell,
                       pack=None if steps > COMPILED else of_any_size)
