"""The node `timo_sim`: wiring of simulator, topics, services, clock, diagnostics and log."""

import math
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from rclpy.node import Node
from rclpy.serialization import serialize_message

from timo_sim.log.notes import CHANGE, change_note, Peak, RESET, start_note
from timo_sim.outputs import NANOSECONDS, outputs, Snapshot
from timo_sim.parameters import changed, LATEST, PARAMETERS, SCENE, whole_ratio
from timo_sim.physics.formulation import LOADS
from timo_sim.ros import diagnostics
from timo_sim.ros.commands import Commands
from timo_sim.ros.gate import Gate
from timo_sim.ros.optional import arm_shape, interfaces, live_feed, transforms
from timo_sim.ros.pacing import Pace
from timo_sim.ros.parameters import (
    declare_parameters, on_set, settled_scene, steps_between_messages)
from timo_sim.ros.run_log import RunLog
from timo_sim.ros.services import NotNow, offer_services
from timo_sim.ros.topics import LateOutlet, MESSAGES, MotionOutlet, Outlet
from timo_sim.scene import scene_from
from timo_sim.simulation import DivergenceError, Simulator

# Steps of one compiled call at most, so that no other thread waits long for it.
_BATCH = 500
# How often a paused or sleeping loop looks at its flags [s].
_PAUSED_POLL, _LONGEST_SLEEP = 0.01, 0.1
# The same while a step waits for a command, and how often the first state is shown again [s].
_COMMAND_POLL, _SHOWN_AGAIN = 1e-4, 0.2
_TWO_CLOCKS = 'somebody else publishes /clock, too: whoever uses sim time sees it jump'


class SimNode(Node):
    """
    Integrates a scene in step with the wall clock.

    `run` is called by the main thread, callbacks by the executor's. Both touch the simulation only
    under `_lock`.

    Parameters
    ----------
    stop : StopRequest
    **options
        Of rclpy.node.Node, such as the namespace of one of several nodes in a process.

    Raises
    ------
    ParameterError

    """

    def __init__(self, stop, **options):
        super().__init__('timo_sim', **options)
        self._stop = stop
        self._lock = threading.Lock()
        self._values = declare_parameters(self)
        scene = scene_from(self._values)
        if scene.values['model.accuracy']:
            scene = settled_scene(self, scene, self._values)
        self._step = scene.step
        steps_each = steps_between_messages(self._values, self._step)
        self._end = whole_ratio('duration', self._values['duration'], 'integrator.step',
                                self._step) or math.floor(LATEST / self._step)

        self._simulator = Simulator(scene)
        if not self._simulator.is_compiled:
            self.get_logger().info('compiling once, this takes some seconds')
        self._simulator.warm_up()
        self._held = np.zeros(LOADS)
        self._applied = [0.0] * LOADS
        self._paused = self._values['start_paused']
        self._diverged = None
        self._pace = Pace(self._step)
        self._cautioned = None
        self._log, self._peak = RunLog(self.get_logger()), Peak()
        self._foreign_clock, self.failed_calls = False, 0
        self._shown = -math.inf
        self._health = diagnostics.Health(self.get_fully_qualified_name())

        self._commands = Commands(self, self._values['motor.dc.resistance'] > 0.0)
        self._gate = Gate(self._sync_period(), self._values['sync_timeout'])
        self._outlets = [self._outlet(output) for output in outputs(scene.values['model.modes'])
                         if output.name != '/clock' or self._values['publish_clock']]
        self._late = [outlet for outlet in self._outlets if isinstance(outlet, LateOutlet)]
        if self._values['publish_arm_shape']:
            self._outlets.append(arm_shape(self, self._simulator.formulation))
        if self._values['publish_tf']:
            self._outlets.append(transforms(self))
        self._live = live_feed(scene, self._values['rerun_live'],
                               self.get_fully_qualified_name())
        self._health_outlet = Outlet(self, '/diagnostics', DiagnosticArray)
        self._apply(self._values, steps_each)
        on_set(self, self._values, self._on_parameters)
        offer_services(self)
        interfaces(self)

    @property
    def subscriptions(self):
        """Those that an executor serves: all but the commands."""
        return (entry for entry in super().subscriptions if not entry.raw)

    def _outlet(self, output):
        delay = output.delay and round(self._values[output.delay] / self._step)
        made = self, output, *MESSAGES[output.name]
        outlet = LateOutlet(*made, delay) if delay else MotionOutlet(*made)
        outlet.asks = not output.delay or self._values['record_sensors']
        return outlet

    def open(self):
        """Open the log and show the initial state, before any callback can change it."""
        if self._values['record']:
            self._open_log()
        self._look()
        self._publish()
        # Only now: rclpy's first line of a process takes a tenth of a second.
        if self._log.path:
            self.get_logger().info(f'logging to {self._log.path}')

    def run(self):
        """Advance sim time with wall time until asked to stop."""
        started = time.monotonic()
        self._pace.start(self._simulator.steps, started)
        self._reported = started, self._simulator.steps
        while not self._stop.set and self.context.ok() and self._simulator.steps < self._end:
            with self._lock:
                wait = self._tick()
            # In slices, because a signal does not cut a sleep short.
            time.sleep(min(max(wait, 0.0), _LONGEST_SLEEP))
        self._close(time.monotonic() - started)

    def _tick(self):
        """Do what is due now; return how long nothing will be [s]."""
        now = time.monotonic()
        if now - self._reported[0] >= diagnostics.PERIOD:
            self._diagnose(now)
        self._commands.poll()
        if self._live is not None:
            self._live.offer(now, self._simulator, lambda: self._snapshot().effort)
        if self._paused:
            return _PAUSED_POLL
        free = self._pace.free
        # The rest of what is due comes with the next tick, after whoever waits for the lock.
        self._advance(1 if self._gate.waiting else _BATCH if free else min(
            self._pace.due(self._simulator.steps, now), _BATCH))
        if self._gate.waiting:
            return _COMMAND_POLL
        return 0.0 if free else self._pace.deadline(self._simulator.steps) - time.monotonic()

    def _advance(self, count):
        """Do steps; apply commands and publish on the way."""
        simulator = self._simulator
        goal = min(simulator.steps + count, self._end)
        while simulator.steps < goal and not self._stop.set:
            first = simulator.steps
            if self._gate and self._waits(first):
                return
            self._apply_commands(first)
            last = first + 1
            if goal > last:
                last = min(goal, first + _BATCH, self._next_event(first))
            try:
                simulator.advance(last - first, self._held)
            except DivergenceError as error:
                self._diverged, self._paused = str(error), True
                self.get_logger().error(f'paused, {error}; ~/reset goes back to the start')
                return
            self._applied = simulator.load.tolist()
            self._publish()

    def _waits(self, step):
        """Return whether a step waits for the controller's command."""
        now, first = time.monotonic(), self._gate.first
        closed = self._gate.closed(step, now,
                                   self._commands.answers(self._simulator.nanoseconds))
        if first and not closed:
            self._pace.start(step, now)  # the run begins now
        if closed and self._gate.first and now >= self._shown + _SHOWN_AGAIN:
            # Until the controller is there, and has seen the state that it shall answer.
            self._shown = now
            self._look()
            self._publish(everything=True)
        return closed

    def _sync_period(self):
        if self._values['sync'] == 'free':
            return 0
        return whole_ratio('sync_period', self._values['sync_period'], 'integrator.step',
                           self._step)

    def _next_event(self, step):
        # The next step at which something is published or a command may begin or fall to zero.
        events = [step - step % outlet.every + outlet.every for outlet in self._outlets
                  if outlet.wanted]
        events += [outlet.arrival for outlet in self._late]
        events += self._commands.end(self._timeout_steps)
        return max(step + 1, min([*events, self._gate.following(step)]))

    def _apply_commands(self, step):
        if not self._gate.boundary(step):
            return
        for index, data in self._commands.apply(step, self._timeout_steps, self._held):
            self._log.write(index, step, self._simulator.nanoseconds, data)

    def _publish(self, everything=False):
        """Send each message that is due at this step and wanted by somebody."""
        step = self._simulator.steps
        for outlet in self._late:
            outlet.deliver(step, self._simulator.nanoseconds)
        due = [outlet for outlet in self._outlets
               if (everything or step % outlet.every == 0) and outlet.wanted]
        if due:
            snapshot = self._snapshot()
            for outlet in due:
                outlet.publish(snapshot)

    def _look(self):
        # A service may be served before the news of a subscriber that was there first.
        for outlet in self._outlets:
            outlet.look()

    def _snapshot(self):
        return Snapshot(self._simulator, self._applied)

    def _diagnose(self, now):
        before, steps_before = self._reported
        simulator = self._simulator
        steps = simulator.steps
        self._reported = now, steps
        self._log.look()
        self._pass_on_caution()
        self._look_for_clocks()
        if not self._health_outlet.wanted:
            return
        snapshot = self._snapshot()
        message = self._health.message(
            snapshot, self._counters(),
            facts={
                'state': 'paused' if self._paused else 'running',
                'sim_time_s': snapshot.nanoseconds / NANOSECONDS,
                'real_time_factor': f'{(steps - steps_before) * self._step / (now - before):.4f}',
                'energy_J': snapshot.energy,
                'step_error_m': f'{simulator.control.largest:.2g}',
                'split_steps': simulator.control.splits,
                'log': self._log.path or 'off'},
            errors=[error for error in (self._diverged, self._log.error) if error],
            cautions=[text for text in (
                simulator.caution, self._foreign_clock and _TWO_CLOCKS) if text])
        self._health_outlet.send(serialize_message(message), snapshot.step, snapshot.nanoseconds)

    def _counters(self):
        return {
            'overruns': self._pace.overruns,
            'dropped_time_s': self._pace.dropped_steps * self._step,
            'refused_commands': self._commands.refused,
            'stale_commands': self._commands.stale,
            'failed_calls': self.failed_calls,
            'missed_commands': self._gate.missed,
            'coarse_steps': self._simulator.control.coarse}

    def _pass_on_caution(self):
        if self._simulator.caution != self._cautioned:
            self._cautioned = self._simulator.caution
            if self._cautioned:
                self.get_logger().warning(self._cautioned)

    def _look_for_clocks(self):
        before = self._foreign_clock
        self._foreign_clock = self._values['publish_clock'] and self.count_publishers('/clock') > 1
        if self._foreign_clock and not before:
            self.get_logger().warning(_TWO_CLOCKS)

    # Parameters, called by the executor.

    def survive(self, error):
        """Say that a callback failed, for example rclpy's at a request that makes no sense."""
        self.failed_calls += 1
        self.get_logger().error(f'a callback failed: {error!r}', throttle_duration_sec=5.0)

    def _apply(self, values, steps_each):
        for outlet in self._outlets:
            outlet.every = steps_each[outlet.rate]
        self._timeout_steps = math.ceil(values['command_timeout'] / self._step)
        self._pace.set(values['real_time_factor'], values['catch_up_limit'],
                       self._simulator.steps, time.monotonic())

    def _on_parameters(self, changed):
        values = {**self._values, **changed}
        steps_each = steps_between_messages(values, self._step)
        of_scene = {name: value for name, value in changed.items()
                    if PARAMETERS[name].scope == SCENE}
        scene = self._simulator.scene.vary(of_scene)
        with self._lock:
            self._apply(values, steps_each)
            if of_scene:
                self._simulator.change(scene)
                self._log.note(CHANGE, change_note(self._simulator.steps, of_scene))

    # Operations for the services, called by the executor.

    @property
    def paused(self):
        """Whether time stands."""
        return self._paused

    @property
    def steps(self):
        """Steps done."""
        return self._simulator.steps

    def pause(self, paused):
        """Let time stand, or go on; return what it does; raise NotNow."""
        with self._lock:
            if not paused:
                self._refuse_diverged()
            self._paused = paused
            self._pace.start(self._simulator.steps, time.monotonic())
        return 'paused' if paused else 'running'

    def reset(self):
        """Go back to the initial state; return when, as text."""
        with self._lock:
            self._look()
            self._simulator.reset()
            self._commands.clear(self._held)
            self._gate.restart()
            for outlet in self._late:
                outlet.drop()
            self._applied = [0.0] * LOADS
            self._diverged = None
            self._log.note(RESET, {'step': str(self._simulator.steps)})
            self._publish(everything=True)
            self._pace.start(self._simulator.steps, time.monotonic())
            return f'reset at step {self._simulator.steps}'

    def step(self, count=None):
        """Do so many steps while paused, or `step_count`; return until when; raise NotNow."""
        with self._lock:
            self._refuse_diverged()
            if not self._paused:
                raise NotNow('a step needs a paused simulation')
            self._look()
            self._commands.poll()
            goal = self._simulator.steps + (self._values['step_count'] if count is None else count)
            self._advance(goal - self._simulator.steps)
            reached = f'at step {self._simulator.steps}'
            if self._simulator.steps < goal:
                raise NotNow(self._diverged or reached + (
                    ', which waits for a command' if self._gate.waiting else ''))
        return reached

    def quit(self):
        """End the process, as SIGINT does."""
        self._stop.set = True

    def _refuse_diverged(self):
        if self._diverged:
            raise NotNow(f'~/reset is needed first: {self._diverged}')

    # The log.

    def _open_log(self):
        self._log.open(
            self._values['record_file'], self._commands.channels,
            [*self._outlets, self._health_outlet],
            start_note(self.get_fully_qualified_name(), self._values, changed(self._values),
                       self._simulator.scene))
        for outlet in self._outlets:
            if self._log.path and outlet.name == '~/tip_deflection':
                outlet.watch = self._peak.see

    def _close(self, wall_time):
        self._pass_on_caution()
        if self._live is not None:
            self._live.close()
        sim_time = self._simulator.steps * self._step
        report = (f'simulated {sim_time:.6g} s in {wall_time:.3f} s, {self._pace.overruns} '
                  f'overruns, {self._pace.dropped_steps * self._step:.6g} s dropped')
        self._log.close({**self._peak.note(), **{
            name: str(count) for name, count in self._counters().items()}})
        if self._log.path:
            report += f'; log: {self._log.path}'
        self.get_logger().info(report)
