# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Keys of a terminal push a running node: arrows its carrier, a and d its shaft; q quits."""

import argparse
from contextlib import contextmanager, suppress
import os
import select
import signal
import sys
import termios
import time
import tty

from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
import rclpy
from rclpy.duration import Duration
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64

# By key: place in (force x, force y, torque), and sign. What arrow keys send ends with A to D.
PUSHES = {'C': (0, 1.0), 'D': (0, -1.0), 'A': (1, 1.0), 'B': (1, -1.0),
          'a': (2, 1.0), 'd': (2, -1.0)}
QUIT = 'q', '\x03', '\x04'  # Ctrl-C and Ctrl-D
# A terminal repeats a key that is held and does not say when it is released. The first push of a
# key therefore lasts until the first repetition, and each repetition prolongs it a little [s].
FIRST_PUSH, REPEATED_PUSH = 0.6, 0.2
PERIOD = 0.05  # [s] between commands


@contextmanager
def keys_at_once():
    """Make the terminal pass on each key at once, even Ctrl-C and Ctrl-Z; restore it after."""
    before = termios.tcgetattr(0)
    try:
        tty.setraw(0, termios.TCSADRAIN)
        yield
    finally:
        with suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(0, termios.TCSAFLUSH, before)


class Teleop:
    """Turns keys into commands for the node with this full name, of sizes [N], [N], [N m]."""

    def __init__(self, name, sizes):
        self.ends, self.name, self.sizes = False, name, sizes
        self.push, self.until, self.sent = 3 * [0.0], 3 * [0.0], 3 * [0.0]
        node = rclpy.create_node('teleop')
        self.wrench = node.create_publisher(WrenchStamped, f'{name}/carrier_wrench', 10)
        self.torque = node.create_publisher(Float64, f'{name}/motor_torque', 10)

    def run(self):
        """Follow the keys until `ends` is set; then take all pushes back."""
        try:
            while not self.ends:
                if select.select([0], [], [], PERIOD)[0]:
                    for key in os.read(0, 64).decode('latin-1'):
                        self.press(key, time.monotonic())
                self.send([push if time.monotonic() < until else 0.0
                           for push, until in zip(self.push, self.until)])
                heard = self.torque.get_subscription_count()
                x, y, torque = self.sent
                os.write(1, (f'\r{x:g}, {y:g} N, {torque:g} N m' if heard else
                             f'\rwaiting for {self.name}').encode() + b'\x1b[K')
        finally:
            if any(self.sent):
                self.send(3 * [0.0])
                for publisher in (self.wrench, self.torque):
                    publisher.wait_for_all_acked(Duration(seconds=1))

    def press(self, key, now):
        """Begin or prolong a push."""
        if key in PUSHES:
            place, sign = PUSHES[key]
            push = sign * self.sizes[place]
            repeated = push == self.push[place] and now < self.until[place]
            self.push[place] = push
            lasts = REPEATED_PUSH if repeated else FIRST_PUSH
            self.until[place] = max(self.until[place], now + lasts)
        self.ends |= key in QUIT

    def send(self, push):
        """Send what acts, and a zero after it; other commands of an idle input stay in force."""
        x, y, torque = push
        if x or y or any(self.sent[:2]):
            self.wrench.publish(WrenchStamped(wrench=Wrench(force=Vector3(x=x, y=y))))
        if torque or self.sent[2]:
            self.torque.publish(Float64(data=torque))
        self.sent = push


def main():
    """Read the arguments, and follow the keys."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--node', default='/timo_sim', help='full name of the node')
    parser.add_argument('--force', type=float, default=5.0, help='on the carrier [N]')
    parser.add_argument('--torque', type=float, default=5.0, help='on the shaft [N m]')
    given = parser.parse_args()
    if not os.isatty(0):
        sys.exit('teleop needs a terminal as its standard input, to read keys from')
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    teleop = Teleop(given.node, (given.force, given.force, given.torque))
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, lambda number, frame: setattr(teleop, 'ends', True))
    print(__doc__)
    with keys_at_once():
        teleop.run()
    print()


if __name__ == '__main__':
    main()
