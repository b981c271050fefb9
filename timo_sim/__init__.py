# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Simulate a planar mobile manipulator with a flexible Timoshenko arm."""

from importlib import import_module
from typing import Any, TYPE_CHECKING

from timo_sim.version import __version__

if TYPE_CHECKING:
    from timo_sim.control.feedforward import feedforward, Plan
    from timo_sim.control.observer import observer
    from timo_sim.control.ringdown import ringdown
    from timo_sim.control.shaping import Shaper, shaper
    from timo_sim.export.c import export_c
    from timo_sim.export.fmu import export_fmu
    from timo_sim.fitting.mapping import read_record
    from timo_sim.fitting.record import Record
    from timo_sim.fitting.result import fit, Fit
    from timo_sim.runs.linear import linearize, LinearModel
    from timo_sim.runs.modes import modes
    from timo_sim.runs.replay import open_log
    from timo_sim.runs.run import Run
    from timo_sim.runs.sensitivities import sensitivities, Sensitivities
    from timo_sim.runs.simulate import choose_resolution, simulate
    from timo_sim.runs.sweep import simulate_many
    from timo_sim.scene.parameters import ModelWarning, ParameterError
    from timo_sim.scene.scene import load_scene, project_on_modes, Scene
    from timo_sim.simulation.batch import Batch
    from timo_sim.simulation.finer import EstimatingSimulator
    from timo_sim.simulation.simulator import Simulator
    from timo_sim.simulation.warnings import DivergenceError

# Modules are imported when first used, so that `sim_node` installs its signal handlers before
# NumPy, SciPy and numba are loaded.
_MODULES = {
    'Batch': 'simulation.batch',
    'DivergenceError': 'simulation.warnings',
    'EstimatingSimulator': 'simulation.finer',
    'Fit': 'fitting.result',
    'LinearModel': 'runs.linear',
    'ModelWarning': 'scene.parameters',
    'ParameterError': 'scene.parameters',
    'Plan': 'control.feedforward',
    'Record': 'fitting.record',
    'Run': 'runs.run',
    'Scene': 'scene.scene',
    'Sensitivities': 'runs.sensitivities',
    'Shaper': 'control.shaping',
    'Simulator': 'simulation.simulator',
    'choose_resolution': 'runs.simulate',
    'export_c': 'export.c',
    'export_fmu': 'export.fmu',
    'feedforward': 'control.feedforward',
    'fit': 'fitting.result',
    'linearize': 'runs.linear',
    'load_scene': 'scene.scene',
    'modes': 'runs.modes',
    'observer': 'control.observer',
    'open_log': 'runs.replay',
    'project_on_modes': 'scene.scene',
    'read_record': 'fitting.mapping',
    'ringdown': 'control.ringdown',
    'sensitivities': 'runs.sensitivities',
    'shaper': 'control.shaping',
    'simulate': 'runs.simulate',
    'simulate_many': 'runs.sweep',
}

__all__ = [
    'Batch', 'DivergenceError', 'EstimatingSimulator', 'Fit', 'LinearModel', 'ModelWarning',
    'ParameterError', 'Plan', 'Record', 'Run', 'Scene', 'Sensitivities', 'Shaper', 'Simulator',
    '__version__',
    'choose_resolution', 'export_c', 'export_fmu', 'feedforward', 'fit', 'linearize', 'load_scene',
    'modes', 'observer', 'open_log', 'project_on_modes', 'read_record', 'ringdown',
    'sensitivities', 'shaper', 'simulate', 'simulate_many']


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(f'{__name__}.{_MODULES[name]}'), name)


def __dir__() -> list[str]:
    return __all__
