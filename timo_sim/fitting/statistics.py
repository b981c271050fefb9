# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""How certain fitted parameters are: covariance, combinations that cannot be told, whiteness."""

import numpy as np

WHITE = 0.01         # probability below which residuals do not count as white
NORMAL = 1.959964    # standard deviations of a 95 % interval
_LAGS = 20           # of the test for whiteness
_BANDWIDTH = 4       # lags of the covariance, in lags after which residuals are uncorrelated
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
    model lacks is in them, too, and it is the one that Newey and West give for correlated
    residuals, which is larger.

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
    u, s, vt = np.linalg.svd(whole, full_matrices=False)
    s = np.maximum(s, max(_ROUND_OFF * s[0], np.finfo(float).tiny**0.25))
    inverse = (vt.T / s**2) @ vt
    white = all(whiteness(each) >= WHITE for each in residuals if len(each) > 4)
    if white:
        return inverse, True
    middle = sum(_long_run(j * r[:, np.newaxis], r) for j, r in zip(jacobians, residuals))
    found = inverse @ middle @ inverse
    # Correlated residuals tell nothing of what no residual depends on.
    lost = vt[s < NORMAL] / s[s < NORMAL, np.newaxis]
    found += lost.T @ lost
    found[np.diag_indices(len(found))] = np.maximum(np.diag(found), np.diag(inverse))
    return found, False


def _long_run(scores, residuals):
    """Return the covariance of the sum of correlated scores, (n, p), by Bartlett's weights."""
    power, lag = residuals @ residuals, 1
    while lag < len(residuals) // 4 and residuals[lag:] @ residuals[:-lag] > 0.05 * power:
        lag += 1
    most = min(_BANDWIDTH * lag, len(residuals) // 2)
    found = scores.T @ scores
    for k in range(1, most + 1):
        product = scores[k:].T @ scores[:-k]
        found += (1.0 - k / (most + 1.0)) * (product + product.T)
    return found


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
