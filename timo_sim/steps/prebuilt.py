# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Intermediate code of all entry points, made when the package is built.

An installation that has it needs numba for nothing: LLVM alone makes machine code for a size.
"""

import sys
from typing import Any

from timo_sim.compiled import machine
from timo_sim.model import exact_code, functions, modes, newton
from timo_sim.steps import derivatives, etdrk4, friction, instance, lanes, loads


def entries() -> list[tuple[Any, tuple[type, ...]]]:
    """Return the entry points and the kinds of their constants."""
    found: list[tuple[Any, tuple[type, ...]]] = [
        (entry, (modes.UniformArm,))
        for entry in (modes.bisect, modes.boundary_conditions, modes.fields)]
    for tables in (exact_code.Tables, newton.Tables):
        step, own = (tables, etdrk4.Propagator), (instance.Plant, instance.Instance)
        found += [
            (functions.rate_once, (tables,)), (functions.tip_once, (tables,)),
            (functions.accelerations_of, (tables, functions.Flow)),
            (functions.efforts, (tables,)), (functions.energies, (tables,)),
            (etdrk4.advance, step), (friction.advance, (*step, friction.Joints)),
            (instance.is_valid, (tables, instance.Instance)),
            (instance.set_rates, (tables, *own)), (instance.set_forces, (tables, *own))]
        found += [(entry, (*step, lanes.LaneConstants))
                  for entry in (lanes.advance_alike, lanes.advance_each)]
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


if __name__ == '__main__':
    machine.write_intermediate_code(sys.argv[1], entries())
