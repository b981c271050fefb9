# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What `work_precision.py` measures of libraries of elastic rods, see `cases`."""

import math

from benchmark.accuracy import rods
from benchmark.accuracy.cases import Case, tip_columns

ROD, DISCRETE, SOFT = 'PyElastica', 'dismech-newton', 'soromox'


def rod_case(scene, elements, axial_factor, inertia_factor):
    """Return a case of PyElastica, in its longest stable step."""
    checked = scene.load({'initial.shaft': 0.0} if scene.drive else None)
    longest = 0.97 * rods.longest_step_of_rod(checked, elements, axial_factor, inertia_factor)
    every = math.ceil(scene.period / longest)
    step = scene.period / every

    def run():
        seconds, *found = rods.elastica(checked, elements, step, scene.duration, every,
                                        scene.drive, axial_factor, inertia_factor)
        return seconds, lambda: tip_columns(*found)
    return Case(ROD, f'{elements} elements, h = {1e3 * step:.3g} ms'
                + _scaled(axial_factor, inertia_factor), run, (elements, step))


def discrete_case(scene, elements, step, axial_factor):
    """Return a case of dismech-newton."""
    checked = scene.load({'initial.shaft': 0.0} if scene.drive else None)

    def run():
        seconds, *found = rods.dismech(checked, elements, step, scene.duration,
                                       round(scene.period / step), scene.drive, axial_factor)
        return seconds, lambda: tip_columns(*found)
    return Case(DISCRETE, f'{elements} elements, h = {1e3 * step:g} ms' + _scaled(axial_factor, 1),
                run, (elements, step))


def _scaled(axial_factor, inertia_factor):
    return ''.join(f', {factor:g} {name}' for factor, name in (
        (axial_factor, 'E A'), (inertia_factor, 'rho I')) if factor != 1)


def soft_case(scene, order, step):
    """Return a case of soromox."""
    from benchmark.accuracy import soft_rods  # JAX is slow to import
    checked = scene.load({'initial.shaft': 0.0} if scene.drive else None)
    drive = soft_rods.spin_up() if scene.drive else None

    def run():
        seconds, *found = soft_rods.soft_rod(
            checked, 1, step, scene.duration, round(scene.period / step), drive, order,
            points=2 * order + 2)
        return seconds, lambda: tip_columns(*found)
    return Case(SOFT, f'order {order}, h = {1e3 * step:g} ms', run, (order, step))


def rods_of(scene, quick):
    """Return the cases of a scene, if its carrier is held; the best found of each, by hand."""
    if not scene.held:
        return []
    if scene.drive:
        scaled = [(7, 1, 400), (10, 1, 400), (14, 1, 200), (20, 1, 1), (24, 1, 50), (40, 2, 10),
                  (60, 2, 4)]
        discrete = [(10, 0.01, 0.1), (20, 0.01, 0.1), (20, 0.005, 1), (30, 0.004, 1)]
    else:
        scaled = [(elements, 1, factor) for elements in (10, 20, 40, 60, 100)
                  for factor in (100, 10, 1)]
        discrete = [(elements, step, 1) for elements in (10, 20, 40)
                    for step in (0.01, 0.005, 0.0025)]
    soft = [(2, 0.01), (3, 0.004), (4, 0.002), (5, 0.0005), (6, 0.0005)]
    few = slice(1) if quick else slice(None)
    return ([rod_case(scene, *settings) for settings in scaled[few]]
            + [discrete_case(scene, *settings) for settings in discrete[few]]
            + [soft_case(scene, *settings) for settings in soft[few]])
