# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A parameter: its type, unit, meaning and rule, and errors that state name, rule and value."""

from dataclasses import dataclass
import difflib
import math
import re
import reprlib
import sys
import warnings

import numpy as np

SCENE, NODE = 'scene', 'node'
LATEST = 2**31 - 1  # [s] largest time that a stamp of ROS can hold, 68 years

_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxlist, _SHORT.maxtuple, _SHORT.maxother = 2, 8, 8, 60
_SHORT.maxstring = 60


class ParameterError(ValueError):
    """A value that breaks a rule; the text states name, value and rule."""


class ModelWarning(UserWarning):
    """A scene or a run for which the model may not hold; the text says why, and what to do."""


@dataclass(frozen=True)
class Parameter:
    """A parameter and its rule."""

    name: str                # dotted
    default: object          # its type is the parameter's: bool, int, float, str, tuple of float
    unit: str
    meaning: str
    low: float = -math.inf   # range of the value, or of each element
    high: float = math.inf
    open_low: bool = False   # whether `low` itself is excluded
    choices: tuple = ()      # allowed texts; empty: all
    form: tuple = ()         # of a text: a regular expression, and the same rule in words
    scope: str = SCENE       # SCENE: part of the physics; NODE: only the node has it
    runtime: bool = False    # whether it can be set while the node runs
    finite: bool = True      # whether infinity is refused
    alone: bool = False      # whether a number stands for a list of this one

    @property
    def rule(self):
        """The rule for values, in words."""
        kind = {bool: 'true or false', int: 'a whole number',
                float: 'a finite number' if self.finite else 'a number',
                str: 'a text', tuple: 'a finite number, or a list of them,' if self.alone
                else 'a list of finite numbers'}[type(self.default)]
        if self.choices:
            return 'one of ' + ', '.join(self.choices)
        if self.form:
            return self.form[1]
        bounds = []
        if self.low > -math.inf:
            bounds.append(f'{">" if self.open_low else ">="} {self.low:g}')
        if self.high < math.inf:
            bounds.append(f'<= {self.high:g}')
        unit = f' {self.unit}' if bounds and self.unit else ''
        none = '' if self.finite else ', .inf for no limit'
        return ' '.join([kind, ' and '.join(bounds)]).strip() + unit + none

    def check(self, value):
        """
        Return the value converted to the parameter's type, or raise ParameterError.

        A whole number is accepted for a float, and so is a text like '70.5e9', which is how YAML
        1.1 reads a number without a sign in the exponent.
        """
        try:
            if isinstance(self.default, tuple):
                if value is None:  # ROS reads an empty list as no value
                    return ()
                if self.alone and (isinstance(value, str) or not hasattr(value, '__iter__')):
                    return (self._checked_number(value),)
                if isinstance(value, (str, bytes, dict, set)) or not hasattr(value, '__iter__'):
                    raise ValueError
                return tuple(self._checked_number(element) for element in value)
            if isinstance(self.default, float):
                return self._checked_number(value)
            if isinstance(value, np.generic):
                value = value.item()
            if (type(value) is not type(self.default) or self.choices and value not in self.choices
                    or isinstance(value, str) and (
                        '\0' in value or self.form and not re.fullmatch(self.form[0], value))
                    or isinstance(value, int) and not self.low <= value <= self.high):
                raise ValueError
            return value
        except (ValueError, TypeError, OverflowError):
            raise ParameterError(
                f'{self.name} must be {self.rule}, got {short(value)}') from None

    def _checked_number(self, value):
        if isinstance(value, (bool, np.bool_)):
            raise ValueError
        number = float(value)
        above = number > self.low if self.open_low else number >= self.low
        if not (above and number <= self.high) or self.finite and not math.isfinite(number):
            raise ValueError
        return number


def warn(text):
    """Give a ModelWarning whose place is the caller's line outside of this package."""
    level, frame = 1, sys._getframe()
    # functools, because it calls the functions of cached properties.
    while frame.f_back and frame.f_globals.get('__name__', '').partition('.')[0] in (
            'timo_sim', 'functools'):
        level, frame = level + 1, frame.f_back
    warnings.warn(text, ModelWarning, stacklevel=level)


def short(value, show=_SHORT.repr):
    """Return any value as one line of at most 60 characters."""
    try:
        shown = show(value)
    except ValueError:  # a whole number of thousands of digits
        shown = f'a huge {type(value).__name__}'
    shown = ''.join(char if char.isprintable() else ' ' for char in shown)
    return shown if len(shown) <= 60 else shown[:57] + '...'


def did_you_mean(name, names):
    """Return '; did you mean X?' for the name that is most like the given one, or ''."""
    close = difflib.get_close_matches(str(name), names, n=1)
    return f'; did you mean {close[0]}?' if close else ''


def whole_ratio(name, value, unit_name, unit):
    """
    Return how many times `unit` fits into `value`, or raise ParameterError if it is not whole.

    The ratio may differ from a whole number by 1e-6, or by 1e-15 of itself for round-off.
    """
    ratio = value / unit
    count = round(ratio) if math.isfinite(ratio) else 0
    near = abs(ratio - count) <= max(1e-6, 1e-15 * ratio) and (count or not value)
    if not near or not math.isfinite(ratio):
        raise ParameterError(f'{name} = {value:.12g} must be a whole multiple of '
                             f'{unit_name} = {unit:.12g}, the ratio is {ratio:.15g}')
    return count
