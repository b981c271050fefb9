# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The track of a plain bag: the shape of the arm from what is published."""

import numpy as np

from timo_sim.physics.layout import rotate
from timo_sim.view.track import Body, joint_traces, POINTS, Poses, span, Trace, Track, TrackError


def of_bag(recording, name, joints):
    """Return the track of a bag, see `motion_track.of_recording`."""
    # The shape from what is published: a cubic along the shaft at the root, along the section at
    # the tip.
    topics = '~/tip_pose', '~/tip_deflection'
    tip, bend = map(recording.read(*topics).get, topics)
    if tip is None or bend is None or not len(tip.ns) or not len(bend.ns):
        raise TrackError(f'{recording.path}: the shape of the arm needs tip_pose and '
                         'tip_deflection, or a log of the node with modal_state')

    # Messages may have come in another order.
    (joint_ns, joints), (tip_ns, place), (bend_ns, bend) = (
        (series.ns[order], series.values[order]) for series, order in (
            (series, np.argsort(series.ns, kind='stable')) for series in (joints, tip, bend)))

    def at_tip(ns, values):
        return np.column_stack([np.interp(tip_ns, ns, column) for column in values.T])

    motion, across = at_tip(joint_ns, joints), at_tip(bend_ns, bend)
    rotation = 2.0 * np.arctan2(place[:, 2], place[:, 3]) - motion[:, 2]
    rotation = (rotation + np.pi) % (2.0 * np.pi) - np.pi
    along = np.column_stack(rotate(-motion[:, 2], *(place[:, :2] - motion[:, :2]).T))
    length = float(np.median(along[:, 0] - across[:, 0]))
    share = np.linspace(0.0, 1.0, POINTS)
    reach, begin, end = 3 * share**2 - 2 * share**3, share - 2 * share**2 + share**3, (
        share**3 - share**2)

    def poses(part):
        slope = length * np.column_stack([np.cos(rotation[part]), np.sin(rotation[part])])
        bent = (along[part][:, np.newaxis] * reach[:, np.newaxis]
                + np.array([length, 0.0]) * begin[:, np.newaxis]
                + slope[:, np.newaxis] * end[:, np.newaxis])
        line = np.stack(rotate(motion[part, 2][:, np.newaxis], bent[..., 0], bent[..., 1]),
                        axis=-1)
        return Poses(motion[part, np.newaxis, :2] + line, motion[part, 2], motion[part, 6:9])

    def trace(panel, names, values):
        return Trace(panel, names, joint_ns, values)

    traces = [
        Trace('tip_deflection', ('w',), bend_ns, lambda part: bend[part, 1:2]),
        Trace('tip_axial', ('u',), bend_ns, lambda part: bend[part, :1]),
        Trace('tip_rotation', ('phi',), tip_ns, rotation[:, np.newaxis].__getitem__),
        *joint_traces(trace, joints[:, :3], joints[:, 3:6], joints[:, 6:9])]
    body = Body(length, 0.01 * length, 0.06 * length, 0.066 * length, 0.056 * length)
    note = (f'{span(tip_ns)}. No modal coordinates are on this bag: **the shape of the arm is a '
            'cubic from root to tip pose**, its bodies have no true size, energy is not known.')
    return Track(name, tip_ns, poses, traces, body, note)
