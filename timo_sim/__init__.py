"""
timo_sim: a mobile manipulator with a flexible Timoshenko arm, simulated.

The public names are imported when first used, so that `sim_node` can take care of signals before
it loads NumPy, SciPy and numba.
"""

from importlib import import_module

__version__ = '0.1.0'

_HOMES = {
    'DivergenceError': 'timo_sim.simulation',
    'ModelWarning': 'timo_sim.simulation',
    'ParameterError': 'timo_sim.parameters',
    'Run': 'timo_sim.run',
    'Scene': 'timo_sim.scene',
    'linearize': 'timo_sim.linear',
    'load_scene': 'timo_sim.scene',
    'project': 'timo_sim.scene',
    'settle': 'timo_sim.accuracy',
    'simulate': 'timo_sim.simulation',
    'simulate_many': 'timo_sim.sweep.many',
}

__all__ = list(_HOMES)


def __getattr__(name):
    if name not in _HOMES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(_HOMES[name]), name)
