# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
A second, finer run of a scene, which tells how far the first is off.

It has three more modes in bending, one more axial mode, half the step or less and the `exact`
formulation. Its machine code is that for all sizes: slower, but nothing is compiled for each.
Where not even the last try has small errors of its own, it is taken all the same: the distance is
then too large rather than too small, as a rule.
"""

from dataclasses import replace

import numpy as np

from timo_sim.jit.constants import of_any_size
from timo_sim.runs.sampled import sampled_run
from timo_sim.scene.scene import scene_from
from timo_sim.simulation import model_warnings

MORE_MODES, MORE_AXIAL, MOST_AXIAL = 3, 1, 3
# Parts of a step, and the tolerance of steps [lengths], from one try to the next.
TRIES = (2, 0.0), (8, 0.0), (8, 1e-6)
# Steps with dry friction cannot be split, and their own error is not always seen.
DRY_TRIES = (8, 0.0), (32, 0.0)
_OWN = 0.3            # of the distance, at most, is by the steps of the second run itself
DOUBT = 5e-6          # estimated errors from which on a run is looked at again [lengths]
UNASKED = 2048        # steps of such a run, at most
_LISTS = 'initial.modal_coordinates', 'initial.modal_rates', 'arm.damping_ratio'


def in_doubt(run):
    """Return whether a run that is short enough may be off by more than its estimate says."""
    values, error = run.scene.values, run.stats['estimated_tip_error_m']
    return run.stats['steps'] <= UNASKED and (
        # What a formulation leaves out is not estimated; a rigid arm moves alike in all.
        values['model.formulation'] != 'exact' and values['model.modes'] > 0
        or run.warning is not None or not error <= DOUBT * values['arm.length'])


def finer(scene, parts, tolerance=0.0):
    """
    Return the scene with more modes, a step of so many parts and the `exact` formulation.

    The tolerance of steps is that of the scene or, if that is more or none, the given one [m].
    """
    values = scene.values
    bending, axial = values['model.modes'], values['model.axial_modes']
    more = min(MORE_AXIAL, MOST_AXIAL - axial) if bending else 0
    further = MORE_MODES if bending else 0  # a rigid arm is meant to be one
    lists = {name: values[name] for name in _LISTS}
    for name in _LISTS:
        if len(values[name]) > (name == 'arm.damping_ratio'):  # one is for all
            own, stretching = values[name][:bending], values[name][bending:]
            kept = name == 'arm.damping_ratio'  # that of the last mode holds for further ones
            lists[name] = [*own, *further * [kept * (own or stretching)[-1]], *stretching,
                           *more * [kept * (stretching or own)[-1]]]
    return scene_from({**values, **lists, 'model.formulation': 'exact', 'model.accuracy': 0.0,
                       'model.static_modes': 'none',
                       'model.modes': bending + further, 'model.axial_modes': axial + more,
                       'integrator.step': scene.step / parts, 'integrator.tolerance': min(
                           values['integrator.tolerance'] or tolerance,
                           tolerance or values['integrator.tolerance'])})


def compared(run, tell=None):
    """
    Return a run with the error that a second, finer one tells.

    Parameters
    ----------
    run : Run
        Of `sampled_run`.
    tell : function, optional
        See `Simulator.warm_up`.

    Returns
    -------
    Run
        With `estimated_tip_error_m` and the warning as the second run has them, and `compared` in
        its statistics; with a warning if all finer runs diverge; as it was, if there is none.

    """
    scene, length = run.scene, run.scene.manipulator.arm.length
    # The coordinates of static modes have no meaning in the second run.
    bent = scene.values['model.static_modes'] != 'none' and any(
        any(scene.values[name]) for name in _LISTS[:2])
    if bent or len(run.t) < 2:
        return run
    second, error = None, 0.0
    for parts, tolerance in DRY_TRIES if scene.friction.any() else TRIES:
        try:
            second = _run(finer(scene, parts, tolerance * length), parts, run, tell)
        except model_warnings.DivergenceError:
            continue
        error = float(np.linalg.norm(
            second.position(length) - run.position(length), axis=1).max())
        if second.stats['step_error_m'] <= max(_OWN * error, DOUBT * length) and (
                not model_warnings.unseen_load(second.scene)):
            break
    if second is None:
        return replace(run, warning=run.warning or model_warnings.NO_SECOND_RUN)
    return replace(run, stats={**run.stats, 'estimated_tip_error_m': error, 'compared': True},
                   warning=model_warnings.after_second_run(
                       scene, second.scene, error, run.stats, run.warning))


def _run(scene, parts, run, tell):
    steps, model = parts * run.stats['steps'], scene.build()
    model.pack, model.packed = of_any_size, of_any_size(model.tables)
    return sampled_run(scene, steps, steps // (len(run.t) - 1), tell=tell)
