# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Input shapers: a command in parts whose vibrations cancel; see doc/theory.md, section 12."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from timo_sim.runs.modes import modes as vibrations
from timo_sim.scene.parameters import (
    checked, CONTACT, FUNCTION, NUMBERS, Parameter, ParameterError)
from timo_sim.scene.scene import SceneLike

KINDS = 'ZV', 'ZVD', 'EI'
_ROUND_OFF = 1e-9  # relative, of a pole and of a number of periods


@dataclass(frozen=True)
class Shaper:
    """
    Impulses at `times` [s] from 0 on with `amplitudes`, whose sum is 1; shapes (n,).

    `poles` [1/s] are those for which it was made, shape (k,).
    """

    times: np.ndarray
    amplitudes: np.ndarray
    poles: np.ndarray

    @checked(command=FUNCTION)
    def shape(self, command: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Return a function of time [s], shaped; the given one is asked for earlier times, too."""
        return lambda t: sum(amplitude * np.asarray(command(t - time))
                             for time, amplitude in zip(self.times, self.amplitudes))

    @checked(samples=(lambda each: np.ndim(each) == 1 and len(each) and NUMBERS[0](each),
                      'a list of finite numbers'))
    def shape_samples(self, samples: Sequence[float] | np.ndarray, dt: float) -> np.ndarray:
        """
        Return samples at intervals dt [s], shape (k,), shaped: (k + times[-1] / dt,), rounded up.

        The command is linear between its samples and constant before and after them; that leaves
        up to `(omega dt)^2 / 8` of a vibration.
        """
        dt = Parameter('dt', 1.0, 's', '', low=0.0, open_low=True).check(dt)
        t = dt * np.arange(len(samples) + math.ceil(self.times[-1] / dt - _ROUND_OFF))
        return self.shape(lambda at: np.interp(at, t[:len(samples)], samples))(t)

    @checked(frequency=NUMBERS, damping=NUMBERS)
    def residual(self, frequency: ArrayLike, damping: ArrayLike | None = None) -> np.ndarray:
        """
        Return the residual vibration of modes, as a share of that after one impulse (T52).

        Natural frequencies [Hz] and damping ratios, >= 0 and < 1, broadcast. By default a mode has
        the damping ratio of that of `poles` whose frequency is nearest.
        """
        if damping is None:
            own = np.abs(self.poles)
            far = np.abs(np.subtract.outer(2.0 * math.pi * np.asarray(frequency), own))
            damping = np.maximum(-self.poles.real / own, 0.0)[far.argmin(axis=-1)]
        ratio = np.asarray(damping, dtype=float)
        if not ((ratio >= 0.0) & (ratio < 1.0)).all():
            raise ParameterError(f'damping must be >= 0 and < 1, got {damping!r}')
        poles = 2.0 * math.pi * np.asarray(frequency) * (1j * np.sqrt(1.0 - ratio**2) - ratio)
        return np.abs(np.exp(np.multiply.outer(poles, self.times[-1] - self.times))
                      @ self.amplitudes)


@checked(contact=CONTACT)
def shaper(plant: SceneLike | list[complex] | np.ndarray, kind: str = 'ZVD', modes: int = 1,
           tolerance: float = 0.05, contact: str = '') -> Shaper:
    """
    Return the Shaper that does not excite the slowest vibrations of a scene, or poles (T53).

    The plant is a scene that forces and torques move, with the number of its `modes`; or poles
    [1/s] with positive imaginary parts, complex, (n,), all of which count: those of a closed loop,
    or `timo_sim.modes(scene, 0.0).poles[:1]` for a shaft that follows its angle exactly.
    `contact` is that of a gear with backlash, as of `linearize`. ZV (zero
    vibration) makes a command longer by half a period of each mode. ZVD (zero vibration and
    derivative) and EI (extra insensitive), which leaves the tolerance (T54) at the mode, take a
    period and tolerate errors of the frequency, EI larger ones. Raises ParameterError if a pole
    does not vibrate, or grows, or is damped too much for the tolerance.

    Examples
    --------
    >>> import timo_sim
    >>> shaper = timo_sim.shaper('paper', 'EI')
    >>> shaper.amplitudes.round(4)
    array([0.2625, 0.475 , 0.2625])
    >>> shaper.residual([3.67, 4.27, 4.87]).round(2)
    array([0.  , 0.05, 0.  ])

    """
    Parameter('kind', '', '', '', choices=KINDS).check(kind)
    left = Parameter('tolerance', 0.0, '', '', low=0.0, high=1.0, open_low=True).check(tolerance)
    if isinstance(plant, (list, np.ndarray)):
        poles = np.ravel(np.asarray(plant, dtype=complex))
        if not len(poles):
            raise ParameterError('plant must be a scene or have at least one pole, got none')
    else:
        poles = vibrations(plant, contact=contact).poles
        poles = poles[:Parameter('modes', 1, '', '', low=1, high=len(poles)).check(modes)]
    times, amplitudes = np.zeros(1), np.ones(1)
    for pole in poles:
        if not pole.imag > _ROUND_OFF * abs(pole) >= pole.real:
            raise ParameterError('a pole must have an imaginary part > 0 and no real part > 0, '
                                 f'got {pole:.6g}')
        half = math.pi / pole.imag
        decay = math.exp(min(pole.real, 0.0) * half)
        parts = {'ZV': [1.0, decay], 'ZVD': [1.0, 2.0 * decay, decay**2], 'EI': [
            1.0, (2.0 * decay**2 - left * (1.0 + decay**2)) / (decay + left), decay**2]}[kind]
        if min(parts) < 0.0:
            raise ParameterError(f'tolerance must be less for the pole {pole:.6g}, got {left:g}')
        times = np.add.outer(times, half * np.arange(len(parts))).ravel()
        amplitudes = np.outer(amplitudes, np.divide(parts, sum(parts))).ravel()
    times, amplitudes = np.array(sorted(zip(times, amplitudes))).T
    return Shaper(times, amplitudes, poles)
