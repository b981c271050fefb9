# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Publishes the node's health on /diagnostics, once per second of wall time."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.serialization import serialize_message

from timo_sim.ros.loop import Loop, Waiting
from timo_sim.ros.topics import Commands, Outlet, RunLog
from timo_sim.simulation.simulator import Simulator
from timo_sim.topics.cdr import NANOSECONDS

_PERIOD = 1.0  # [s] of wall time
_TWO_CLOCKS = '/clock has another publisher: nodes that use sim time see it jump'
_SILENCE = 5  # periods without a first command, though somebody publishes commands
_SILENT = ('time stands: no command has come yet, although commands have a publisher; with sync: '
           'wait a controller must answer joint_states, since a timer on sim time never begins')


class Health:
    """
    Collects the counters of a node's faults and publishes them; one that has grown is a warning.

    `failed_calls` counts callbacks that raised an exception.
    """

    def __init__(self, node: Node, simulator: Simulator, loop: Loop, commands: Commands,
                 log: RunLog, publishes_clock: bool) -> None:
        self.outlet = Outlet(node, '/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
        self.failed_calls = 0
        self._node, self._simulator, self._loop = node, simulator, loop
        self._commands, self._log, self._publishes_clock = commands, log, publishes_clock
        self._before: dict[str, float] = {}
        self._silent_periods = 0
        self._warnings: list[str] = []  # that hold now

    def start(self, now: float) -> None:
        """Begin to measure the real-time factor at a wall time [s]."""
        self._reported = now, self._simulator.steps

    def counters(self) -> dict[str, float]:
        """Return counters by name, which grow only if something goes wrong."""
        pace = self._loop.pace
        return {
            'overruns': pace.overruns,
            'dropped_time_s': pace.dropped_steps * self._simulator.scene.step,
            'refused_commands': self._commands.count('refused'),
            'stale_commands': self._commands.stale,
            'failed_calls': self.failed_calls,
            'missed_commands': self._loop.gate.missed,
            'mismatched_commands': self._commands.count('mismatched')}

    def report(self, now: float) -> None:
        """Publish the health if a period is over at a wall time [s]."""
        (before, steps), simulator = self._reported, self._simulator
        if now - before < _PERIOD:
            return
        self.start(now)
        self._log.check()
        self.warn()
        if self.outlet.wanted:
            pace = (simulator.steps - steps) * simulator.scene.step / (now - before)
            snapshot = self._loop.snapshot()
            self.outlet.send(serialize_message(self._message(snapshot, pace)), snapshot.step,
                             snapshot.nanoseconds)

    def warn(self) -> None:
        """Find what is wrong with the simulation and other nodes; print what is new."""
        node, gate = self._node, self._loop.gate
        silent = (gate.waits is Waiting.FIRST and not self._loop.paused
                  and self._commands.expected())
        self._silent_periods = self._silent_periods + 1 if silent else 0
        nodes = node.get_node_names_and_namespaces()
        before, self._warnings = self._warnings, [text for text, holds in (
            (self._simulator.warning or '', self._simulator.warning),
            (_TWO_CLOCKS, self._publishes_clock and node.count_publishers('/clock') > 1),
            (f'another node has the name {node.get_fully_qualified_name()}, or had it and was '
             'killed just now', nodes.count((node.get_name(), node.get_namespace())) > 1),
            (_SILENT, self._silent_periods >= _SILENCE)) if holds]
        for text in self._warnings:
            if text not in before:
                node.get_logger().warning(text)

    def _message(self, snapshot, pace):
        counters = self.counters()
        grown = [name for name, count in counters.items() if count > self._before.get(name, 0)]
        self._before = counters
        timing = self._loop.pace.report()
        waits = not pace and self._loop.gate.waiting
        state = ('paused' if self._loop.paused else 'waiting for a command' if waits else
                 'running')
        # The full name tells nodes in different namespaces apart.
        status = DiagnosticStatus(
            name=f'{self._node.get_fully_qualified_name().removeprefix("/")}: simulation',
            hardware_id='timo_sim', level=DiagnosticStatus.OK, message=state)
        errors = [self._loop.diverged, self._log.trouble]
        warnings = [*self._warnings, grown and 'more ' + ', '.join(grown),
                    not {'overruns', 'dropped_time_s'}.isdisjoint(grown) and timing]
        for level, texts in ((DiagnosticStatus.WARN, warnings), (DiagnosticStatus.ERROR, errors)):
            if any(texts):
                status.level = level
                status.message = '; '.join([*[state] * waits, *filter(None, texts)])
        status.values = [KeyValue(key=name, value=str(value)) for name, value in {
            'state': state,
            'sim_time_s': snapshot.nanoseconds / NANOSECONDS,
            'real_time_factor': f'{pace:.4f}',
            'timing': timing,
            'energy_J': snapshot.energy,
            'estimated_tip_error_m': f'{self._simulator.estimated_error:.2g}',
            'estimated_deflection_error_m': f'{self._simulator.estimated_deflection_error:.2g}',
            'log': self._log.path or 'off',
            **counters}.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp.sec, message.header.stamp.nanosec = snapshot.time
        return message
