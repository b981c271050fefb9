# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The node `timo_sim`, which connects loop, topics, services, diagnostics and log."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, ExitStack
from functools import partial
from importlib.util import find_spec
import math
import os
import threading
import time
from typing import Any, NoReturn

from rclpy.context import Context
from rclpy.subscription import Subscription
from std_srvs.srv import SetBool, Trigger

from timo_sim.log.write import CHANGE, change_note, Peak, RESET, start_note
from timo_sim.ros.diagnostics import Health
from timo_sim.ros.loop import Loop, StateError
from timo_sim.ros.parameters import ParameterNode, steps_between_messages
from timo_sim.ros.topics import Commands, LateOutlet, MotionOutlet, RunLog
from timo_sim.runs.simulate import resolve
from timo_sim.scene.parameters import (
    changed, frame_names, LATEST, ParameterError, PARAMETERS, SCENE, short)
from timo_sim.scene.scene import find_implausible, Scene, scene_from
from timo_sim.simulation.simulator import Simulator, STEPS_BEHIND
from timo_sim.topics.outputs import outputs, TRANSFORMS

_LONGEST_SLEEP = 0.1  # [s] after which a sleeping node looks at its flags
# Environment in which a node discovers no other and is discovered by none.
_UNDISCOVERED = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF', 'ROS_LOCALHOST_ONLY': ''}


def no_live_feed(scene: Scene, url: str, name: str) -> NoReturn:
    """Raise ParameterError: only the executable sim_node can stream to a viewer."""
    raise ParameterError(f'rerun_live = {short(url)} needs the executable sim_node, which brings '
                         'the stream of the viewer')


@contextmanager
def _undiscovered(args, options):
    """Yield a node that has the parameters of a SimNode, and that no other node sees."""
    context, before = Context(), {name: os.environ.get(name) for name in _UNDISCOVERED}
    os.environ.update(_UNDISCOVERED)
    try:
        context.init(args, initialize_logging=False)
    finally:
        for name, value in before.items():
            del os.environ[name]
            os.environ.update({name: value} if value is not None else {})
    with ExitStack() as stack:
        stack.callback(context.try_shutdown)
        node = ParameterNode('timo_sim', context=context, enable_rosout=False, **options)
        stack.callback(node.destroy_node)
        yield node


def _prepare(node):
    """
    Return a simulator, compiled, and its settings from the parameters of a node.

    The settings are values by name, steps between messages by rate, and the last step.
    """
    values, tell = node.given(), node.get_logger().info
    if values['model.accuracy']:
        tell('choosing modes and step for model.accuracy')
    scene, steps = resolve(scene_from(values), values['duration'], tell,
                           partial(steps_between_messages, values))
    values.update(scene.values)
    steps_each = steps_between_messages(values, scene.step)
    simulator = Simulator(scene, values['estimate_error'])
    simulator.warm_up(tell, messages=True)
    return simulator, values, steps_each, steps or math.floor(LATEST / scene.step)


class SimNode(ParameterNode):
    """
    Integrates a scene in step with the wall clock.

    `run` is called by the main thread, callbacks by the executor's. Both touch the simulation only
    under `_lock`. `stop` is a StopRequest, `args` a command line with parameters, by default that
    of the process; `options` are those of rclpy.node.Node, such as the namespace of one of several
    nodes in a process. `live_feed` returns a stream of a scene to a viewer, given its address and
    the name of the node: `send(now, simulator, effort)` is called at each tick, `close()` at the
    end; its attribute `warning` is a warning or None. Raises ParameterError.
    """

    def __init__(self, stop: Any, live_feed: Callable[[Scene, str, str], Any] = no_live_feed,
                 args: list[str] | None = None, **options: Any) -> None:
        # Compiling takes seconds: it is done before others see the node and wait for its answers.
        with _undiscovered(args, options) as node:
            self._simulator, values, steps_each, end = _prepare(node)
        self._frames = frame_names(values)
        super().__init__('timo_sim', **options)
        self._stop, self._values, scene = stop, values, self._simulator.scene
        self._lock = threading.Lock()
        doubts = find_implausible(scene.values)
        if doubts:
            self.get_logger().warning(doubts)
        self._step = scene.step
        self._log, self._peak = RunLog(self.get_logger()), Peak()
        self._commands = Commands(self, values['motor.dc.resistance'] > 0.0, self._frames)
        self._outlets = self._make_outlets(scene)
        self._loop = Loop(self._simulator, values, self._commands, self._outlets, self._log,
                          self.get_logger(), end)
        self._health = Health(self, self._simulator, self._loop, self._commands, self._log,
                              values['publish_clock'])
        self._live = values['rerun_live'] and live_feed(
            scene, values['rerun_live'], self.get_fully_qualified_name())
        if self._live and self._live.warning:
            self.get_logger().warning(self._live.warning)
        self._loop.configure(values, steps_each)
        self.declare(values, self._on_parameters)
        self._offer_services()

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Subscriptions that an executor serves: all but the commands, which the loop polls."""
        return (entry for entry in super().subscriptions if not entry.raw)

    def _make_outlets(self, scene):
        outlets = [self._make_outlet(output) for output in outputs(scene.modal_count)
                   if output.name != '/clock' or self._values['publish_clock']]
        try:
            if self._values['publish_arm_shape']:
                remedy = 'publish_arm_shape', 'visualization-msgs, or pip install it'
                from timo_sim.ros.arm_shape import ArmShape
                outlets.append(ArmShape(self, self._simulator.model, self._frames['world']))
            if self._values['publish_tf']:
                remedy = 'publish_tf', 'tf2-msgs'
                outlets.append(MotionOutlet(self, TRANSFORMS, self._frames))
                outlets[-1].logged = False
        except ModuleNotFoundError as error:
            raise ParameterError(f'{remedy[0]} needs {error.name}, which is not installed: '
                                 f'apt-get install ros-jazzy-{remedy[1]}') from None
        return outlets

    def _make_outlet(self, output):
        delay = output.delay and round(self._values[output.delay] / self._step)
        outlet = LateOutlet(self, output, self._frames, delay) if delay else MotionOutlet(
            self, output, self._frames)
        outlet.always_logged = not output.delay or self._values['record_sensors']
        return outlet

    def _offer_services(self):
        for kind, name, operation in (
                (SetBool, '~/pause', lambda request: self.pause(request.data)),
                (Trigger, '~/reset', lambda request: self.reset()),
                (Trigger, '~/step', lambda request: self.step())):
            self.create_service(kind, name, partial(_answer, operation))
        if find_spec('simulation_interfaces') is not None:
            from timo_sim.ros.interfaces import Interfaces
            Interfaces(self)

    def open(self) -> None:
        """Open the log and publish the initial state, before any callback can change it."""
        if self._values['record']:
            self._open_log()
        self._loop.check_subscribers()
        self._loop.publish()
        # After publishing, because rclpy's first log line in a process takes a tenth of a second.
        self.get_logger().info(
            f'{"paused" if self.paused else "running"}: {self._simulator.scene.modal_count} '
            f'modes, step {self._step:g} s, waiting for commands' + (
                f', logging to {self._log.path}' if self._log.path else ''))

    def _open_log(self):
        self._log.open(
            self._values['record_file'], self._commands.channels,
            [*self._outlets, self._health.outlet],
            start_note(self.get_fully_qualified_name(), self._values, changed(self._values),
                       self._simulator.scene))
        for outlet in self._outlets:
            if self._log.path and outlet.name == '~/tip_deflection':
                outlet.watch = self._peak.update

    def run(self) -> None:
        """Advance sim time with wall time until asked to stop."""
        started, loop = time.monotonic(), self._loop
        loop.pace.start(self.steps, started)
        self._health.start(started)
        while not self._stop.set and self.context.ok() and self.steps < loop.end:
            with self._lock:
                wait = self._tick()
            # In slices, because a signal does not end a sleep early.
            time.sleep(min(max(wait, 0.0), _LONGEST_SLEEP))
        self._close(time.monotonic() - started)

    def _tick(self):
        """Do what is due now; return the time until something is due again [s]."""
        now = time.monotonic()
        self._health.report(now)
        self._loop.poll()
        if self._live:
            self._live.send(now, self._simulator, lambda: self._loop.snapshot().effort)
        wait = self._loop.tick(now, self._stop)
        # The error is measured while nothing else is due.
        return 0.0 if wait > 0.0 and self._simulator.measure_error(STEPS_BEHIND) else wait

    def _close(self, wall_time):
        error = self._simulator.estimated_error
        self._health.pass_on_warning()
        if self._live:
            self._live.close()
        pace = self._loop.pace
        report = (f'simulated {self.steps * self._step:.6g} s in {wall_time:.3f} s, '
                  f'{pace.overruns} overruns, {pace.dropped_steps * self._step:.6g} s dropped')
        self._log.close({
            **self._peak.note(), 'estimated_tip_error_m': f'{error:.3g}',
            **{name: str(count) for name, count in self._health.counters().items()}})
        if self._log.path:
            report += f'; log: {self._log.path}'
        self.get_logger().info(report)

    # Called by the executor.

    def count_failure(self, error: Exception) -> None:
        """Count and log an error of a callback, for example of rclpy's at a malformed request."""
        self._health.failed_calls += 1
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
    def paused(self) -> bool:
        """Whether time stands."""
        return self._loop.paused

    @property
    def steps(self) -> int:
        """Number of steps done; a reset does not set it back."""
        return self._simulator.steps

    def pause(self, paused: bool) -> str:
        """Pause, or go on; return the new state, as text, or raise StateError."""
        with self._lock:
            self._loop.pause(paused)
        return 'paused' if paused else 'running'

    def reset(self) -> str:
        """Go back to the initial state; return at which step, as text."""
        with self._lock:
            self._loop.reset()
            self._log.note(RESET, {'step': str(self.steps)})
            self._loop.restart()
            return f'reset at step {self.steps}'

    def step(self, count: int | None = None) -> str:
        """
        Do steps while paused; return the step reached, as text, or raise StateError.

        Their number is `steps_per_call` unless `count` is given.
        """
        with self._lock:
            return self._loop.step(
                self._values['steps_per_call'] if count is None else count, self._stop)

    def quit(self) -> None:
        """End the process, as SIGINT does."""
        self._stop.set = True


def _answer(operation, request, response):
    try:
        response.message = operation(request)
        response.success = True
    except StateError as reason:
        response.message = str(reason)
    return response
