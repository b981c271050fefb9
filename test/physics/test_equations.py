# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The formulations against their equations written out with velocities, by another integrator.

`timo_sim` integrates momenta about the mass centre, or eliminates the carrier. Here the same
physics is 3 + N rows for the accelerations of carrier (along turning axes), shaft and modes,
turned into world axes. Rows and columns of held or driven coordinates are removed, the rest is
solved at once and integrated by SciPy's DOP853. The scene has a shear modulus so low that shear
matters as much as bending, a spinning shaft, gravity, and loads.
"""

from functools import cache, partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmark.figures.root_reactions import MENTIONED
import timo_sim
from timo_sim.model import FORMULATIONS

MODES, DURATION = 3, 0.6
DRAG = np.array([3.0, 3.0, 0.5])  # viscous friction of the carrier's axes and of the shaft
GRAVITY = [0.7, -2.0]
FREE = {'initial.carrier_x_velocity': 0.5, 'initial.shaft_velocity': 3.0}
DRIVEN = {'motor.shaft': 'driven', 'motor.drive.time': [0.0, 0.4, 1.0],
          'motor.drive.angle': [0.3, 1.2, 3.0], 'motor.drive.speed': [0.0, 4.0, 1.0],
          'motor.drive.acceleration': [5.0, 0.0, 0.0]}
CONSTRAINTS = {
    'free': FREE,
    'x held': {'carrier.held': 'x', 'initial.shaft_velocity': 3.0},
    'y held': {'carrier.held': 'y', **FREE},
    'carrier held': {'carrier.held': 'both', 'initial.shaft_velocity': 3.0},
    'shaft driven': {**DRIVEN, 'initial.carrier_x_velocity': 0.5},
    'shaft driven, x held': {'carrier.held': 'x', **DRIVEN},
    'shaft driven, carrier held': {'carrier.held': 'both', **DRIVEN},
    'shaft locked': {'motor.shaft': 'locked', 'initial.carrier_x_velocity': 0.5},
    'shaft locked, y held': {'motor.shaft': 'locked', 'carrier.held': 'y'},
}


# As stiff in bending as the default arm, with an eighteenth of its axial stiffness.
STRETCHING = {'arm.section.height': 0.08, 'arm.young_modulus': 1e9, 'arm.density': 677.5}


NOTHING_ON_TIP = {
    'load.tip_force_x.harmonic.amplitude': [0.0], 'load.tip_force_y.table.value': [0.0, 0.0],
    'load.tip_torque.harmonic.amplitude': [0.0]}


def scene_of(formulation, constraints, damping=0.03, **values):
    return timo_sim.load_scene({}, {
        'model.formulation': formulation, 'model.modes': MODES, 'integrator.step': 0.0005,
        'model.static_modes': 'none',
        'arm.shear_modulus': 1e6, 'gravity': GRAVITY, 'arm.damping_ratio': [damping],
        'carrier.viscous_friction': DRAG[0], 'motor.viscous_friction': DRAG[2],
        'initial.modal_rates': [1.0, 0.3, -0.1],
        'load.force_x.harmonic.amplitude': [8.0], 'load.force_x.harmonic.frequency': [2.0],
        'load.force_y.table.time': [0.0, 1.0], 'load.force_y.table.value': [3.0, -3.0],
        'load.torque.harmonic.amplitude': [6.0], 'load.torque.harmonic.frequency': [1.0],
        'load.tip_force_x.harmonic.amplitude': [0.6],
        'load.tip_force_x.harmonic.frequency': [1.5],
        'load.tip_force_y.table.time': [0.0, 1.0], 'load.tip_force_y.table.value': [-0.5, 0.5],
        'load.tip_torque.harmonic.amplitude': [0.4], 'load.tip_torque.harmonic.frequency': [3.0],
        **values, **CONSTRAINTS[constraints]})


def loads(t, theta):
    """Return F_I, F_II and tau on carrier and shaft, then on the tip."""
    c, s = np.cos(theta), np.sin(theta)
    found = []
    for x, y, torque in (
            (8.0 * np.sin(4 * np.pi * t), 3.0 - 6.0 * t, 6.0 * np.sin(2 * np.pi * t)),
            (0.6 * np.sin(3 * np.pi * t), t - 0.5, 0.4 * np.sin(6 * np.pi * t))):
        found += [c * x + s * y, c * y - s * x, torque]
    return found


def shaft_drive(scene):
    """Return theta''(t) of a driven or locked shaft, from the end conditions of its two pieces."""
    if scene.values['motor.shaft'] == 'locked':
        return lambda t: 0.0
    points = list(zip(*(DRIVEN[f'motor.drive.{name}']
                        for name in ('time', 'angle', 'speed', 'acceleration'))))
    pieces = []
    for (t0, *left), (t1, *right) in zip(points, points[1:]):
        rows, values = [], []
        for t, ends in ((0.0, left), (t1 - t0, right)):
            for order in range(3):
                rows.append([np.polyval(np.polyder(np.eye(6)[k], order), t) for k in range(6)])
                values.append(ends[order])
        pieces.append((t0, np.linalg.solve(rows, values)))
    return lambda t: np.polyval(np.polyder(pieces[int(t >= 0.4)][1], 2),
                                t - pieces[int(t >= 0.4)][0])


def solve(scene, equations):
    """
    Integrate the motion with the given equations, without constrained rows and columns.

    Returns the coordinates and the residuals of the rows of carrier and shaft, which are the
    forces of the constraints.
    """
    model, values = scene.build(), scene.values
    half = model.size // 2
    struck = [k for k, name in enumerate('xy') if values['carrier.held'] in (name, 'both')]
    driven = values['motor.shaft'] != 'free'
    free = np.array([k for k in range(half) if k not in struck and not (driven and k == 2)])
    acceleration = shaft_drive(scene) if driven else None

    def accelerate(t, y):
        theta, q, om, qdot = y[2], y[3:half], y[half + 2], y[half + 3:]
        matrix, right = equations(model, t, theta, q, om, qdot)
        turn = np.eye(half)
        turn[:2, :2] = [[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]]
        matrix, right = turn.T @ matrix @ turn, turn.T @ right
        right[:2] -= DRAG[:2] * y[half:half + 2]
        right += matrix[:, :2] @ GRAVITY  # as in a freely falling frame
        result = np.zeros(half)
        if driven:
            result[2] = acceleration(t)
        else:
            right[2] -= DRAG[2] * om
        left = right - matrix @ result
        result[free] = np.linalg.solve(matrix[np.ix_(free, free)], left[free])
        return result, (matrix @ result - right)[:3]

    def rate(t, y):
        return np.concatenate([y[half:], accelerate(t, y)[0]])

    t = np.linspace(0.0, DURATION, 31)
    parts = [(0.0, 0.4), (0.4, DURATION)]  # the drive's fourth derivative jumps at 0.4 s
    y, motion = scene.initial_motion(), [scene.initial_motion()[:, np.newaxis]]
    for start, stop in parts:
        chosen = t[(t > start) & (t <= stop)]
        motion.append(solve_ivp(rate, (start, stop), y, 'DOP853', chosen, rtol=1e-10,
                                atol=1e-11).y)
        y = motion[-1][:, -1]
    motion = np.hstack(motion).T
    forces = np.array([accelerate(*sample)[1] for sample in zip(t, motion)])
    forces[:, [k for k in range(3) if k in free]] = 0.0
    return motion[:, :half], forces


@cache
def integrals(model):
    """Return kernel and first moments of the masses, and the strains of the modes at the nodes."""
    nodes, to_points, mass = model.quadrature.nodes, model.points.integral.T, model.point_mass
    rotation, shear = model.modes.rotation(nodes).T, model.modes.shear(nodes).T
    return (to_points.T @ (mass[:, np.newaxis] * to_points), to_points.T @ mass, rotation, shear,
            model.modes.stretch(nodes).T if model.axial else np.zeros_like(shear))


def exact(model, t, theta, q, om, qdot):
    body, points = model.manipulator, model.points
    kernel, moments, rotation, shear, stretch = integrals(model)
    coupling = points.rotation @ model.point_inertia
    rotary = (points.rotation * model.point_inertia) @ points.rotation.T
    (phi, gamma, e), (phi_t, gamma_t, e_t) = (
        [each @ field for field in (rotation, shear, stretch)] for each in (q, qdot))
    c, s = np.cos(phi), np.sin(phi)
    a, b = (1 + e) * c - gamma * s, (1 + e) * s + gamma * c
    c1 = -b * rotation - s * shear + c * stretch
    c2 = a * rotation + c * shear + s * stretch
    a_t, b_t = qdot @ c1, qdot @ c2
    a_b = -b_t * phi_t - c * phi_t * gamma_t - s * phi_t * e_t
    b_b = a_t * phi_t - s * phi_t * gamma_t + c * phi_t * e_t

    matrix = np.zeros((3 + len(q), 3 + len(q)))
    matrix[0, 0] = matrix[1, 1] = model.mass
    matrix[0, 2], matrix[1, 2] = -moments @ b, moments @ a
    matrix[2, 2] = body.shaft_inertia + model.point_inertia.sum() + a @ kernel @ a + b @ kernel @ b
    matrix[0, 3:], matrix[1, 3:] = c1 @ moments, c2 @ moments
    matrix[2, 3:] = c2 @ kernel @ a - c1 @ kernel @ b + coupling
    matrix[3:, 3:] = c1 @ kernel @ c1.T + c2 @ kernel @ c2.T + rotary
    matrix = np.triu(matrix) + np.triu(matrix, 1).T
    force_1, force_2, torque, tip_1, tip_2, twist = loads(t, theta)
    to_tip, tip_rotation = points.integral[:, -1], points.rotation[:, -1]
    pull_1, pull_2 = om**2 * a + 2 * om * b_t - a_b, om**2 * b - 2 * om * a_t - b_b
    right = np.concatenate([
        [force_1 + tip_1 + moments @ pull_1, force_2 + tip_2 + moments @ pull_2,
         torque + twist + (to_tip @ a) * tip_2 - (to_tip @ b) * tip_1
         - 2 * om * (a @ kernel @ a_t + b @ kernel @ b_t) - a @ kernel @ b_b
         + b @ kernel @ a_b],
        c1 @ kernel @ pull_1 + c2 @ kernel @ pull_2 - model.modes.omega**2 * q
        - 2 * model.damping * model.modes.omega * qdot
        + (c1 @ to_tip) * tip_1 + (c2 @ to_tip) * tip_2 + tip_rotation * twist])
    return matrix, right


def newton(model, t, theta, q, om, qdot, rigid_axial=False, root_stress=False):
    body, points, mass = model.manipulator, model.points, model.point_mass
    w, xi = points.deflection, points.xi
    a, c, s, m_a = w @ mass, w @ (mass * xi), mass @ xi, mass.sum()
    b = c + points.rotation @ model.point_inertia
    gram = (w * mass) @ w.T
    omega2 = model.modes.omega**2
    stress = omega2 * q + 2 * model.damping * model.modes.omega * qdot
    e = m_a * model.modes.deflection([s / m_a])[0] if rigid_axial else a
    force_1, force_2, torque, tip_1, tip_2, twist = loads(t, theta)
    if root_stress:
        tip_1 = tip_2 = twist = 0.0
    tip_deflection, tip_rotation = w[:, -1], points.rotation[:, -1]

    matrix = np.zeros((3 + MODES, 3 + MODES))
    matrix[0, 0], matrix[0, 2] = model.mass, -e @ q
    matrix[3:, 1], matrix[3:, 2], matrix[3:, 3:] = a, b, np.eye(MODES)
    right = np.concatenate([[force_1 + tip_1 + 2 * om * e @ qdot + om**2 * s, 0.0, 0.0],
                            om**2 * gram @ q - stress + tip_deflection * tip_2
                            + tip_rotation * twist])
    if root_stress:
        # V(0) and M(0) from the curvature and the shear strain of the series at the root.
        section, root = body.arm.section, np.zeros(1)
        bending = section.bending_stiffness * model.modes.curvature(root)[0]
        shear = section.shear_stiffness * model.modes.shear(root)[0]
        matrix[1, 1], matrix[2, 2] = body.base_mass, body.shaft_inertia
        right[1] = force_2 + shear @ (stress / omega2)
        right[2] = torque + bending @ (stress / omega2)
    else:
        matrix[1] = [0.0, model.mass, s, *a]
        matrix[2] = [0.0, s, body.shaft_inertia + model.point_inertia.sum() + mass @ xi**2, *b]
        right[1] = force_2 + tip_2 + om**2 * a @ q
        right[2] = (torque + om**2 * c @ q + twist + body.arm.length * tip_2
                    - (tip_deflection @ q) * tip_1)
    return matrix, right


EQUATIONS = {
    'exact': exact,
    'newton': newton,
    'newton_rigid_axial': partial(newton, rigid_axial=True),
    'newton_root_stress': partial(newton, root_stress=True),
}


CASES = [*(('exact', constraints) for constraints in CONSTRAINTS),
         *(('newton', constraints) for constraints in (
             'free', 'x held', 'carrier held', 'shaft driven, x held', 'shaft locked')),
         ('newton_rigid_axial', 'free'), ('newton_root_stress', 'free')]


@pytest.mark.parametrize('formulation, constraints', CASES)
def test_formulation_agrees_with_its_equations(monkeypatch, formulation, constraints):
    for name, place in MENTIONED.items():
        monkeypatch.setitem(FORMULATIONS, name, place)
    scene = scene_of(formulation, constraints, **(
        NOTHING_ON_TIP if formulation == 'newton_root_stress' else {}))
    run = timo_sim.simulate(scene, DURATION, sample_every=40, estimate=False)
    truth, forces = solve(scene, EQUATIONS[formulation])
    # The deflection is large, and shear makes a good part of it.
    assert np.abs(run.deflection(2.0)[:, 1]).max() > 0.04
    # The error of ETDRK4 at 0.5 ms is 1e-9, found by halving the step.
    assert np.abs(run.values[:, :3 + MODES] - truth).max() < 2e-8
    # Measured: 1.4e-9, mostly by differentiating the sampled motions.
    error = np.abs(run.effort - forces)[:, run.model.constrained].max(initial=0.0)
    assert error <= 5e-9 * np.abs(forces).max()


@pytest.mark.parametrize('constraints, modes, axial_modes', [
    ('free', 3, 2), ('x held', 3, 1), ('shaft driven, carrier held', 5, 1)])
def test_an_arm_that_stretches_agrees_with_its_equations(constraints, modes, axial_modes):
    """Those are Lagrange's; the state of `timo_sim` has momenta and rates of axial coordinates."""
    scene = scene_of('exact', constraints, **STRETCHING, **{
        'model.modes': modes, 'model.axial_modes': axial_modes, 'integrator.step': 1e-4,
        'initial.modal_rates': [1.0, 0.3, -0.1] + [0.0] * (modes + axial_modes - 3)})
    assert scene.fastest == np.inf  # steps resolve all axial vibrations
    run = timo_sim.simulate(scene, DURATION, sample_every=200, estimate=False)
    truth, forces = solve(scene, exact)
    model, axial = scene.build(), run.q.copy()
    axial[:, :modes] = 0.0
    # The stretch is a thousand times the tolerance below.
    assert np.abs(axial @ model.modes.displacement([2.0])[0]).max() > 2e-5
    assert np.abs(run.values[:, :model.size // 2] - truth).max() < 2e-8
    error = np.abs(run.effort - forces)[:, run.model.constrained].max(initial=0.0)
    # Measured: 2.2e-7 with one axis held; accelerations of stiff modes are large for their q.
    assert error <= 1e-6 * np.abs(forces).max()
