# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A table of the loads of coming steps: the scene's own, plus those of the actuators."""

import numpy as np

from timo_sim.physics.integrate.global_error import LEAST
from timo_sim.physics.integrate.run_error import CHUNK
from timo_sim.physics.integrate.steps import NO_LOADS
from timo_sim.physics.layout import LOADS, STEP_LOADS

_FEW = 256  # least number of steps tabulated by themselves; fewer as part of a block of CHUNK


class LoadTable:
    """
    Loads of steps; the steps are counted from the start of the scene's own loads.

    Parameters
    ----------
    scene : Scene

    """

    def __init__(self, scene):
        self._load, self._step = scene.load, scene.step
        self._begin, self._block, self._breaks = 0, NO_LOADS, []
        self._room = NO_LOADS

    def at_start(self):
        """Return the scene's own load at its beginning, shape (14,)."""
        return self._load.stages(0, 1, self._step)[0, 0]

    def stages(self, first, count, parts=1, actuators=None):
        """
        Return the loads in parts of steps.

        Parameters
        ----------
        first, count : int
            Number of the first step, and number of steps.
        parts : int
            Number of parts of each step.
        actuators : Actuators, optional
            Their loads are added.

        Returns
        -------
        ndarray, shape (parts count, 4, 14)

        """
        loads = self._own(first, count) if parts == 1 else self._load.stages(
            parts * first, parts * count, self._step / parts)
        return loads if actuators is None else loads + actuators.loads(first, count, parts)

    def tabulate(self, actuators):
        """Return `stages` with actuators, as a function of first, count and parts."""
        return lambda first, count, parts: self.stages(first, count, parts, actuators)

    def _own(self, first, count):
        begin, block = self._begin, self._block
        if not begin <= first <= first + count <= begin + len(block):
            # A node asks for a few steps at a time, so more are tabulated ahead.
            ahead = count if count >= _FEW else CHUNK
            if len(self._room) < ahead:
                self._room = np.zeros((ahead, STEP_LOADS, LOADS))
            begin, block = first, self._load.stages(first, ahead, self._step, self._room)
            self._begin, self._block = begin, block
            self._breaks = self._load.breaks(first, ahead, self._step)
        return block[first - begin:first - begin + count]

    def pieces(self, first, count, actuators=None):
        """
        Divide some steps into pieces whose load is smooth, or that are too short for an estimate.

        Returns
        -------
        list of tuple
            First step, number of steps, whether the load jumps or bends at their beginning, and
            whether the piece is smooth and long enough to estimate its error by defects.

        """
        self._own(first, count)
        breaks = {at for at in self._breaks if first <= at < first + count}
        if actuators is not None:
            breaks.update(actuators.breaks(first, count))
        if not breaks:
            return [(first, count, False, True)]
        edges, pieces = [*sorted({first, *breaks}), first + count], []
        for begin, end in zip(edges, edges[1:]):
            # The last piece counts as long enough, because later steps may continue it.
            smooth = begin not in breaks or end - begin >= LEAST or end == edges[-1]
            if pieces and not smooth and not pieces[-1][3]:
                begin = pieces.pop()[0]
            pieces.append((begin, end - begin, begin in breaks, smooth))
        return pieces


def advance_by_pieces(integration, table, actuators, state, load, first, count, sample_every,
                      sampled, motions, heat):
    """
    Advance a state by steps, in pieces with a smooth load, and estimate the error of each piece.

    Parameters
    ----------
    integration : Steps
    table : LoadTable
    actuators : Actuators or None
    state, load, first, count, sample_every, sampled, motions, heat
        See `Steps.advance`.

    Returns
    -------
    done : int
        Number of steps done; fewer than `count` if the state is no longer finite.
    load : ndarray, shape (14,)
        Load at their end.

    """
    errors, tabulate = integration.errors, table.tabulate(actuators)
    for begin, number, breaks, smooth in table.pieces(first, count, actuators):
        smooth = smooth and integration.keeps_states
        if breaks:
            errors.cut(state, load)
        if not smooth or errors.unseen >= CHUNK:
            errors.look(state, tabulate, begin, 0 if smooth else number)
        end = begin + number
        while begin < end:
            part = min(end - begin, errors.room)
            done, load = integration.advance(state, load, tabulate, begin, part, sample_every,
                                             sampled + begin - first, motions, heat)
            begin += done
            if done < part:
                return begin - first, load
            if not errors.room or not smooth:
                errors.cut(state, load, smooth)
    return count, load
