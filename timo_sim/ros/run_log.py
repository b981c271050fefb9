# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The log of a node's run, which may be off."""

from datetime import datetime
import os

from timo_sim.log.notes import names_note, START, SUMMARY
from timo_sim.log.recorder import Recorder


class RunLog:
    """
    The log of a run; while it is not open, what is written to it is dropped.

    `error` says why there is no log, why it ends early, that it was moved or that the disk is
    slow; it is also sent to rclpy's logger.
    """

    def __init__(self, logger):
        self._logger, self._recorder, self.error = logger, None, None

    @property
    def path(self):
        """Path of the log, or None without one."""
        return self._recorder and self._recorder.path

    def open(self, path, channels, outlets, note):
        """
        Begin a log with a note, a dictionary; without a path its name has date and time.

        It has `channels`, whose messages `write` takes, and the channels of the outlets, which
        write to it by themselves from now on. If it cannot be opened, `error` says why.
        """
        # ~ comes as it is from parameter files, and from -p in some shells.
        path = os.path.expanduser(path or f'timo_sim_{datetime.now():%Y%m%d_%H%M%S}.mcap')
        outlets = [outlet for outlet in outlets if outlet.logged]
        logged = [*channels, *(outlet.channel for outlet in outlets)]
        try:
            self._recorder = Recorder(path, logged, {START: {**note, **names_note(logged)}})
        except (OSError, ValueError) as error:  # ValueError: a path without a name
            self._fail(f'no log is written to {path}: {error}')
            return
        for index, outlet in enumerate(outlets, start=len(channels)):
            outlet.recorder, outlet.index = self._recorder, index

    def write(self, index, step, nanoseconds, data):
        """Log a serialised message of the channel with this index, at a sim time [ns]."""
        if self._recorder is not None:
            self._recorder.write(index, step, nanoseconds, data)

    def note(self, name, values):
        """Log a metadata record: a name, and a dictionary of str."""
        if self._recorder is not None:
            self._recorder.note(name, values)

    def look(self):
        """Ask the recorder whether the log has ended early or was moved."""
        if self._recorder is not None:
            error = self._recorder.error and f'the log ends early: {self._recorder.error}'
            if (error or self._recorder.warning) not in (None, self.error):
                self._fail(error or self._recorder.warning)

    def close(self, summary):
        """End the log with a summary of the run, a dictionary of str."""
        if self._recorder is not None:
            self._recorder.note(SUMMARY, summary)
            self._recorder.close()
            self.look()

    def _fail(self, error):
        self.error = error
        self._logger.error(error)
