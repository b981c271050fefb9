# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""`timo_sim teleop` on a terminal of its own (a pty), with a real node."""

import os
import pty
import signal
import subprocess
import sys
import termios

import pytest
from ros_process import PATIENCE
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

LEFT, UP = b'\x1b[D', b'\x1bOA'  # as a terminal sends them, in its two modes


class Terminal:
    """A terminal in which `timo_sim teleop` runs."""

    def __init__(self, *arguments, **streams):
        self.master, self.slave = pty.openpty()
        os.set_blocking(self.master, False)
        self.before, self._output = termios.tcgetattr(self.slave), b''
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'timo_sim', 'teleop', *arguments], start_new_session=True,
            **{'stdin': self.slave, 'stdout': self.slave, 'stderr': self.slave, **streams})

    def press(self, key):
        """Press a key once."""
        os.write(self.master, key)

    def shown(self):
        """Return all that was shown so far."""
        try:
            while part := os.read(self.master, 65536):
                self._output += part
        except BlockingIOError:
            return self._output.decode()

    def line(self):
        """Return the present content of the status line."""
        return self.shown().rpartition('\r')[2]

    def end(self, act):
        """Call `act`, wait for the end; return exit code and whether the terminal was restored."""
        assert termios.tcgetattr(self.slave) != self.before
        act(self)
        code = self.process.wait(PATIENCE)
        return code, termios.tcgetattr(self.slave) == self.before

    def close(self):
        """End the process if it still runs."""
        self.process.kill()
        self.process.wait()
        for number in (self.master, self.slave):
            os.close(number)


@pytest.fixture
def terminal():
    """Return a function that starts teleop in a terminal."""
    terminals = []

    def start(*arguments, **streams):
        terminals.append(Terminal(*arguments, **streams))
        return terminals[-1]
    yield start
    for each in terminals:
        each.close()


def test_held_keys_push_and_other_keys_pause_reset_and_quit(start, client, terminal):
    node = start('-r', '__ns:=/class', record=False)
    keys = terminal('--node', 'class/timo_sim', '--torque', '3', '--force', '7')
    states = client.collect(JointState, '/class/joint_states')

    def hold(key, joint, effort):
        """Hold a key, which the terminal repeats, until it acts."""
        def acts():
            keys.press(key)
            return states and states[-1].effort[joint] == effort
        client.wait(acts, f'{key} to act')

    for key, joint, effort in ((b'a', 2, 3.0), (b'd', 2, -3.0), (LEFT, 0, -7.0), (UP, 1, 7.0)):
        hold(key, joint, effort)
        client.wait(lambda: states[-1].effort[joint] == 0.0, f'the end of {key}')
        assert states[-1].position[joint] != states[0].position[joint]
    assert 'arrows push the carrier' in keys.shown() and 'nan' not in keys.shown()
    client.wait(lambda: 'deg   tip' in keys.line() and 'mm   push' in keys.line(), 'the state')

    keys.press(b' ')
    client.wait(lambda: 'time stands   paused' in keys.line(), 'the pause')
    keys.press(b' ')
    client.wait(lambda: 'N m   running' in keys.line(), 'the end of the pause')
    keys.press(b'r')
    client.wait(lambda: 'reset at step' in keys.line(), 'the reset')
    # Forces that act when it ends fall to zero, too.
    hold(b'a', 2, 3.0)
    assert keys.end(lambda keys: keys.press(b'q')) == (0, True)
    client.wait(lambda: states[-1].effort[2] == 0.0, 'no torque')
    assert node.end()[0] == 0


def test_what_is_not_known_yet_is_not_shown(client, terminal):
    """Joint states have come, but those of another robot, and no deflection of the tip."""
    states = client.create_publisher(JointState, '/joint_states', 10)
    client.create_subscription(Float64, '/timo_sim/motor_torque', lambda message: None, 10)
    keys, state = terminal(), JointState(name=['elbow'], position=[1.0])

    def shown():
        states.publish(state)
        return 'push' in keys.line()
    client.wait(shown, 'a line')
    state.name = ['shaft']
    client.wait(lambda: shown() and 'shaft' in keys.line(), 'the shaft')
    assert 'shaft    57.3 deg   push 0, 0 N' in keys.line() and 'nan' not in keys.shown()


def test_the_terminal_is_as_it_was_whatever_ends_it(client, terminal):
    """It ends by Ctrl-C, by signals, and by a closed pipe as output."""
    read, write = os.pipe()
    ends = {'Ctrl-C': (0, lambda keys: keys.press(b'\x03')),
            'a closed window': (0, lambda keys: keys.process.send_signal(signal.SIGHUP)),
            'kill': (0, lambda keys: keys.process.send_signal(signal.SIGTERM)),
            'error': (128 + signal.SIGPIPE, lambda keys: os.close(read))}
    started = {name: terminal(**({'stdout': write} if name == 'error' else {})) for name in ends}
    os.close(write)
    for name, (code, act) in ends.items():
        keys = started[name]
        client.wait(lambda: termios.tcgetattr(keys.slave) != keys.before, f'the start of {name}')
        assert keys.end(act) == (code, True), name
        assert 'Traceback' not in keys.shown()
    assert 'waiting for /timo_sim' in started['Ctrl-C'].shown()


def test_without_a_terminal_or_with_wrong_options_it_ends_with_one_line(terminal):
    refused = [(terminal(option, value), words) for option, value, words in (
        ('--force', 'nan', '--force must be a finite number > 0 N, got nan'),
        ('--node', '/a b', "--node must be the full name of a node, got '/a b'"))]
    result = subprocess.run([sys.executable, '-m', 'timo_sim', 'teleop'], input='q', text=True,
                            capture_output=True)
    assert result.returncode == 2 and result.stdout == '' and result.stderr.count('\n') == 1
    assert 'teleop needs a terminal as its standard input' in result.stderr
    for keys, words in refused:
        assert keys.process.wait(PATIENCE) == 2
        assert words in keys.shown() and keys.shown().count('\n') == 1
