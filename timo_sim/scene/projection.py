# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Projection of fields along the arm on the modes of a scene."""

from collections.abc import Callable
from typing import Any

import numpy as np

from timo_sim.scene.scene import Scene


def project_on_modes(scene: Scene, deflection: Callable[[np.ndarray], Any],
                     rotation: Callable[[np.ndarray], Any]) -> tuple[float, ...]:
    """
    Project a deflection field, or a velocity field, on the modes of a scene.

    The result is exact to first order in the field. It is a value for the parameters
    `initial.modal_coordinates` or `initial.modal_rates`.

    Parameters
    ----------
    scene : Scene
    deflection : function(ndarray) -> array_like
        Deflection w(xi) in the arm frame [m], or its rate [m/s], for xi of shape (p,) [m].
    rotation : function(ndarray) -> array_like
        Rotation phi(xi) [rad], or its rate [rad/s].

    Returns
    -------
    tuple of float, length N
        Modal coordinates [m sqrt(kg)] or rates [m sqrt(kg)/s]. Source: paper eqs. (21), (23).

    Examples
    --------
    >>> import timo_sim
    >>> scene = timo_sim.load_scene({})
    >>> q = timo_sim.project_on_modes(scene, lambda xi: 0.01 * xi**2, lambda xi: 0.02 * xi)
    >>> bent = scene.vary({'initial.modal_coordinates': q})

    """
    return tuple(scene.build().project_on_modes(deflection, rotation).tolist())
