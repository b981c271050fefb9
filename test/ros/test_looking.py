# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A person at a running node: what RViz sees, `timo_sim send`, and keys of example/teleop.py."""

import contextlib
import os
from pathlib import Path
import pty
import re
import signal
import subprocess
import sys
import termios

import numpy as np
import pytest
from ros_process import nanoseconds, PATIENCE
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

import timo_sim
from timo_sim.log.tables import Recording
from timo_sim.ros.send import send
from timo_sim.simulation.simulator import Simulator
from timo_sim.topics.outputs import TRANSFORMS

ROOT = Path(__file__).resolve().parents[2]


def turn(half_sine, half_cosine):
    """Return the rotation in the plane of a quaternion."""
    cosine, sine = half_cosine**2 - half_sine**2, 2.0 * half_sine * half_cosine
    return np.array([[cosine, -sine], [sine, cosine]])


def test_the_frames_of_tf_lead_from_the_world_to_the_bent_tip(paper):
    """Their product gives the position and rotation of the tip of a run."""
    scene = timo_sim.load_scene(paper)
    simulator = Simulator(scene)
    simulator.advance(1810)  # where the arm is bent most
    x, y, *arm, along, across, tip_z, tip_w = TRANSFORMS.numbers(simulator.snapshot())
    run = timo_sim.simulate(scene, 1.81, sample_every=1810)
    assert abs(across - run.deflection(2.0)[-1, 1]) < 1e-14 and abs(across) > 0.08
    assert np.allclose([x, y] + turn(*arm) @ [along, across], run.position(2.0)[-1], atol=1e-14)
    angle = run.shaft[-1] + run.rotation(2.0)[-1]
    assert np.allclose(turn(*arm) @ turn(tip_z, tip_w) @ [1.0, 0.0],
                       [np.cos(angle), np.sin(angle)], atol=1e-14)


def test_the_links_of_tf_follow_the_centre_line(paper):
    """Each begins where the one before it ends, as near to the bent arm as a chord to its arc."""
    scene = timo_sim.load_scene(paper, {'initial.modal_coordinates': [1.2, -0.1, 0.0]})
    simulator = Simulator(scene)
    snapshot, links = simulator.snapshot(), TRANSFORMS.template['transforms'][4:]
    numbers = np.reshape(TRANSFORMS.unlogged(snapshot), (-1, 3))
    model, frame, place, rotation = scene.build(), 'arm', np.zeros(2), np.eye(2)
    ends = model.centre_line(snapshot.motion[np.newaxis, 3:6],
                             model.at(np.linspace(0.0, 2.0, len(links) + 1)))[0]
    assert ends[-1, 1] > 0.5 and len(links) == len(numbers) == 10
    for (along, z, w), link, end in zip(numbers, links, ends):
        assert link['header']['frame_id'] == frame
        frame, place = link['child_frame_id'], place + rotation @ [along, 0.0]
        rotation = rotation @ turn(z, w)
        # An arc of 0.2 m with a curvature of 0.5 / m is longer than its chord by 0.1 mm.
        assert np.linalg.norm(place - end) < 1e-3
    assert np.linalg.norm(place + rotation @ [0.2, 0.0] - ends[-1]) < 1e-3


LEFT, UP = b'\x1b[D', b'\x1bOA'  # as a terminal sends them, in its two modes


class Terminal:
    """A terminal in which example/teleop.py runs."""

    def __init__(self, *arguments, **streams):
        self.master, self.slave = pty.openpty()
        os.set_blocking(self.master, False)
        self.before, self._output = termios.tcgetattr(self.slave), b''
        self.process = subprocess.Popen(
            [sys.executable, ROOT / 'example/teleop.py', *arguments], start_new_session=True,
            **{'stdin': self.slave, 'stdout': self.slave, 'stderr': self.slave, **streams})

    def press(self, key):
        """
        Press a key, and read what is shown: a program whose terminal is full waits for ever.

        A terminal whose program does not read yet loses keys when it is full.
        """
        self.shown()
        with contextlib.suppress(BlockingIOError):
            os.write(self.master, key)

    def shown(self):
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
        self.process.kill()
        self.process.wait()
        for number in (self.master, self.slave):
            os.close(number)


@pytest.fixture
def terminal():
    terminals = []

    def start(*arguments, **streams):
        terminals.append(Terminal(*arguments, **streams))
        return terminals[-1]
    yield start
    for each in terminals:
        each.close()


def test_held_keys_push_until_they_are_released_or_the_program_ends(start, client, terminal):
    node = start('-r', '__ns:=/class', record=False)
    keys = terminal('--node', '/class/timo_sim', '--torque', '3', '--force', '7')
    states = client.collect(JointState, '/class/joint_states')

    def hold(key, joint, effort):
        """Hold a key, which the terminal repeats, until it acts."""
        def acts():
            keys.press(key)
            return states and states[-1].effort[joint] == effort
        client.wait(acts, f'{key} to act')

    for key, joint, effort in ((b'a', 2, 3.0), (b'd', 2, -3.0), (LEFT, 0, -7.0), (UP, 1, 7.0)):
        hold(key, joint, effort)
        client.wait(lambda: keys.shown() and states[-1].effort[joint] == 0.0, f'the end of {key}')
        assert states[-1].position[joint] != states[0].position[joint]
    hold(b'a', 2, 3.0)
    assert keys.end(lambda keys: keys.press(b'q')) == (0, True)
    client.wait(lambda: states[-1].effort[2] == 0.0, 'no torque')
    assert node.end()[0] == 0


def test_the_terminal_is_as_it_was_whatever_ends_it(client, terminal):
    """It ends by Ctrl-C, by signals, and by a closed pipe as output."""
    read, write = os.pipe()
    ends = {'Ctrl-C': (0, lambda keys: keys.press(b'\x03')),
            'a closed window': (0, lambda keys: keys.process.send_signal(signal.SIGHUP)),
            'kill': (0, lambda keys: keys.process.send_signal(signal.SIGTERM)),
            'error': (1, lambda keys: os.close(read))}
    started = {name: terminal(**({'stdout': write} if name == 'error' else {})) for name in ends}
    os.close(write)
    for name, (code, act) in ends.items():
        keys = started[name]
        client.wait(lambda: termios.tcgetattr(keys.slave) != keys.before, f'the start of {name}')
        if name != 'error':  # whose output is the pipe
            client.wait(lambda: 'waiting for /timo_sim' in keys.shown(), f'a line of {name}')
        assert keys.end(act) == (code, True), name


SENT = {'motor_torque': ('-15e-1', [-1.5, 0]),  # no number in YAML 1.1, which wants -15.0e-1
        'commands': ('[1, 2, -0.3]', [1, 2, 0, 0, -0.3, 0]),
        'tip_wrench': ('{header: {frame_id: arm}, wrench: {force: {x: 0.5}, torque: {z: 2}}}',
                       [0, 0, 0.5, 0, 2, 0, 0]),
        'carrier_acceleration': ('{vector: {y: -2}}', [0, -2]),
        'joint_command': ('{name: [shaft], effort: [4]}', 4 * [np.nan] + [4, 0])}


def test_a_command_is_sent_and_acknowledged_or_it_is_said_that_nobody_listens(start):
    node = start()
    said = {name: subprocess.Popen(
        [sys.executable, '-m', 'timo_sim', 'send', name, message, '--wait', str(patience)],
        text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) for name, message, patience in
        [*((name, message, PATIENCE) for name, (message, _) in SENT.items()),
         ('motor_voltage', '1', 0)]}
    told = {name: (each.communicate()[0], each.returncode) for name, each in said.items()}
    words, code = told.pop('motor_voltage')  # this motor has none
    assert code == 1 and '/timo_sim/motor_voltage has no subscriber' in words
    assert told == {name: (f'sent to /timo_sim/{name}; the node is running\n', 0) for name in SENT}
    assert node.end()[0] == 0
    topics = Recording(node.log).topics
    for name, (_, values) in SENT.items():
        assert np.array_equal(topics[f'~/{name}'].values, [values], equal_nan=True), name


def said(topic, message):
    """Return the exit code of `timo_sim send`, and what it says."""
    result = subprocess.run(
        [sys.executable, '-m', 'timo_sim', 'send', topic, message, '--wait', str(PATIENCE)],
        text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    return result.returncode, result.stdout.strip()


def test_what_a_sent_command_does_is_said(start, client):
    """Its frame must be one of this node, which is paused."""
    node = start('-p', 'frame.arm:=link', start_paused=True)
    sent = {topic: said(topic, message) for topic, message in (
        ('motor_torque', '2'),
        ('tip_wrench', '{header: {frame_id: link}, wrench: {force: {z: 1}}}'),
        ('joint_command', '{name: [elbow], effort: [1]}'))}
    for topic, (code, words) in sent.items():
        effect = {'motor_torque': '', 'tip_wrench': '; no effect of force.z: the arm moves in a '
                  'plane, the carrier without turning', 'joint_command': "; no effect: 'elbow' is "
                  "none of ('carrier_x', 'carrier_y', 'shaft')"}[topic]
        assert (code, words) == (0, f'sent to /timo_sim/{topic}{effect}; the node is paused: the '
                                 'command acts when it goes on, a reset drops it')
    code, words = said('tip_wrench', '{header: {frame_id: arm}, wrench: {force: {y: 1}}}')
    assert code == 2 and "frame_id must be empty, 'world', 'link' or 'tip', got 'arm'" in words
    states = client.collect(JointState, '/joint_states')
    assert client.service(SetBool, '/timo_sim/pause')(data=False).success
    client.wait(lambda: states and nanoseconds(states[-1]) > 10**7, 'time')
    assert 'refused' not in node.end()[1]
    topics = Recording(node.log).topics
    assert topics['~/motor_torque'].values.tolist() == [[2.0, 0.0]]
    assert topics['~/tip_wrench'].values.shape == (1, 7)


def test_of_a_node_that_diverged_it_is_said_that_it_needs_a_reset(start, client):
    node = start(record=False)
    assert said('motor_torque', '1.0e+300')[0] == 0
    client.wait(lambda: 'paused, ' in node.output(), 'the end of the motion')
    code, words = said('motor_torque', '0')
    assert code == 0 and re.search(
        'the node is paused, the state diverges .*: ~/reset goes back to the start and drops the '
        'command', words)


@pytest.mark.parametrize('topic, message, words', [
    ('torque', '1', 'TOPIC must be one of carrier_wrench, .* motor_voltage, got .torque.'),
    ('commands', '[1, 2]', 'got .*: data must have 3 elements, for carrier_x, .* got 2'),
    ('motor_torque', '.nan', 'takes a std_msgs/msg/Float64, in YAML .*: data must be finite'),
    ('motor_torque', '[1]', 'takes a std_msgs/msg/Float64, in YAML'),
    ('carrier_wrench', '{force: {x: 1}}', 'WrenchStamped has no field force'),
    ('tip_wrench', '{header: 1}', 'header of .* must be a std_msgs/msg/Header, got 1'),
    ('joint_command', '{name: [shaft, shaft], effort: [1, 2]}', 'hold joints, once each'),
    ('joint_command', '{name: [shaft], effort: [.nan]}', 'effort must be finite, got nan'),
    ('commands', '[0, .nan, 1]', 'every component must be finite, got nan'),
    ('motor_torque', '1e400', 'data must be finite, got inf'),
    ('motor_torque', 'much', "data of std_msgs/msg/Float64 must be a float64, got 'much'"),
    ('motor_torque', 'yes', 'data of std_msgs/msg/Float64 must be a float64, got True'),
    ('tip_wrench', '{wrench: {force: 3}}', 'force of .* must be a geometry_msgs/msg/Vector3'),
    ('tip_wrench', '{wrench: {force: {x: 1:30}}}', "x of .*Vector3 must be a float64, got '1:30'"),
    ('joint_command', '{name: shaft, effort: [1]}', "name of .* must be a list, got 'shaft'"),
    ('joint_command', '{name: [shaft], effort: 1}', 'effort of .* must be a list, got 1')])
def test_a_wrong_command_is_answered_by_what_is_right(topic, message, words):
    with pytest.raises(timo_sim.ParameterError, match=words):
        send(topic, message, '/timo_sim', 0.0)


def test_a_command_is_sent_to_a_full_name_alone():
    with pytest.raises(timo_sim.ParameterError, match="full name of a node, got '/a b'"):
        send('motor_torque', '1', '/a b', 0.0)
