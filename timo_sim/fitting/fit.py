# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The function `fit`: output-error least squares of a scene's parameters to a record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
import time
from typing import Any

from timo_sim.fitting.assess import result_of
from timo_sim.fitting.files import read_record
from timo_sim.fitting.from_log import read_log
from timo_sim.fitting.problem import Problem
from timo_sim.fitting.record import Record
from timo_sim.fitting.result import Fit
from timo_sim.fitting.search import LOSSES, Search
from timo_sim.fitting.tables import SUFFIXES
from timo_sim.scene.parameter import Parameter, ParameterError, short, warn
from timo_sim.scene.scene import load_scene, SceneLike

_HOLD_OUT = Parameter('hold_out', 0.0, '', '', low=0.0, high=0.95)
_WINDOW = Parameter('window', 1.0, 's', '', low=0.0, open_low=True)


def fit(scene: SceneLike | None, record: Record | str | Path, free: Sequence[str],
        bounds: Mapping[str, Sequence[float]] | None = None, hold_out: float = 0.0,
        window: float | None = None, loss: str = 'linear',
        mapping: str | Path | Mapping[str, Any] | None = None) -> Fit:
    """
    Fit parameters of a scene to a measured record.

    The inputs of the record act on the scene, and the free parameters are those for which the
    outputs of the run are closest to the measured ones, by least squares of residuals in standard
    deviations of each sensor. These are estimated, too, if the record does not give them.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes, or None
        Its values of the free parameters are first guesses. None: the scene of a log of the node.
    record : Record, str or Path
        A Record; a log or bag of the node; or a table: CSV or other text, Parquet, MAT.
        A text whose name ends otherwise needs a mapping.
    free : sequence of str
        Names of parameters of the scene that are numbers, with [k] for an element of a list;
        QUANTITY.gain, .bias or .delay of an input or output of the record, such as shaft.bias, and
        .lag of an output; or `initial` for the whole initial state.
    bounds : dict, optional
        (low, high) by name, within the parameter's own rule.
    hold_out : float
        Part of the record, at its end, that is not fitted but predicted, 0 to 0.95.
    window : float, optional
        Fit windows of about this length, each with an initial state of its own [s]. For arms
        whose long runs depend too much on details, such as those of dry friction. What is held
        out is predicted by one run from the beginning all the same.
    loss : str
        `linear`, or `soft_l1`, `huber` or `cauchy`, with which outliers weigh less.
    mapping : str, Path or dict, optional
        Which column of a table is which quantity, see doc/fit.md.

    Returns
    -------
    Fit

    Raises
    ------
    ParameterError
        If names, bounds, mapping or record are not valid, or the first guess cannot be run.

    Warns
    -----
    ModelWarning
        With `Fit.warnings`, if there are any.

    Examples
    --------
    >>> import numpy as np, timo_sim
    >>> truth = timo_sim.load_scene('paper', {'motor.viscous_friction': 0.5})
    >>> run = timo_sim.simulate(truth, 2.0)
    >>> noise = 1e-4 * np.random.default_rng(1).standard_normal(len(run.t))
    >>> record = timo_sim.Record.of({}, {'shaft': (run.t, run.shaft + noise)})
    >>> found = timo_sim.fit(truth.vary({'motor.viscous_friction': 1.0}), record,
    ...                      ['motor.viscous_friction'])
    >>> abs(found.values['motor.viscous_friction'] - 0.5) < 0.01
    True

    """
    hold_out = _HOLD_OUT.check(hold_out)
    window = None if window is None else _WINDOW.check(window)
    if loss not in LOSSES:
        raise ParameterError(f'loss must be one of {", ".join(LOSSES)}, got {short(loss)}')
    if isinstance(free, str) or not all(isinstance(name, str) for name in free):
        raise ParameterError(f'free must be a list of names, got {short(free)}')
    start, measured = read(scene, record, mapping)
    begun, until = time.monotonic(), (1.0 - hold_out) * measured.duration
    problem = Problem(start, measured, list(free), dict(bounds or {}), until, window)
    search = Search(problem, loss)
    search.do()
    found = result_of(problem, search.x[:len(problem.free)], search.first_state(),
                      search.deviations, search.derivatives(), search.against,
                      time.monotonic() - begun)
    if found.warnings:
        warn('; '.join(found.warnings))
    return found


def read(scene, record, mapping=None):
    """Return the Scene and the Record of a fit, see there."""
    if isinstance(record, Record):
        if scene is None:
            raise ParameterError('scene must be given with a Record')
        return load_scene(scene), record
    if Path(record).suffix in SUFFIXES or mapping is not None:
        if scene is None:
            raise ParameterError(f'scene must be given with {record}, which has none')
        return load_scene(scene), read_record(record, mapping)
    given = None if scene is None else load_scene(scene)
    found, record = read_log(record, given)
    return given or found, record
