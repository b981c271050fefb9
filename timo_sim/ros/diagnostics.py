# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The node's health, once per second of wall time, on /diagnostics."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

TYPE_NAME = 'diagnostic_msgs/msg/DiagnosticArray'
PERIOD = 1.0  # [s] of wall time


class Health:
    """
    Turns counters into a level: what has grown since the last report is a warning.

    Parameters
    ----------
    node : str
        Its fully qualified name, by which nodes in namespaces are told apart.

    """

    def __init__(self, node):
        self._name, self._before = node.removeprefix('/'), {}

    def message(self, snapshot, counters, facts, errors, warnings=()):
        """
        Build the message.

        Parameters
        ----------
        snapshot : Snapshot
        counters : dict
            Numbers that only grow when something is wrong, by name.
        facts : dict
            Further values by name.
        errors : list of str
            What is wrong now, if anything.
        warnings : list of str, optional
            Why the results should not be trusted.

        Returns
        -------
        DiagnosticArray

        """
        grown = [name for name, count in counters.items() if count > self._before.get(name, 0)]
        self._before = dict(counters)
        status = DiagnosticStatus(name=f'{self._name}: simulation', hardware_id='timo_sim')
        warnings = [*warnings, *(['more ' + ', '.join(grown)] if grown else [])]
        if errors:
            status.level, status.message = DiagnosticStatus.ERROR, '; '.join(errors)
        elif warnings:
            status.level, status.message = DiagnosticStatus.WARN, '; '.join(warnings)
        else:
            status.level, status.message = DiagnosticStatus.OK, facts['state']
        status.values = [KeyValue(key=name, value=str(value))
                         for name, value in {**facts, **counters}.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp.sec, message.header.stamp.nanosec = snapshot.time
        return message
