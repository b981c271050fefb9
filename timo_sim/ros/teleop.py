# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A client of a running node: keys of a terminal push its carrier and shaft."""

from contextlib import contextmanager, suppress
import math
import os
import select
import shutil
import signal
import termios
import time
import tty

from geometry_msgs.msg import Vector3, Vector3Stamped, Wrench, WrenchStamped
import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from timo_sim.scene.parameters import ParameterError, short

_HELP = b'arrows push the carrier, a and d turn the shaft; space pauses, r resets, q quits\n'
# By key: place in (force x, force y, torque), and sign. What arrow keys send ends with A to D.
_PUSHES = {'C': (0, 1.0), 'D': (0, -1.0), 'A': (1, 1.0), 'B': (1, -1.0),
           'a': (2, 1.0), 'd': (2, -1.0)}
_QUIT = 'q', '\x03', '\x04'  # Ctrl-C and Ctrl-D
# A terminal repeats a key that is held and does not say when it is released. The first push of a
# key therefore lasts until the first repetition, and each repetition prolongs it a little [s].
_FIRST_PUSH, _REPEATED_PUSH = 0.6, 0.2
_PERIOD = 0.05  # [s] between commands, and between lines
_STANDING_AFTER = 0.3   # [s] without a new stamp after which time is said to stand
_LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


@contextmanager
def _keys_at_once():
    """Make the terminal pass on each key at once, even Ctrl-C and Ctrl-Z; restore it after."""
    before = termios.tcgetattr(0)
    try:
        tty.setraw(0, termios.TCSADRAIN)
        yield
    finally:
        with suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(0, termios.TCSAFLUSH, before)


class _Teleop:
    """Turns keys into commands and calls, and shows what the node answers."""

    def __init__(self, name, force, torque):
        self.ends = False
        self._name, self._sizes = name, (force, force, torque)
        self._push, self._until, self._sent = 3 * [0.0], 3 * [0.0], 3 * [0.0]
        self._shaft = self._tip = math.nan  # [rad], [m]
        self._stamp, self._moved, self._answer = None, 0.0, ''
        node = rclpy.create_node('teleop')
        self._wrench = node.create_publisher(WrenchStamped, f'{name}/carrier_wrench', 10)
        self._torque = node.create_publisher(Float64, f'{name}/motor_torque', 10)
        self._pause = node.create_client(SetBool, f'{name}/pause')
        self._reset = node.create_client(Trigger, f'{name}/reset')
        node.create_subscription(JointState, f'{name.rpartition("/")[0]}/joint_states',
                                 self._see_joints, _LATEST)
        node.create_subscription(Vector3Stamped, f'{name}/tip_deflection', self._see_tip, _LATEST)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)

    def run(self):
        """Follow the keys until `ends` is set; then take all pushes back."""
        due = 0.0
        try:
            while not self.ends:
                self._executor.spin_once(timeout_sec=_PERIOD)
                now = time.monotonic()
                if select.select([0], [], [], 0.0)[0]:
                    for key in os.read(0, 64).decode('latin-1'):
                        self._press(key, now)
                if now >= due:
                    due = now + _PERIOD
                    self._send([push if now < until else 0.0
                                for push, until in zip(self._push, self._until)])
                    self._show(now)
        finally:
            if any(self._sent):
                self._send(3 * [0.0])
                for publisher in (self._wrench, self._torque):
                    publisher.wait_for_all_acked(Duration(seconds=1))
            self._executor.shutdown()  # before the context, or rclpy prints a traceback

    def _press(self, key, now):
        if key in _PUSHES:
            place, sign = _PUSHES[key]
            push = sign * self._sizes[place]
            repeated = push == self._push[place] and now < self._until[place]
            self._push[place] = push
            lasts = _REPEATED_PUSH if repeated else _FIRST_PUSH
            self._until[place] = max(self._until[place], now + lasts)
        elif key == ' ':
            self._call(self._pause, SetBool.Request(data=not self._stands(now)))
        elif key == 'r':
            self._call(self._reset, Trigger.Request())
        self.ends |= key in _QUIT

    def _send(self, push):
        x, y, torque = push
        if x or y or any(self._sent[:2]):
            self._wrench.publish(WrenchStamped(wrench=Wrench(force=Vector3(x=x, y=y))))
        if torque or self._sent[2]:
            self._torque.publish(Float64(data=torque))
        self._sent = push

    def _call(self, client, request):
        self._answer = ''
        client.call_async(request).add_done_callback(self._show_answer)

    def _show_answer(self, future):
        self._answer = future.result().message

    def _see_joints(self, message):
        if 'shaft' in message.name:
            self._shaft = message.position[message.name.index('shaft')]
        if message.header.stamp != self._stamp:
            self._stamp, self._moved = message.header.stamp, time.monotonic()

    def _see_tip(self, message):
        self._tip = message.vector.y

    def _stands(self, now):
        return now > self._moved + _STANDING_AFTER

    def _show(self, now):
        if self._stamp and self._torque.get_subscription_count():
            x, y, torque = self._sent
            # Adding 0.0 turns -0.0 into 0.0.
            shaft, tip = math.degrees(self._shaft), 1e3 * self._tip  # NaN: not known yet
            line = '   '.join([
                *[f'shaft {round(shaft, 1) + 0.0:7.1f} deg'] * (not math.isnan(shaft)),
                *[f'tip {round(tip, 1) + 0.0:6.1f} mm'] * (not math.isnan(tip)),
                f'push {x:g}, {y:g} N, {torque:g} N m',
                *['time stands'] * self._stands(now), self._answer])
        else:
            line = f'waiting for {self._name}: ros2 run timo_sim sim_node'
        width = shutil.get_terminal_size().columns - 1
        os.write(1, f'\r{line[:width]}\x1b[K'.encode())


def teleop(name: str, force: float, torque: float) -> None:
    """
    Let keys of the terminal, which is standard input, push a node until q or a signal.

    `name` is its full name, `force` [N] and `torque` [N m] are the sizes of pushes. Raises
    ParameterError if standard input is no terminal, or an argument breaks its rule; OSError if
    standard output cannot be written.
    """
    if not os.isatty(0):
        raise ParameterError('teleop needs a terminal as its standard input, to read keys from')
    for option, value, unit in (('--force', force, 'N'), ('--torque', torque, 'N m')):
        if not 0.0 < value < math.inf:
            raise ParameterError(f'{option} must be a finite number > 0 {unit}, got {value}')
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        teleop = _Teleop('/' + name.strip('/'), force, torque)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            signal.signal(number, lambda number, frame: setattr(teleop, 'ends', True))
        os.write(1, _HELP)
        with _keys_at_once():
            teleop.run()
        os.write(1, b'\n')
    except NameValidationException:
        raise ParameterError(
            f'--node must be the full name of a node, got {short(name)}') from None
    finally:
        rclpy.try_shutdown()
