# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Many models of one size as one, whose arrays have the models as first axis."""

import copy

import numpy as np

_ARRAYS = 'point_mass', 'point_inertia', 'gravity'


def stacked(models):
    """
    Return models of one class and size as one, to observe motions of all of them at once.

    `centre_line`, `world` and `velocities` take motions, or coordinates, whose first axis is that
    of the models: (models, n, ...). If all models are the same one, it is returned as it is, and
    takes motions with any axes before the last.

    Parameters
    ----------
    models : list of Formulation

    """
    if all(model is models[0] for model in models):
        return models[0]
    stack = copy.copy(models[0])
    for name in (*stack.arrays, *_ARRAYS):
        setattr(stack, name, np.array([getattr(model, name) for model in models]))
    for name in 'points', 'tip_point':
        setattr(stack, name, of_all([getattr(model, name) for model in models]))
    stack.tables = of_all([model.tables for model in models])
    return stack


def of_all(tuples):
    """Return NamedTuples as one, whose arrays have another first axis."""
    return tuples[0]._make(np.array(arrays) for arrays in zip(*tuples))
