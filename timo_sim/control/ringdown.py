# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Frequencies and damping of what goes on vibrating after a stop; see doc/ringdown.md."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh, eigvals, hankel, lstsq, matmul_toeplitz, pinv
from scipy.optimize import least_squares
from scipy.signal import correlate, firwin, oaconvolve

from timo_sim.control.shaping import KINDS, shaper
from timo_sim.extras import optional
from timo_sim.scene.parameters import checked, NUMBERS, Parameter, ParameterError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST, _QUICK = 2000, 400   # samples of a fit, and of one that tries a start
_FEWEST = 30                # samples of a ring-down
_ORDERS = 2, 3, 4, 5, 6, 8, 10  # numbers of poles that are tried
_STARTS, _HALVINGS = 6, 7   # starts within a length that are tried, and lengths
_PERIODS = 3.0              # least periods of a vibration in its record
_DAMPED = 0.3               # damping ratio above which what dies out is no vibration
_WEAK = 0.1                 # amplitude relative to the strongest that is not listed
_PART = 0.25                # of a period: longest time between means of samples
_HEARD, _LOUD = 0.01, 6.0   # least peak in a spectrum, of the largest, and in medians
_SURE = 6.0                 # least amplitude in standard deviations
_STRAIGHT = 0.5             # misfit of a straight envelope relative to that of an exponential one
_POOR = 0.5                 # what a fit may leave
_LEVELS, _CUT = 10, 0.02    # least values of what is cut, and least part of samples at an end
_NORMAL = 1.96              # standard deviations of an interval of 95 %


@dataclass(frozen=True, repr=False)
class RingDown:
    """
    The n vibrations of a record after a stop, the strongest first.

    Attributes
    ----------
    frequency, damping : ndarray, shape (n,)
        Natural frequencies [Hz] and damping ratios.
    frequency_error, damping_error : ndarray, shape (n,)
        Half widths of their intervals of 95 %.
    amplitude : ndarray, shape (n,)
        Amplitudes at the start, in the unit of the record.
    t, measured, fitted : ndarray, shape (k,)
        The samples of the ring-down, and their fit, which also has an offset and a drift.
    remarks : tuple of str
        What these numbers do not show, such as dry friction.

    """

    frequency: np.ndarray
    damping: np.ndarray
    frequency_error: np.ndarray
    damping_error: np.ndarray
    amplitude: np.ndarray
    t: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray
    remarks: tuple[str, ...]

    @property
    def poles(self) -> np.ndarray:
        """Poles with positive imaginary parts, which `timo_sim.shaper` takes, shape (n,) [1/s]."""
        return 2.0 * math.pi * self.frequency * (
            1j * np.sqrt(1.0 - self.damping**2) - self.damping)

    def report(self) -> str:
        """Return vibrations, what shapers leave of them, and remarks, as a text."""
        share = np.std(self.measured - self.fitted) / np.std(self.measured)
        lines = [f'rings from {self.t[0]:.4g} to {self.t[-1]:.4g} s; the fit leaves '
                 f'{100.0 * share:.2g} %', '',
                 f'{"frequency [Hz]":<24}{"damping ratio":<24}amplitude']
        lines += [f'{f"{hertz:.5g} +- {of_hertz:.2g}":<24}{f"{ratio:.4f} +- {of_ratio:.2g}":<24}'
                  f'{size:.4g}' for hertz, of_hertz, ratio, of_ratio, size in zip(
                      self.frequency, self.frequency_error, self.damping, self.damping_error,
                      self.amplitude)]
        lines += ['', f'{"shaper":<14}{"longer by":>12}   leaves, at the frequency   5 % off   '
                  '10 % off']
        for count in range(1, min(len(self.poles), 2) + 1):
            for kind in KINDS:
                made = shaper(self.poles[:count], kind)
                left = [100.0 * made.residual(np.outer([1.0 - off, 1.0 + off],
                                                       self.frequency[:count])).max()
                        for off in (0.0, 0.05, 0.1)]
                lines.append(f'{f"{kind}, {count} mode" + "s" * (count > 1):<14}'
                             f'{made.times[-1]:>10.3f} s'
                             + '{:>23.1f} %{:>8.1f} %{:>9.1f} %'.format(*left))
        return '\n'.join([*lines, '', *self.remarks]).rstrip()

    def plot(self) -> Figure:
        """Draw what was measured and the fit; needs matplotlib."""
        with optional():
            from matplotlib.figure import Figure
        figure = Figure(figsize=(10, 4), layout='constrained')
        axes = figure.subplots()
        axes.plot(self.t, self.measured, '.', color='0.6', label='measured')
        axes.plot(self.t, self.fitted, label='fitted')
        axes.set(xlabel='time [s]')
        axes.grid(alpha=0.3)
        axes.legend()
        return figure


class _Fit:
    """
    Poles [1/s], (p,), of samples by least squares.

    `amplitude` and its deviation, (p,); deviations of rates and frequencies, (2, p) [1/s].
    """

    def __init__(self, t: np.ndarray, values: np.ndarray, most: int = _MOST) -> None:
        self.dt = dt = float(np.median(np.diff(t)))
        even = np.arange(t[0], t[-1] + 0.5 * dt, dt)
        smooth = np.interp(even, t, values)
        # What a low-pass filter makes of samples has the same poles. Where there would be too few
        # of its values for the fastest vibration they are those of the beginning alone. It passes
        # nearly all that its values can show, so that white noise stays white. To find where the
        # arm rings, means of all blocks do.
        block = math.ceil(len(even) / most)
        self.weights = np.full(block, 1.0 / block)
        if block > 1 and most == _MOST:
            block = min(block, max(int(_PART / dt / _fastest(smooth, dt)), 1))
            self.weights = firwin(12 * block + 1, 0.9 / block) if block > 1 else np.ones(1)
        longer = len(self.weights) - 1
        smooth = oaconvolve(smooth[:most * block + longer], self.weights, 'valid')[::block]
        even = t[0] + dt * (0.5 * longer + block * np.arange(len(smooth)))
        self.t, self.values = (even, smooth) if block > 1 else (t[:most], values[:most])
        tries = 20 if most == _MOST else 1
        self._solve(min(_pencil(smooth - smooth.mean(), block * dt),
                        key=lambda poles: np.std(self._residual(poles)) * 1.1**len(poles)), tries)
        # What else the order took in is noise, and counts as such in the errors.
        self.keep(self.vibrations() + [*np.flatnonzero(self.poles.imag == 0.0)], tries)

    def keep(self, places: list[int], tries: int = 20) -> None:
        """Leave out other poles."""
        if len(places) < len(self.poles):
            self._solve(self.poles[places], tries)

    def _residual(self, poles):
        basis = _basis(self.t, poles)
        return basis @ lstsq(basis, self.values, lapack_driver='gelsy')[0] - self.values

    def _solve(self, poles, tries):
        """Set all from first guesses of the poles."""
        count, waves = len(poles), poles.imag != 0.0

        def poles_of(x):
            found = x[:count].astype(complex)
            found[waves] += 1j * x[count:]
            return found

        def by_pole(of_cosine, of_sine):
            found = np.zeros((2, count))
            found[0], found[1, waves] = of_cosine, of_sine
            return found

        growth = 1.0 / (self.t[-1] - self.t[0])  # what grows more is no ring-down
        start = np.concatenate([np.minimum(poles.real, 0.9 * growth), poles.imag[waves]])
        self.poles, self.deviation, gain = poles, np.zeros((2, count)), None
        if count:
            fit = least_squares(lambda x: self._residual(poles_of(x)), start, x_scale='jac',
                                bounds=(-np.inf, [growth] * count + [np.inf] * waves.sum()),
                                max_nfev=tries)
            self.poles, gain = poles_of(fit.x), pinv(fit.jac).T
        basis = _basis(self.t, self.poles)
        unmix = pinv(basis)
        parts = unmix @ self.values
        self.fitted = basis @ parts
        self.residual = self.values - self.fitted
        shifts = self.dt * (np.arange(len(self.weights)) - 0.5 * (len(self.weights) - 1))
        with np.errstate(over='ignore', invalid='ignore'):  # of what dies out at once
            mean = np.abs(self.weights @ np.exp(np.multiply.outer(shifts, self.poles)))
        self.amplitude = np.hypot(*by_pole(parts[:count], parts[count:-2])) / mean
        deviation = self._deviations(unmix.T)
        deviation = by_pole(deviation[:count], deviation[count:-2])
        self.amplitude_deviation = deviation.max(axis=0) / mean
        if gain is not None:
            deviation = self._deviations(gain)
            self.deviation = by_pole(deviation[:count], deviation[count:])

    def _deviations(self, gain):
        """Return those of what a gain, (k, m), makes of the noise, white or coloured."""
        count = len(self.residual)
        lags = correlate(self.residual, self.residual)[count - 1:] / max(
            count - 2 - 4 * len(self.poles), 1)
        taper = np.maximum(1.0 - np.arange(count) / (0.1 * count), 0.0)
        coloured = np.sum(gain * matmul_toeplitz(lags * taper, gain), axis=0)
        return np.sqrt(np.maximum(coloured, lags[0] * np.sum(gain**2, axis=0)))

    def vibrations(self) -> list[int]:
        """Return places of the poles that are vibrations and no noise, the strongest first."""
        length, size = self.t[-1] - self.t[0], np.abs(self.poles)
        rate, omega = np.maximum(-self.poles.real, 0.01 / length), self.poles.imag
        good = ((omega * length > 2.0 * math.pi * _PERIODS) & (rate < _DAMPED * size)
                & (self.amplitude > _SURE * self.amplitude_deviation))
        energy = self.amplitude**2 * -np.expm1(-2.0 * rate * length) / rate
        places: list[int] = []
        for place in sorted(np.flatnonzero(good), key=lambda place: -energy[place]):
            apart = all(abs(omega[place] - omega[other]) * length > 2.0 * math.pi
                        for other in places)
            if apart and self.amplitude[place] > _WEAK * max(
                    self.amplitude[places[:1]], default=0.0):
                places.append(int(place))
        return places

    def dies_out(self, place: int) -> bool:
        """Return whether a vibration dies out for certain."""
        return -self.poles[place].real > _NORMAL * self.deviation[0, place]

    def doubt(self) -> float:
        """Return the deviation of the strongest damping ratio that is certain, or infinity."""
        for place in filter(self.dies_out, self.vibrations()):
            return self.deviation[0, place] / abs(self.poles[place])
        return math.inf


def _fastest(values, dt):
    """Return the highest frequency [Hz] whose peak in the spectrum is that of a vibration."""
    size = np.abs(np.fft.rfft(values - values.mean()))
    size[0] = 0.0
    peaks = np.flatnonzero(size > max(_HEARD * size.max(), _LOUD * np.median(size)))
    return (peaks[-1] if len(peaks) else 1) / (dt * len(values))


def _pencil(values, dt):
    """Yield poles [1/s] by number: the matrix pencil of Hua and Sarkar (1990)."""
    rows = len(values) // 3
    data = hankel(values[:rows], values[rows - 1:])
    directions = eigh(data @ data.T, subset_by_index=(rows - max(_ORDERS), rows - 1))[1]
    for order in _ORDERS:
        basis = directions[:, -order:]
        z = eigvals(pinv(basis[:-1]) @ basis[1:])
        poles = np.log(z[np.abs(z) > 0.01].astype(complex)) / dt
        # Less than half a period in the record is a drift.
        slow = np.abs(poles.imag) * dt * len(values) < math.pi
        poles = np.where(slow, poles.real, poles)
        yield poles[(poles.imag >= 0.0) & (poles.imag < 0.99 * math.pi / dt)
                    & (np.abs(poles) * dt * len(values) > 1.0)
                    & (poles.real * dt * len(values) < 100.0)]  # exp(710) is no number


def _basis(t, poles):
    """Return columns, (k, m): of each pole a cosine and a sine that die out, offset, drift."""
    waves = np.exp(np.multiply.outer(t - t[0], poles))
    return np.hstack([waves.real, waves.imag[:, poles.imag != 0.0],
                      np.ones((len(t), 1)), t[:, np.newaxis] - t.mean()])


@checked(t=NUMBERS, values=NUMBERS)
def ringdown(t: ArrayLike, values: ArrayLike, start: float | None = None,
             end: float | None = None) -> RingDown:
    """
    Return frequencies and damping ratios of what vibrates after a stop, with their errors.

    Parameters
    ----------
    t, values : array, shape (k,)
        Times [s], which may be uneven, and an acceleration, angle, strain or the like.
    start, end : float, optional
        Where the ring-down is, or within what it is looked for without the other one [s]. It is
        the part of the record in which the damping ratio is most certain: while something
        moves the arm, what is measured is no sum of vibrations that die out.

    Raises
    ------
    ParameterError
        If times do not ascend, there are too few samples, or nothing vibrates and dies out.

    Examples
    --------
    >>> import numpy as np, timo_sim
    >>> t = np.arange(0.0, 3.0, 0.01)
    >>> noise = 0.01 * np.random.default_rng(0).normal(size=300)
    >>> found = timo_sim.ringdown(t, np.exp(-t) * np.cos(20.0 * t) + noise)
    >>> print(f'{found.frequency[0]:.2f} Hz, {found.damping[0]:.2f}')
    3.19 Hz, 0.05

    """
    t, values = (np.ravel(each).astype(float) for each in (t, values))
    if t.shape != values.shape or (np.diff(t) <= 0.0).any() or (np.abs(values) > 1e100).any():
        raise ParameterError('t must ascend and have as many numbers as values, which are at '
                             f'most 1e+100 in size, got {len(t)} and {len(values)}')
    low, high = (default if each is None else Parameter(name, 0.0, 's', '').check(each)
                 for name, each, default in (('start', start, -math.inf), ('end', end, math.inf)))
    within = (t >= low) & (t <= high)
    if within.sum() < _FEWEST:
        raise ParameterError(f'a ring-down must have at least {_FEWEST} samples, got '
                             f'{within.sum()} from start to end')
    t, values = t[within], values[within]
    low, high = (start, end) if None not in (start, end) else \
        _window(t, values, start is not None)
    fit = _Fit(t[t >= low], values[t >= low])
    straight = any(_is_straight(fit, place) for place in fit.vibrations()[:1])
    if straight:  # which several vibrations of nearly the same frequency would imitate
        fit.keep(fit.vibrations()[:1] + [*np.flatnonzero(~_near(fit, fit.vibrations()[0]))])
    elif high < t[-1]:
        within = (t >= low) & (t <= high)
        fit = _Fit(t[within], values[within])
    found = fit.vibrations()
    places = [*filter(fit.dies_out, found)]
    steady = ', '.join(f'{abs(fit.poles[place]) / (2.0 * math.pi):.4g} Hz'
                       for place in found if place not in places)
    if not places:
        raise ParameterError(
            f'nothing vibrates and dies out from {fit.t[0]:.4g} to {fit.t[-1]:.4g} s: ' + (
                f'{steady} goes on' if steady else f'no frequency with {_PERIODS:g} periods or '
                f'more stands out of the rest, of {np.std(fit.residual):.3g}')
            + '; say where the arm rings after a stop, or measure nearer to its tip and faster')
    rate, omega = -fit.poles.real[places], fit.poles.imag[places]
    size, (of_rate, of_omega) = np.hypot(rate, omega), _NORMAL * fit.deviation[:, places]
    return RingDown(
        frequency=size / (2.0 * math.pi), damping=rate / size,
        frequency_error=np.hypot(rate * of_rate, omega * of_omega) / (2.0 * math.pi * size),
        damping_error=omega * np.hypot(omega * of_rate, rate * of_omega) / size**3,
        amplitude=fit.amplitude[places], t=fit.t, measured=fit.values, fitted=fit.fitted,
        remarks=tuple(_remarks(
            fit, places, steady, straight, values[(t >= fit.t[0]) & (t <= fit.t[-1])])))


def _window(t, values, given):
    """Return start and end, within all times, between which the damping is most certain."""
    def doubt(start, end):
        kept = (t >= start) & (t <= end)
        enough = kept.sum() >= _FEWEST
        return (_Fit(t[kept], values[kept], _QUICK).doubt() if enough else math.inf), start, end

    best, step = (math.inf, t[0], t[-1]), 0.0
    for length in (t[-1] - t[0]) * 0.5**np.arange(_HALVINGS):
        starts = t[:1] if given else np.arange(t[0], t[-1] - 0.99 * length, length / _STARTS)
        found = min(doubt(start, start + length) for start in starts)
        if found[0] < best[0]:
            best, step = found, 0.0 if given else length / _STARTS
        elif length < 0.3 * (best[2] - best[1]):
            break
    for start in best[1] + step * np.linspace(-1.0, 1.0, 9):
        best = min(best, doubt(max(start, t[0]), best[2]))
    for more in 0.5, 1.0, 2.0:
        best = min(best, doubt(best[1], min(best[2] + more * (best[2] - best[1]), t[-1])))
    return best[1:]


def _remarks(fit, places, steady, straight, samples):
    """Yield what poles and their errors do not show."""
    levels, counts = np.unique(samples, return_counts=True)
    for end, beside in ((0, 1), (-1, -2)) if len(levels) >= _LEVELS else ():
        if counts[end] > max(_CUT * len(samples), 4.0 * counts[beside]):  # of a sine it is 1.4
            yield (f'{counts[end] / len(samples):.0%} of the samples are {levels[end]:.4g}, as of '
                   'a sensor that saturates: damping ratios are then wrong; let the ring-down '
                   'begin where it no longer does')
    if np.std(fit.residual) > _POOR * np.std(fit.values):
        yield ('less than half of what was measured are these vibrations: look at the picture, '
               'and say where the arm rings')
    if steady:
        yield (f'{steady} does not die out: it comes from a controller, a motor or the mains, and '
               'no shaper ends it')
    if abs(fit.poles[places]).max() * fit.dt > 0.4 * math.pi:
        yield 'there are less than five samples in a period: measure faster'
    if straight:
        yield ('the vibration dies out along a straight line, as with dry friction, and not '
               'exponentially: its damping ratio is a mean, and larger for smaller vibrations')


def _near(fit, place):
    """Return which poles, (p,), a mean over its period does not tell from one."""
    return np.abs(fit.poles.imag - fit.poles[place].imag) < 0.3 * fit.poles[place].imag


def _is_straight(fit, place):
    """Return whether the amplitude of a vibration, from means of periods, falls on a line."""
    t = np.linspace(fit.t[0], fit.t[-1], len(fit.t))
    others = _basis(fit.t, fit.poles[~_near(fit, place)])
    alone = fit.values - others @ lstsq(others, fit.values)[0]
    turned = np.interp(t, fit.t, alone) * np.exp(-1j * fit.poles[place].imag * t)
    period = max(round(2.0 * math.pi / fit.poles[place].imag / (t[1] - t[0])), 1)
    envelope = np.abs(np.convolve(turned, np.full(period, 1.0 / period), 'valid'))
    small = np.flatnonzero(envelope < 0.1 * envelope[0])
    envelope = envelope[:small[0]] if len(small) else envelope
    if len(envelope) < 3 * period:
        return False
    t = t[:len(envelope)]
    straight = np.polyval(np.polyfit(t, envelope, 1), t)
    exponential = np.exp(np.polyval(np.polyfit(t, np.log(envelope), 1, w=envelope), t))
    return np.std(envelope - straight) < _STRAIGHT * np.std(envelope - exponential)
