# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The node's loop: does steps in time with the wall clock, applies commands and publishes."""

from collections.abc import Callable
from enum import Enum
import math
import time
from typing import Any

import numpy as np

from timo_sim.ros.topics import Commands, RunLog
from timo_sim.scene.parameters import MOST_STEPS, whole_ratio
from timo_sim.simulation.loads import load_of_commands
from timo_sim.simulation.simulator import Simulator
from timo_sim.simulation.snapshot import Snapshot
from timo_sim.simulation.warnings import DivergenceError
from timo_sim.topics.cdr import NANOSECONDS
from timo_sim.topics.commands import COMMANDED, has_tip_force

_TICK_TIME = 1e-3          # [s] of wall time; shorter steps are done several at a time
_PAUSED_POLL = 0.01   # [s] of wall time between two checks of a paused loop
_COMMAND_POLL = 1e-4  # [s] of wall time between two checks for the command that a step waits for
_PART_OF_WAIT = 0.02  # by which looking for it less often may lengthen a wait
_REPETITION = 0.2     # [s] of wall time after which a state is published again while time stands
_BATCH = 500          # most steps of one compiled call, so that no other thread waits long for it
# In lock step these topics are published at each state that waits for a command, not at a rate.
_ANSWERED = 'rate.joint_states', 'rate.clock'


def sync_steps(values: dict[str, Any], step: float) -> int:
    """Return the steps [s] of a `sync_period`, 0 without lock step, or raise ParameterError."""
    return 0 if values['sync'] == 'free' else whole_ratio(
        'sync_period', values['sync_period'], 'integrator.step', step)


class StateError(Exception):
    """The simulation cannot do what is asked in its present state; the text says why."""


class Loop:
    """
    Advances a simulator until step `end`; its caller must hold the node's lock.

    `values` are the node's parameters, `outlets` the publishers of the topics that are sent at
    steps, `logger` is one of rclpy. `diverged` is None, or says why the simulation diverged; it
    then cannot go on before a reset.
    """

    def __init__(self, simulator: Simulator, values: dict[str, Any], commands: Commands,
                 outlets: list, log: RunLog, logger: Any, end: int) -> None:
        self.simulator, self.end = simulator, end
        period = sync_steps(values, simulator.scene.step)
        self.pace = Pace(simulator.scene.step, waits=period > 0)
        self.gate = Gate(period, values['sync_timeout'])
        self.paused: bool = values['start_paused']
        self.diverged: str | None = None
        self._commands, self._log, self._logger = commands, log, logger
        # /clock first, then the states, which wake the controller, so that it reads the new time.
        self._outlets = sorted(outlets, key=lambda outlet: outlet.name != '/clock') if (
            self.gate.period) else outlets
        self._late = [outlet for outlet in outlets if outlet.delay]
        self._commanded = np.zeros(COMMANDED)
        self._shown_at = -math.inf  # wall time at which the state was published last [s]

    def configure(self, values: dict[str, Any], steps_each: dict[str, int]) -> None:
        """Take parameters that may change at run time, and steps between messages by rate."""
        for outlet in self._outlets:
            outlet.every = self.gate.period if self.gate.period and outlet.rate in _ANSWERED else (
                steps_each[outlet.rate])
        self._timeout_steps = math.ceil(values['command_timeout'] / self.simulator.scene.step)
        self.pace.set(values['real_time_factor'], values['catch_up_limit'],
                      self.simulator.steps, time.monotonic())

    def poll(self) -> None:
        """Receive commands."""
        self._commands.poll(self.gate.answered_stamp(
            self.simulator.steps, self.simulator.scene.step))

    def tick(self, now: float, stop: Any) -> float:
        """Do what is due at a wall time [s]; return the time until something is due again [s]."""
        if self.paused:
            self._show_again(now)
            return _PAUSED_POLL
        free = self.pace.free
        # At most a batch: the rest follows in the next tick, after others have had the lock.
        self._advance(1 if self.gate.waiting else _BATCH if free else min(
            self.pace.due(self.simulator.steps, now), _BATCH), stop)
        if self.gate.waiting:
            return self.gate.poll(now)
        return 0.0 if free else self.pace.deadline(self.simulator.steps) - time.monotonic()

    def _advance(self, count, stop):
        """Do steps; apply commands and publish on the way."""
        simulator = self.simulator
        goal = min(simulator.steps + count, self.end)
        while simulator.steps < goal and not stop.set:
            first = simulator.steps
            if self.gate.period and self._waits(first):
                return
            self._apply_commands(first)
            last = first + 1
            if goal > last and not has_tip_force(self._commanded):
                last = min(goal, first + _BATCH, self._next_event(first))
            try:
                simulator.advance(last - first, load_of_commands(self._commanded, simulator))
            except DivergenceError as error:
                self.diverged, self.paused = str(error), True
                self._logger.error(f'paused, {error}; ~/reset goes back to the start')
                return
            self.publish()

    def _waits(self, step):
        """Return whether a step must wait for the controller's command."""
        now, gate = time.monotonic(), self.gate
        before, stands = gate.waits, (Waiting.FIRST, Waiting.NOBODY)
        gate.look(step, now, self._commands.received, self._commands.expected)
        if gate.waits is Waiting.NOBODY is not before:
            self._logger.warning(f'nobody publishes commands any more: time stands at step {step} '
                                 'until the next command')
        if gate.waiting:
            # Repeated until the controller is there and has received the state it must answer.
            self._show_again(now, everybody=gate.waits in stands)
            return True
        self._shown_at = now
        if before in stands:
            self.pace.start(step, now)  # time begins to run now, or goes on
        return False

    def _show_again(self, now, everybody=False):
        """Send the state again while time stands, to new subscribers and not to the log."""
        if now < self._shown_at + _REPETITION:
            return
        self._shown_at = now
        self.check_subscribers()
        step = self.simulator.steps
        self._send(outlet for outlet in self._outlets
                   if outlet.subscribed and (everybody or outlet.watched_anew(now))
                   # Between its samples a delayed sensor would measure anew, not repeat itself.
                   and (outlet not in self._late or step % outlet.every == 0))

    def _next_event(self, step):
        # The next step at which something is published, or a command may begin or time out.
        events = [step - step % outlet.every + outlet.every for outlet in self._outlets
                  if outlet.wanted]
        events += [outlet.arrival for outlet in self._late]
        events += self._commands.end(self._timeout_steps)
        return max(step + 1, min([*events, self.gate.next_boundary(step)]))

    def _apply_commands(self, step):
        if not self.gate.takes_commands(step):
            return
        for index, data in self._commands.apply(step, self._timeout_steps, self._commanded):
            self._log.write(index, step, self.simulator.nanoseconds, data)

    def publish(self, everything: bool = False) -> None:
        """Send each message that is due at this step, or every one, if somebody wants it."""
        step = self.simulator.steps
        for outlet in self._late:
            outlet.deliver(step, self.simulator.nanoseconds)
        due = [outlet for outlet in self._outlets
               if (everything or step % outlet.every == 0) and outlet.wanted]
        if due:
            snapshot = self.snapshot()
            for outlet in due:
                outlet.publish(snapshot)

    def _show_reached(self):
        """Send the state to subscribers, where it was not due."""
        step = self.simulator.steps
        # In lock step controllers would answer a state that waits for no command.
        if self.gate.takes_commands(step) and not self.diverged:
            self._send(outlet for outlet in self._outlets if outlet.subscribed
                       and step % outlet.every and outlet not in self._late)

    def _send(self, outlets):
        """Publish the present state, to subscribers alone."""
        snapshot = None
        for outlet in outlets:
            snapshot = snapshot or self.snapshot()
            outlet.publish(snapshot, again=True)

    def check_subscribers(self) -> None:
        """Ask who subscribes: a service call may overtake the event of a new subscriber."""
        for outlet in self._outlets:
            outlet.check_subscribers()

    def snapshot(self) -> Snapshot:
        """Return the Snapshot of the present motion, from which messages are made."""
        snapshot = self.simulator.snapshot()
        late = self.gate.stamp_offset(snapshot.step)
        if late:
            snapshot.time = divmod(snapshot.nanoseconds + late, NANOSECONDS)
        return snapshot

    # Operations for the services.

    def pause(self, paused: bool) -> None:
        """Pause, or go on; raise StateError if the simulation has diverged."""
        if not paused:
            self._refuse_diverged()
        self.paused = paused
        if paused:
            self.check_subscribers()
            self._show_reached()
        self.pace.start(self.simulator.steps, time.monotonic())

    def reset(self) -> None:
        """Go back to the initial state, and drop commands and messages under way."""
        self.check_subscribers()
        self.poll()
        self.simulator.reset()
        self._commands.clear(self._commanded)
        self.gate.restart(self.simulator.steps)
        for outlet in self._late:
            outlet.under_way.clear()
        self.diverged = None

    def restart(self) -> None:
        """Publish the state after a reset, and go on from now."""
        self.publish(everything=True)
        self.pace.start(self.simulator.steps, time.monotonic())

    def step(self, count: int, stop: Any) -> str:
        """Do steps while paused; return the step reached, as text, or raise StateError."""
        self._refuse_diverged()
        if not self.paused:
            raise StateError('a step needs a paused simulation: pause it first')
        if count > MOST_STEPS:  # no other call is answered meanwhile
            raise StateError(f'a call does at most {MOST_STEPS} steps, got {count}')
        self.check_subscribers()
        self.poll()
        goal = self.simulator.steps + count
        self._advance(count, stop)
        self._show_reached()
        self._shown_at = time.monotonic()
        reached = f'at step {self.simulator.steps}'
        if self.simulator.steps < goal:
            raise StateError(self.diverged or reached + (
                ', which waits for a command' if self.gate.waiting else ''))
        return reached

    def _refuse_diverged(self):
        if self.diverged:
            raise StateError(f'~/reset is needed first: {self.diverged}')


class Pace:
    """
    Paces sim time by wall time and the real-time factor; `step` is in [s].

    Unless the loop `waits` for commands, it counts `overruns`, ticks later than the deadline of
    the next one, and `dropped_steps`, given up because they were beyond the catch-up limit.
    """

    def __init__(self, step: float, waits: bool = False) -> None:
        self._step, self._waits = step, waits
        self._factor = math.nan  # not set yet
        self.overruns = self.dropped_steps = 0

    def set(self, factor: float, limit: float, steps: int, now: float) -> None:
        """Set the real-time factor, 0 for as fast as possible, and the catch-up limit [s]."""
        self._limit = limit
        if factor != self._factor:  # else keep the part of a step that has passed
            self._factor = factor
            self._tick_steps = max(1, math.floor(_TICK_TIME * factor / self._step))
            self.start(steps, now)

    @property
    def free(self) -> bool:
        """Whether steps are done as fast as possible."""
        return self._factor == 0.0

    def start(self, steps: int, now: float) -> None:
        """Count from here: `steps` steps are done at wall time `now` [s], none of them late."""
        self._base_steps, self._base_time = steps, now

    def due(self, steps: int, now: float) -> int:
        """Return how many steps to do at a wall time [s], given the number done."""
        elapsed = (now - self._base_time) * self._factor / self._step
        # A step is due when the clock reads its deadline: rounding must not delay it by a tick.
        behind = self._base_steps + math.floor(elapsed + 1e-6) - steps
        if behind >= 2 * self._tick_steps and not self._waits:
            self.overruns += 1
        most = max(self._tick_steps, math.floor(self._limit * self._factor / self._step))
        if behind > most:
            self.dropped_steps += 0 if self._waits else behind - most
            self._base_steps -= behind - most
            behind = most
        return max(behind, 0)

    def report(self) -> str:
        """Say whether sim time was lost, and how many ticks were late."""
        lost = self.dropped_steps * self._step
        return (f'{lost:.6g} s of sim time were lost to delays beyond catch_up_limit' if lost else
                'no sim time was lost') + f' ({self.overruns} late ticks)'

    def deadline(self, steps: int) -> float:
        """Return the wall time of the next tick [s]."""
        ahead = steps + self._tick_steps - self._base_steps
        return self._base_time + ahead * self._step / self._factor


class Waiting(Enum):
    """What a step in lock step waits for."""

    NOT = 'nothing'
    FIRST = 'the first command since the start or a reset'
    COMMAND = 'the next command'
    NOBODY = 'the next command, though nobody publishes commands any more'


class Gate:
    """
    Lock step: says when a step must wait for the controller's command, and for which: `waits`.

    The run begins with the first command, which is waited for without limit. Then a wait takes at
    most `timeout` [s of wall time]. An answer has the stamp of the state. The first state after a
    reset is stamped 1 ns late, 2 ns after a second reset at that step, and so on: at time 0 its
    stamp would otherwise be 0, which is that of a command without one.

    `period` is the number of steps from one wait to the next, 0 without lock step. `missed` counts
    waits that ended without a command.
    """

    def __init__(self, period: int, timeout: float) -> None:
        self.period, self._timeout = period, timeout
        self.missed = 0
        self._begin, self._late = 0, 0
        self.restart(0)

    def restart(self, step: int) -> None:
        """Wait for a first command again, which answers the state at a step."""
        self.waits, self._begun = Waiting.NOT, False
        self._passed: int | None = None  # step that has waited
        self._since = 0.0  # wall time at which a wait began [s]
        self._begin, self._late = step, self._late + 1 if step == self._begin else 1

    def stamp_offset(self, step: int) -> int:
        """Return how much later than its sim time the state at a step is stamped [ns]."""
        return self._late if self.period and step == self._begin else 0

    @property
    def waiting(self) -> bool:
        """Whether a step waits."""
        return self.waits is not Waiting.NOT

    def poll(self, now: float) -> float:
        """Return the time from a wall time in a wait to the next look for a command [s]."""
        return min(max(_COMMAND_POLL, _PART_OF_WAIT * (now - self._since)), _PAUSED_POLL)

    def takes_commands(self, step: int) -> bool:
        """Return whether commands may begin to act at a step."""
        return not self.period or step % self.period == 0

    def answered_stamp(self, step: int, size: float) -> int | None:
        """Return the stamp [ns] that answers have at a step, whose `size` is in [s]; None: any."""
        if not self.period:
            return None
        answered = -(-step // self.period) * self.period
        return round(answered * size * 1e9) + self.stamp_offset(answered)

    def next_boundary(self, step: int) -> float:
        """Return the next step at which commands may begin to act, or infinity."""
        return (step // self.period + 1) * self.period if self.period else math.inf

    def look(self, step: int, now: float, answered: bool, expected: Callable[[], bool]) -> None:
        """Find what a step waits for at a wall time [s]; `answered` says that a command came."""
        if step % self.period or step == self._passed:
            return
        self._begun |= answered
        if not answered:
            if not self.waiting:
                self._since = now
                self.waits = Waiting.COMMAND if self._begun else Waiting.FIRST
            if not self._begun or now - self._since < self._timeout:
                return
            if not expected():
                self._since, self.waits = now, Waiting.NOBODY
                return
            self.missed += 1
        self._passed, self.waits = step, Waiting.NOT
