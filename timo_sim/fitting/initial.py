# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""First guesses of the initial states of windows of a record."""

import numpy as np

from timo_sim.fitting.free import free_parameters
from timo_sim.simulation.model_warnings import DivergenceError

_NEAREST = 5  # samples to each side from which the angle and speed of the shaft are taken


def initial_states(problem, values):
    """
    Return the Free parameters of the initial state of each window, a list of lists.

    They begin with the motion of one run, and the shaft where the record shows it.
    """
    try:
        run = problem.run(values, 0.0, problem.until)
    except DivergenceError as error:
        run = error.run
    found = []
    for window in problem.windows:
        motion = run.motion[min(round(window.begin / run.scene.step), len(run.t) - 1)]
        half = len(motion) // 2
        guess = dict(zip(('initial.carrier_x', 'initial.carrier_y', 'initial.shaft'), motion))
        guess |= dict(zip((f'{name}_velocity' for name in [*guess]), motion[half:half + 3]))
        guess |= _measured(problem, window.begin, values)
        scene = problem.scene.vary({
            **{name: float(value) for name, value in guess.items() if name in window.names},
            'initial.modal_coordinates': motion[3:half], 'initial.modal_rates': motion[half + 3:]})
        found.append(free_parameters(window.names, {}, scene, problem.record))
    return found


def _measured(problem, begin, values):
    channel = problem.record.outputs.get('shaft')
    if channel is None:
        return {}
    sensor = problem.sensor(values)
    t = channel.t - begin - sensor('shaft', 'delay')
    place = np.searchsorted(t, 0.0)
    near = slice(max(0, place - _NEAREST), place + _NEAREST + 1)
    speed, angle = np.polyfit(t[near], (channel.values[near] - sensor('shaft', 'bias'))
                              / sensor('shaft', 'gain'), 1)
    return {'initial.shaft': angle, 'initial.shaft_velocity': speed}
