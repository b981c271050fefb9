# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The table of a sweep: one row for each run, columns by name."""

import numpy as np

from timo_sim.scene.files import flatten
from timo_sim.scene.parameter import ParameterError, SCENE
from timo_sim.scene.parameters import PARAMETERS
from timo_sim.sweep.jobs import SUMMARY


def varied(variations):
    """Return the names of the scene's parameters that variations set, in order of appearance."""
    names = {name: None for variation in variations for name in flatten(variation)}
    return [name for name in names
            if name in PARAMETERS and PARAMETERS[name].scope == SCENE]


def table_of(job, names, outcome):
    """
    Return the rows of a job.

    Parameters
    ----------
    job : Job
    names : list of str
        Parameters that have a column.
    outcome : Outcome

    Returns
    -------
    dict of ndarray
        `run`, the parameters, the numbers of `SUMMARY`, `warning` and `reason`.

    """
    table = {'run': job.first + np.arange(len(job.variations))}
    flat = [flatten(variation) for variation in job.variations]
    for name in names:
        table[name] = _cells(PARAMETERS[name], [values.get(name, job.scene.values[name])
                                                for values in flat])
    table.update((column.name, outcome.numbers[:, k]) for k, column in enumerate(SUMMARY))
    return {**table, 'warning': np.array(outcome.warnings, dtype=object),
            'reason': np.array(outcome.reasons, dtype=object)}


def _cells(parameter, values):
    # A value that breaks its rule is missing: NaN or None; the reason of its row names it.
    cells = []
    for value in values:
        try:
            cells.append(parameter.check(value))
        except ParameterError:
            cells.append(None)
    kind = type(parameter.default)
    if kind is float:
        return np.array(cells, dtype=float)
    if kind is int and None not in cells:
        return np.array(cells)
    column = np.empty(len(cells), dtype=object)
    column[:] = cells
    return column


def joined(tables):
    """Return one table of those of all jobs, in their order."""
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
