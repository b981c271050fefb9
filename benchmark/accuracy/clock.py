# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Mend the clock of the sweeps of Delft: `python -m benchmark.accuracy.clock FILE.csv ...`.

Their times are counts of samples of 1 ms, but the sampler pauses every 62 ms, mostly for 1.5 ms
and each fifth time for 6.3 ms. The cart moves on meanwhile, with the last voltage: from one
sample to the next it goes several times as far as before and after. A pause is seen where the cart
moves fast enough; elsewhere it is put where the rhythm has it. Each FILE_clock.csv has the true
times; all else is as it was.
"""

from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from benchmark.report import parser

SAMPLE = 1e-3          # [s]
SLOWEST = 15e-6        # way of the cart in a sample, below which no pause can be seen [m]
LEAST, LONG = 0.6, 3.5  # pause that is one, and that is a long one [samples]
EVERY, AFTER_LONG, LONGS = 61, 55, 5  # samples between pauses; each fifth is long
USUAL = 1.5, 6.3       # pauses that are not seen [samples]
NEAR = 9               # samples between a pause and where the rhythm has it


def pauses(x):
    """Return how long the sampler pauses after each sample of the cart's place, (n - 1,) [s]."""
    ways = np.diff(x)
    near = np.delete(sliding_window_view(ways, 9), 4, axis=1).mean(axis=1)
    slow = np.abs(near) < SLOWEST
    seen = np.pad(np.where(slow, 0.0, ways[4:-4] / np.where(slow, 1.0, near) - 1.0), 4)
    seen[seen < np.maximum(LEAST, np.maximum(np.roll(seen, 1), np.roll(seen, -1)))] = 0.0
    found = np.where(seen > LONG, seen, 0.0)
    place, count = int(np.flatnonzero(found)[0]), 0
    while place + EVERY + NEAR < len(ways):
        place += EVERY if count else AFTER_LONG
        count = (count + 1) % LONGS
        around = np.arange(place - NEAR, place + NEAR + 1)
        best = around[np.argmax(seen[around])]
        if seen[best]:
            place, found[best] = int(best), seen[best]
            count = 0 if seen[best] > LONG else count
        else:
            found[place] = USUAL[count == 0]
    return SAMPLE * found


def mend(path):
    """Write the file beside a CSV file that has its true times; return its path."""
    path = Path(path)
    table = np.loadtxt(path, delimiter=',')
    table[1:, 0] += np.cumsum(pauses(table[:, 2]))
    result = path.with_name(f'{path.stem}_clock.csv')
    np.savetxt(result, table, '%.9g', delimiter=',')
    return result


if __name__ == '__main__':
    arguments = parser(__spec__, __doc__)
    arguments.add_argument('files', nargs='+')
    for file in arguments.parse_args().files:
        print(mend(file))
