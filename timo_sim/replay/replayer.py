# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Segments of a recorded run, done again in a scene."""

import math

import numpy as np

from timo_sim.log.notes import CHANGE, change_note, RESET
from timo_sim.messages.commands import COMMANDS
from timo_sim.messages.outputs import outputs
from timo_sim.physics.layout import LOADS
from timo_sim.simulation.model_warnings import DivergenceError
from timo_sim.simulation.simulator import Simulator

_BATCH = 500  # steps of one compiled call at most


class Replay:
    """
    Runs segments through a scene.

    Parameters
    ----------
    scene : Scene
    segments : list of Segment
        Filled with what was replayed.
    sink : object, optional
        Gets the new log: `command(index, step, nanoseconds, data)`,
        `output(name, snapshot, numbers)` and `note(name, values)`.

    Attributes
    ----------
    simulator : Simulator
    diverged : str or None
        Why the replay ended early.

    """

    def __init__(self, scene, segments, sink=None):
        self.simulator = Simulator(scene)
        self.simulator.warm_up()
        self.diverged = None
        self._segments, self._sink = segments, sink
        self._outputs = {output.name: output for output in outputs(scene.modal_count)}

    def run(self, report=lambda count: None):
        """Do it; `report` receives how many further steps are done."""
        for number, segment in enumerate(self._segments):
            if number:
                self.simulator.reset()
                if self._sink:
                    self._sink.note(RESET, {'step': str(self.simulator.steps)})
            try:
                self._run(segment, report)
            except DivergenceError as error:
                self.diverged = str(error)
                break

    def _run(self, segment, report):
        commanded, load = np.zeros(LOADS), [0.0] * LOADS
        topics = [(name, self._outputs[name], segment.samples[name].tolist() + [math.inf])
                  for name in self._outputs if name in segment.samples]
        for name, output, steps in topics:
            segment.replayed[name] = np.empty((len(steps) - 1, len(output.columns)))
            segment.done[name] = 0
        commands, begun = [*segment.commands, (math.inf,)], 0
        changes, made = [*segment.changes, (math.inf,)], 0
        simulator = self.simulator
        while True:
            step, snapshot, following = simulator.steps, None, segment.last
            for name, output, steps in topics:
                place = segment.done[name]
                while steps[place] == step:
                    snapshot = snapshot or simulator.snapshot(load)
                    numbers = output.numbers(snapshot)
                    segment.replayed[name][place] = numbers
                    if self._sink:
                        self._sink.output(name, snapshot, numbers)
                    segment.done[name] = place = place + 1
                following = min(following, steps[place])
            while changes[made][0] <= step:
                values = changes[made][1]
                simulator.change(simulator.scene.vary(values))
                if self._sink:
                    self._sink.note(CHANGE, change_note(step, values))
                made += 1
            if step >= segment.last:
                return
            while commands[begun][0] <= step:
                _, index, values, data = commands[begun]
                COMMANDS[index].apply(values, commanded)
                if self._sink:
                    self._sink.command(index, step, simulator.nanoseconds, data)
                begun += 1
            following = min(following, commands[begun][0], changes[made][0], step + _BATCH)
            simulator.advance(following - step, commanded)
            load = simulator.load.tolist()
            report(following - step)
