# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The node's publishers, its subscriptions to commands, and its log."""

from collections.abc import Sequence
from datetime import datetime
from importlib import import_module
import math
import os
import time
from typing import Any

import numpy as np
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile

from timo_sim.log.notes import START, start_note, SUMMARY
from timo_sim.log.rosbag2 import DEPTH
from timo_sim.log.write import Channel, Recorder
from timo_sim.ros.private import take
from timo_sim.simulation.snapshot import Snapshot
from timo_sim.topics.cdr import CdrError, pack, Reader
from timo_sim.topics.commands import COMMANDS, GROUPS, RefusedError, TIMED_OUT

_DISCOVERY_TIME = 10.0  # [s] of wall time in which a new subscriber discovers the publisher, too


def message_class(type_name: str) -> type:
    """Return the class of messages of a type, named as in 'sensor_msgs/msg/JointState'."""
    package, _, name = type_name.split('/')
    return getattr(import_module(f'{package}.msg'), name)


class Outlet:
    """
    A publisher that also hands its messages to the log, and knows whether anybody wants them.

    They go to the `channel` with an `index` of a `recorder`, once there is one; with
    `always_logged` also those that nobody receives. Unless it `publishes`, it only logs. If it is
    `latched`, who subscribes later receives the last messages.
    """

    always_logged = True

    def __init__(self, node, topic, type_name, publishes=True, latched=False):
        self.subscribed, self._joined, self._latched = False, -math.inf, latched
        self.recorder, self.index = None, None
        self._publisher: Publisher | None = None
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        self.channel = Channel(node.resolve_topic_name(topic), type_name, topic,
                               durability=durability.name.lower())
        if publishes:
            self._publisher = node.create_publisher(
                message_class(type_name), topic, QoSProfile(depth=DEPTH, durability=durability),
                event_callbacks=PublisherEventCallbacks(matched=self._matched))

    def _matched(self, event):
        self.check_subscribers()
        if event.total_count_change:
            self._joined = time.monotonic()

    def watched_anew(self, now: float) -> bool:
        """Return whether somebody has subscribed shortly before a wall time [s]."""
        return self.subscribed and now < self._joined + _DISCOVERY_TIME

    def check_subscribers(self) -> None:
        """Ask the middleware whether anybody subscribes; this is also done at every change."""
        self.subscribed = self._publisher is not None and (
            self._latched or self._publisher.get_subscription_count() > 0)

    @property
    def wanted(self) -> bool:
        """Whether a message would reach a subscriber or the log."""
        return self.subscribed or (
            self.always_logged and self.recorder is not None and self.recorder.error is None)

    def send(self, data: bytes, step: int, nanoseconds: int, again: bool = False) -> None:
        """Send a message to subscribers and, unless `again`, log its step and sim time [ns]."""
        if self._publisher and self.subscribed:
            self._publisher.publish(data)
        if self.recorder is not None and not again:
            self.recorder.write(self.index, step, nanoseconds, data)


class MotionOutlet(Outlet):
    """
    The outlet of an Output with names of its FRAMES; it is published each `every` steps.

    The messages of a sensor are sent `delay` steps after the measurement. Header and step in the
    log are those of the measurement; measuring a step again replaces what is `under_way`.
    """

    def __init__(self, node, output, frames, publishes=True, delay=0):
        super().__init__(node, output.name, output.type_name, publishes)
        self._serialize = output.serializer(frames)
        self._output, self.rate = output, output.rate
        self.name, self.every, self.delay = output.name, 1, delay
        self.under_way: dict[int, bytes] = {}

    def publish(self, snapshot: Snapshot, again: bool = False) -> None:
        """Send the message of a snapshot, or keep it until `deliver`."""
        data = self._serialize(snapshot, self._output.numbers(snapshot))
        if self.delay:
            self.under_way[snapshot.step] = data
        else:
            self.send(data, snapshot.step, snapshot.nanoseconds, again)

    @property
    def arrival(self) -> float:
        """The step at which the next message is due, or infinity."""
        return next(iter(self.under_way), math.inf) + self.delay

    def deliver(self, step: int, nanoseconds: int) -> None:
        """Send the messages that are due until a step, at this sim time [ns]."""
        while self.arrival <= step:
            measured = next(iter(self.under_way))
            self.send(self.under_way.pop(measured), measured, nanoseconds)


class Inlet:
    """
    The subscription to a command topic; the loop polls it under the node's lock.

    No executor serves it: the EventsExecutor's queue is unbounded, the middleware's is not.
    `pending` is the command that will act next, its row and its message, or None. Counted are
    commands `refused` or, because they answer another state, `mismatched`.
    """

    def __init__(self, node, command, frames):
        self.command, self._frames = command, frames
        self.type, self._read = message_class(command.type_name), Reader(command.type_name)
        # A logger for each topic, so that the warnings of each are throttled separately.
        self.logger = node.get_logger().get_child(command.name.removeprefix('~/'))
        self.subscription = node.create_subscription(
            self.type, command.name, lambda data: None, DEPTH, raw=True)
        self.channel = Channel(self.subscription.topic_name, command.type_name, command.name)
        self.pending = None
        self.refused = self.mismatched = 0

    def receive(self, data: bytes, answered: int | None) -> bool:
        """Make a message pending, unless it is refused; return whether it is now."""
        try:
            texts, lists, stamp = self._read(data)
            row = self.command.row(texts, lists, self._frames)
        except (CdrError, RefusedError) as reason:
            self.refused += 1
            self.logger.warning(
                f'command refused, {reason}; the previous command stays in force',
                throttle_duration_sec=5.0)
            return False
        if stamp and answered is not None and stamp != answered:
            self.mismatched += 1
            self.logger.warning(
                f'command dropped, its stamp is {stamp} ns, that of the state {answered} ns: '
                'with sync: wait copy the stamp of joint_states', once=True)
            return False
        if idle := self.command.no_effect(texts, lists):
            self.logger.warning(idle, once=True)
        self.pending = row, data
        return True


class Commands:
    """
    All command topics of a node, and which of them each group of inputs follows.

    `voltage` says whether there is a motor that takes one. `inlets`, and `channels` of the log,
    are in the order of COMMANDS. `stale` counts how often a group of inputs fell to zero because
    its command was too old; `received` says whether a command has come since `apply` was called.
    """

    def __init__(self, node, voltage, frames):
        self.inlets = [Inlet(node, command, frames) for command in COMMANDS
                       if voltage or command.name != '~/motor_voltage']
        self.channels = [inlet.channel for inlet in self.inlets]
        self.stale, self.received = 0, False
        # Of each group that follows a command: the command's inlet, and the step when it began.
        self._followed = {}

    def count(self, fault: str) -> int:
        """Return the number of commands `refused` or `mismatched`."""
        return sum(getattr(inlet, fault) for inlet in self.inlets)

    def expected(self) -> bool:
        """Return whether anybody publishes commands."""
        return any(inlet.subscription.get_publisher_count() for inlet in self.inlets)

    def poll(self, answered: int | None) -> None:
        """Receive what has arrived; drop what has another stamp than `answered` [ns], if any."""
        for inlet in self.inlets:
            for data in take(inlet.subscription, inlet.type):
                self.received |= inlet.receive(data, answered)

    def apply(self, step: int, timeout_steps: float,
              commanded: np.ndarray) -> list[tuple[int, bytes]]:
        """
        Let pending commands act from this step on, and set inputs to zero that have timed out.

        `commanded`, shape (COMMANDED,), is updated in place; with `timeout_steps` 0 nothing times
        out. Return the index in COMMANDS and the message of each command that begins to act; a
        time-out counts as a message of zeros.
        """
        started, self.received = [], False
        for index, inlet in enumerate(self.inlets):
            if inlet.pending is not None:
                row, data = inlet.pending
                inlet.pending = None
                for key in inlet.command.apply(row, commanded):
                    self._followed[key] = inlet, step
                started.append((index, data))
        if timeout_steps:
            for key, (inlet, since) in list(self._followed.items()):
                if step >= since + timeout_steps:
                    del self._followed[key]
                    self.stale += 1
                    inlet.logger.warning(
                        f'no command for {timeout_steps} steps, the {key} input falls to zero',
                        throttle_duration_sec=5.0)
                    commanded[GROUPS[key]] = 0.0
                    index = TIMED_OUT[key]
                    started.append((index, pack(self.inlets[index].command.type_name, {})))
        return started

    def end(self, timeout_steps: float) -> list[float]:
        """Return the list of steps at which inputs will time out."""
        return [since + timeout_steps for _, since in self._followed.values()
                ] if timeout_steps else []

    def clear(self, commanded: np.ndarray) -> None:
        """Set all commanded values, (COMMANDED,), to zero and drop pending commands."""
        commanded[:] = 0.0
        self._followed, self.received = {}, False
        for inlet in self.inlets:
            inlet.pending = None


class RunLog(Recorder):
    """The log of a run, once it is open; `trouble` is what the logger was told last about it."""

    path: Any = None
    error: str | None = ''  # until it is open: nothing is written
    warning: str | None = None

    def __init__(self, logger):
        self._logger, self.trouble = logger, None

    def open(self, path: str, channels: list[Channel], outlets: Sequence[Outlet],
             node: str, values: dict[str, Any]) -> None:
        """
        Begin a log of a node with these values; without a path its name has date and time.

        Messages of `channels` are given to `write`; outlets write to it by themselves from now on.
        """
        # ~ comes as it is from parameter files, and from -p in some shells.
        path = os.path.expanduser(path or f'timo_sim_{datetime.now():%Y%m%d_%H%M%S}.mcap')
        logged = [*channels, *(outlet.channel for outlet in outlets)]
        try:
            super().__init__(path, logged, {START: start_note(node, values, logged)})
        except (OSError, ValueError) as error:  # ValueError: a path without a name
            self.path, self.error = None, ''
            self._tell(f'no log is written to {path}: {error}')
            return
        for index, outlet in enumerate(outlets, start=len(channels)):
            outlet.recorder, outlet.index = self, index

    def check(self) -> None:
        """Tell the logger if the log has ended early or was moved."""
        self._tell(self.error and f'the log ends early: {self.error}' or self.warning)

    def complete(self, summary: dict[str, str]) -> None:
        """End the log with a summary of the run, a dictionary of str."""
        if self.path:
            self.note(SUMMARY, summary)
            self.close()
            self.check()

    def _tell(self, trouble):
        if trouble not in (None, self.trouble):
            self.trouble = trouble
            self._logger.error(trouble)
