# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Code that is made when the package is built, for a first result at once.

An installation that has the intermediate code of all entry points but derivatives of steps and
observers needs numba for these alone: LLVM makes machine code for a size. The machine code of
usual sizes is made here, too, for the processor of the build; its files have names that tell the
processor, so that no other loads them.
An editable installation, whose sources will change, has the code of the default scene alone.
Equations other than `exact` have the code of single runs without dry friction; numba makes the
rest when somebody needs it.
"""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
import shutil
import sys
from typing import Any

import numpy as np

from timo_sim.compiled import machine, store
from timo_sim.compiled.entry import EntryPoint
from timo_sim.compiled.functions import Constants
from timo_sim.export import instance
from timo_sim.model import bodies, exact_code, functions, modes, newton
from timo_sim.model.layout import LOADS
from timo_sim.scene.scene import load_scene
from timo_sim.simulation.finer import EstimatingSimulator
from timo_sim.steps import bristles, etdrk4, lanes, loads, sensors

# A carrier and a shaft that move freely, as in the paper; and an arm on a hub, on a carrier that
# is held, as in the scene of `timo_sim new`. Each has the size of its finer run, too.
USUAL: list[dict[str, Any]] = [
    *[{'model.modes': modes} for modes in range(1, 6)], {'model.formulation': 'newton'},
    {'carrier.held': 'both', 'hub.radius': 0.03, 'end_effector.mass': 0.1,
     'end_effector.inertia': 5.0e-5}]


# Kinds of the constants of entry points, by the name of the argument; None is that of `tables`.
_KINDS: dict[str, list[Any]] = {
    'arm': [modes.UniformArm], 'tables': [exact_code.Tables, newton.Tables],
    'flow': [functions.Flow], 'propagator': [*etdrk4.one_step.bodies],
    'bristles': [bristles.Bristles],
    'lane': [lanes.Lane], 'plan': [lanes.Plan],
    'loads': [loads.SceneLoads], 'actuators': [loads.Actuators], 'plant': [instance.Plant],
    'root': [functions.Root], 'outline': [functions.Outline],
    'errors': [sensors.SensorErrors], 'beyond': [None], 'seen': [None],
    'instance': [instance.Instance]}


def entries() -> Iterator[tuple[EntryPoint, tuple[type, ...]]]:
    """Yield the entry points, each with the kinds of its constants."""
    for module in bodies, modes, functions, etdrk4, instance, lanes, loads, sensors:
        for entry in vars(module).values():
            if not isinstance(entry, EntryPoint) or entry.__module__ != module.__name__:
                continue
            names = [name for name, argument in entry.arguments.items()
                     if isinstance(argument, Constants)]
            for chosen in product(*(_KINDS[name] for name in names)):
                kinds = tuple(kind or chosen[names.index('tables')] for kind in chosen)
                if newton.Tables not in kinds or module in (functions, etdrk4):
                    yield entry, kinds


def compile_usual(values: dict[str, Any]) -> list[str]:
    """
    Compile what runs and nodes with some values of a scene need, finer runs, and linear models.

    Return the names of the files of machine code.
    """
    scene = load_scene(values)
    EstimatingSimulator(scene).warm_up(messages=True)
    model, motion, load = scene.build().of_any_size(), scene.initial_motion(), np.zeros(LOADS)
    state = model.state(motion)
    model.rate(state, load)
    model.sense(*(each[np.newaxis] for each in (motion, state, load)))
    return [f'{name}.o' for name in machine.ADDRESSES]


def build(folder: str, editable: bool) -> None:
    """
    Write the code that an installation has to files of a new folder.

    What the store of this user has is not compiled again.
    """
    shutil.rmtree(folder, ignore_errors=True)
    names = []
    for entry, kinds in [] if editable else entries():
        machine.intermediate_code(entry, kinds)
        names.append(machine.file_name(entry, kinds))
    with ProcessPoolExecutor(4) as pool:
        for loaded in pool.map(compile_usual, [{}] if editable else USUAL):
            names += loaded
    Path(folder).mkdir()
    for name in {*names}:
        store.copy(name, Path(folder, name))


if __name__ == '__main__':
    build(sys.argv[1], 'editable' in sys.argv[2:])
