# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Which time step is due when: deadlines on the steady clock, and waits for a controller."""

import math

TICK = 1e-3  # [s] of wall time; shorter steps are done several at a time


class Pace:
    """
    Sim time against wall time.

    Attributes
    ----------
    overruns : int
        Ticks that came later than the deadline of the next one.
    dropped_steps : int
        Steps that were given up because they were beyond the catch-up limit.

    """

    def __init__(self, step):
        self._step = step
        self._factor = None
        self.overruns = 0
        self.dropped_steps = 0

    def set(self, factor, limit, steps, now):
        """Set the real-time factor, 0 for as fast as possible, and the catch-up limit [s]."""
        self._limit = limit
        if factor != self._factor:  # a new start would cost the part of a step that has passed
            self._factor = factor
            self._tick_steps = max(1, math.floor(TICK * factor / self._step))
            self.start(steps, now)

    @property
    def free(self):
        """Whether sim time does not wait for wall time."""
        return self._factor == 0.0

    def start(self, steps, now):
        """Say that `steps` steps are done at wall time `now` [s], none of them late."""
        self._base_steps, self._base_time = steps, now

    def due(self, steps, now):
        """Return how many steps to do now, given the number done."""
        elapsed = (now - self._base_time) * self._factor / self._step
        # A deadline is met by a clock that reads it: rounding must not cost a tick.
        behind = self._base_steps + math.floor(elapsed + 1e-6) - steps
        if behind >= 2 * self._tick_steps:
            self.overruns += 1
        most = max(self._tick_steps, math.floor(self._limit * self._factor / self._step))
        if behind > most:
            self.dropped_steps += behind - most
            self._base_steps -= behind - most
            behind = most
        return max(behind, 0)

    def deadline(self, steps):
        """Return the wall time of the next tick [s]."""
        ahead = steps + self._tick_steps - self._base_steps
        return self._base_time + ahead * self._step / self._factor


class Gate:
    """
    Lock step: says when a step must wait for the controller's command.

    The first command is waited for as long as it takes: the run begins with it. The stamp of the
    state that it answers is `late`, by 1 ns: at time 0 it would be that of a command without a
    stamp, and after a reset that of another state.

    Parameters
    ----------
    period : int
        Steps from one wait to the next; 0: there is none.
    patience : float
        Of a wait but the first [s of wall time].

    Attributes
    ----------
    missed : int
        Waits that ended without a command.
    first : bool
        Whether no command has come yet.

    """

    def __init__(self, period, patience):
        self._period, self._patience = period, patience
        self.missed = 0
        self._begin, self._late = None, 0
        self.restart(0)

    def restart(self, step):
        """Wait for a first command again, with a state that is shown at a step."""
        self._passed, self._since, self.first = None, None, True
        self._begin, self._late = step, self._late + 1 if step == self._begin else 1

    def late(self, step):
        """Return by how much the stamp of the state at a step is behind its sim time [ns]."""
        return self._late if self._period and step == self._begin else 0

    @property
    def waiting(self):
        """Whether a step waits."""
        return self._since is not None

    def boundary(self, step):
        """Return whether commands begin to act at a step."""
        return not self._period or step % self._period == 0

    def answered(self, step):
        """Return the step whose state is answered by commands that come at a step."""
        return -(-step // self._period) * self._period

    def following(self, step):
        """Return the next step at which commands begin to act, or infinity."""
        return (step // self._period + 1) * self._period if self._period else math.inf

    def __bool__(self):
        return self._period > 0

    def closed(self, step, now, answered):
        """Return whether a step must wait at a wall time [s], `answered` if it has a command."""
        if step % self._period or step == self._passed:
            return False
        self._since = now if self._since is None else self._since
        if not answered:
            if self.first or now - self._since < self._patience:
                return True
            self.missed += 1
        self._passed, self._since, self.first = step, None, False
        return False
