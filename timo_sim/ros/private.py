# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
All that is used of rclpy and is not public there, each with what it is for.

Tried with rclpy 7.1.6 (Jazzy); in those of Kilted (9.1.5) and Lyrical (10.0.10) mypy finds it.
"""

from collections.abc import Iterator
from typing import Any

# The middleware's own errors, such as missing security keys; public ones derive from none.
from rclpy._rclpy_pybind11 import RCLError  # noqa: F401
from rclpy.node import Node
from rclpy.subscription import Subscription

try:  # it serves callbacks faster than SingleThreadedExecutor: benchmark/speed/latency.py
    from rclpy.experimental import EventsExecutor as Executor
except ImportError:  # an older rclpy
    from rclpy.executors import SingleThreadedExecutor as Executor  # noqa: F401


def overrides(node: Node) -> dict[str, Any]:
    """Return the Parameters that files and -p give: public functions hide undeclared ones."""
    return node._parameter_overrides


def take(subscription: Subscription, kind: type) -> Iterator[bytes]:
    """Yield the serialised messages that have arrived: in public only an executor takes them."""
    handle: Any = subscription.handle
    with handle:
        # At most a full queue: a fast publisher could keep an endless loop busy for ever.
        for _ in range(subscription.qos_profile.depth):
            taken = handle.take_message(kind, True)
            if taken is None:
                return
            yield taken[0]
