# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The node `timo_sim`: wiring of loop, topics, services, diagnostics and log."""

import math
import threading
import time

from rclpy.node import Node
from rclpy.serialization import serialize_message

from timo_sim.log.notes import CHANGE, change_note, Peak, RESET, start_note
from timo_sim.messages.outputs import NANOSECONDS, outputs
from timo_sim.ros import diagnostics
from timo_sim.ros.commands import Commands
from timo_sim.ros.loop import Loop
from timo_sim.ros.optional import arm_shape, interfaces, live, transforms
from timo_sim.ros.parameters import (
    declare_parameters, on_set, resolved_scene, steps_between_messages)
from timo_sim.ros.run_log import RunLog
from timo_sim.ros.services import offer_services
from timo_sim.ros.topics import LateOutlet, MotionOutlet, Outlet
from timo_sim.scene.parameter import LATEST, SCENE, whole_ratio
from timo_sim.scene.parameters import changed, PARAMETERS
from timo_sim.scene.plausibility import implausible
from timo_sim.scene.scene import scene_from
from timo_sim.simulation.simulator import Simulator

_LONGEST_SLEEP = 0.1  # [s] after which a sleeping node looks at its flags
_TWO_CLOCKS = 'somebody else publishes /clock, too: whoever uses sim time sees it jump'


class SimNode(Node):
    """
    Integrates a scene in step with the wall clock.

    `run` is called by the main thread, callbacks by the executor's. Both touch the simulation only
    under `_lock`.

    Parameters
    ----------
    stop : StopRequest
    live_feed : function(Scene, str, str) -> object, optional
        For a scene, the address of a viewer and the name of the node returns what streams to it:
        its `offer(now, simulator, effort)` is called at each tick, its `close()` at the end.
    **options
        Of rclpy.node.Node, such as the namespace of one of several nodes in a process.

    Raises
    ------
    ParameterError

    """

    def __init__(self, stop, live_feed=None, **options):
        super().__init__('timo_sim', **options)
        self._stop = stop
        self._lock = threading.Lock()
        self._values = declare_parameters(self)
        scene = scene_from(self._values)
        if scene.values['model.accuracy']:
            scene = resolved_scene(self, scene, self._values)
        doubts = implausible(scene.values)
        if doubts:
            self.get_logger().warning(doubts)
        self._step = scene.step
        steps_each = steps_between_messages(self._values, self._step)
        end = whole_ratio('duration', self._values['duration'], 'integrator.step',
                          self._step) or math.floor(LATEST / self._step)

        self._simulator = Simulator(scene)
        self._simulator.warm_up(self.get_logger().info, messages=True)
        self._warned = None
        self._log, self._peak = RunLog(self.get_logger()), Peak()
        self._foreign_clock, self.failed_calls = False, 0
        self._health = diagnostics.Health(self.get_fully_qualified_name())

        self._commands = Commands(self, self._values['motor.dc.resistance'] > 0.0)
        self._outlets = self._made_outlets(scene)
        self._loop = Loop(self._simulator, self._values, self._commands, self._outlets, self._log,
                          self.get_logger(), end)
        self._live = live(live_feed, scene, self._values['rerun_live'],
                          self.get_fully_qualified_name())
        self._health_outlet = Outlet(self, '/diagnostics', diagnostics.TYPE_NAME)
        self._loop.configure(self._values, steps_each)
        on_set(self, self._values, self._on_parameters)
        offer_services(self)
        interfaces(self)

    @property
    def subscriptions(self):
        """Those that an executor serves: all but the commands."""
        return (entry for entry in super().subscriptions if not entry.raw)

    def _made_outlets(self, scene):
        outlets = [self._outlet(output) for output in outputs(scene.modal_count)
                   if output.name != '/clock' or self._values['publish_clock']]
        if self._values['publish_arm_shape']:
            outlets.append(arm_shape(self, self._simulator.model))
        if self._values['publish_tf']:
            outlets.append(transforms(self))
        return outlets

    def _outlet(self, output):
        delay = output.delay and round(self._values[output.delay] / self._step)
        outlet = LateOutlet(self, output, delay) if delay else MotionOutlet(self, output)
        outlet.asks = not output.delay or self._values['record_sensors']
        return outlet

    def open(self):
        """Open the log and show the initial state, before any callback can change it."""
        if self._values['record']:
            self._open_log()
        self._loop.look()
        self._loop.publish()
        # Only now: rclpy's first line of a process takes a tenth of a second.
        if self._log.path:
            self.get_logger().info(f'logging to {self._log.path}')

    def run(self):
        """Advance sim time with wall time until asked to stop."""
        started, loop = time.monotonic(), self._loop
        loop.pace.start(self.steps, started)
        self._reported = started, self.steps
        while not self._stop.set and self.context.ok() and self.steps < loop.end:
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
            self._live.offer(now, self._simulator, lambda: self._loop.snapshot().effort)
        return self._loop.tick(now, self._stop)

    # Diagnostics.

    def _diagnose(self, now):
        before, steps_before = self._reported
        simulator, integration = self._simulator, self._simulator.integration
        self._reported = now, simulator.steps
        self._log.look()
        self._pass_on_warning()
        self._look_for_clocks()
        if not self._health_outlet.wanted:
            return
        snapshot = self._loop.snapshot()
        pace = (simulator.steps - steps_before) * self._step / (now - before)
        message = self._health.message(
            snapshot, self._counters(),
            facts={
                'state': 'paused' if self.paused else 'running',
                'sim_time_s': snapshot.nanoseconds / NANOSECONDS,
                'real_time_factor': f'{pace:.4f}',
                'energy_J': snapshot.energy,
                'step_error_m': f'{integration.largest_error:.2g}',
                'split_steps': integration.splits,
                'log': self._log.path or 'off'},
            errors=[error for error in (self._loop.diverged, self._log.error) if error],
            warnings=[text for text in (
                simulator.warning, self._foreign_clock and _TWO_CLOCKS) if text])
        self._health_outlet.send(serialize_message(message), snapshot.step, snapshot.nanoseconds)

    def _counters(self):
        pace = self._loop.pace
        return {
            'overruns': pace.overruns,
            'dropped_time_s': pace.dropped_steps * self._step,
            'refused_commands': self._commands.refused,
            'stale_commands': self._commands.stale,
            'failed_calls': self.failed_calls,
            'missed_commands': self._loop.gate.missed,
            'unresolved_steps': self._simulator.integration.unresolved}

    def _pass_on_warning(self):
        if self._simulator.warning != self._warned:
            self._warned = self._simulator.warning
            if self._warned:
                self.get_logger().warning(self._warned)

    def _look_for_clocks(self):
        before = self._foreign_clock
        self._foreign_clock = self._values['publish_clock'] and self.count_publishers('/clock') > 1
        if self._foreign_clock and not before:
            self.get_logger().warning(_TWO_CLOCKS)

    # Called by the executor.

    def survive(self, error):
        """Say that a callback failed, for example rclpy's at a request that makes no sense."""
        self.failed_calls += 1
        self.get_logger().error(f'a callback failed: {error!r}', throttle_duration_sec=5.0)

    def _on_parameters(self, changed):
        values = {**self._values, **changed}
        steps_each = steps_between_messages(values, self._step)
        of_scene = {name: value for name, value in changed.items()
                    if PARAMETERS[name].scope == SCENE}
        scene = self._simulator.scene.vary(of_scene)
        with self._lock:
            self._loop.configure(values, steps_each)
            if of_scene:
                self._simulator.change(scene)
                self._log.note(CHANGE, change_note(self.steps, of_scene))

    @property
    def paused(self):
        """Whether time stands."""
        return self._loop.paused

    @property
    def steps(self):
        """Steps done."""
        return self._simulator.steps

    def pause(self, paused):
        """Let time stand, or go on; return what it does; raise NotNow."""
        with self._lock:
            self._loop.pause(paused)
        return 'paused' if paused else 'running'

    def reset(self):
        """Go back to the initial state; return when, as text."""
        with self._lock:
            self._loop.reset()
            self._log.note(RESET, {'step': str(self.steps)})
            self._loop.restart()
            return f'reset at step {self.steps}'

    def step(self, count=None):
        """Do so many steps while paused, or `steps_per_call`; return until when; raise NotNow."""
        with self._lock:
            return self._loop.step(
                self._values['steps_per_call'] if count is None else count, self._stop)

    def quit(self):
        """End the process, as SIGINT does."""
        self._stop.set = True

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
        self._pass_on_warning()
        if self._live is not None:
            self._live.close()
        pace = self._loop.pace
        report = (f'simulated {self.steps * self._step:.6g} s in {wall_time:.3f} s, '
                  f'{pace.overruns} overruns, {pace.dropped_steps * self._step:.6g} s dropped')
        self._log.close({**self._peak.note(), **{
            name: str(count) for name, count in self._counters().items()}})
        if self._log.path:
            report += f'; log: {self._log.path}'
        self.get_logger().info(report)
