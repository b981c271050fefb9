# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The function `fit` and its result: fitted parameters, their intervals, and what they predict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
import math
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np

from timo_sim.extras import optional
from timo_sim.fitting.auto import choose, plain
from timo_sim.fitting.logs import read_log
from timo_sim.fitting.look import begin_with, look, noise_of, turned
from timo_sim.fitting.mapping import read_record
from timo_sim.fitting.objective import LOSSES, MANY, Objective
from timo_sim.fitting.record import INPUT_UNITS, Record, unit_of
from timo_sim.fitting.problem import (
    covariance, names_for, NORMAL, r_squared, split_guess, unidentified_combinations, whiteness)
from timo_sim.fitting.posterior import Posterior, Samples
from timo_sim.fitting.response import problem_of, Response
from timo_sim.fitting.search import INTERRUPTED, NUMERICAL, Search
from timo_sim.fitting.suspects import name_suspects, Suspect, suspects
from timo_sim.log.columns import SUFFIXES
from timo_sim.runs.run import Run
from timo_sim.scene.files import scene_text, whole_file
from timo_sim.scene.numbers import INITIAL
from timo_sim.scene.parameters import (
    checked, FLAG, FUNCTION, MAPPING, Parameter, ParameterError, PATH, short, TEXT, TEXTS,
    warn, WHOLE)
from timo_sim.scene.scene import load_scene, Scene, SceneLike
from timo_sim.simulation.finer import refine

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HIGH_CORRELATION = 0.95  # correlation from which on a pair of parameters is named
_RUN_HEAD = 'rms error and R^2 of one run from the beginning of the record, without feedback:'
_AT_BOUND = 1e-3  # distance from a bound, in coordinates of the fit, that counts as none
_MIN_SAMPLES = 10  # samples of a part whose errors are worth a number
_MAX_NOISE_RATIO = 2.0  # ratio of a residual to the known noise, above which there is a warning
_NARROWED = 0.5  # part of the width of a guess that a record leaves, above which it tells nothing
_WORSE, _POOR = 3.0, 0.9  # ratio of errors held out and fitted, and R^2, that are warned of
_USELESS = 0.5  # R^2 of what was held out that is warned of, however good the fit is
_FAR_START = 0.05  # the same of a first angle off the first sample, of the range
_FAR = 10.0  # ratio of an estimate to its first guess, above which there is a warning
_RUNS, _RUNS_AFTER = 30, 6  # of a fit, and after its search, for each free parameter, roughly
_KEPT = 0.5  # most of the time of a fit that is kept for these
_FOR_EFFECTS = 0.6  # least part of the time of a fit in which effects are tried
_MAX_NUMERICAL = 0.2  # part of a residual that may be numerical error
# What makes an input of a record that of a scene, in this order, see `SENSOR`.
_TO_AN_INPUT = {'dead_zone': 'take off its dead zone', 'gain': 'multiply it by its gain',
                'bias': 'add its bias', 'delay': 'delay it', 'lag': 'let it lag after its limits'}


@dataclass(frozen=True)
class Estimate:
    """
    A fitted parameter with its 95 % interval, `low` to `high`; NaN if it is not identified.

    The interval alone is NaN where the fit was stopped before it, and where `Fit.misfit` is above
    5, since nothing says how far what the model lacks moves estimates. A parameter of whose guess
    the record leaves more than half the width counts as not identified; it is `from_guess` if it
    has stayed within two of these widths.

    `deviation` is the standard deviation; of a positive parameter that of its logarithm times its
    value. `start` is the first guess; `bound` is 'low' or 'high' if it is at this bound, else ''.
    `profile` says that the interval is where least squares with this parameter held have risen by
    as much, because they are not quadratic.
    """

    value: float
    low: float
    high: float
    deviation: float
    start: float
    unit: str
    identified: bool
    bound: str
    profile: bool = False
    from_guess: bool = False


@dataclass(frozen=True)
class Errors:
    """How far a run is from an output of the record, in its unit."""

    rms: float
    r_squared: float
    hold_out_rms: float         # NaN without a part that is held out
    hold_out_r_squared: float
    whiteness: float            # probability that white residuals of the fit are as correlated


@dataclass(frozen=True, repr=False)
class Prediction:
    """
    A record and what a fitted scene predicts of it by one run; what is after `until` is held out.

    `errors` and `predicted`, (n,) at the samples, are by output; `run` is None if it diverges.
    """

    record: Record
    errors: dict[str, Errors]
    run: Run | None
    predicted: dict[str, np.ndarray]
    until: float

    def table(self) -> str:
        """Return the errors as a text."""
        held_out = self.until < self.record.duration
        rows = [f'{"output":<18} {"unit":<6} {"fitted":>9} {"R^2":>7}'
                + f' {"held out":>9} {"R^2":>7}' * held_out]
        for name, each in self.errors.items():
            unit = '' if isinstance(self.record, Response) else unit_of(name)
            rows.append(f'{name:<18} {unit:<6} {each.rms:>9.3g} {each.r_squared:>7.4f}'
                        + f' {each.hold_out_rms:>9.3g} {each.hold_out_r_squared:>7.4f}' * held_out)
        return '\n'.join(rows)

    def plot(self) -> Figure:
        """Draw outputs, measured and predicted, of all records of a Fit; needs matplotlib."""
        every = [self, *getattr(self, 'more', [])]
        in_time = [each for each in every if not isinstance(each.record, Response)]
        with optional():
            from timo_sim.view.fit import draw_fit, draw_responses
        return draw_fit(in_time, unit_of) if in_time else draw_responses(every)


@dataclass(frozen=True, repr=False)
class Fit(Prediction):
    """
    What `fit` has found, with the Prediction of the first record.

    Attributes
    ----------
    scene : Scene
        With the fitted values, without the loads of the record.
    estimates : dict of Estimate
        By name of a free parameter; what each of several records has of its own ends in
        `(record 1)`, and so on.
    correlation : ndarray, shape (p, p)
        Of the estimates, in their order.
    unidentified : list of dict
        Combinations that the record hardly depends on: the part of each parameter by name.
    seconds : float
    white : bool
        Whether the residuals are white; else the model lacks something, and intervals are wider.
    warnings : list of str
    starts : int
    others : list of dict
        Other sets of values, by name, with which the records are fitted as well.
    more : list of Prediction
        Of further records, held-out ones last.
    posterior : Posterior
    suspects : list of Suspect
        What the scene may lack, that of the largest share of the squares first.
    stopped : str
        Why the search ended early, if it did: the estimates are then the best so far.
    look : list of str
        What the records said before the search, by themselves and beside the first guess.
    ladder : list of str
        With `auto`, effects that were tried, the error of what was held out for that, of its
        spread, and those that stay, which are not indented.

    """

    scene: Scene
    estimates: dict[str, Estimate]
    correlation: np.ndarray
    unidentified: list
    white: bool
    warnings: list = field(default_factory=list)
    seconds: float = math.nan
    starts: int = 1
    others: list = field(default_factory=list)
    more: list = field(default_factory=list)
    posterior: Any = None
    suspects: list[Suspect] = field(default_factory=list)
    stopped: str = ''
    look: list[str] = field(default_factory=list)
    ladder: list[str] = field(default_factory=list)

    @property
    def values(self) -> dict[str, float]:
        """The estimates by name, without those that the record does not identify."""
        return {name: each.value for name, each in self.estimates.items() if each.identified}

    def __repr__(self) -> str:
        found = ', '.join(f'{name} = {value:.4g}' for name, value in self.values.items())
        best = 'best so far: ' if self.stopped else ''
        return f'<Fit of {self.record.source}: {best}{found or "nothing is identified"}>'

    def report(self) -> str:
        """Return estimates, errors and doubts as a text."""
        width = max(map(len, self.estimates))
        lines = [f'{"parameter":<{width}}  '
                 f'{"best so far" if self.stopped else "estimate":>11}  {"95 % interval":>25}  '
                 f'{"first guess":>11}']
        for name, each in self.estimates.items():
            interval = ('from your guess' if each.from_guess
                        else 'not known' if self.posterior is None
                        else 'no interval' if self.misfit > MANY or not each.identified
                        else f'{each.low:.5g} to {each.high:.5g}')
            shown = (f'{"not identified by this record":>38}' if math.isnan(each.value)
                     else f'{each.value:>11.5g}  {interval:>25}')
            bound = '  by profile' * each.profile + (
                f'  at its {each.bound} bound' if each.bound else '')
            lines.append(f'{name:<{width}}  {shown}  {each.start:>11.5g}  {each.unit}{bound}'
                         .rstrip())
        pairs = [f'{first} and {second} ({self.correlation[i, j]:.3f})'
                 for j, second in enumerate(self.estimates)
                 for i, first in enumerate([*self.estimates][:j])
                 if first in self.values and second in self.values
                 and abs(self.correlation[i, j]) > _HIGH_CORRELATION]
        lines += ['', 'correlation above 0.95: ' + (
            ', '.join(pairs) or ('none' if self.posterior else 'not known'))]
        lines += ['not identified: ' + ' '.join(
            f'{part:+.2f} {name}' for name, part in parts.items()) for parts in self.unidentified]
        lines += ['another set of parameters fits as well: ' + ', '.join(
            f'{name} = {value:.5g}' for name, value in values.items()) for values in self.others]
        lines += [f'{self.starts} starts were tried' if self.starts > 1 else 'one start was tried']
        if self.record.inputs and any(
                value for name, value in self.scene.values.items() if name.startswith('load.')):
            lines += ['the loads of the scene act beside the inputs of the record']
        lines += ['', 'before the search:', *self.look]
        if self.ladder:
            lines += ['', 'effects, and the error of the last and the first third of the motion, '
                      'each predicted by the rest, of its spread:', *self.ladder]
        lines += ['', _RUN_HEAD]
        for number, each in enumerate([self, *self.more], 1):
            lines += [f'record {number}, {each.record.source}:'] * bool(self.more)
            lines += [each.table()]
        exact = all(1.0 - each.r_squared <= NUMERICAL for part in (self, *self.more) if part.until
                    for each in part.errors.values())
        lines += ['', 'residuals of the fit are ' + (
            'white' if self.white else 'numerical errors alone' if exact else
            'not white, so the model lacks something; ' + (
                f'they are {self.misfit:.3g} times the noise, so there are no intervals'
                if self.misfit > MANY else 'intervals allow for correlated residuals'))]
        return '\n'.join([*lines, *(f'warning: {each}' for each in self.warnings), '',
                          self.verdict])

    @property
    def verdict(self) -> str:
        """How well the fit predicts what was held out, in a sentence."""
        parts = [f'{each.hold_out_rms:.2g}{f" {unit}".rstrip()} of {name} '
                 f'({100.0 * share:.2g} % of its range)'
                 for part in (self, *self.more) for name, each in part.errors.items()
                 for unit in ['' if isinstance(part.record, Response) else unit_of(name)]
                 if math.isfinite(share := each.hold_out_rms / (
                     np.ptp(part.record.outputs[name].values) or math.nan))]
        held_out = any(part.until < part.record.duration for part in (self, *self.more))
        return ('predicts what was held out with rms errors of ' + ', '.join(parts) if parts else
                f'nothing {"that can be compared " * held_out}was held out, so nothing says how '
                'well it predicts')

    @property
    def misfit(self) -> float:
        """The largest ratio of residuals to the noise of an output, if these are not white."""
        return 0.0 if self.white else max(
            each.rms / (channel.noise or noise_of(channel) or math.inf)
            for part in (self, *self.more) if part.until for each, channel in zip(
                part.errors.values(), part.record.outputs.values()))

    @checked(seed=WHOLE)
    def sample(self, n: int, seed: int = 0) -> Samples:
        """
        Return n Samples of the parameters that the records allow, each as likely as the others.

        Up to 1000 draws are weighted by the squares of some two runs each. Raises ParameterError
        if a parameter has no value, or the fit was stopped before its intervals.
        """
        if self.posterior is None:
            raise ParameterError('samples must have intervals, before which the fit was stopped')
        if lost := [name for name, each in self.estimates.items() if math.isnan(each.value)]:
            raise ParameterError(f'samples need parameters that are identified: fix {lost[0]}')
        return self.posterior.sample(n, seed, self.scene)

    @checked(path=PATH)
    def save(self, path: str | Path) -> Path:
        """Write the fitted scene, all of it, as a parameter file; an existing one is kept."""
        path = Path(path)
        sources = [each.record.source for each in [self, *self.more] if each.until]
        head = ''.join(f'# {line}'.rstrip() + '\n' for line in [
            f'Fitted to {", ".join(sources)} by timo_sim fit.', *self.report().split('\n')])
        with whole_file(path, new=True) as part:
            part.write_text(head + scene_text(self.scene.values), encoding='utf-8')
        return path


_HOLD_OUT = Parameter('hold_out', 0.0, '', '', low=0.0, high=0.95)
_STARTS = Parameter('starts', 1, '', '', low=1, high=1_000_000)
_TIME = Parameter('time', 1.0, 's', '', low=0.0, open_low=True)


def _are_records(value):
    return all(isinstance(each, RecordLike) and each != '' for each in (
        value if isinstance(value, (list, tuple)) else [value]))


@checked(free=TEXTS, bounds=MAPPING, loss=TEXT, tell=FUNCTION, quick=FLAG, auto=FLAG,
         keep=FUNCTION, record=(_are_records, 'a Record, a path, or a list of these'),
         hold_out_records=(_are_records, 'a list of Records or paths'))
def fit(scene: SceneLike | None, record: RecordLike | Sequence[RecordLike],
        free: Sequence[str] = (),
        bounds: Mapping[str, Sequence[float]] | None = None, hold_out: float = 0.0,
        loss: str = 'linear',
        mapping: str | Path | Mapping[str, Any] | Sequence[Any] | None = None,
        starts: int | None = None,
        hold_out_records: Sequence[RecordLike] = (),
        tell: Callable[[str], object] | None = None, quick: bool = False,
        time: float | None = None, auto: bool = False,
        keep: Callable[[Scene, str], object] | None = None) -> Fit:
    """
    Fit parameters of a scene to a measured record, or to several.

    The inputs of the record act on the scene, and its outputs shall be closest to the measured
    ones, by least squares of residuals in standard deviations of each sensor. These are estimated,
    too, if the record does not give them.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes, or None
        Its values of the free parameters are first guesses. None: the scene of a log of the node.
    record : Record, str or Path, or a list of them
        A Record; a log or bag of the node; or a table: CSV or other text, Parquet, MAT. Several
        share parameters, but for biases and deviations of sensors and an initial state.
    free : sequence of str
        Names of parameters of the scene that are numbers, with [k] for an element of a list;
        QUANTITY.gain, .bias, .delay or .lag of an input or output of the record, such as
        shaft.bias, or .dead_zone of an input; or `initial`, the whole initial state. NAME=VALUE
        gives a first guess, else the scene does; NAME~WIDTH and NAME=VALUE~WIDTH its standard
        deviation: 5%, x3 (a factor), a number, or inf, which is no guess but a place to begin.
        ~WIDTH alone is that of all which have none; else it is a usual one, see doc/fit.md.
    bounds : dict, optional
        (low, high) by name, within the parameter's own rule.
    hold_out : float
        Part of each record, at its end, that is not fitted but predicted, 0 to 0.95.
    loss : str
        `linear`, or `soft_l1`, `huber` or `cauchy`, with which outliers weigh less.
    mapping : str, Path or dict, optional
        Which column of a table is which quantity, see doc/fit.md; or a list with one for each
        record, those that are held out at the end.
    starts : int, optional
        The scene's values, and points around them; by default up to 16, until one is good.
    hold_out_records : list of Record, str or Path
        They are predicted, not fitted, with the scene's initial state and no bias of a sensor.
    tell : function(str), optional
        Is called with the time that the fit may take, each start, and each further phase.
    quick : bool
        End with the search: all intervals are quadratic, and no suspects are sought.
    time : float, optional
        Most that the fit may take [s], but for the last run of each record. Where this or a
        KeyboardInterrupt (Ctrl-C) stops it, the best so far is returned, see `Fit.stopped`.
    auto : bool
        Choose the effects, too: from what `free` names, by default the plain arm, effects are
        tried in turn, and kept if the last and the first third of the motion that is fitted are
        predicted better, each by a fit to the rest. They may take `time` but that of one more fit.
    keep : function(Scene, str), optional
        Is called, with `auto`, with each scene that is the best so far, and the values found.

    Raises
    ------
    ParameterError
        If an argument is not valid, or the first guess cannot be run.

    Warns
    -----
    ModelWarning
        With `Fit.warnings`, if there are any.

    Examples
    --------
    >>> import numpy as np, timo_sim
    >>> truth = timo_sim.load_scene('paper', {'motor.viscous_friction': 0.5})
    >>> run = timo_sim.simulate(truth, 2.0)
    >>> noise = 1e-4 * np.random.default_rng(1).standard_normal(len(run.t))
    >>> record = timo_sim.Record.of({}, {'shaft': (run.t, run.shaft + noise)})
    >>> found = timo_sim.fit(truth.vary({'motor.viscous_friction': 1.0}), record,
    ...                      ['motor.viscous_friction'])
    >>> abs(found.values['motor.viscous_friction'] - 0.5) < 0.01
    True

    """
    hold_out = _HOLD_OUT.check(hold_out)
    if loss not in LOSSES:
        raise ParameterError(f'loss must be one of {", ".join(LOSSES)}, got {short(loss)}')
    starts = None if starts is None else _STARTS.check(starts)
    time = None if time is None else _TIME.check(time)
    start, measured, held = read_scene_and_records(scene, record, mapping, hold_out_records)
    start = start.with_fixed_shapes()
    given = {name: value for name, value in start.values.items() if name.startswith(INITIAL)}
    if plainly := auto and not free:
        start, free = plain(start, measured[0])
    if not any(split_guess(each)[0] for each in free):
        raise ParameterError('a fit must have at least one free parameter, got none, or auto')
    begins = [begin_with(start, each, free) for each in measured]
    bounds, begun = dict(bounds or {}), monotonic()

    def say(text):
        if tell:
            tell(f'{monotonic() - begun:.1f} s: {text}')

    def objective_of(scene, texts, like=None):
        names = [split_guess(each)[0] for each in texts]
        late = {name: (-measured[0].period, math.inf) for name in names
                if auto and name.endswith('.delay')}
        ends = {name: ends for name, ends in (late | bounds).items() if not auto or name in names}
        return Objective([
            problem_of(scene=scene.vary(changes), record=each, names=names_for(each, measured, [
                *texts, *(text for text in more if split_guess(text)[0] not in names)]),
                    bounds=ends, until=(1.0 - hold_out) * each.duration)
            for (changes, more, _), each in zip(begins, measured)], loss, like)

    objective, end = objective_of(start, free), math.inf if time is None else begun + time
    wrong = turned(objective.problems[0], objective.values(objective.start, 0)) if plainly else []
    if wrong:
        measured, held = ([replace(each, outputs={
            name: channel._replace(values=(-1.0)**(name in wrong) * channel.values)
            for name, channel in each.outputs.items()}) for each in some]
            for some in (measured, held))
        objective = objective_of(start, free)
    seen = [f'{name} moves against the run of the first guess, and all else with it: its sign is '
            'taken for wrong, as by scale: -1 in the mapping' for name in wrong] + [
        f'{line} (record {k + 1})' if len(measured) > 1 else line
        for k, (problem, (*_, told)) in enumerate(zip(objective.problems, begins))
        for line in (*told, *look(problem, objective.values(objective.start, k)))]
    if tell or time:
        run, count = _measure(objective), len(objective.free)
        say(f'a run of the records takes {run:.2g} s, a fit of {count} parameters from one start '
            f'some {_RUNS * count * run:.2g} s, or ten times that if the model lacks something'
            + f', then some {_RUNS_AFTER * count * run:.2g} s for intervals and suspects' * (
                not quick))
        say('\n  '.join(['before the search:', *seen]))
    choice, first = None, {}
    if auto:
        choice = choose(start, [*free], objective_of, say, keep or (lambda scene, text: None),
                        end if time is None else end - min(
                            (1.0 - _FOR_EFFECTS) * time, (_RUNS + _RUNS_AFTER) * count * run),
                        starts)
        start, free, starts, first = choice.scene, choice.free, starts or 0, choice.values
        objective = objective_of(start, free, choice.weighs)
    others = [_held_out(given, start, each, free) for each in held]
    search = Search(objective, say, first)
    search.interrupted = choice is not None and choice.interrupted
    if time:
        search.set_deadline(end - min(_KEPT * time, run * _RUNS_AFTER * count))
    search.run(starts)
    phases = _Phases(search, say, end)
    known = _find_intervals(search, phases, quick)
    seconds = monotonic() - begun
    shared = {free.name: free.value(at) for free, at in zip(objective.free, search.x)}
    phases.doubts += _find_doubts(
        known.estimates, objective, shared, objective.values(search.x, 0))
    say('one run of each record, and one with more modes and half the step')
    every = [(problem, objective.values(search.x, k)) for k, problem in enumerate(
        objective.problems)] + [(problem, _values_of_other(problem, given, measured, {
            each.name: shared[each.name] for each in objective.free if not each.is_own}))
            for problem in others]
    predictions = [_predict(problem, values, phases, f' (record {k})' * (len(every) > 1))
                   for k, (problem, values) in enumerate(every, 1)]
    likely = []
    if known.posterior and not quick and not known.white and not any(
            isinstance(each, Response) for each in measured) and any(
            1.0 - each.r_squared > NUMERICAL for prediction in predictions
            for each in prediction.errors.values()):
        likely = phases.attempt(
            'what the residuals look like is', lambda: suspects(objective, search.x), [],
            'what the residuals look like')
        phases.doubts[bool(search.stopped):bool(search.stopped)] = name_suspects(likely)
    first, *more = predictions
    result = Fit(
        **vars(first), scene=objective.problems[0].scene_of(objective.values(search.x, 0)),
        **known._asdict(), warnings=phases.doubts, seconds=seconds, starts=search.tried,
        others=search.others, more=more, stopped=search.stopped,
        suspects=[each._replace(effect=None, x=None) for each in likely],
        look=seen, ladder=choice.ladder if choice else [])
    if result.misfit > MANY:
        for name, each in result.estimates.items():
            result.estimates[name] = replace(each, low=math.nan, high=math.nan)
    if phases.doubts:
        warn('; '.join(phases.doubts))
    return result


def _held_out(given, start, record, free):
    """Return the Problem of a record that is predicted, which begins as it does or as `given`."""
    start, shown = start.vary(given), {name: each for name, each in record.outputs.items()
                                       if _shows_start(each)}
    begin = begin_with(start, replace(record, outputs=shown), [])[0]
    if 'shaft' in shown and {INITIAL, 'initial.shaft'} & {split_guess(each)[0] for each in free}:
        begin['initial.shaft'] = float(shown['shaft'].values[0])
    return problem_of(start.vary(begin), record, [], {}, 0.0)


def _shows_start(channel):
    """Return whether a channel of a Record begins with it; one of a Response does not."""
    return channel.t[0] < 1.5 * (channel.t[1] - channel.t[0])


def _values_of_other(problem, given, measured, common):
    """Return the values of a Problem of `_held_out`, of those that are common to all records."""
    values = {name: common[name] for name in names_for(problem.record, measured, [*common])}
    return values | {  # what was measured at its beginning has the gain of the sensor
        name: begin / values.get(f'{name[len(INITIAL) + 1:].removesuffix("_velocity")}.gain', 1.0)
        for name, value in given.items() if (begin := problem.scene.values[name]) != value}


class _Found(NamedTuple):
    """What is known of p estimates."""

    estimates: dict[str, Estimate]
    correlation: np.ndarray  # (p, p)
    unidentified: list[dict[str, float]]
    white: bool
    posterior: Posterior | None  # None: the fit was stopped before it was known


def _find_intervals(search, phases, quick):
    """Return what is _Found of the estimates of a search that has ended."""
    objective, x = search.objective, search.x
    jacobian, jumps = phases.attempt('intervals are', search.derivatives, (None, []),
                                     'derivatives, for the intervals')
    if jumps:
        phases.doubts.append(f'the run depends on {", ".join(jumps)} in jumps, so the intervals '
                             'may be too small')
    spread, white, posterior = np.full((len(x), len(x)), math.nan), objective.is_white(x), None
    if jacobian is not None:
        residuals = objective.residuals(x)
        residuals *= objective.weights(residuals)
        spread, white = covariance(
            objective.split(jacobian), objective.split(residuals), objective.widths)
        posterior = Posterior(objective, x, jacobian, residuals, spread)
    sigma = np.sqrt(np.diag(spread))
    identified = [posterior is None or bool(NORMAL * deviation < min(
        1.0 if free.log else max(1.0, abs(at)), _NARROWED * NORMAL * free.width))
        for free, at, deviation in zip(objective.free, x, sigma)]
    profiles = {} if quick or posterior is None else phases.attempt(
        'intervals by profile are', lambda: posterior.intervals(np.flatnonzero(identified)), {},
        'intervals, where others may be by profile')
    estimates = {}
    for k, (free, at, deviation) in enumerate(zip(objective.free, x, sigma)):
        known = identified[k] or math.isfinite(free.width)
        value, half = (free.value(at), NORMAL * deviation) if known else (math.nan, math.nan)
        low, high = map(free.value, profiles.get(k, (at - half, at + half)))
        estimates[free.name] = Estimate(
            value=value, low=low, high=high, start=free.start, unit=free.unit,
            deviation=half / NORMAL * (value if free.log else free.scale),
            identified=identified[k], profile=k in profiles,
            from_guess=known and not identified[k] and bool(
                abs(at - objective.start[k]) < NORMAL * free.width), bound=next((
                    name for name in ('low', 'high')
                    if abs(at - getattr(objective, name)[k]) < _AT_BOUND), ''))
    lost = {name for name, each in estimates.items() if not each.identified}
    return _Found(
        estimates, np.clip(spread / np.outer(sigma, sigma), -1.0, 1.0),  # but for round-off
        [] if posterior is None else unidentified_combinations(
            np.concatenate(objective.split(jacobian)), [*estimates], lost), white, posterior)


class _Phases:
    """
    What follows a search, in phases that may fail or be stopped without loss of the others.

    At `end`, a time of `time.monotonic`, a phase is stopped that is not needed; what lies between
    phases is never.
    """

    def __init__(self, search: Search, say: Callable[[str], None], end: float) -> None:
        self._search, self._end = search, end
        self._over, self._say = search.interrupted, say
        self.doubts = ['these are the best values so far, since the search was stopped: '
                       + search.stopped] if search.stopped else []

    def attempt(self, what: str, function: Callable[[], Any], otherwise: Any, text: str = '',
                needed: bool = False) -> Any:
        """Return what a function does; otherwise, or if a phase was stopped, something else."""
        reason = 'the fit was stopped before'
        if needed or not self._over:
            try:
                if text:
                    self._say(text)
                self._search.set_deadline(math.inf if needed else self._end)
                return function()
            except KeyboardInterrupt as stop:
                self._over, reason = True, str(stop) or INTERRUPTED
            except (ArithmeticError, ValueError) as error:  # of parameters, of linear algebra
                reason = str(error)
            finally:
                self._search.set_deadline(math.inf)
        self.doubts.append(f'{what} not known: {reason}')
        return otherwise


def _measure(objective):
    """Return how long a run of the records takes [s]."""
    begun = monotonic()
    for k, problem in enumerate(objective.problems):
        problem.run(objective.values(objective.start, k), problem.until)
    return monotonic() - begun


RecordLike = Record | str | Path


def read_scene_and_records(
        scene: Any, record: RecordLike | Sequence[RecordLike], mapping: Any,
        held: Sequence[RecordLike]) -> tuple[Scene, list[Record], list[Record]]:
    """Return the Scene and the Records of a fit from what `fit` takes for them."""
    fitted = [record] if isinstance(record, RecordLike) else [*record]
    every: list[Any] = [*fitted, *held]
    found: list[Record] = []
    mappings = [*mapping] if isinstance(mapping, (list, tuple)) else [mapping] * len(every)
    if not fitted or len(mappings) != len(every):
        raise ParameterError('a fit needs a record, and one mapping for all or one for each, got '
                             f'{len(fitted)} and {len(mappings)}, with {len(held)} held out')
    if mapping is not None and all(isinstance(each, Record) for each in every):
        raise ParameterError('mapping must be None with Records, got ' + short(mapping))
    for each, own in zip(every, mappings):  # the scene of the first log is that of all
        scene, measured = _read(scene, each, own)
        found.append(measured)
    return scene, found[:len(fitted)], found[len(fitted):]


def _read(scene, record, mapping):
    known = isinstance(record, Record)
    if known or Path(record).suffix in SUFFIXES or mapping is not None:
        if scene is None:
            place = 'a Record' if known else record
            raise ParameterError(f'scene must be given with {place}, which has none')
        return load_scene(scene), record if known else read_record(record, mapping)
    return read_log(record, None if scene is None else load_scene(scene))


def _predict(problem, values, phases, place):
    """Return the Prediction of a problem, one of several in a `place`, with these values."""
    errors = {}

    def run_all(refined=lambda scene: scene):
        run = problem.run(values, scene=refined(problem.scene_of(values)))
        return run, problem.predicted(values, run=run)

    run, predicted = phases.attempt(f'one run of the whole record{place} is', run_all, (None, {}),
                                    needed=True)
    _, again = (None, {}) if run is None else phases.attempt(
        'the numerical error is', lambda: run_all(lambda scene: refine(
            scene, 2, None, 0, same_equations=True)), (None, {}))
    for name, channel in problem.record.outputs.items():
        parts, own = [], predicted.get(name, math.nan) - channel.values
        for part in (channel.t <= problem.until, channel.t > problem.until):
            measured = channel.values[part]
            parts += [float(np.sqrt(np.mean(own[part]**2))), r_squared(
                measured, measured + own[part])] if part.sum() >= _MIN_SAMPLES else [math.nan] * 2
        rms, fit, late, predicts = parts
        errors[name] = Errors(rms, fit, late, predicts, math.nan if math.isnan(rms) else whiteness(
            own[channel.t <= problem.until]))
        if channel.noise and rms > _MAX_NOISE_RATIO * channel.noise:
            phases.doubts.append(
                f'{name} is off by {rms / channel.noise:.1f} times its noise: the model lacks '
                f'something, or this is not the best minimum: try other first guesses{place}')
        if late > _WORSE * rms and predicts < _POOR:
            phases.doubts.append(
                f'what was held out of {name} is {late / rms:.2g} times as far off as what was '
                f'fitted (R^2 {predicts:.3f}): this scene fits the record, and does not predict '
                f'another: hold fewer parameters free, or fit a record of more motion{place}')
        elif predicts < _USELESS:
            phases.doubts.append(f'what was held out of {name} is not predicted: R^2 is '
                                 f'{predicts:.3g}, and 0 is that of its mean{place}')
        apart = float(np.sqrt(np.mean((again[name] - predicted[name])**2))) if again else 0.0
        most = rms if problem.until else late
        if apart > _MAX_NUMERICAL * most:
            phases.doubts.append(
                f'{name} differs by {apart:.2g} from that of a run with more modes and half the '
                f'step, a large part of its error of {most:.2g}: take more model.modes or a '
                f'smaller integrator.step{place}')
    return Prediction(problem.record, errors, run, predicted, problem.until)


def _find_doubts(estimates, objective, found, values):
    inputs = ', '.join(f'{name} = {value:.5g}' + (
        ' (not identified)' if not estimates[name].identified else '')
        for name, value in found.items() if name.rpartition('.')[0] in INPUT_UNITS)
    if inputs:
        to_do = [text for kind, text in _TO_AN_INPUT.items() if f'.{kind} ' in inputs]
        yield (f'the fitted scene does not hold {inputs}: {", ".join(to_do)}, before an input '
               'goes to the scene')
    if at_bound := [name for name, each in estimates.items() if each.bound]:
        yield f'at a bound, so that intervals do not hold: {", ".join(at_bound)}'
    if far := [free.name for free in objective.free if free.log
               and not 1.0 / _FAR < found[free.name] / free.start < _FAR]:
        yield (f'{", ".join(far)}: more than {_FAR:g} times off the first guess: unless that was '
               'rough, look at unit and scale of the columns')
    if lost := [name for name, each in estimates.items() if math.isnan(each.value)]:
        yield (f'{", ".join(lost)} cannot be identified from this record: hold '
               f'{"some of them" if lost[1:] else "it"} fixed, or record more outputs or another '
               'motion')
    problem = objective.problems[0]
    shaft = problem.record.outputs.get('shaft')
    if shaft and _shows_start(shaft) and 'initial.shaft' in values:
        begins = values.get('shaft.gain', 1.0) * values['initial.shaft'] + values.get(
            'shaft.bias', 0.0)
        if abs(begins - shaft.values[0]) > _FAR_START * np.ptp(shaft.values):
            yield (f'initial.shaft lets the shaft begin at {begins:.3g} rad, where the record has '
                   f'{shaft.values[0]:.3g} rad: it stands for a motion that the model lacks')
    for free, part in product(problem.free, (0.99, 1.01)):
        near = min(max(part * values[free.name], free.low), free.high)
        try:
            problem.scene_of({**values, free.name: near})
        except ParameterError as error:
            yield ('the search ended where values are refused, so that intervals do not hold: '
                   f'{error}')
            return
