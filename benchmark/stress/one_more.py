# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Stated errors over true ones where the finer run has one more mode, see `one_more_does`.

`python -m benchmark.stress.one_more` prints the least, the median and the largest ratio by number
of modes, also for a finer run with two more: of random scenes of the stress test, and of soft arms
that a heavy tip bends by up to their length.
"""

import math
import warnings

import numpy as np

from benchmark.stress.scenes import cell
import timo_sim
from timo_sim.runs.run import run_scene
from timo_sim.scene.static_shapes import one_more_does
from timo_sim.simulation.finer import choose_parts, PARTS, refine, tip_distances

MODES, COUNT = (3, 4, 5), 40
_SEEN = 1e-7  # true error that counts [lengths]


def some(number, modes):
    """Return a random scene of the stress test, its steps and those between samples, or None."""
    drawn = cell(number)
    values = drawn.values
    if values['model.formulation'] != 'exact' or values['model.axial_modes'] or (
            not values['model.modes'] or 'motor.coulomb_friction' in values):
        return None
    first = values.get('initial.modal_coordinates', [0.0])[:1]
    return timo_sim.load_scene({}, {
        **values, 'model.modes': modes,
        'initial.modal_coordinates': first + (modes - 1) * [0.0]}), drawn.steps, drawn.every


def bent(number, modes):
    """Return a soft arm with a force on its heavy tip, its steps, and those between samples."""
    random = np.random.default_rng([number, 3])
    young, tip, length, height = math.exp(random.uniform(16.0, 21.0)), random.uniform(
        0.5, 5.0), 1.0, 0.01
    mass, stiffness = 2700.0 * 3.0 * height**2 * length, young * 3.0 * height**4 / 12.0
    omega = math.sqrt(3.0 * stiffness / length**3 / (mass * (tip + 0.24)))
    return timo_sim.load_scene({
        'arm.length': length, 'arm.section.height': height, 'arm.section.width': 3.0 * height,
        'arm.density': 2700.0, 'arm.young_modulus': young, 'arm.shear_modulus': young / 2.6,
        'arm.damping_ratio': [0.01], 'end_effector.mass': mass * tip,
        'end_effector.inertia': mass * tip * random.uniform(0.002, 0.05),
        'carrier.mass': 5.0 * mass, 'motor.mass': mass, 'motor.shaft_inertia': 0.5 * mass,
        'carrier.held': ('none', 'both')[number % 2],
        'motor.shaft': ('free', 'locked')[number // 2 % 2],
        'model.modes': modes, 'integrator.step': 2.0 * math.pi / omega / random.uniform(300, 1200),
        'load.tip_force_y.harmonic.amplitude': [
            random.uniform(0.2, 1.5) * 3.0 * stiffness / length**2],
        'load.tip_force_y.harmonic.frequency': [omega / 2.0 / math.pi * random.uniform(0.2, 0.8)],
        'load.tip_force_y.harmonic.phase': [0.0]}), 1200, 10


def ratios(scene, steps, every):
    """Return the error that one more mode shows over the true one, and that of two; or None."""
    size, run = scene.manipulator.arm.length, run_scene(scene, steps, every)

    def apart(finer):
        parts = round(scene.step / finer.step)
        other = run_scene(finer, parts * steps, parts * every)
        return tip_distances(run.model, run.values, other.model, other.values)[0]

    true, doubtful = (apart(refine(scene, parts, modes)) for parts, modes in ((8, 9), (6, 6)))
    if true < _SEEN * size or abs(true - doubtful) > 0.1 * true:
        return None
    return [apart(refine(scene, PARTS[0], modes)) / true for modes in (None, 2)]


def main():
    """Print the range of the ratios by kind of scene, number of modes and finer run."""
    warnings.simplefilter('ignore', timo_sim.ModelWarning)
    for draw in some, bent:
        for modes in MODES:
            found, number = [], 0
            while len(found) < COUNT:
                number += 1
                try:
                    scene, *given = draw(number, modes) or (None,)
                    if scene and choose_parts(scene)[0] == PARTS[0] and one_more_does(
                            scene.manipulator, modes, scene.static):
                        found += [each] if (each := ratios(scene, *given)) else []
                except (timo_sim.ParameterError, timo_sim.DivergenceError):
                    continue
            for more, each in zip(('one more', 'two more'), np.transpose(found)):
                least, median, most = np.quantile(each, [0.0, 0.5, 1.0])
                print(f'{draw.__name__}, N = {modes}, {more}: {least:.2f} to {most:.2f}, '
                      f'median {median:.2f}, within a factor of two '
                      f'{np.mean((each > 0.5) & (each < 2.0)):.0%}', flush=True)


if __name__ == '__main__':
    main()
