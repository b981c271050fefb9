# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""How certain fitted parameters are: covariance, combinations that cannot be told, whiteness."""

import numpy as np
from scipy.linalg import matmul_toeplitz

WHITE = 0.01         # probability below which residuals do not count as white
NORMAL = 1.959964    # standard deviations of a 95 % interval
_LAGS = 20           # of the test for whiteness
_ORDER = 12          # largest of an autoregressive process
_NOTHING = 1e-30     # sensitivity of residuals that counts as none
_FAR = 1e3           # deviation of a combination of which residuals say nothing
_ROUND_OFF = 1e-9    # singular value, relative to the largest, below which it is that of noise
# Of the largest part in a combination, from which on a parameter is named: any, or a lost one.
_PART, _SMALL = 0.25, 0.02


def whiteness(residuals):
    """
    Return the probability that white residuals are as correlated as these, by Ljung and Box.

    Parameters
    ----------
    residuals : ndarray, shape (n,)
        Ascending in time.

    """
    from scipy.stats import chi2
    r = residuals - residuals.mean()
    n, lags = len(r), min(_LAGS, len(r) // 4)
    power = r @ r
    if not power:
        return 1.0
    lag = np.arange(1, lags + 1)
    correlation = np.array([r[k:] @ r[:-k] for k in lag]) / power
    return float(chi2.sf(n * (n + 2.0) * np.sum(correlation**2 / (n - lag)), lags))


def covariance(jacobians, residuals):
    """
    Return the covariance of parameters estimated by least squares.

    If the residuals of all outputs are white it is that of independent noise. Otherwise what the
    model lacks is in them, too, and each series counts as an autoregressive process, whose order
    minimises Schwarz's criterion (BIC). No combination of parameters is then taken to be more
    certain than with independent noise.

    Parameters
    ----------
    jacobians : list of ndarray, shape (n_i, p)
        Of the residuals of each series (an output in a window) by the parameters.
    residuals : list of ndarray, shape (n_i,)
        In standard deviations.

    Returns
    -------
    covariance : ndarray, shape (p, p)
    white : bool

    """
    whole = np.concatenate(jacobians)
    norms = np.maximum(np.linalg.norm(whole, axis=0), _NOTHING)
    u, s, vt = np.linalg.svd(whole / norms, full_matrices=False)
    root = vt.T / norms[:, np.newaxis]
    # What is below the errors of the derivatives may be nothing.
    s = np.where(s < _ROUND_OFF * s[0], np.minimum(s, np.abs(root).max(axis=0) / _FAR), s)
    root /= np.maximum(s, _NOTHING)
    white = all(whiteness(each) >= WHITE for each in residuals if len(each) > 4)
    if not white:
        # Between orthonormal columns: by the parameters, round-off may exceed the least of it.
        parts = np.split(u, np.cumsum([len(each) for each in residuals])[:-1])
        size, axes = np.linalg.eigh(sum(map(_of_sums, parts, residuals)))
        root = root @ (axes * np.sqrt(np.maximum(size, 1.0)))
    return root @ root.T, white


def _of_sums(columns, residuals):
    """Return the covariance of sums of residuals weighted by columns, shape (n, p)."""
    n = len(residuals)
    lags = range(min(_ORDER, n // 10) + 1)
    found = np.array([residuals[k:] @ residuals[:n - k] for k in lags]) / n
    # The recursion of Levinson and Durbin.
    past, rest, best = np.zeros(0), found[0], (np.inf, np.zeros(0), found[0])
    for order in lags:
        if order:
            last = (found[order] - past @ found[order - 1:0:-1]) / rest
            past = np.append(past - last * past[::-1], last)
            rest *= 1.0 - last**2
        if not rest > _ROUND_OFF * found[0]:
            break
        best = min(best, (n * np.log(rest) + order * np.log(n), past, rest), key=lambda it: it[0])
    _, past, rest = best
    response = np.fft.rfft(np.append(1.0, -past), 4 * n)
    covariances = np.fft.irfft(rest / np.abs(response)**2, 4 * n)[:n]
    return columns.T @ matmul_toeplitz(covariances, columns)


def unknown(jacobian, names, doubtful, most=1.0):
    """
    Return which combinations of parameters the residuals hardly depend on.

    Parameters
    ----------
    jacobian : ndarray, shape (n, p)
        Of all residuals in standard deviations, by coordinates of the fit.
    names : list of str, length p
    doubtful : set of str
        Those that are not identified; a combination has one of them.
    most : float
        Half of the 95 % interval of a combination from which on it counts as unknown.

    Returns
    -------
    list of dict
        For each such combination the part of each parameter that matters in it, by name.

    """
    _, s, vt = np.linalg.svd(jacobian, full_matrices=False)
    found = []
    for value, parts in zip(s, vt):
        if value * most < NORMAL or value < _ROUND_OFF * s[0]:
            share = np.abs(parts) / np.abs(parts).max()
            large = (share > _PART) | (share > _SMALL) & [name in doubtful for name in names]
            sign = np.sign(parts[np.argmax(np.abs(parts))])
            found.append({name: float(sign * part)
                          for name, part, kept in zip(names, parts, large) if kept})
    return [parts for parts in found if doubtful & parts.keys()]


def r_squared(measured, predicted):
    """Return the coefficient of determination R^2; NaN if nothing was measured to vary."""
    spread = np.sum((measured - measured.mean())**2)
    return float(1.0 - np.sum((measured - predicted)**2) / spread) if spread else np.nan
