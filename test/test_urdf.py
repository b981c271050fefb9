# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""`timo_sim urdf`, read by the URDF parser of ROS."""

from pathlib import Path
import shutil
import subprocess

from command_line import call
import numpy as np
import pytest

import timo_sim

urdf_parser_py = pytest.importorskip('urdf_parser_py.urdf')

URDF = Path(__file__).resolve().parents[1] / 'timo_sim/scene/timo_sim.urdf'
TAPERED = {'arm.profile.position': [0.0, 2.0], 'arm.profile.height': [0.06, 0.02],
           'carrier.mass': 7.0, 'motor.mass': 3.0, 'end_effector.mass': 0.5, 'hub.radius': 0.1}


def urdf(scene, changes=None, code=0):
    """Return the output of the command for a scene with some parameters changed."""
    settings = [text for name, value in (changes or {}).items()
                for text in ('--set', f'{name}={value}')]
    told = call('urdf', scene, *settings, code=code)
    return told[max(0, told.find('<?xml')):]  # after warnings on stderr


@pytest.mark.parametrize('name, changes', [
    ('paper', {}), ('paper', TAPERED), ('spin_up', {}),
    ('arm', {'arm.section.shape': 'tube', 'arm.section.wall': 0.001})])
def test_bodies_move_as_those_of_the_model(name, changes):
    """Energy and momentum of the straight arm, which turns and moves along y, are the same."""
    robot = urdf_parser_py.URDF.from_xml_string(urdf(name, changes).encode())
    carrier, arm, tip = (robot.link_map[link].inertial for link in ('carrier', 'arm', 'tip'))
    length = robot.joint_map['tip'].origin.xyz[0]
    bodies = [(carrier.mass, carrier.origin.xyz[0]), (arm.mass, arm.origin.xyz[0]),
              (tip.mass, length + tip.origin.xyz[0])]
    total, first, second = (sum(mass * x**power for mass, x in bodies) for power in range(3))
    speed, turning = 3.0, 2.0
    scene = timo_sim.load_scene(name, changes)
    motion = np.zeros(2 * (3 + scene.modal_count))
    motion[len(motion) // 2 + 1:][:2] = speed, turning  # along y, across the arm
    model = scene.build()
    kinetic = 0.5 * (total * speed**2 + (second + arm.inertia.izz + tip.inertia.izz) * turning**2
                     ) + first * speed * turning
    assert kinetic == pytest.approx(model.energy(motion[np.newaxis])[0], rel=1e-8)  # 9 digits
    assert total * speed + first * turning == pytest.approx(
        model.momentum(motion[np.newaxis])[0, 1], rel=1e-8)
    assert length == pytest.approx(scene.values['hub.radius'] + scene.values['arm.length'])
    for body in carrier, arm, tip:  # a rigid body has such moments of inertia
        moments = sorted([body.inertia.ixx, body.inertia.iyy, body.inertia.izz])
        assert 0.0 <= moments[2] <= moments[0] + moments[1]


def test_joints_topics_and_the_file_that_is_installed(tmp_path):
    printed = urdf('paper')
    assert printed == URDF.read_text()
    robot = urdf_parser_py.URDF.from_xml_string(printed.encode())
    links = {name: joint.type for name, joint in robot.joint_map.items() if 'arm_' in name}
    assert links == {f'arm_{number}': 'fixed' for number in range(1, 11)}
    assert {name: joint.type for name, joint in robot.joint_map.items() if name not in links} == {
        'carrier_x': 'prismatic', 'carrier_y': 'prismatic', 'shaft': 'continuous', 'tip': 'fixed'}


def test_links_are_the_frames_of_the_scene(tmp_path):
    (tmp_path / 'left.yaml').write_text('timo_sim: {ros__parameters: {frame_prefix: left/}}')
    printed = urdf(tmp_path / 'left.yaml', {'frame.world': 'odom'})
    robot = urdf_parser_py.URDF.from_xml_string(printed.encode())
    assert robot.get_root() == 'odom'
    assert robot.get_chain('odom', 'left/tip', joints=False) == [
        'odom', 'left/carrier_rail', 'left/carrier', 'left/arm', 'left/tip']
    if shutil.which('check_urdf'):  # the parser in C++
        (tmp_path / 'left.urdf').write_text(printed)
        told = subprocess.run(['check_urdf', tmp_path / 'left.urdf'], capture_output=True,
                              text=True)
        assert told.returncode == 0 and 'root Link: odom' in told.stdout, told.stderr


REFUSED = [
    ('papper', {}, 'did you mean paper?'),
    ('paper', {'arm.length': -1.0}, 'arm.length must be a finite number > 0 m, got -1.0'),
    ('paper', {'frame.tip': 'arm'}, 'must differ')
]


def test_an_invalid_scene_gives_one_line_and_code_2():
    for scene, changes, words in REFUSED:
        text = urdf(scene, changes, code=2)
        assert words in text and text.count('\n') == 1
