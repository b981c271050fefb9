# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The model: bodies, modes and equations of motion of the manipulator; values in, values out.

This package may import NumPy, SciPy and `compiled`; it knows no files, no scenes, no ROS and no
integrator. A formulation is a subclass of `formulation.Formulation` with compiled functions that
are tied to its constants, see `functions`.
"""

from importlib import import_module
from typing import Any

# Module and class of each formulation by name. Modules are imported on demand, so that listing
# the names is cheap. Another package adds its formulations to them.
FORMULATIONS = {
    'exact': 'timo_sim.model.exact:Exact',
    'newton': 'timo_sim.model.newton:Newton',
}


def formulation_class(name: str) -> Any:
    """Return the class of a formulation, a subclass of `formulation.Formulation`."""
    module, _, attribute = FORMULATIONS[name].partition(':')
    return getattr(import_module(module), attribute)
