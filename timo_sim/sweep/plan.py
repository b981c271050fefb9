# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The file of a sweep: a scene, how long, and what varies."""

from dataclasses import dataclass
import hashlib
import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from timo_sim.scene.files import flatten
from timo_sim.scene.parameter import ParameterError, SCENE, whole_ratio
from timo_sim.scene.parameters import check, PARAMETERS
from timo_sim.scene.scene import load_scene, Scene
from timo_sim.version import __version__

_KINDS = ('runs', 'grid', 'random')
_ENTRIES = ('scene', 'parameters', 'duration', *_KINDS)


@dataclass(frozen=True)
class Plan:
    """
    What a sweep does.

    Attributes
    ----------
    scene : Scene
    duration : float
        [s]
    names : list of str
        The parameters that vary.
    count : int
        Number of runs.
    kind : str
        `runs`, `grid` or `random`.
    given : list or dict
        What the file says about these.

    """

    scene: Scene
    duration: float
    names: list
    count: int
    kind: str
    given: Any

    def variations(self):
        """Yield the overrides of each run, the same ones each time."""
        if self.kind == 'runs':
            yield from self.given
        elif self.kind == 'grid':
            for values in itertools.product(*self.given.values()):
                yield dict(zip(self.given, values))
        else:
            random = np.random.default_rng(self.given['seed'])
            for _ in range(self.count):
                yield {name: np.asarray(random.uniform(*ends)).tolist()
                       for name, ends in self.given['ranges'].items()}

    @property
    def fingerprint(self):
        """A text that differs for plans whose results may differ."""
        content = __version__, self.scene.values, self.duration, self.kind, self.given
        return hashlib.sha256(repr(content).encode()).hexdigest()


def read_plan(path):
    """
    Read and check the file of a sweep, see config/sweep.yaml.

    Raises
    ------
    ParameterError
        The text names file, entry and rule.
    OSError
        If a file cannot be read.

    """
    try:
        content = yaml.safe_load(Path(path).read_text(encoding='utf-8'))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ParameterError(f'{path} is not a YAML file: {error}') from None
    try:
        return _plan(content, Path(path).parent)
    except ParameterError as error:
        raise ParameterError(f'{error} ({path})') from None


def _plan(content, folder):
    if not isinstance(content, dict) or not set(content) <= set(_ENTRIES):
        shown = [*set(content) - set(_ENTRIES)] if isinstance(content, dict) else content
        raise ParameterError(f'a sweep has the entries {", ".join(_ENTRIES)}; got {shown!r}')
    kinds = [kind for kind in _KINDS if kind in content]
    if len(kinds) != 1 or 'scene' not in content:
        raise ParameterError('a sweep must have a scene and one of runs, grid, random; got '
                             + ', '.join(content))
    scene = content['scene']
    if not isinstance(scene, (str, dict)):
        raise ParameterError(f'scene must be the name of a file, or parameters, got {scene!r}')
    scene = load_scene(folder / scene if isinstance(scene, str) else scene,
                       _mapping('parameters', content.get('parameters') or {}))
    duration = _number('duration', content.get('duration'))
    whole_ratio('duration', duration, 'integrator.step', scene.step)
    kind = kinds[0]
    read = {'runs': _runs, 'grid': _grid, 'random': _random}[kind]
    names, count = read(content[kind])
    return Plan(scene, duration, names, count, kind, content[kind])


def _runs(given):
    if not isinstance(given, list) or not given:
        raise ParameterError(f'runs must be a list of sets of parameters, got {given!r}')
    for run, values in enumerate(given):
        _check(f'runs[{run}]', flatten(_mapping(f'runs[{run}]', values)))
    names = dict.fromkeys(name for values in given for name in flatten(values))
    return list(names), len(given)


def _grid(given):
    for name, values in _mapping('grid', given).items():
        if not isinstance(values, list) or not values:
            raise ParameterError(f'grid: {name} must be a list of values, got {values!r}')
        for value in values:
            _check('grid', {name: value})
    return list(given), math.prod(len(values) for values in given.values())


def _random(given):
    if set(_mapping('random', given)) != {'seed', 'count', 'ranges'}:
        raise ParameterError(f'random must have seed, count and ranges, got {list(given)}')
    for name in ('seed', 'count'):
        if type(given[name]) is not int or given[name] < (name == 'count'):
            raise ParameterError(f'random: {name} must be a whole number >= '
                                 f'{int(name == "count")}, got {given[name]!r}')
    for name, ends in _mapping('random: ranges', given['ranges']).items():
        try:
            low, high = np.array(ends, dtype=float)
        except (TypeError, ValueError):
            raise ParameterError(f'random: {name} must have a lower and an upper end, numbers or '
                                 f'lists of as many numbers, got {ends!r}') from None
        if not np.all(low <= high):
            raise ParameterError(f'random: {name} must have ends in ascending order, got {ends!r}')
        for end in ends:
            _check('random', {name: end})
    return list(given['ranges']), given['count']


def _mapping(entry, given):
    if not isinstance(given, dict):
        raise ParameterError(f'{entry} must be parameters with values, got {given!r}')
    return given


def _number(entry, given):
    try:
        number = float(given) if not isinstance(given, bool) else math.nan
    except (TypeError, ValueError):
        number = math.nan
    if not 0.0 < number < math.inf:
        raise ParameterError(f'{entry} must be a finite number > 0 s, got {given!r}')
    return number


def _check(entry, values):
    check(values, entry)
    for name in values:
        if PARAMETERS[name].scope != SCENE:
            raise ParameterError(f'{name} is a parameter of the node, not of the scene ({entry})')
