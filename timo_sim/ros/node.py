# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The node `timo_sim`, which connects loop, topics, services, diagnostics and log."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib.util import find_spec
import math
import threading
import time
from types import MappingProxyType
from typing import Any

import numpy as np
from rclpy.parameter_service import ParameterService
from rclpy.subscription import Subscription
from std_srvs.srv import SetBool, Trigger

from timo_sim.log.new_log import DESCRIPTION, description
from timo_sim.log.notes import CHANGE, change_note, RESET, scene_message, TEXT
from timo_sim.ros.diagnostics import Health
from timo_sim.ros.loop import Loop, StateError, sync_steps
from timo_sim.ros.parameters import ParameterNode, steps_between_messages
from timo_sim.ros.topics import Commands, MotionOutlet, Outlet, RunLog
from timo_sim.runs.simulate import resolve
from timo_sim.scene.parameters import (
    frame_names, LATEST, ParameterError, PARAMETERS, SCENE)
from timo_sim.scene.plausible import find_implausible
from timo_sim.scene.scene import scene_from
from timo_sim.simulation.finer import EstimatingSimulator, STEPS_BEHIND
from timo_sim.simulation.simulator import Simulator
from timo_sim.simulation.snapshot import Snapshot

_LONGEST_SLEEP = 0.1  # [s] after which a sleeping node looks at its flags


class SimNode(ParameterNode):
    """
    Integrates a scene in step with the wall clock.

    `run` is called by the main thread, callbacks by the executor's. Both touch the simulation only
    under `_lock`. `stop` is a StopRequest; `files` are those of `ParameterNode.given`;
    `options` are those of rclpy.node.Node, such as the namespace of one of several nodes in a
    process. `frames` are the names of FRAMES. Raises
    ParameterError.
    """

    def __init__(self, stop: Any, files: Mapping = MappingProxyType({}), **options: Any) -> None:
        # Compiling takes seconds. Services and topics come after it: others wait for these.
        super().__init__('timo_sim', start_parameter_services=False, **options)
        self._stop, self._lock, self._values = stop, threading.Lock(), self.given(files)
        values, tell = self._values, self.get_logger().info
        if values['model.accuracy']:
            tell('choosing modes and step for model.accuracy')
        scene, steps = resolve(scene_from(values), values['duration'], tell)
        values.update(scene.values)
        self._step = scene.step
        steps_each = steps_between_messages(values, scene.step)
        sync_steps(values, scene.step)
        self._simulator: Any = (
            EstimatingSimulator if values['estimate_error'] else Simulator)(scene)
        self._errors: Any = 0.0, 0.0  # the largest before the last reset
        self._simulator.warm_up(tell, messages=True)
        if doubts := find_implausible(scene.values):
            self.get_logger().warning(doubts)
        self.frames = frame_names(values)
        self._log = RunLog(self.get_logger())
        self._commands = Commands(self, values['motor.dc.resistance'] > 0.0, self.frames)
        self._outlets = self._make_outlets(scene)
        self._loop = Loop(simulator=self._simulator, values=values, commands=self._commands,
                          outlets=self._outlets, log=self._log, logger=self.get_logger(),
                          end=steps or math.floor(LATEST / scene.step))
        self._health = Health(node=self, simulator=self._simulator, loop=self._loop,
                              commands=self._commands, log=self._log,
                              publishes_clock=values['publish_clock'])
        self._loop.configure(values, steps_each)
        self._description = Outlet(self, DESCRIPTION, TEXT, values['publish_tf'], latched=True)
        self._scene_topic = Outlet(self, '~/scene', TEXT, latched=True)
        self.declare(values, self._on_parameters)
        self._parameter_services = ParameterService(self)
        self._offer_services()

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Subscriptions that an executor serves: all but the commands, which the loop polls."""
        return (entry for entry in super().subscriptions if not entry.raw)

    def _make_outlets(self, scene):
        outlets = []
        for output in scene.outputs:
            if output.name == '/clock' and not self._values['publish_clock']:
                continue
            delay = round(self._values[output.delay] / self._step) if output.delay else 0
            outlets.append(MotionOutlet(self, output, self.frames, delay=delay))
            outlets[-1].always_logged = not output.delay or self._values['record_sensors']
        try:
            outlets.append(MotionOutlet(self, scene.transforms, self.frames,
                                        self._values['publish_tf']))
        except ModuleNotFoundError as error:
            raise ParameterError(f'publish_tf needs {error.name}, which is not installed: apt-get '
                                 'install ros-$ROS_DISTRO-tf2-msgs') from None
        return outlets

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
        """Open the log, publish the initial state before a callback can change it, start time."""
        outlets = [*self._outlets, self._health.outlet, self._description]
        self._channels = [*self._commands.channels, *(outlet.channel for outlet in outlets)]
        if self._values['record']:
            self._log.open(
                self._values['record_file'], self._commands.channels, outlets,
                self.get_fully_qualified_name(), self._values)
        self._loop.check_subscribers()
        for outlet in self._scene_topic, self._description:
            outlet.check_subscribers()
        self._tell_scene('start', self._values)
        self._description.send(description(self._simulator.scene, self.frames), 0, 0)
        self._loop.publish()
        # After publishing, because rclpy's first log line in a process takes a tenth of a second.
        self.get_logger().info(
            f'{"paused" if self.paused else "running"}: {self._simulator.scene.modal_count} '
            f'modes, step {self._step:g} s, ready for commands' + (
                f', logging to {self._log.path}' if self._log.path else ''))
        self._opened = time.monotonic()
        self._loop.pace.start(self.steps, self._opened)
        self._health.start(self._opened)

    def run(self) -> None:
        """Advance sim time with wall time until asked to stop."""
        while not self._stop.set and self.context.ok() and self.steps < self._loop.end:
            with self._lock:
                wait = self._tick()
            # In slices, because a signal does not end a sleep early.
            time.sleep(min(max(wait, 0.0), _LONGEST_SLEEP))
        with self._lock:
            self._close()

    def _tick(self):
        """Do what is due now; return the time until something is due again [s]."""
        now = time.monotonic()
        self._health.report(now)
        self._loop.poll()
        wait = self._loop.tick(now, self._stop)
        # The error is measured while nothing else is due.
        if wait > 0.0 and isinstance(self._simulator, EstimatingSimulator) and (
                self._simulator.measure_error(STEPS_BEHIND)):
            return 0.0
        return wait

    def _close(self):
        wall_time = time.monotonic() - self._opened
        tip, deflection = self._largest_errors()
        if self.context.ok():  # else there are no other nodes to ask for
            self._health.warn()
        timing = self._loop.pace.report()
        report = f'simulated {self.steps * self._step:.6g} s in {wall_time:.3f} s; {timing}'
        self._log.complete({
            'timing': timing,
            'estimated_tip_error_m': f'{tip:.3g}',
            'estimated_deflection_error_m': f'{deflection:.3g}',
            **{name: str(count) for name, count in self._health.counters().items()}})
        if self._log.trouble or self._log.path:
            report += f'; {self._log.trouble or f"log: {self._log.path}"}'
        self.get_logger().info(report)

    def _largest_errors(self):
        """Return the estimated errors of tip and deflection, also before resets, (2,) [m]."""
        return np.maximum(self._errors, (  # NaN if one is not known
            self._simulator.estimated_error, self._simulator.estimated_deflection_error))

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
            if of_scene or 'command_timeout' in changed:  # a bag does not show time-outs
                self._tell_scene('set', values, of_scene)

    def _tell_scene(self, event, values, given=None):
        """Publish parameters, so that a bag of the node can be replayed as its log can."""
        self._scene_topic.send(scene_message(
            event, self.steps, self.get_fully_qualified_name(), self._channels, values,
            given or {}), 0, 0)

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
            self._errors = self._largest_errors()
            self._loop.reset()
            self._log.note(RESET, {'step': str(self.steps)})
            self._tell_scene('reset', self._values)
            self._loop.restart()
            return f'reset at step {self.steps}'

    def with_snapshot(self, read: Callable[[Snapshot], Any]) -> Any:
        """Return what a function returns for the Snapshot of now; the motion stands meanwhile."""
        with self._lock:
            return read(self._loop.snapshot())

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
