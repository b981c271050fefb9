# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Linear models for control design: matrices with names, continuous or discrete in time."""

from dataclasses import dataclass, replace

import numpy as np

from timo_sim.extras import optional
from timo_sim.scene.parameter import did_you_mean, Parameter, ParameterError
from timo_sim.scene.summary import html_table

_PERIOD = Parameter('dt', 1.0, 's', 'period', low=0.0, open_low=True)


@dataclass(frozen=True, repr=False)
class LinearModel:
    """
    `x' = A x + B u`, `y = C x + D u`: deviations from an equilibrium.

    Attributes
    ----------
    A, B, C, D : ndarray, shapes (m, m), (m, u), (y, m), (y, u)
    states, inputs, outputs : tuple of str
        Names with units.
    dt : float or None
        Period of a discrete-time model [s], `x+ = A x + B u`; None: continuous time.

    Examples
    --------
    >>> import timo_sim
    >>> model = timo_sim.linearize(timo_sim.load_scene({'model.modes': 3}))
    >>> model.select(['torque_N_m'], ['shaft_rad']).to_discrete(0.002).D.shape
    (1, 1)

    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    states: tuple
    inputs: tuple
    outputs: tuple
    dt: float | None = None

    def __repr__(self):
        time = 'continuous time' if self.dt is None else f'dt = {self.dt:g} s'
        return (f'<LinearModel: {len(self.states)} states, inputs {", ".join(self.inputs)}, '
                f'outputs {", ".join(self.outputs)}, {time}>')

    def _repr_html_(self):
        return html_table('LinearModel', {
            'states': ', '.join(self.states), 'inputs': ', '.join(self.inputs),
            'outputs': ', '.join(self.outputs),
            'frequencies [Hz]': ', '.join(f'{each:.4g}' for each in self.frequencies()),
            'time': 'continuous' if self.dt is None else f'dt = {self.dt:g} s'})

    def select(self, inputs=None, outputs=None):
        """
        Return the model with some inputs and outputs, in the order given.

        Raises
        ------
        ParameterError
            If a name is none of the model's.

        """
        u = _places(self.inputs, inputs, 'input')
        y = _places(self.outputs, outputs, 'output')
        return replace(self, B=self.B[:, u], C=self.C[y], D=self.D[np.ix_(y, u)],
                       inputs=tuple(self.inputs[place] for place in u),
                       outputs=tuple(self.outputs[place] for place in y))

    def state_space(self):
        """Return the model as a `scipy.signal.StateSpace`."""
        from scipy.signal import StateSpace
        time = {} if self.dt is None else {'dt': self.dt}
        return StateSpace(self.A, self.B, self.C, self.D, **time)

    def to_control(self):
        """Return the model as a `control.StateSpace` of python-control, names included."""
        with optional():
            from control import ss
        return ss(self.A, self.B, self.C, self.D, self.dt or 0, states=list(self.states),
                  inputs=list(self.inputs), outputs=list(self.outputs))

    def to_discrete(self, dt):
        """
        Return the model at the instants of a controller that holds its commands for dt [s].

        It is exact: `x` after a period is `A x + B u`.

        Raises
        ------
        ParameterError
            If the period is not > 0, or the model is of discrete time already.

        """
        from scipy.signal import cont2discrete
        if self.dt is not None:
            raise ParameterError(f'the model is of discrete time already, dt = {self.dt:g} s')
        dt = _PERIOD.check(dt)
        a, b, c, d, _ = cont2discrete((self.A, self.B, self.C, self.D), dt, method='zoh')
        return replace(self, A=a, B=b, C=c, D=d, dt=dt)

    def frequency_response(self, frequency):
        """Return outputs per input at frequencies, shape (n,) [Hz], complex, (n, y, u)."""
        s = 2j * np.pi * np.asarray(frequency, dtype=float)[:, np.newaxis, np.newaxis]
        if self.dt is not None:
            s = np.exp(s * self.dt)  # z on the unit circle
        return self.C @ np.linalg.solve(s * np.eye(len(self.A)) - self.A,
                                        self.B[np.newaxis]) + self.D

    def poles(self):
        """
        Return the poles by magnitude, shape (m,) [1/s].

        The poles s of a discrete-time model belong to its eigenvalues `z = exp(s dt)`.
        """
        poles = np.linalg.eigvals(self.A)
        if self.dt is not None:
            poles = np.log(poles.astype(complex)) / self.dt
        return poles[np.lexsort((poles.imag, np.abs(poles).round(9)))]

    def frequencies(self):
        """Return the natural frequencies of the oscillating poles, ascending [Hz]."""
        poles = self.poles()
        return np.abs(poles[poles.imag > 1e-3]) / (2.0 * np.pi)


def _places(names, chosen, kind):
    if chosen is None:
        return list(range(len(names)))
    unknown = [name for name in chosen if name not in names]
    if unknown:
        raise ParameterError(f'{kind} {unknown[0]!r} is none of {", ".join(names)}'
                             f'{did_you_mean(unknown[0], names)}')
    return [names.index(name) for name in chosen]
