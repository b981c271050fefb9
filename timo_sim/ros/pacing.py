# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Says when time steps are due: by deadlines on the steady clock, and by waits for commands."""

import math

TICK = 1e-3  # [s] of wall time; shorter steps are done several at a time
AGAIN = 0.2  # [s] of wall time after which a state is published again while time stands


class Pace:
    """
    Paces sim time by wall time and the real-time factor.

    Parameters
    ----------
    step : float
        [s]
    waits : bool
        Whether steps wait for commands, so that late and dropped steps are not counted.

    Attributes
    ----------
    overruns : int
        Ticks that came later than the deadline of the next one.
    dropped_steps : int
        Steps that were given up because they were beyond the catch-up limit.

    """

    def __init__(self, step, waits=False):
        self._step, self._waits = step, waits
        self._factor = None
        self.overruns = 0
        self.dropped_steps = 0

    def set(self, factor, limit, steps, now):
        """Set the real-time factor, 0 for as fast as possible, and the catch-up limit [s]."""
        self._limit = limit
        if factor != self._factor:  # else keep the part of a step that has passed
            self._factor = factor
            self._tick_steps = max(1, math.floor(TICK * factor / self._step))
            self.start(steps, now)

    @property
    def free(self):
        """Whether steps are done as fast as possible."""
        return self._factor == 0.0

    def start(self, steps, now):
        """Count from here: `steps` steps are done at wall time `now` [s], none of them late."""
        self._base_steps, self._base_time = steps, now

    def due(self, steps, now):
        """Return how many steps to do at a wall time [s], given the number done."""
        elapsed = (now - self._base_time) * self._factor / self._step
        # A step is due when the clock reads its deadline: rounding must not delay it by a tick.
        behind = self._base_steps + math.floor(elapsed + 1e-6) - steps
        if behind >= 2 * self._tick_steps:
            self.overruns += not self._waits
        most = max(self._tick_steps, math.floor(self._limit * self._factor / self._step))
        if behind > most:
            self.dropped_steps += 0 if self._waits else behind - most
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

    The run begins with the first command, for which the wait has no limit. The stamp of the state
    that it answers is `late` by a nanosecond, and by one more for each further reset at the same
    step: at time 0 it would otherwise equal the stamp 0 of a command that has none, and after a
    reset the stamp of the state before.

    Where any command is an answer, a wait for the first one also ends once somebody publishes
    commands: a controller manager on sim time sends none before its clock has gone on by a period.

    Parameters
    ----------
    period : int
        Steps from one wait to the next; 0 without lock step.
    patience : float
        Longest wait once the first command has come [s of wall time].
    stamped : bool
        Whether an answer has the stamp of the state; if not, any command is an answer.

    Attributes
    ----------
    missed : int
        Waits that ended without a command.
    first : bool
        Whether the first command since the start or a reset has not come yet.
    left : bool
        Whether time stands because nobody publishes commands any more.

    """

    def __init__(self, period, patience, stamped=True):
        self.period, self._patience, self.stamped = period, patience, stamped
        self.missed = 0
        self._begin, self._late = None, 0
        self.restart(0)

    def restart(self, step):
        """Wait for a first command again, which answers the state at a step."""
        self._passed, self._since, self.first, self.left = None, None, True, False
        self._begin, self._late = step, self._late + 1 if step == self._begin else 1

    def late(self, step):
        """Return how much later than its sim time the state at a step is stamped [ns]."""
        return self._late if self.period and step == self._begin else 0

    @property
    def waiting(self):
        """Whether a step waits."""
        return self._since is not None

    def boundary(self, step):
        """Return whether commands may begin to act at a step."""
        return not self.period or step % self.period == 0

    def answered(self, step):
        """Return the step whose state is answered by commands that come at a step."""
        return -(-step // self.period) * self.period

    def following(self, step):
        """Return the next step at which commands may begin to act, or infinity."""
        return (step // self.period + 1) * self.period if self.period else math.inf

    def __bool__(self):
        return self.period > 0

    def closed(self, step, now, answered, expected):
        """
        Return whether a step must wait at a wall time [s].

        `answered` says whether its command has come, and `expected()` whether anybody publishes
        commands; while nobody does, a wait does not end.
        """
        if step % self.period or step == self._passed:
            return False
        self._since = now if self._since is None else self._since
        if answered:
            self.first = False
        else:
            patience = self._patience if not self.first else math.inf if self.stamped else AGAIN
            if now - self._since < patience:
                return True
            if not expected():
                self._since, self.left = now, not self.first
                return True
            self.missed += not self.first
        self._passed, self._since, self.left = step, None, False
        return False
