"""Segments of a recorded run through a scene, and how far the motion is from what was logged."""

from dataclasses import dataclass
import math

import numpy as np

from timo_sim.commands import COMMANDS
from timo_sim.log.notes import CHANGE, change_note, RESET
from timo_sim.outputs import outputs, Snapshot, with_angles
from timo_sim.physics.formulation import LOADS
from timo_sim.simulation import DivergenceError, Simulator

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
        self._outputs = {output.name: output for output in outputs(scene.values['model.modes'])}

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
        held, load = np.zeros(LOADS), [0.0] * LOADS
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
                    snapshot = snapshot or Snapshot(simulator, load)
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
                COMMANDS[index].apply(values, held)
                if self._sink:
                    self._sink.command(index, step, simulator.nanoseconds, data)
                begun += 1
            following = min(following, commands[begun][0], changes[made][0], step + _BATCH)
            simulator.advance(following - step, held)
            load = simulator.load.tolist()
            report(following - step)


@dataclass(frozen=True)
class Difference:
    """
    How far the replay of a quantity is from its log.

    Attributes
    ----------
    name : str
        Topic and column.
    largest, rms : float
        In the unit that the column names.
    time : float
        When it is largest [s].

    """

    name: str
    largest: float
    rms: float
    time: float


def compare(segments, scene, columns):
    """
    Compare what was replayed with what was logged.

    Parameters
    ----------
    segments : list of Segment
    scene : Scene
    columns : dict
        Names of the quantities of each topic in the log.

    Returns
    -------
    count, other : int
        Numbers in the log, and how many are not the same to the last bit.
    list of Difference
        Of each quantity that log and replay have both.

    """
    count = other = 0
    result = []
    for output in outputs(scene.values['model.modes']):
        topic = output.name
        done = [segment for segment in segments
                if topic in segment.logged and topic in segment.replayed]
        if not done:
            continue
        parts = [slice(segment.done[topic]) for segment in done]
        time = scene.step * np.concatenate(
            [segment.samples[topic][part] for segment, part in zip(done, parts)])
        logged, replayed = (
            np.concatenate([getattr(segment, kind)[topic][part]
                            for segment, part in zip(done, parts)])
            for kind in ('logged', 'replayed'))
        count += logged.size
        other += (int(np.count_nonzero(logged.view('i8') != replayed.view('i8')))
                  if logged.shape == replayed.shape else logged.size)
        if len(time):
            result += _differences(topic, time, with_angles(columns[topic], logged),
                                   with_angles(output.columns, replayed))
    return count, other, result


def _differences(topic, time, logged, replayed):
    for column in [name for name in logged[0] if name in replayed[0]]:
        before, now = (values[:, columns.index(column)] for columns, values in (logged, replayed))
        distance = np.abs(now - before)
        place = int(np.argmax(distance))
        yield Difference(f'{topic.removeprefix("~/")} {column}', float(distance[place]),
                         float(np.sqrt(np.mean(distance**2))), float(time[place]))
