"""What a log says of a run besides its messages: metadata records `timo_sim` and others."""

from importlib.metadata import version
import json
import platform

from llvmlite.binding import get_host_cpu_name

import timo_sim

START, RESET, SUMMARY = 'timo_sim', 'timo_sim.reset', 'timo_sim.summary'
# What the last bits of a run depend on besides its scene.
_GROUND = ('timo_sim', 'python', 'numpy', 'scipy', 'numba', 'machine', 'processor')


def start_note(node, values, scene):
    """
    Return what a log says at its beginning.

    Parameters
    ----------
    node : str
        Fully qualified name.
    values : dict
        All parameters of the node.
    scene : Scene

    Returns
    -------
    dict of str

    """
    return {
        'node': node, 'parameters': json.dumps(values),
        'initial_motion': json.dumps(scene.initial_motion().tolist()), **_here()}


def other_ground(facts):
    """Return in words what is not as it was when a log was made, '' if nothing is known to be."""
    return ', '.join(f'{name} {facts[name][:40]} (here {value})'
                     for name, value in _here().items() if facts.get(name, value) != value)


def _here():
    return dict(zip(_GROUND, (
        timo_sim.__version__, platform.python_version(),
        *(version(package) for package in ('numpy', 'scipy', 'numba')),
        platform.machine(), get_host_cpu_name())))
