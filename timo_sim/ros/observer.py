# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The node `observer`, which estimates the motion of an arm from its sensors and commands."""

from collections.abc import Mapping
from functools import partial
import math
import time
from types import MappingProxyType
from typing import Any

import numpy as np
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from timo_sim.compiled.machine import telling
from timo_sim.control.observer import observer
from timo_sim.model.layout import (
    FORCE_I, FORCE_II, FORCE_X, FORCE_Y, place, TIP_I, TIP_II, TIP_TORQUE, TIP_X, TIP_Y, TORQUE,
    VOLTAGE)
from timo_sim.ros.parameters import ParameterNode
from timo_sim.ros.private import overrides, take
from timo_sim.ros.topics import Commands, message_class, MotionOutlet
from timo_sim.scene.parameters import frame_names, Parameter, ParameterError, short
from timo_sim.scene.scene import scene_from
from timo_sim.simulation.loads import load_of_commands
from timo_sim.simulation.warnings import DivergenceError
from timo_sim.topics.cdr import CdrError, form, NANOSECONDS, Reader
from timo_sim.topics.commands import COMMANDED, RefusedError
from timo_sim.topics.outputs import IMU, outputs, SENSORS

_POLL = 1e-3        # [s] of wall time between two looks for messages
_LONGEST_GAP = 1.0  # [s] between stamps, forward or back, beyond which an estimate begins again
_LOST = 5.0         # `Observer.consistency` beyond which it does so
_DEPTH = 1000       # messages that wait for a busy node
_QOS = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
_SHOWN = 'joint_states', '~/modal_state', '~/tip_deflection', '~/tip_pose'
_DISTURBANCE = Parameter('disturbance', (), '', '', low=0.0)


class ObserverNode(ParameterNode):
    """
    Estimates the motion of the arm whose topics are in its namespace, by default /timo_sim.

    Its parameters are those of the scene and `disturbance`: deviation and correlation time of the
    unknown torque on the shaft. Time is that of the stamps of measurements; commands act from the
    last one on. `stop` is a StopRequest. Raises ParameterError.
    """

    subscriptions: Any = ()  # no executor serves them: `run` polls

    def __init__(self, stop: Any, files: Mapping = MappingProxyType({})) -> None:
        super().__init__('observer', namespace='timo_sim', start_parameter_services=False)
        given = overrides(self).pop('disturbance', None)
        disturbance = given and {'torque': _DISTURBANCE.check(given.value)}
        if disturbance and len(disturbance['torque']) != 2:
            raise ParameterError(f'disturbance must be [N m, s], got {short(given.value)}')
        values = self.given(files)
        scene, frames = scene_from(values), frame_names(values)
        self._stop, self._begin = stop, partial(observer, scene, disturbance=disturbance)
        self._observer, self._begun = self._begin(), False
        self._observer.simulator.warm_up(self.get_logger().info, messages=True)
        with telling(self.get_logger().info):  # `_start` makes a new observer
            self._observer.update({name: self._observer.expected(name).tolist()
                                   for name in self._observer.sensors}, dt=scene.step)
        self._stamps: dict[str, int] = {}  # of the last measurement used, by topic [ns]
        self._count = dict.fromkeys(('used', 'repeated', 'late', 'refused', 'begun again'), 0)
        # Topics of the arm are in the namespace of this node.
        self._commands = Commands(self, values['motor.dc.resistance'] > 0.0, frames, '', _DEPTH)
        self._commanded = np.zeros(COMMANDED)
        self._timeout = math.ceil(values['command_timeout'] / scene.step)
        self._sources: list[tuple] = [  # subscription, its type, what takes a message
            (inlet.subscription, inlet.type, partial(self._command, inlet))
            for inlet in self._commands.inlets]
        for output in outputs(1):
            sensors = [each for each in SENSORS
                       if each.topic == output.name and each.name in self._observer.sensors]
            if not sensors:
                continue
            if values[str(output.delay)]:
                raise ParameterError(f'{output.delay} must be 0 s for the node observer, which '
                                     'takes measurements as they come')
            kind = message_class(output.type_name)
            places = dict(zip(output.columns, form(output.type_name, output.template)[2]))
            topic = output.name.removeprefix('~/')
            self._sources.append((
                self.create_subscription(
                    kind, topic, lambda data: None, _QOS, raw=True,
                    qos_overriding_options=self.qos_of('subscription', topic)),
                kind, partial(self._measurement, sensors, Reader(output.type_name), places)))
        shown = [output._replace(name=f'~/{output.name.removeprefix("~/")}')
                 for output in outputs(scene.modal_count) if output.name in _SHOWN]
        shown += [each._replace(name='~/tip_deviation',
                                numbers=lambda _: self._observer.deflection_deviation)
                  for each in shown if each.name == '~/tip_deflection']
        self._outlets = [MotionOutlet(self, output, frames) for output in shown]
        self._covariance = self.create_publisher(Float64MultiArray, '~/covariance', 10)

    def open(self) -> None:
        """Say what is observed."""
        self.get_logger().info(f'observing {", ".join(self._observer.sensors)} in '
                               f'{self.get_namespace()}')

    def run(self) -> None:
        """Use measurements and commands in the order of their arrival until asked to stop."""
        while not self._stop.set and self.context.ok():
            arrived = [(at, number, data) for number, source in enumerate(self._sources)
                       for data, at in take(*source[:2])]
            for _, number, data in sorted(arrived):
                try:
                    self._sources[number][2](data)
                except DivergenceError as error:
                    self._again(error)
                except (CdrError, ParameterError, RefusedError) as error:
                    self.count_failure(error)
            time.sleep(_POLL)
        self.get_logger().info(f'measurements: {self._count}')

    def count_failure(self, error: Any, kind: str = 'refused') -> None:
        """Count and say what went wrong."""
        self._count[kind] += 1
        self.get_logger().warning(f'{kind}, {error}: {self._count}', throttle_duration_sec=5.0)

    def _again(self, reason):
        self._begun = False
        self.count_failure(reason, 'begun again')

    def _command(self, inlet, data):
        inlet.receive(data, None)
        self._commands.apply(self._observer.simulator.steps, self._timeout, self._commanded)

    def _measurement(self, sensors, read, places, data):
        (_, *names), lists, stamp = read(data)
        shown = {}
        for sensor in sensors:
            joint = sensor.joint or sensor.name
            if sensor.topic == IMU:
                shown[sensor.name] = [lists[0][places[column]] for column in sensor.columns]
            elif joint in names and len(lists[0]) == len(names):
                shown[sensor.name] = [lists[0][names.index(joint)]]
            else:
                raise RefusedError(f'{sensor.topic} must have a position of {joint}')
        simulator = self._observer.simulator
        step = round(1e-9 * stamp / simulator.scene.step)
        if self._begun and abs(step - simulator.steps) * simulator.scene.step > _LONGEST_GAP:
            self._again(f'a stamp is {_LONGEST_GAP:g} s or more from the last')
        if not self._begun:
            if 'encoder' in self._observer.sensors and 'encoder' not in shown:
                return
            self._start(step, shown)
        elif stamp == self._stamps.get(sensors[0].topic):  # while time stands
            self._count['repeated'] += 1
            return
        elif step < simulator.steps:
            self.count_failure(f'{", ".join(shown)} of {1e-9 * stamp:.9g} s', 'late')
            return
        ahead = step - self._observer.simulator.steps
        self._observer.update(shown, self._acting() if ahead else {},
                              ahead * simulator.scene.step)
        self._count['used'] += 1
        self._stamps[sensors[0].topic] = stamp
        self._publish(stamp)
        if self._observer.consistency > _LOST:
            self._again(self._observer.warning)

    def _start(self, step, shown):
        begun = self._begin()
        motion = begun.motion.values
        motion[2] = shown.get('encoder', motion[2:])[0]
        begun.simulator.set_motion(motion)
        begun.simulator.steps = step  # at which the scene's own loads act
        self._observer, self._begun = begun, True

    def _acting(self):
        """Return what commands act until the next measurement, as `Observer.update` takes them."""
        simulator = self._observer.simulator
        self._commands.apply(simulator.steps, self._timeout, self._commanded)
        load = load_of_commands(self._commanded, simulator)
        theta = float(simulator.motion.shaft)
        return {
            'force': place(load[FORCE_X], load[FORCE_Y], theta, load[FORCE_I], load[FORCE_II]),
            'tip_force': place(load[TIP_X], load[TIP_Y], theta, load[TIP_I], load[TIP_II]),
            'torque': load[TORQUE], 'tip_torque': load[TIP_TORQUE], 'voltage': load[VOLTAGE]}

    def _publish(self, stamp):
        snapshot = self._observer.simulator.snapshot()
        snapshot.time = divmod(stamp, NANOSECONDS)
        for outlet in self._outlets:
            if outlet.wanted:
                outlet.publish(snapshot)
        if self._covariance.get_subscription_count():
            size, names = len(self._observer.states), ', '.join(self._observer.states)
            self._covariance.publish(Float64MultiArray(
                data=[1e-9 * stamp, *self._observer.covariance.ravel().tolist()],
                layout=MultiArrayLayout(data_offset=1, dim=[
                    MultiArrayDimension(label=names, size=size, stride=stride)
                    for stride in (size * size, size)])))
