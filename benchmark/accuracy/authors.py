# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Reproduce an example of each rival's own authors, with the code that sets it up in the benchmarks.

It fills the part "set up right" of doc/benchmark.md.
"""

from importlib.metadata import version
import math

import numpy as np

from benchmark.accuracy import rivals
from benchmark.accuracy.rivals import chain_of
from benchmark.report import make_page, table
from oracles import finite_elements
from oracles.engine import exudyn, items
from timo_sim import load_scene


def clamped(length, mass, bending, axial, shear=None, angle=0.0, gravity=0.0):
    """Return an arm of given mass per length, E I and E A, and kappa G A, clamped at its root."""
    height = math.sqrt(12.0 * bending / axial)
    values = {'arm.length': length, 'arm.section.width': height, 'arm.section.height': height,
              'arm.density': mass / height**2, 'arm.young_modulus': axial / height**2,
              'arm.shear_modulus': (shear or axial) / height**2,
              'arm.section.shear_correction': 1.0,
              'end_effector.mass': 0.0, 'end_effector.inertia': 0.0, 'carrier.held': 'both',
              'motor.shaft': 'locked', 'initial.shaft': angle, 'gravity': [0.0, gravity]}
    return load_scene(values)


def cable():
    """Return the tip's displacement along x of exudyn's cable that hangs at rest [m]."""
    _, system, nodes, _ = finite_elements.system_of(
        clamped(2.0, 78.0, 833.3333333333333, 1e6, gravity=-9.81), 32, kind='cable')
    return _rest(system, nodes[-1])[0]


def beam(elements=16, kind='linear'):
    """Return the tip's displacement along y of exudyn's short beam, bent by half a turn [m]."""
    modulus, width, height, ratio = 2.07e11, 0.1, 0.5, 0.3
    area = width * height
    _, system, nodes, _ = finite_elements.system_of(clamped(
        2.0, 7850.0 * area, modulus * area * height**2 / 12.0, modulus * area,
        10.0 * (1.0 + ratio) / (12.0 + 11.0 * ratio) * 7.9615e10 * area, math.pi / 4.0),
        elements, kind=kind)
    force = 5e8 * height**3 * math.sqrt(0.5)
    tip = system.AddMarker(items.MarkerNodeRigid(nodeNumber=nodes[-1]))
    system.AddLoad(items.Force(markerNumber=tip, loadVector=[force, -force, 0.0]))
    system.AddLoad(items.Torque(markerNumber=tip, loadVector=[0.0, 0.0, -5e8]))
    return _rest(system, nodes[-1])[1]


def _rest(system, node):
    system.Assemble()
    settings = exudyn.SimulationSettings()
    settings.staticSolver.numberOfLoadSteps, settings.staticSolver.verboseMode = 10, 0
    settings.staticSolver.newton.maxIterations, settings.solution.file.write = 50, False
    system.SolveStatic(settings)
    return system.GetNodeOutput(node, exudyn.OutputVariableType.Coordinates)


def circle(parts=40):
    """Return the moments that bend MuJoCo's chain and rod into a circle, over 2 pi E I / l."""
    import mujoco

    scene = clamped(1.0, 0.01, 1e9 * math.pi * 0.005**4 / 4.0, 1e5)
    arm = chain_of(scene, parts, gauss=False, matched=0)
    moment, found = 2.0 * math.pi * arm.springs[0] / parts, []
    model = rivals.chain_model(arm, 1e-4)
    data = mujoco.MjData(model)
    data.qpos[:] = 2.0 * math.pi / parts
    mujoco.mj_forward(model, data)
    found.append(-data.qfrc_passive.mean() / moment)
    model = rivals.rod_model(
        chain_of(scene, parts, gauss=False, matched=0, lumped=True), 1e-3)
    data = mujoco.MjData(model)
    model.dof_damping[:] = 1e-3
    for step in range(4000):
        data.qfrc_applied[-1] = moment * min(1.0, step / 1000)
        mujoco.mj_step(model, data)
    return found + [2.0 * math.pi / data.qpos[-1]]


def timoshenko():
    """Return the deflection of PyElastica's rod under a force on its tip, and theirs [m]."""
    area, length, force = math.pi * 0.25**2, 3.0, 15.0
    bending, shear = 1e6 * area**2 / (4.0 * math.pi), 27.0 / 28.0 * 1e4 * area
    scene = clamped(length, 5000.0 * area, bending, 1e6 * area, shear)
    found = rivals.elastica(scene, 20, 1e-3, 40.0, 40000, tip_force=-force, damping=1.0)
    return -found[4][-1], force * (length / shear + length**3 / (3.0 * bending))


def sag():
    """Return the mean sag of dismech-newton's clamped rod over a period, and theirs [m]."""
    segments, part, radius, stiffness = 40, 0.025, 0.01, 140.0
    mass, span = 1000.0 * math.pi * radius**2, 1.0 - 0.5 * part
    scene = clamped(span, mass, stiffness * part, 1e6 * part, gravity=-9.81)
    period = 2.0 * math.pi / 1.8751**2 * math.sqrt(mass * span**4 / (stiffness * part))
    step = 1.0 / 480.0
    steps = round(period / step)
    across = rivals.dismech(scene, segments, step, steps * step, 1)[4]
    return -across.mean(), mass * 9.81 * span**4 / (8.0 * stiffness * part)


def affine():
    """Return a stiffness of soromox's pendulum of affine curvature, in units of E I / l."""
    import jax

    from benchmark.accuracy.soft_rods import rod

    scene = clamped(1.0, 1.0, 1.0, 1e4)
    stiffness = jax.jacobian(rod(scene, 1, False).elastic_force)(np.zeros(2))
    return 0.25 * float(stiffness.sum())  # of a curvature that is affine, 0 at the root


def rows():
    """Return rows (rival, example, its authors' number, ours)."""
    tip, theirs = timoshenko()
    mean, beam_sag = sag()
    chain, rod = circle()
    return [
        ('exudyn, ANCF cable', 'MiniExamples/ObjectANCFCable2D.py: 32 elements at rest, u_x of '
         'the tip [m]', -0.5013058140308901, cable()),
        ('exudyn, geometrically exact', 'TestModels/geometricallyExactBeam2Dtest.py: 16 elements, '
         'u_y of the tip [m]', -2.2115028353806547, beam()),
        ('exudyn, three nodes', 'the same by 8 elements', -2.2115028353806547,
         beam(8, 'quadratic')),
        ('MuJoCo, hinged links', 'elasticity_test.cc, CantileverIntoCircle (MuJoCo 3): moment '
         'over 2 pi E I / l', 1.0, chain),
        ('MuJoCo, rod', 'the same', 1.0, rod),
        ('PyElastica', "examples/TimoshenkoBeamCase: its Timoshenko beam's deflection [m]", theirs,
         tip),
        ('dismech-newton', "examples/cantilever.py: its Euler-Bernoulli beam's sag [m]", beam_sag,
         mean),
        ('soromox', 'examples/simulation/gvs/soft_pendulums.py: stiffness of the affine curvature '
         '[E I / l]', 1.0 / 3.0, affine())]


def part(quick):
    """Return the table of the page."""
    return table(['rival', 'example of its authors', 'their number', 'ours', 'difference'], [
        (rival, example, f'{theirs:.6g}', f'{ours:.6g}', f'{100.0 * (ours / theirs - 1.0):.2g} %')
        for rival, example, theirs, ours in rows()])


if __name__ == '__main__':
    make_page(__spec__, __doc__, 'benchmark.md', {'set up right': part}, 'print it only', **{
        name: (lambda name=name: version(name)) for name in (
            'exudyn', 'mujoco-core', 'pyelastica', 'dismech-newton', 'soromox')})
