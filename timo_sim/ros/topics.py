# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Publishers of the topics that carry the motion, which `messages.outputs` defines."""

from importlib import import_module
import math
import time

from rclpy.event_handler import PublisherEventCallbacks

from timo_sim.log.recorder import Channel
from timo_sim.messages.outputs import in_frames
from timo_sim.messages.packing import Serializer

_NEW = 10.0  # [s] of wall time in which a new subscriber discovers the publisher, too


def message_class(type_name):
    """Return the class of messages of a type, named as in 'sensor_msgs/msg/JointState'."""
    package, _, name = type_name.split('/')
    return getattr(import_module(f'{package}.msg'), name)


def channel_of(endpoint, type_name, name):
    """Return the channel of a publisher or subscription in the log, with the QoS that acts."""
    qos = endpoint.qos_profile
    return Channel(endpoint.topic_name, type_name, name, qos.depth, qos.reliability.name.lower())


class Outlet:
    """
    A publisher that also hands its messages to the log, and knows whether anybody wants them.

    Attributes
    ----------
    subscribed : bool
        Whether anybody subscribes.
    logged : bool
        Whether its messages are for the log, too.
    asks : bool
        Whether the log wants messages that nobody else receives.
    channel : Channel
        Of the log.
    recorder : Recorder or None
        The open log.
    index : int or None
        Of the channel in the log.

    """

    logged = asks = True

    def __init__(self, node, topic, type_name):
        self.subscribed, self._joined = False, -math.inf
        self._publisher = node.create_publisher(
            message_class(type_name), topic, 10,
            event_callbacks=PublisherEventCallbacks(matched=self._matched))
        self.channel = channel_of(self._publisher, type_name, topic)
        self.recorder, self.index = None, None

    def _matched(self, event):
        self.look()
        if event.total_count_change:
            self._joined = time.monotonic()

    def watched_anew(self, now):
        """Return whether somebody has subscribed shortly before a wall time [s]."""
        return self.subscribed and now < self._joined + _NEW

    def look(self):
        """Ask the middleware whether anybody subscribes; this is also done at every change."""
        self.subscribed = self._publisher.get_subscription_count() > 0

    @property
    def wanted(self):
        """Whether a message would reach a subscriber or the log."""
        return self.subscribed or (
            self.asks and self.recorder is not None and self.recorder.error is None)

    def send(self, data, step, nanoseconds, again=False):
        """
        Send a serialised message to subscribers and log; with `again` to subscribers alone.

        `step` and `nanoseconds`, sim time [ns], are those that the log notes.
        """
        if self.subscribed:
            self._publisher.publish(data)
        if self.recorder is not None and not again:
            self.recorder.write(self.index, step, nanoseconds, data)


class MotionOutlet(Outlet):
    """
    The outlet of an Output of `messages.outputs`; `frames` names each of its FRAMES.

    It is published each `every` steps; `watch(numbers, ns)`, unless None, sees what is logged.
    """

    def __init__(self, node, output, frames):
        super().__init__(node, output.name, output.type_name)
        self._serialize = Serializer(output.type_name, in_frames(output.template, frames))
        self._output, self.rate = output, output.rate
        self.name, self.every, self.watch = output.name, 1, None

    def publish(self, snapshot, again=False):
        """Send the message of a snapshot."""
        numbers, data = self._message(snapshot)
        self.send(data, snapshot.step, snapshot.nanoseconds, again)
        if self.watch is not None and not again:
            self.watch(numbers, snapshot.nanoseconds)

    def _message(self, snapshot):
        numbers = self._output.numbers(snapshot)
        return numbers, self._serialize(snapshot.time, self._output.content(snapshot, numbers))


class LateOutlet(MotionOutlet):
    """
    The outlet of a sensor whose messages are sent `delay` steps after the measurement.

    Their header and their step in the log are those of the measurement.
    """

    def __init__(self, node, output, frames, delay):
        super().__init__(node, output, frames)
        self._delay, self._under_way = delay, {}

    def publish(self, snapshot, again=False):
        """Measure; measuring the same step again replaces the earlier measurement."""
        self._under_way[snapshot.step] = self._message(snapshot)[1]

    @property
    def arrival(self):
        """The step at which the next message is due, or infinity."""
        return next(iter(self._under_way), math.inf) + self._delay

    def deliver(self, step, nanoseconds):
        """Send the messages that are due until a step, at this sim time [ns]."""
        while self.arrival <= step:
            measured = next(iter(self._under_way))
            self.send(self._under_way.pop(measured), measured, nanoseconds)

    def drop(self):
        """Drop the messages that are not due yet."""
        self._under_way.clear()
