# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The function `fit` and its result: fitted parameters, their intervals, and what they predict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
from pathlib import Path
import time
from typing import Any, TYPE_CHECKING

import numpy as np
import yaml

from timo_sim.extras import optional
from timo_sim.fitting.record import read_log, read_record, Record, SUFFIXES, unit_of
from timo_sim.fitting.problem import (
    covariance, LOSSES, NORMAL, Problem, r_squared, Search, unidentified_combinations, whiteness)
from timo_sim.runs.run import Run
from timo_sim.scene.files import whole_file
from timo_sim.scene.parameters import changed, Parameter, ParameterError, short, warn
from timo_sim.scene.scene import load_scene, Scene, SceneLike
from timo_sim.simulation.finer import can_refine, refine
from timo_sim.simulation.warnings import DivergenceError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HIGH_CORRELATION = 0.95  # correlation from which on a pair of parameters is named
_RUN_HEAD = 'rms error and R^2 of one run from the beginning of the record, without feedback:'


@dataclass(frozen=True)
class Estimate:
    """
    A fitted parameter with its 95 % interval, `low` to `high`; NaN if it is not identified.

    `deviation` is the standard deviation; of a positive parameter that of its logarithm times its
    value. `start` is the first guess; `bound` is 'low' or 'high' if it is at this bound, else ''.
    """

    value: float
    low: float
    high: float
    deviation: float
    start: float
    unit: str
    identified: bool
    bound: str


@dataclass(frozen=True)
class Errors:
    """How far a run is from an output of the record, in its unit."""

    rms: float
    r_squared: float
    hold_out_rms: float         # NaN without a part that is held out
    hold_out_r_squared: float
    residual_rms: float         # of the fit itself, whose windows have initial states of their own
    whiteness: float            # probability that white residuals of it are as correlated


@dataclass(frozen=True, repr=False)
class Fit:
    """
    What `fit` has found.

    Attributes
    ----------
    scene : Scene
        With the fitted values; its loads are not those of the record.
    record : Record
    estimates : dict of Estimate
        By name of a free parameter.
    correlation : ndarray, shape (p, p)
        Of the estimates, in their order.
    unidentified : list of dict
        Combinations of parameters that the record hardly depends on: by name, the part of each
        in it (of the logarithm, for positive parameters).
    errors : dict of Errors
        By output.
    run : Run or None
        The whole record, predicted by one run from its beginning; None if that diverges.
    predicted : dict of ndarray, shape (n,)
        By output, what this run shows at the record's samples.
    until, seconds : float
        Time from which on the record was held out; wall time of the fit [s].
    white : bool
        Whether the residuals of the fit are white; if not, the model lacks something, and the
        intervals allow for that.
    warnings : list of str

    """

    scene: Scene
    record: Record
    estimates: dict[str, Estimate]
    correlation: np.ndarray
    unidentified: list
    errors: dict[str, Errors]
    run: Run | None
    predicted: dict[str, np.ndarray]
    until: float
    white: bool
    warnings: list = field(default_factory=list)
    seconds: float = math.nan

    @property
    def values(self) -> dict[str, float]:
        """The estimates by name, without those that the record does not identify."""
        return {name: each.value for name, each in self.estimates.items() if each.identified}

    def __repr__(self) -> str:
        found = ', '.join(f'{name} = {value:.4g}' for name, value in self.values.items())
        return f'<Fit of {self.record.source}: {found or "nothing is identified"}>'

    def report(self) -> str:
        """Return estimates, errors and doubts as a text."""
        width = max(map(len, self.estimates))
        lines = [f'{"parameter":<{width}}  {"estimate":>11}  {"95 % interval":>25}  '
                 f'{"first guess":>11}']
        for name, each in self.estimates.items():
            shown = (f'{each.value:>11.5g}  {f"{each.low:.5g} to {each.high:.5g}":>25}'
                     if each.identified else f'{"not identified by this record":>38}')
            bound = f'  at its {each.bound} bound' if each.bound else ''
            lines.append(f'{name:<{width}}  {shown}  {each.start:>11.5g}  {each.unit}{bound}'
                         .rstrip())
        pairs = [f'{first} and {second} ({self.correlation[i, j]:.3f})'
                 for j, second in enumerate(self.estimates)
                 for i, first in enumerate([*self.estimates][:j])
                 if first in self.values and second in self.values
                 and abs(self.correlation[i, j]) > _HIGH_CORRELATION]
        lines += ['', 'correlation above 0.95: ' + (', '.join(pairs) or 'none')]
        lines += ['not identified: ' + ' '.join(
            f'{part:+.2f} {name}' for name, part in parts.items()) for parts in self.unidentified]
        if self.scene.load and self.record.inputs:
            lines += ['the loads of the scene act beside the inputs of the record']
        lines += ['', _RUN_HEAD, self._table()]
        lines += ['', 'residuals of the fit are ' + (
            'white' if self.white else 'not white, so the model lacks something; intervals '
            'allow for correlated residuals')]
        return '\n'.join([*lines, *(f'warning: {each}' for each in self.warnings)])

    def _table(self):
        rows = [f'{"output":<18} {"unit":<6} {"fitted":>9} {"R^2":>7}']
        held_out = self.until < self.record.duration
        if held_out:
            rows[0] += f' {"held out":>9} {"R^2":>7}'
        for name, each in self.errors.items():
            row = f'{name:<18} {unit_of(name):<6} {each.rms:>9.3g} {each.r_squared:>7.4f}'
            if held_out:
                row += f' {each.hold_out_rms:>9.3g} {each.hold_out_r_squared:>7.4f}'
            rows.append(row)
        return '\n'.join(rows)

    def plot(self) -> Figure:
        """Draw measured and predicted outputs, and their difference; needs matplotlib."""
        with optional():
            from matplotlib.figure import Figure

            from timo_sim.view.plot import COLOURS
        record = self.record
        rows = [*record.inputs, *record.outputs]
        figure = Figure(figsize=(12, 1.0 + 2.2 * len(rows)), layout='constrained')
        heights = [0.6 if name in record.inputs else 1.0 for name in rows]
        all_axes = figure.subplots(len(rows), 1, sharex=True, squeeze=False,
                                   height_ratios=heights)[:, 0]
        for axes, name in zip(all_axes, rows):
            unit = unit_of(name)
            label = 'tip deflection' if name == 'tip_transverse' else name.replace('_', ' ')
            axes.set(ylabel=f'{label} [{unit}]' if unit else label, xlim=(0.0, record.duration))
            axes.grid(alpha=0.3)
            if self.until < record.duration:
                axes.axvspan(self.until, record.duration, color='0.93', zorder=0)
            if name in record.inputs:
                channel = record.inputs[name]
                axes.plot(channel.t, channel.values, color='0.4', linewidth=1.0,
                          drawstyle='steps-post' if channel.hold == 'zero' else 'default')
                continue
            channel = record.outputs[name]
            axes.plot(channel.t, channel.values, color=COLOURS[0], label='measured', linewidth=2.0)
            if name in self.predicted:
                axes.plot(channel.t, self.predicted[name], color=COLOURS[1], linewidth=1.2,
                          label='predicted')
                axes.plot(channel.t, channel.values - self.predicted[name], color=COLOURS[2],
                          linewidth=0.8, label='difference')
            each = self.errors[name]
            text = f'R² = {each.r_squared:.3f} fitted'
            if np.isfinite(each.hold_out_r_squared):
                text += f', {each.hold_out_r_squared:.3f} held out'
            axes.legend(fontsize='small', ncols=3, frameon=False, loc='lower right',
                        bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)
            axes.set_title(text, loc='left', fontsize='small')
        all_axes[-1].set(xlabel='time [s]')
        return figure

    def save(self, path: str | Path) -> Path:
        """Write the fitted scene as a parameter file for `sim_node`; an existing one is kept."""
        path, nested = Path(path), {}
        for name, value in changed(self.scene.values).items():
            place = nested
            *groups, last = name.split('.')
            for group in groups:
                place = place.setdefault(group, {})
            place[last] = [*value] if isinstance(value, tuple) else value
        head = ''.join(f'# {line}'.rstrip() + '\n' for line in [
            f'Fitted to {self.record.source} by timo_sim fit.', *self.report().split('\n')])
        if path.exists():
            raise ParameterError(f'{path} exists: remove it or choose another name')
        with whole_file(path, new=True) as part:
            part.write_text(head + yaml.safe_dump(
                {'/**': {'ros__parameters': nested}}, sort_keys=False), encoding='utf-8')
        return path


_HOLD_OUT = Parameter('hold_out', 0.0, '', '', low=0.0, high=0.95)
_WINDOW = Parameter('window', 1.0, 's', '', low=0.0, open_low=True)


def fit(scene: SceneLike | None, record: Record | str | Path, free: Sequence[str],
        bounds: Mapping[str, Sequence[float]] | None = None, hold_out: float = 0.0,
        window: float | None = None, loss: str = 'linear',
        mapping: str | Path | Mapping[str, Any] | None = None) -> Fit:
    """
    Fit parameters of a scene to a measured record.

    The inputs of the record act on the scene, and the free parameters are those for which the
    outputs of the run are closest to the measured ones, by least squares of residuals in standard
    deviations of each sensor. These are estimated, too, if the record does not give them.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes, or None
        Its values of the free parameters are first guesses. None: the scene of a log of the node.
    record : Record, str or Path
        A Record; a log or bag of the node; or a table: CSV or other text, Parquet, MAT.
    free : sequence of str
        Names of parameters of the scene that are numbers, with [k] for an element of a list;
        QUANTITY.gain, .bias or .delay of an input or output of the record, such as shaft.bias, and
        .lag of an output; or `initial` for the whole initial state.
    bounds : dict, optional
        (low, high) by name, within the parameter's own rule.
    hold_out : float
        Part of the record, at its end, that is not fitted but predicted, 0 to 0.95.
    window : float, optional
        Fit windows of about this length, each with an initial state of its own [s]. For arms
        whose long runs depend too much on details, such as those of dry friction. What is held
        out is predicted by one run from the beginning all the same.
    loss : str
        `linear`, or `soft_l1`, `huber` or `cauchy`, with which outliers weigh less.
    mapping : str, Path or dict, optional
        Which column of a table is which quantity, see doc/fit.md.

    Raises
    ------
    ParameterError
        If names, bounds, mapping or record are not valid, or the first guess cannot be run.

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
    window = None if window is None else _WINDOW.check(window)
    if loss not in LOSSES:
        raise ParameterError(f'loss must be one of {", ".join(LOSSES)}, got {short(loss)}')
    if isinstance(free, str) or not all(isinstance(name, str) for name in free):
        raise ParameterError(f'free must be a list of names, got {short(free)}')
    start, measured = read_scene_and_record(scene, record, mapping)
    begun, until = time.monotonic(), (1.0 - hold_out) * measured.duration
    problem = Problem(start, measured, list(free), dict(bounds or {}), until, window)
    search = Search(problem, loss)
    search.run()
    names, count = [free.name for free in problem.free], len(problem.free)
    jacobians, residuals, jumps, friction = search.derivatives()
    seconds = time.monotonic() - begun
    x, initial = search.x[:count], search.split(search.x)[1][0]
    spread, white = covariance(jacobians, residuals)
    spread = spread[:count, :count]
    sigma = np.sqrt(np.diag(spread))
    estimates = {}
    for each, at, deviation in zip(problem.free, x, sigma):
        value, half = each.value(at), NORMAL * deviation
        identified = bool(half < (1.0 if each.log else max(1.0, abs(at))))
        edges = each.coordinate(each.low), each.coordinate(each.high)
        bound = next((name for name, edge in zip(('low', 'high'), edges)
                      if abs(at - edge) < _AT_BOUND), '')
        low, high = ((each.value(at - half), each.value(at + half)) if identified
                     else (math.nan, math.nan))
        estimates[each.name] = Estimate(
            value if identified else math.nan, low, high,
            deviation * (value if each.log else each.scale) if identified else math.nan,
            each.start, each.unit, identified, bound)
    values = problem.values(x)
    fitted, doubts = problem.scene_of(values, initial), []
    if jumps:
        cause = ', as with dry friction' if problem.scene.friction.any() else ''
        doubts.append(f'the run depends on {", ".join(jumps)} in jumps{cause}, so the intervals '
                      'may be too small: try a shorter window, or friction with a coulomb_speed')
    run, predicted = None, {}
    try:
        run = problem.run(values, scene=fitted)
        predicted = {name: found for name, (_, found) in
                     problem.predictions(run, values).items()}
    except DivergenceError as error:
        doubts.append(f'one run of the whole record diverges: {error}')
    errors = _errors(problem, predicted, residuals, search.deviations)
    doubts += _possible_causes(errors, search.against, {} if white else friction)
    doubts += _find_doubts(problem, fitted, estimates, errors, values, run, predicted)
    # The derivatives by the parameters that initial states of windows cannot make up for.
    whole = np.concatenate(jacobians)
    q, _ = np.linalg.qr(whole[:, count:])
    parts = unidentified_combinations(
        whole[:, :count] - q @ (q.T @ whole[:, :count]), names,
        {name for name, each in estimates.items() if not each.identified})
    correlation = np.clip(spread / np.outer(sigma, sigma), -1.0, 1.0)  # but for round-off
    found = Fit(fitted, problem.record, estimates, correlation, parts, errors, run, predicted,
                problem.until, white, doubts, seconds)
    if doubts:
        warn('; '.join(doubts))
    return found


def read_scene_and_record(
        scene: SceneLike | None, record: Record | str | Path,
        mapping: str | Path | Mapping[str, Any] | None = None) -> tuple[Scene, Record]:
    """Return the Scene and the Record of a fit from what `fit` takes for them."""
    if isinstance(record, Record):
        if scene is None:
            raise ParameterError('scene must be given with a Record')
        return load_scene(scene), record
    if Path(record).suffix in SUFFIXES or mapping is not None:
        if scene is None:
            raise ParameterError(f'scene must be given with {record}, which has none')
        return load_scene(scene), read_record(record, mapping)
    return read_log(record, None if scene is None else load_scene(scene))


_AT_BOUND = 1e-3  # distance from a bound, in coordinates of the fit, that counts as none
_MIN_SAMPLES = 10  # samples of a part whose errors are worth a number
_ANTICORRELATED = -0.5  # correlation below which a sign may be the other one
_MIN_R_SQUARED = 0.5  # R^2 below which an output is not predicted
_NUMERICAL_RESIDUAL = 1e-9  # 1 - R^2 below which only numerical errors are left
_MIN_EXPLAINED = 0.2  # part of the squares of residuals from which on its cause is named
_MAX_NOISE_RATIO = 2.0  # ratio of a residual to the known noise, above which there is a warning
_MAX_NUMERICAL = 0.2  # part of a residual that may be numerical error


def _possible_causes(errors, against, friction):
    """Yield what may be wrong with a record or a scene that do not agree."""
    if not all(each.r_squared > _MIN_R_SQUARED for each in errors.values()):
        for name, correlation in against.items():
            if correlation < _ANTICORRELATED:
                yield (f'{name} is anticorrelated with a run of the first guess '
                       f'({correlation:.2f}): its sign, or that of an input, may be the other one '
                       '(scale: -1 in the mapping)')
    for name, (share, value) in friction.items():
        if share > _MIN_EXPLAINED and any(1.0 - each.r_squared > _NUMERICAL_RESIDUAL
                                          for each in errors.values()):
            yield (f'dry friction, which the scene has not got, would explain {100.0 * share:.0f} '
                   f'% of the squares of the residuals: set {name} to about {value:.2g}, and free '
                   'it')


def _errors(problem, predicted, residuals, deviations):
    found, outputs = {}, [*problem.record.outputs]
    for place, name in enumerate(outputs):
        channel = problem.record.outputs[name]
        parts = []
        for part in (channel.t <= problem.until, channel.t > problem.until):
            enough = part.sum() >= _MIN_SAMPLES and name in predicted
            measured = channel.values[part]
            parts += [float(np.sqrt(np.mean((predicted[name][part] - measured)**2))),
                      r_squared(measured, predicted[name][part])] if enough else [math.nan] * 2
        own = residuals[place:len(problem.windows) * len(outputs):len(outputs)]
        size = math.sqrt(np.mean(np.concatenate(own)**2))
        found[name] = Errors(parts[0], parts[1], parts[2], parts[3], deviations[name] * size,
                             min(whiteness(each) for each in own if len(each) > 4))
    return found


def _find_doubts(problem, scene, estimates, errors, values, run, predicted):
    at_bound = [name for name, each in estimates.items() if each.bound]
    if at_bound:
        yield f'at a bound, so that intervals do not hold: {", ".join(at_bound)}'
    lost = [name for name, each in estimates.items() if not each.identified]
    if lost:
        yield (f'{", ".join(lost)} cannot be identified from this record: fix some of them, or '
               'record more outputs or another motion')
    for name, each in errors.items():
        noise = problem.record.outputs[name].noise
        if noise and each.residual_rms > _MAX_NOISE_RATIO * noise:
            yield (f'{name} is off by {each.residual_rms / noise:.1f} times its noise: the model '
                   'lacks something, or this is not the best minimum: try other first guesses')
    if run is None:
        return
    # Coordinates of static modes have no meaning in other modes.
    try:
        finer = refine(scene, 2, None if can_refine(scene) else 0, 0, same_equations=True)
        again = problem.predictions(problem.run(values, scene=finer), values)
    except (DivergenceError, ParameterError) as error:
        yield f'the numerical error is not known: {error}'
        return
    for name, (_, found) in again.items():
        apart = float(np.sqrt(np.mean((found - predicted[name])**2)))
        if apart > _MAX_NUMERICAL * errors[name].rms:
            yield (f'{name} differs by {apart:.2g} from that of a run with more modes and half '
                   f'the step, a large part of its error of {errors[name].rms:.2g}: take more '
                   'model.modes or a smaller integrator.step')
