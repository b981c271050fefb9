# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Code that is made when the package is built, for a first result at once.

An installation that has the intermediate code of all entry points needs numba for nothing: LLVM
alone makes machine code for a size. The machine code of usual sizes is made here, too, for the
processor of the build; its files have names that tell the processor, so that no other loads them.
An editable installation, whose sources will change, has the code of the default scene alone.
"""

from concurrent.futures import ProcessPoolExecutor
import os
from pathlib import Path
import shutil
import sys
import tempfile
from typing import Any

from timo_sim.compiled import machine, store
from timo_sim.model import exact_code, functions, modes, newton
from timo_sim.scene.scene import load_scene
from timo_sim.simulation.simulator import Simulator
from timo_sim.steps import derivatives, etdrk4, friction, instance, lanes, loads

# A carrier and a shaft that move freely, as in the paper; each with the size of its finer run.
USUAL = [{'model.formulation': formulation, 'model.modes': modes}
         for formulation in ('exact', 'newton') for modes in range(1, 9)]


def entries() -> list[tuple[Any, tuple[type, ...]]]:
    """Return the entry points and the kinds of their constants."""
    found: list[tuple[Any, tuple[type, ...]]] = [
        (entry, (modes.UniformArm,))
        for entry in (modes.bisect, modes.boundary_conditions, modes.fields)]
    for tables in (exact_code.Tables, newton.Tables):
        own = instance.Plant, instance.Instance
        found += [
            (functions.rate_once, (tables,)), (functions.tips, (tables,)),
            (functions.accelerations_of, (tables, functions.Flow)),
            (functions.efforts, (tables,)), (functions.energies, (tables,)),
            (instance.is_valid, (tables, instance.Instance)),
            (instance.set_rates, (tables, *own)), (instance.set_forces, (tables, *own))]
        for step in [(tables, matrices) for matrices in etdrk4.one_step.bodies]:
            found += [(etdrk4.advance, step), (friction.advance, (*step, friction.Joints)),
                      (lanes.advance_alike, (*step, lanes.LaneConstants)),
                      (lanes.advance_each, (*step, lanes.LaneConstants))]
    found.append((derivatives.differentiate,
                  (exact_code.Tables, etdrk4.Propagator, derivatives.Inputs)))
    actuators = loads.Actuators, instance.Instance
    found.append((loads.add_scene_loads, ()))
    found += [(entry, (loads.Actuators,)) for entry in (
        loads.add_commands, loads.restart, instance.get_parameter)]
    found += [(entry, own) for entry in (instance.finish, instance.set_outputs)]
    found += [(instance.prepare, (loads.SceneLoads, *actuators)),
              (instance.reset, (instance.Plant, *actuators))]
    found += [(entry, actuators) for entry in (
        instance.set_parameter, instance.get_state, instance.set_state)]
    return found + [(entry, (instance.Instance,)) for entry in (
        instance.set_input, instance.get_input, instance.set_place, instance.compare,
        instance.lose, instance.get_output, instance.get_outputs, instance.check_state)]


def compile_usual(values: dict[str, Any]) -> None:
    """Compile what runs and nodes with some values of a scene need, and runs that are finer."""
    Simulator(load_scene(values), estimate=True).warm_up(messages=True)


def build(folder: str, editable: bool) -> None:
    """Write the code that an installation has to files of a new folder."""
    shutil.rmtree(folder, ignore_errors=True)
    with tempfile.TemporaryDirectory() as root:
        os.environ['NUMBA_CACHE_DIR'] = root
        for entry, kinds in [] if editable else entries():
            machine.intermediate_code(entry, kinds)
        with ProcessPoolExecutor(4) as pool:
            list(pool.map(compile_usual, [{}] if editable else USUAL))
        Path(folder).mkdir()
        directory = store.store_directory()
        for made in directory.iterdir() if directory else []:
            if made.suffix != '.lock':
                shutil.copyfile(made, Path(folder, made.name))


if __name__ == '__main__':
    build(sys.argv[1], 'editable' in sys.argv[2:])
