"""The table of a sweep: one row for each run, columns by name."""

import numpy as np

from timo_sim.parameters import ParameterError, PARAMETERS, SCENE
from timo_sim.scene import flatten
from timo_sim.sweep.chunk import SUMMARY


def varied(variations):
    """Return the names of the scene's parameters that variations set, in order of appearance."""
    names = {name: None for variation in variations for name in flatten(variation)}
    return [name for name in names
            if name in PARAMETERS and PARAMETERS[name].scope == SCENE]


def table_of(chunk, names, outcome):
    """
    Return the rows of a chunk.

    Parameters
    ----------
    chunk : Chunk
    names : list of str
        Parameters that have a column.
    outcome : Outcome

    Returns
    -------
    dict of ndarray
        `run`, the parameters, the numbers of `SUMMARY`, `caution` and `reason`.

    """
    table = {'run': chunk.first + np.arange(len(chunk.variations))}
    flat = [flatten(variation) for variation in chunk.variations]
    for name in names:
        table[name] = _cells(PARAMETERS[name], [values.get(name, chunk.scene.values[name])
                                                for values in flat])
    table.update((column.name, outcome.numbers[:, k]) for k, column in enumerate(SUMMARY))
    return {**table, 'caution': np.array(outcome.cautions, dtype=object),
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
    """Return one table of those of all chunks, in their order."""
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
