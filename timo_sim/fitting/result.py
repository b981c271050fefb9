# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The class Fit: fitted parameters with their intervals, and how well they predict the record."""

from __future__ import annotations

from dataclasses import dataclass, field
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml

from timo_sim.extras import optional
from timo_sim.fitting.quantities import unit_of
from timo_sim.fitting.record import Record
from timo_sim.runs.run import Run
from timo_sim.scene.files import whole_file
from timo_sim.scene.parameter import ParameterError
from timo_sim.scene.values import changed
from timo_sim.scene.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CLOSE = 0.95        # correlation from which on a pair of parameters is named
_RUN_HEAD = 'rms error and R^2 of one run from the beginning of the record, without feedback:'


@dataclass(frozen=True)
class Estimate:
    """
    A fitted parameter.

    Attributes
    ----------
    value, low, high : float
        And its 95 % interval; NaN if the record does not identify it.
    deviation : float
        Standard deviation; of a positive parameter that of its logarithm times its value.
    start : float
        First guess.
    unit : str
    identified : bool
    bound : str
        'low' or 'high' if it is at this bound, else ''.

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
    until : float
        Time from which on the record was held out [s].
    white : bool
        Whether the residuals of the fit are white; if not, the model lacks something, and the
        intervals allow for that.
    warnings : list of str
    seconds : float
        Wall time of the fit.

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
        lines += ['', 'correlation above 0.95: ' + (', '.join(self._close()) or 'none')]
        lines += [f'not identified: {_shown(parts)}' for parts in self.unidentified]
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

    def _close(self):
        names = [*self.estimates]
        for j, second in enumerate(names):
            for i, first in enumerate(names[:j]):
                both = self.estimates[first].identified and self.estimates[second].identified
                if both and abs(self.correlation[i, j]) > _CLOSE:
                    yield f'{first} and {second} ({self.correlation[i, j]:.3f})'

    def plot(self) -> Figure:
        """Draw measured and predicted outputs, and their difference; needs matplotlib."""
        with optional():
            from timo_sim.fitting.picture import plot
        return plot(self)

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


def _shown(parts):
    return ' '.join(f'{part:+.2f} {name}' for name, part in parts.items())
