# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
A long run of the node: commands, a log, and a subscriber that comes and goes.

`python -m benchmark.stress.soak --minutes 60` prints a row each minute: memory of the node, by
how much its clock has drifted from the steady clock since the first row, what was lost. At the
end it replays the log. Exit code 0 means that the clock kept time, but for what the node itself
says that it dropped, that memory does not grow, and that the replay has the same bits.
"""

import argparse
import os
import random
import sys
import tempfile
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from benchmark import ROOT
from benchmark.process import ENVIRONMENT, resident, wait
from benchmark.stress.node_process import growth, LEAK, Node, survived
from timo_sim.runs.replay import replay

PERIOD = 0.05        # [s] between commands
VISIT = 7.0          # [s] for which the subscriber stays, and stays away
MOST_DRIFT = 5e-3    # [s] of the clock; messages of a busy machine come late by milliseconds


class Visitor:
    """Sends commands, and subscribes to the states for a while again and again."""

    def __init__(self):
        self.node = rclpy.create_node('visitor')
        self.sent = self.states = self.visits = 0
        self.offset, self.health = float('inf'), {}
        self._random, self._subscription, self._changed = random.Random(1), None, 0.0
        self._wrench = self.node.create_publisher(WrenchStamped, 'timo_sim/carrier_wrench', 10)
        self._torque = self.node.create_publisher(Float64, 'timo_sim/motor_torque', 10)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._see, 10)
        self.node.create_timer(PERIOD, self._act)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()

    def end(self):
        """Send and receive nothing any more."""
        self._executor.shutdown()
        self._thread.join()
        self.node.destroy_node()

    def _see(self, message):
        # The least delay of delivery since the last row counts.
        now, stamp = time.monotonic(), message.header.stamp
        self.health = {pair.key: pair.value for pair in message.status[0].values}
        self.offset = min(self.offset, now - stamp.sec - 1e-9 * stamp.nanosec
                          - float(self.health['dropped_time_s']))

    def _act(self):
        now = time.monotonic()
        if now > self._changed + VISIT:
            self._changed = now
            if self._subscription:
                self.node.destroy_subscription(self._subscription)
                self._subscription = None
            else:
                self._subscription = self.node.create_subscription(
                    JointState, 'joint_states', self._count, 10)
                self.visits += 1
        wrench = WrenchStamped()
        wrench.wrench.force.x, wrench.wrench.force.y = (
            self._random.uniform(-1.0, 1.0) for _ in range(2))
        self._wrench.publish(wrench)
        self._torque.publish(Float64(data=self._random.uniform(-0.5, 0.5)))
        self.sent += 2

    def _count(self, message):
        self.states += 1


def soak(minutes, rows):
    """Run the node for some minutes, print so many rows; return the reasons against it."""
    with tempfile.TemporaryDirectory() as folder:
        node = Node(folder, '--params-file', str(ROOT / 'config' / 'paper.yaml'),
                    publish_clock=True).ready()
        visitor, lows, first = Visitor(), [], None
        wait(lambda: visitor.health, node.process)
        begun = time.monotonic()
        print('| minute | memory [MB] | drift [ms] | dropped [s] | overruns | refused | '
              'commands | visits | states | log [MB] |', flush=True)
        print('|' + 10 * '---|', flush=True)
        for row in range(rows):
            low, visitor.offset = float('inf'), float('inf')
            while time.monotonic() < begun + 60.0 * minutes * (row + 1) / rows:
                time.sleep(1.0)
                low = min(low, resident(node.process.pid))
            lows.append(low)
            health = visitor.health
            first = visitor.offset if first is None else first
            drift = visitor.offset - first
            print(f'| {(time.monotonic() - begun) / 60.0:.1f} | {low / 1e6:.1f} | '
                  f'{1e3 * drift:+.2f} | {health["dropped_time_s"]} | {health["overruns"]} | '
                  f'{health["refused_commands"]} | {visitor.sent} | {visitor.visits} | '
                  f'{visitor.states} | {node.log.stat().st_size / 1e6:.1f} |', flush=True)
        visitor.end()
        well, _ = survived(node)
        print(node.output().splitlines()[-1], flush=True)
        same = replay(node.log, show=print)
    return [reason for reason, holds in (
        ('the node did not end well', not well), ('the replay differs', not same),
        (f'memory grows by {growth(lows) / 1e6:.1f} MB a row', growth(lows) > LEAK),
        (f'the clock drifts by {1e3 * drift:.2f} ms', not abs(drift) <= MOST_DRIFT)) if holds]


def main():
    """Run the soak; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0].strip())
    parser.add_argument('--minutes', type=float, default=60.0)
    parser.add_argument('--rows', type=int, default=60, help='at least 4')
    given = parser.parse_args()
    os.environ.update(ENVIRONMENT)
    rclpy.init()
    against = soak(given.minutes, max(4, given.rows))
    print('; '.join(against) or f'{given.minutes:g} minutes: all is well')
    rclpy.try_shutdown()
    return len(against)


if __name__ == '__main__':
    sys.exit(main())
