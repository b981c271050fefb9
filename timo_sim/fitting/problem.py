# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""Predictions of a record by runs of a scene, and their distance from it."""

from __future__ import annotations

from dataclasses import dataclass
import math
import warnings

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from timo_sim.fitting.free import free_parameters, SENSOR
from timo_sim.fitting.inputs import limited, loads_of
from timo_sim.fitting.quantities import DRIVE, OUTPUTS
from timo_sim.runs.sampled import sampled_run
from timo_sim.scene.numbers import INITIAL, initial_names, placed
from timo_sim.scene.parameter import ModelWarning, ParameterError
from timo_sim.simulation.model_warnings import DivergenceError

_NEAR = 1e-6      # [steps] distance from a step within which a sample is at it
_MOST_STEPS = 1e7
_LOST = 1e3       # residual, in standard deviations, of a run that diverges


@dataclass(frozen=True)
class Window:
    """A part of a record that is predicted from an initial state of its own."""

    begin: float    # [s]
    end: float      # [s], excluded but for the last window
    names: tuple    # of the free parameters of its initial state; empty: that of the scene


class Problem:
    """
    A record, the scene that shall predict it, and the parameters that are free.

    Parameters
    ----------
    scene : Scene
    record : Record
    names : sequence of str
    bounds : dict
    until : float
        End of the part to which the parameters are fitted [s].
    window : float, optional
        Length of windows that are predicted from initial states of their own [s].

    Attributes
    ----------
    free : list of Free
    windows : list of Window

    """

    def __init__(self, scene, record, names, bounds, until, window=None):
        if DRIVE in record.inputs and scene.values['motor.shaft'] != 'driven':
            scene = scene.vary({'motor.shaft': 'driven', 'motor.drive': {
                'time': [0.0], 'angle': [0.0], 'speed': [0.0], 'acceleration': [0.0]}})
        if DRIVE not in record.inputs and scene.values['motor.shaft'] == 'driven' and (
                window or not scene.load.drive):
            raise ParameterError('motor.shaft = driven needs a record of the input drive')
        if record.duration > _MOST_STEPS * scene.step:
            raise ParameterError(f'the record lasts {record.duration:g} s, but at most '
                                 f'{_MOST_STEPS:g} steps of {scene.step:g} s are fitted: cut it, '
                                 'if the unit of its times is right')
        self.scene, self.until = scene, until
        self.record = limited(record, scene.values)
        self.free = free_parameters(names, bounds, scene, record)
        self.windows = [Window(0.0, until, ())]
        self._own = {name for name in initial_names(scene)} if window else set()
        if window:
            self._divide(window)
        still = not (scene.load or scene.load.drive or scene.initial_motion()[3:].any()
                     or scene.build().gravity.any())
        if still and not record.inputs and not any(name.startswith(INITIAL) for name in names):
            raise ParameterError('nothing moves the arm: the record has no input, and the scene '
                                 'no load, no motion at the beginning and no gravity')

    def _divide(self, window):
        if self.scene.load or self.scene.payloads or self.scene.values['initial.equilibrium']:
            raise ParameterError('windows need a scene without loads, payloads and '
                                 'initial.equilibrium of its own, which have their times')
        fixed = [free.name for free in self.free if free.name in self._own]
        if fixed:
            raise ParameterError(f'{fixed[0]} cannot be free with windows, which have initial '
                                 'states of their own')
        if not window >= 10.0 * self.scene.step:
            raise ParameterError('window must be at least ten steps, '
                                 f'{10.0 * self.scene.step:g} s, got {window:g}')
        count = max(1, round(self.until / window))
        edges = self.scene.step * np.rint(
            np.linspace(0.0, self.until, count + 1) / self.scene.step)
        names = tuple(initial_names(self.scene))
        self.windows = [Window(begin, end, names) for begin, end in zip(edges, edges[1:])]

    def values(self, x):
        """Return the values of the free parameters, by name, for coordinates of the fit."""
        return {free.name: free.value(each) for free, each in zip(self.free, x)}

    def scene_of(self, values, initial=None):
        """Return the scene with free values, and an initial state, without the record's loads."""
        own = {name: value for name, value in values.items() if not self._is_sensor(name)}
        return self.scene.vary(placed({**own, **(initial or {})}, self.scene))

    def _is_sensor(self, name):
        quantity, _, kind = name.rpartition('.')
        return kind in SENSOR and (quantity in self.record.inputs
                                   or quantity in self.record.outputs)

    def run(self, values, begin=0.0, end=None, initial=None, scene=None):
        """
        Return the Run that predicts a part of the record.

        Parameters
        ----------
        values : dict
            Free values by name.
        begin, end : float
            In the record [s]; by default all of it.
        initial : dict, optional
            Values of the initial state, by name.
        scene : Scene, optional
            By default `scene_of(values, initial)`.

        Raises
        ------
        DivergenceError
            If the run diverges.
        ParameterError
            If the values do not fit together.

        """
        scene = scene or self.scene_of(values, initial)
        scene = scene.with_load(loads_of(self.record, scene, self.sensor(values), begin))
        duration = (self.record.duration if end is None else end) - begin + self._latest(values)
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', ModelWarning)
            return sampled_run(scene, max(1, math.ceil(duration / scene.step - _NEAR)))

    def _latest(self, values):
        return max(0.0, *(-values.get(f'{name}.delay', 0.0) for name in self.record.outputs))

    @staticmethod
    def sensor(values):
        """Return a function of quantity and kind: the gain, bias or delay of a sensor."""
        return lambda name, kind: values.get(f'{name}.{kind}', SENSOR[kind])

    def predictions(self, run, values, begin=0.0, end=math.inf):
        """Return what each output should show at its samples in a part: by name, times, values."""
        sensor, found = self.sensor(values), {}
        for name, channel in self.record.outputs.items():
            t = channel.t[samples(channel.t, begin, end, self.until)]
            seen = _lagging(OUTPUTS[name].of_run(run), sensor(name, 'lag') / run.scene.step)
            found[name] = t, sensor(name, 'gain') * _at(
                t - begin - sensor(name, 'delay'), run, seen) + sensor(name, 'bias')
        return found

    def residuals(self, values, deviations, window, initial=None):
        """
        Return the residuals of a window, in standard deviations, all outputs after each other.

        A run that diverges has large ones.
        """
        measured = self.measured(window)
        try:
            run = self.run(values, window.begin, window.end, initial)
            predicted = self.predictions(run, values, window.begin, window.end)
        except (DivergenceError, ParameterError):
            return np.full(sum(map(len, measured.values())), _LOST)
        return np.concatenate([(predicted[name][1] - measured[name]) / deviations[name]
                               for name in measured])

    def measured(self, window):
        """Return the measured samples of a window, by output."""
        return {name: channel.values[samples(channel.t, window.begin, window.end, self.until)]
                for name, channel in self.record.outputs.items()}


def samples(t, begin, end, until):
    """Return where times are in a part from `begin` to `end`, which ends after it at `until`."""
    return (t >= begin) & ((t < end) | (t <= end if end == until else False))


def _lagging(values, lag):
    """Return what a sensor of first order shows, with a time constant in steps."""
    if lag <= 0.0:
        return values
    # Exact for straight lines between the samples; it begins at rest.
    fade = math.exp(-1.0 / lag)
    old, new = lag * (1.0 - fade) - fade, 1.0 - lag * (1.0 - fade)
    return lfilter([new, old], [1.0, -fade], values, zi=[values[0] * (1.0 - new)])[0]


def _at(times, run, values):
    """Return a quantity of a run at times, shape (n,) [s]."""
    position = times / run.scene.step
    whole = np.rint(position)
    if np.abs(position - whole).max(initial=0.0) <= _NEAR:
        return values[np.clip(whole, 0, len(values) - 1).astype(int)]
    if len(values) < 4:
        return np.interp(times, run.t, values)
    # A run shows nothing from before it begins but its first motion.
    return CubicSpline(run.t, values)(np.clip(times, 0.0, run.t[-1]))
