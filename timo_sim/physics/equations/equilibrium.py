# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Where a manipulator is at rest under gravity and constant loads, however far its arm bends."""

import numpy as np

_SHIFT = 1e-5        # of differences [rad of the most turned section]
_FARTHEST = 0.3      # that a section turns from one iteration to the next [rad]
_CLOSE = 1e-12       # [rad]
_ITERATIONS = 400
_TIP_OVER = 1e-3     # by which an unstable equilibrium is left [rad]
_UNBALANCED = 1e-9   # force on a free carrier over all forces


def equilibrium(model, motion, load):
    """
    Return a motion at rest in which nothing accelerates, shape (2 (3 + N),).

    Found by following `u' = M^-1 F(u)` of the forces F on shaft and modes in implicit steps that
    grow (T48), pseudo-transient continuation (C. T. Kelley, D. E. Keyes, SIAM J. Numer. Anal. 35
    (1998) 508-523). It leads from the given motion downhill to an equilibrium that is stable.

    Parameters
    ----------
    model : Formulation
    motion : ndarray, shape (2 (3 + N),)
        Where to begin. The carrier and a driven shaft stay there.
    load : ndarray, shape (14,)
        See `physics.layout`.

    Raises
    ------
    ValueError
        If there is none: the text says what is not balanced.

    """
    axes, half = len(model.axes), len(model.linear) // 2
    mobility = model.linear[axes:half, half + axes:]
    unknown = slice(2 + model.first, model.size // 2)
    turn = np.append(1.0, model.section_turn)[model.first:]
    motion = np.concatenate([motion[:model.size // 2], np.zeros(model.size // 2)])

    def pull(at):
        state = model.state(at)
        return model.rate(state, load)[half:]

    def shifted(at, change):
        at = at.copy()
        at[unknown] += change
        return at

    time = None
    for _ in range(_ITERATIONS if len(turn) else 0):
        slope = mobility @ np.stack([
            (pull(shifted(motion, step)) - pull(shifted(motion, -step)))[axes:] / (2 * step.max())
            for step in np.diag(_SHIFT / turn)], axis=-1)
        flow = mobility @ pull(motion)[axes:]
        growth, directions = np.linalg.eig(slope)
        fastest = growth.real.max()
        if time is None:
            time = _FARTHEST / max(turn @ np.abs(flow), _CLOSE)
        if fastest > 0.0:
            time = min(time, 0.5 / fastest)
        while True:
            change = np.linalg.solve(np.eye(len(flow)) / time - slope, flow)
            if turn @ np.abs(change) <= _FARTHEST:
                break
            time *= 0.25
        motion[unknown] += change
        if turn @ np.abs(change) <= _CLOSE and fastest * time > 0.4:
            tipped = directions[:, np.argmax(growth.real)].real
            motion[unknown] += _TIP_OVER * tipped / (turn @ np.abs(tipped))
        elif turn @ np.abs(change) <= _CLOSE and time * max(
                np.abs(growth).min(), 1e-12 * np.abs(growth).max()) > 1e3:
            break
        time *= 4.0
    else:
        if len(turn):
            raise ValueError('no equilibrium was found: the shaft turns, or the arm bends, on and '
                             'on under these loads')
    force = pull(motion)[:axes]
    weights = np.abs(model.mass * model.gravity).sum() + np.abs(load).sum()
    for axis, left in zip(model.axes, force):
        if abs(left) > _UNBALANCED * weights:
            raise ValueError(f'there is none, because the carrier is free along {"xy"[axis]} and '
                             'the forces along it do not balance; hold it with carrier.held')
    return motion
