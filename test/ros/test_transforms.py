# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The frames on /tf; conftest.py skips this file where tf2_msgs is not installed."""

import math
from pathlib import Path
import xml.etree.ElementTree as ElementTree

import numpy as np
from tf2_msgs.msg import TFMessage

import timo_sim

URDF = Path(__file__).resolve().parents[2] / 'timo_sim/scene/timo_sim.urdf'


def test_a_node_turns_the_frames_with_the_shaft_and_the_tip(start, client, paper):
    node = start('--params-file', str(paper), publish_tf=True, **{'rate.tf': 100.0})
    messages = client.collect(TFMessage, '/tf')
    client.wait(lambda: len(messages) > 30, 'frames')
    code, output = node.end()
    assert code == 0, output
    links = {link.get('name') for link in ElementTree.parse(URDF).getroot().findall('link')}
    last = messages[-1].transforms[0].header.stamp
    run = timo_sim.simulate(timo_sim.load_scene(paper), last.sec + 1e-9 * last.nanosec)
    for frames in messages:
        names = [(frame.header.frame_id, frame.child_frame_id) for frame in frames.transforms]
        assert names[:4] == [('world', 'carrier_rail'), ('carrier_rail', 'carrier'),
                             ('carrier', 'arm'), ('arm', 'tip')]
        assert {name for pair in names for name in pair} == links
        stamps = {(frame.header.stamp.sec, frame.header.stamp.nanosec)
                  for frame in frames.transforms}
        (sec, nanosec), = stamps
        step = round(1e3 * (sec + 1e-9 * nanosec))
        assert step % 10 == 0
        rail, carrier, arm, tip = (frame.transform for frame in frames.transforms[:4])
        assert [rail.translation.x, carrier.translation.y] == run.carrier[step].tolist()
        assert carrier.rotation.w == 1.0 and arm.translation.x == arm.translation.y == 0.0
        for turned, angle in ((arm, run.shaft[step]), (tip, run.rotation(2.0)[step])):
            assert abs(2.0 * math.atan2(turned.rotation.z, turned.rotation.w) - angle) < 1e-13
        place = run.deflection(2.0)[step] + [2.0, 0.0]
        assert np.allclose([tip.translation.x, tip.translation.y], place, rtol=0, atol=1e-14)


def test_a_paused_node_shows_its_frames_by_their_names(start, client):
    start(start_paused=True, publish_tf=True, record=False, frame_prefix='left/')
    messages = client.collect(TFMessage, '/tf')
    client.wait(lambda: len(messages) > 1, 'frames, again')
    assert messages[-1] == messages[0]
    frames = [(frame.header.frame_id, frame.child_frame_id) for frame in messages[0].transforms]
    assert frames[:4] == [
        ('world', 'left/carrier_rail'), ('left/carrier_rail', 'left/carrier'),
        ('left/carrier', 'left/arm'), ('left/arm', 'left/tip')]
