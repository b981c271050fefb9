# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
A second, finer run of a scene, which tells how far the first is off.

It has three more modes in bending, one more axial mode, half the step and the `exact` formulation.
Its machine code is that for all sizes, so that nothing is compiled for each: about ten times
slower, which does not matter in the few steps of a run that is looked at unasked.
"""

from dataclasses import replace

import numpy as np

from timo_sim.jit.constants import of_any_size
from timo_sim.runs.sampled import sampled_run
from timo_sim.scene.parameter import ParameterError
from timo_sim.scene.scene import scene_from
from timo_sim.simulation import model_warnings

MORE_MODES, MORE_AXIAL, MOST_AXIAL = 3, 1, 3
PARTS = 2, 8          # of a step; the second where the first diverges
DOUBT = 2e-5          # estimated errors from which on a run is looked at again [lengths]
UNASKED = 2048        # steps of such a run, at most
_LISTS = 'initial.modal_coordinates', 'initial.modal_rates', 'arm.damping_ratio'


def in_doubt(run):
    """Return whether a run that is short enough may be off by more than its estimate says."""
    values, stats = run.scene.values, run.stats
    return bool(values['model.modes']) and stats['steps'] <= UNASKED and (
        values['model.formulation'] != 'exact'  # what a formulation leaves out is not estimated
        or not stats['estimated_tip_error_m'] <= DOUBT * values['arm.length'])


def finer(scene, parts):
    """Return the scene with more modes, a step of so many parts and the `exact` formulation."""
    values = scene.values
    bending, axial = values['model.modes'], values['model.axial_modes']
    more = min(MORE_AXIAL, MOST_AXIAL - axial)
    lists = {name: values[name] for name in _LISTS}
    for name in _LISTS:
        if len(values[name]) > (name == 'arm.damping_ratio'):  # one is for all
            own, stretching = values[name][:bending], values[name][bending:]
            kept = name == 'arm.damping_ratio'  # that of the last mode holds for further ones
            lists[name] = [*own, *MORE_MODES * [kept * own[-1]], *stretching,
                           *more * [kept * (stretching or own)[-1]]]
    return scene_from({**values, **lists, 'model.formulation': 'exact', 'model.accuracy': 0.0,
                       'model.static_modes': 'none',
                       'model.modes': bending + MORE_MODES, 'model.axial_modes': axial + more,
                       'integrator.step': scene.step / parts})


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
        its statistics; as it was, if there is no second run.

    """
    scene, length = run.scene, run.scene.manipulator.arm.length
    # The coordinates of static modes have no meaning in the second run.
    bent = scene.values['model.static_modes'] != 'none' and any(
        any(scene.values[name]) for name in _LISTS[:2])
    if bent or len(run.t) < 2:
        return run
    for parts in PARTS:
        try:
            path = _path(finer(scene, parts), parts, run, tell)
        except model_warnings.DivergenceError:
            continue
        except ParameterError:
            break
        error = float(np.linalg.norm(path - run.position(length), axis=1).max())
        return replace(
            run, stats={**run.stats, 'estimated_tip_error_m': error, 'compared': True},
            warning=model_warnings.after_second_run(scene, error, run.stats, run.warning))
    return run


def _path(scene, parts, run, tell):
    steps, model = parts * run.stats['steps'], scene.build()
    model.pack, model.packed = of_any_size, of_any_size(model.tables)
    second = sampled_run(scene, steps, steps // (len(run.t) - 1), tell=tell)
    return second.position(scene.manipulator.arm.length)
