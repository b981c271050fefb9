# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""SIGINT and SIGTERM as a clean end, from the first line of `main` to its last."""

import os
import signal
import sys


class StopRequest:
    """
    Catches SIGINT and SIGTERM, in a way that fits how far the process has come.

    While modules are imported nothing needs an end, and an exception could surface as a failed
    import: the process just ends. While the node is `building` (it may compile for seconds)
    SystemExit(0) unwinds it; where Python must swallow that, in a callback of C code, `set` is
    seen as soon as the node runs. Once it is `running`, `set` is for its loop to see; further
    signals change nothing, so they cannot break the cleaning up.
    """

    def __init__(self):
        self.set = False
        self._handler = lambda: os._exit(0)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def building(self):
        """Say that all imports are done."""
        self._handler = _unwind
        sys.unraisablehook = _ignore_exit

    def running(self):
        """Say that a loop looks at `set` from now on."""
        self._handler = _leave_to_loop

    def finished(self):
        """Say that only the interpreter's own end is left: it would undo a handler, not this."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)

    def _handle(self, number, frame):
        first, self.set = not self.set, True
        if first:
            self._handler()


def _unwind():
    raise SystemExit(0)


def _ignore_exit(unraisable):
    if not isinstance(unraisable.exc_value, SystemExit):
        sys.__unraisablehook__(unraisable)


def _leave_to_loop():
    pass
