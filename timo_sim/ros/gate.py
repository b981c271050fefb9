# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Lock step: the simulation waits, each control period, for the controller's command."""

import math


class Gate:
    """
    Says when a step must wait.

    The first command is waited for as long as it takes: the run begins with it.

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
        self.restart()

    def restart(self):
        """Wait for a first command again."""
        self._passed, self._since, self.first = None, None, True

    @property
    def waiting(self):
        """Whether a step waits."""
        return self._since is not None

    def __bool__(self):
        return self._period > 0

    def boundary(self, step):
        """Return whether commands begin to act at a step."""
        return not self._period or step % self._period == 0

    def following(self, step):
        """Return the next step at which commands begin to act, or infinity."""
        return (step // self._period + 1) * self._period if self._period else math.inf

    def closed(self, step, now, answered):
        """
        Return whether a step must wait; for a gate with a period.

        Parameters
        ----------
        step : int
        now : float
            Wall time, steady [s].
        answered : bool
            Whether a command for this step has arrived.

        """
        if step % self._period or step == self._passed:
            return False
        self._since = now if self._since is None else self._since
        if not answered:
            if self.first or now - self._since < self._patience:
                return True
            self.missed += 1
        self._passed, self._since, self.first = step, None, False
        return False
