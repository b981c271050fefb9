# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Integration in time: the step ETDRK4, the estimate of its error, dry friction.

This package may import `jit`, `physics.layout` and `physics.equations`, of which it knows the
declared functions and `Formulation`.
"""

from timo_sim.physics.integrate.friction import FrictionSteps
from timo_sim.physics.integrate.steps import Steps


def steps_of(model, step, friction=None):
    """
    Return the time steps of a model.

    Parameters
    ----------
    model : Formulation
    step : float
        [s]
    friction : ndarray, shape (3,), optional
        Largest dry friction of carrier x, y [N] and shaft [N m].

    Returns
    -------
    Steps

    """
    if friction is not None and friction.any():
        return FrictionSteps(model, step, friction)
    return Steps(model, step)
