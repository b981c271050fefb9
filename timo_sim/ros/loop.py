# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The node's loop: does steps in time with the wall clock, applies commands and publishes."""

import math
import time

import numpy as np

from timo_sim.messages.commands import acting, COMMANDED, turns
from timo_sim.messages.outputs import NANOSECONDS
from timo_sim.physics.layout import LOADS
from timo_sim.ros.pacing import AGAIN, Gate, Pace
from timo_sim.ros.topics import LateOutlet
from timo_sim.scene.parameter import whole_ratio
from timo_sim.simulation.model_warnings import DivergenceError

# Most steps of one compiled call, so that no other thread waits long for it.
_BATCH = 500
# In lock step these topics are published at each state that waits for a command, not at a rate.
_ANSWERED = 'rate.joint_states', 'rate.clock'
# Time between two looks of a paused loop at its flags [s].
_PAUSED_POLL = 0.01
# Time between two looks for a command while a step waits for one [s].
_COMMAND_POLL = 1e-4


class NotNow(Exception):
    """The simulation cannot do what is asked in its present state; the text says why."""


class Loop:
    """
    Advances a simulator; its caller must hold the node's lock.

    Parameters
    ----------
    simulator : Simulator
    values : dict
        Parameters of the node.
    commands : Commands
    outlets : list of Outlet
        Publishers of the topics that are sent at steps.
    log : RunLog
    logger
        A logger of rclpy.
    end : int
        Step at which the run ends.

    Attributes
    ----------
    diverged : str or None
        Why the simulation diverged; it then stays paused until a reset.

    """

    def __init__(self, simulator, values, commands, outlets, log, logger, end):
        self.simulator, self.end = simulator, end
        period = 0 if values['sync'] == 'free' else whole_ratio(
            'sync_period', values['sync_period'], 'integrator.step', simulator.scene.step)
        self.pace = Pace(simulator.scene.step, waits=period > 0)
        self.gate = Gate(period, values['sync_timeout'], values['sync'] != 'any_command')
        self.paused, self.diverged = values['start_paused'], None
        self._commands, self._log, self._logger = commands, log, logger
        # Where states wake the controller, its clock should be as late as they are; where /clock
        # wakes it, as ros2_control, the states should be there.
        self._outlets = sorted(outlets, key=lambda outlet: outlet.name != '/clock') if (
            self.gate and self.gate.stamped) else outlets
        self._late = [outlet for outlet in outlets if isinstance(outlet, LateOutlet)]
        self._commanded, self._applied = np.zeros(COMMANDED), [0.0] * LOADS
        self._shown_at = -math.inf  # wall time [s]; `AGAIN` after it the state is published again

    def configure(self, values, steps_each):
        """Take parameters that may change at run time, and steps between messages by rate."""
        for outlet in self._outlets:
            outlet.every = self.gate.period if self.gate and outlet.rate in _ANSWERED else (
                steps_each[outlet.rate])
        self._timeout_steps = math.ceil(values['command_timeout'] / self.simulator.scene.step)
        self.pace.set(values['real_time_factor'], values['catch_up_limit'],
                      self.simulator.steps, time.monotonic())

    def poll(self):
        """Receive commands."""
        answered = None
        if self.gate and self.gate.stamped:
            step = self.gate.answered(self.simulator.steps)
            answered = round(step * self.simulator.scene.step * 1e9) + self.gate.late(step)
        self._commands.poll(answered)

    def tick(self, now, stop):
        """Do what is due at a wall time [s]; return the time until something is due again [s]."""
        if self.paused:
            self._show_again(now)
            return _PAUSED_POLL
        free = self.pace.free
        # At most a batch: the rest follows in the next tick, after others have had the lock.
        self._advance(1 if self.gate.waiting else _BATCH if free else min(
            self.pace.due(self.simulator.steps, now), _BATCH), stop)
        if self.gate.waiting:
            return _COMMAND_POLL
        return 0.0 if free else self.pace.deadline(self.simulator.steps) - time.monotonic()

    def _advance(self, count, stop):
        """Do steps; apply commands and publish on the way."""
        simulator = self.simulator
        goal = min(simulator.steps + count, self.end)
        while simulator.steps < goal and not stop.set:
            first = simulator.steps
            if self.gate and self._waits(first):
                return
            self._apply_commands(first)
            last = first + 1
            if goal > last and not turns(self._commanded):
                last = min(goal, first + _BATCH, self._next_event(first))
            try:
                simulator.advance(last - first, acting(self._commanded, simulator))
            except DivergenceError as error:
                self.diverged, self.paused = str(error), True
                self._logger.error(f'paused, {error}; ~/reset goes back to the start')
                return
            self._applied = simulator.load.tolist()
            if not self.gate.stamped and self.gate.boundary(simulator.steps):
                # A command that came before this state is published acts, but does not answer it.
                self.poll()
                self._commands.received = False
            self.publish()

    def _waits(self, step):
        """Return whether a step must wait for the controller's command."""
        now, gate = time.monotonic(), self.gate
        stood, left = gate.first or gate.left, gate.left
        closed = gate.closed(step, now, self._commands.received, self._commands.expected)
        if stood and not closed:
            self.pace.start(step, now)  # time begins to run now, or goes on
        if gate.left and not left:
            self._logger.warning(f'nobody publishes commands any more: time stands at step {step} '
                                 'until the next command')
        if closed:
            # Repeated until the controller is there and has received the state it must answer.
            self._show_again(now, everybody=gate.first or gate.left)
        else:
            self._shown_at = now
        return closed

    def _show_again(self, now, everybody=False):
        """Send the state again while time stands, to new subscribers and not to the log."""
        if now < self._shown_at + AGAIN:
            return
        self._shown_at = now
        self.look()
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
        return max(step + 1, min([*events, self.gate.following(step)]))

    def _apply_commands(self, step):
        if not self.gate.boundary(step):
            return
        for index, data in self._commands.apply(step, self._timeout_steps, self._commanded):
            self._log.write(index, step, self.simulator.nanoseconds, data)

    def publish(self, everything=False):
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
        """Send the state at which time begins to stand to subscribers, if it was not due."""
        step = self.simulator.steps
        # In lock step controllers would answer a state that waits for no command.
        if self.gate.boundary(step) and not self.diverged:
            self._send(outlet for outlet in self._outlets
                       if outlet.subscribed and step % outlet.every and outlet not in self._late)

    def _send(self, outlets):
        """Publish the present state, to subscribers alone."""
        snapshot = None
        for outlet in outlets:
            snapshot = snapshot or self.snapshot()
            outlet.publish(snapshot, again=True)

    def look(self):
        """Ask who subscribes: a service call may overtake the event of a new subscriber."""
        for outlet in self._outlets:
            outlet.look()

    def snapshot(self):
        """Return the Snapshot of the present motion, from which messages are made."""
        snapshot = self.simulator.snapshot(self._applied)
        late = self.gate.late(snapshot.step)
        if late:
            snapshot.time = divmod(snapshot.nanoseconds + late, NANOSECONDS)
        return snapshot

    # Operations for the services.

    def pause(self, paused):
        """Pause, or go on; raise NotNow if the simulation has diverged."""
        if not paused:
            self._refuse_diverged()
        self.paused = paused
        if paused:
            self.look()
            self._show_reached()
        self.pace.start(self.simulator.steps, time.monotonic())

    def reset(self):
        """Go back to the initial state, and drop commands and messages under way."""
        self.look()
        self.poll()
        self.simulator.reset()
        self._commands.clear(self._commanded)
        self.gate.restart(self.simulator.steps)
        for outlet in self._late:
            outlet.drop()
        self._applied, self.diverged = [0.0] * LOADS, None

    def restart(self):
        """Publish the state after a reset, and go on from now."""
        self.publish(everything=True)
        self.pace.start(self.simulator.steps, time.monotonic())

    def step(self, count, stop):
        """Do steps while paused; return the step reached, as text, or raise NotNow."""
        self._refuse_diverged()
        if not self.paused:
            raise NotNow('a step needs a paused simulation')
        self.look()
        self.poll()
        goal = self.simulator.steps + count
        self._advance(count, stop)
        self._show_reached()
        self._shown_at = time.monotonic()
        reached = f'at step {self.simulator.steps}'
        if self.simulator.steps < goal:
            raise NotNow(self.diverged or reached + (
                ', which waits for a command' if self.gate.waiting else ''))
        return reached

    def _refuse_diverged(self):
        if self.diverged:
            raise NotNow(f'~/reset is needed first: {self.diverged}')
