"""
The formulations against their equations written out with velocities, by another integrator.

`timo_sim` integrates momenta about the mass centre. Here the same physics is Lagrange's equations
for the carrier's velocity in turning axes, 3 + N rows solved at once, by SciPy's DOP853. A scene
with a shear modulus so low that shear matters as much as bending, a spinning shaft, and loads.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import timo_sim

MODES, DURATION = 3, 1.0


def scene_of(formulation, damping=0.03):
    return timo_sim.load_scene({
        'model.formulation': formulation, 'model.modes': MODES, 'integrator.step': 0.0005,
        'arm.shear_modulus': 1e6, 'arm.damping_ratio': [damping], 'initial.shaft_velocity': 3.0,
        'initial.carrier_x_velocity': 0.5, 'initial.modal_rates': [1.0, 0.3, -0.1],
        'load.force_x.harmonic.amplitude': [8.0], 'load.force_x.harmonic.frequency': [2.0],
        'load.force_y.table.time': [0.0, 1.0], 'load.force_y.table.value': [3.0, -3.0],
        'load.torque.harmonic.amplitude': [6.0], 'load.torque.harmonic.frequency': [1.0]})


def loads(t, theta):
    """Return F_I, F_II and tau."""
    x, y = 8.0 * np.sin(4 * np.pi * t), 3.0 - 6.0 * t
    c, s = np.cos(theta), np.sin(theta)
    return c * x + s * y, c * y - s * x, 6.0 * np.sin(2 * np.pi * t)


def solve(scene, accelerations):
    """Integrate x_c, y_c, theta, q, v_I, v_II, theta', q' with the given accelerations."""
    model = scene.build()
    start = scene.initial_motion()
    half = 3 + MODES
    theta = start[2]
    turn = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
    start[half:half + 2] = turn @ start[half:half + 2]

    def rate(t, y):
        theta, q, (v1, v2, om), qdot = y[2], y[3:half], y[half:half + 3], y[half + 3:]
        alpha, beta, *rest = accelerations(model, t, theta, q, om, qdot)
        c, s = np.cos(theta), np.sin(theta)
        return [c * v1 - s * v2, s * v1 + c * v2, om, *qdot, alpha + om * v2, beta - om * v1,
                *rest]

    t = np.linspace(0.0, DURATION, 51)
    return solve_ivp(rate, (0, DURATION), start, 'DOP853', t, rtol=1e-11, atol=1e-12).y[:half].T


def exact(model, t, theta, q, om, qdot):
    body, points = model.manipulator, model.points
    nodes = model.quadrature.nodes
    to_points, mass = points.integral.T, model.point_mass
    kernel, lever = to_points.T @ (mass[:, np.newaxis] * to_points), to_points.T @ mass
    rotation, shear = model.modes.rotation(nodes).T, model.modes.shear(nodes).T
    coupling = points.rotation @ model.point_inertia
    rotary = (points.rotation * model.point_inertia) @ points.rotation.T
    phi, gamma, phi_t, gamma_t = q @ rotation, q @ shear, qdot @ rotation, qdot @ shear
    c, s = np.cos(phi), np.sin(phi)
    a, b = c - gamma * s, s + gamma * c
    c1, c2 = -b * rotation - s * shear, a * rotation + c * shear
    a_t, b_t = qdot @ c1, qdot @ c2
    a_b = -b_t * phi_t - c * phi_t * gamma_t
    b_b = a_t * phi_t - s * phi_t * gamma_t

    matrix = np.zeros((3 + MODES, 3 + MODES))
    matrix[0, 0] = matrix[1, 1] = body.mass
    matrix[0, 2], matrix[1, 2] = -lever @ b, lever @ a
    matrix[2, 2] = body.section_inertia + a @ kernel @ a + b @ kernel @ b
    matrix[0, 3:], matrix[1, 3:] = c1 @ lever, c2 @ lever
    matrix[2, 3:] = c2 @ kernel @ a - c1 @ kernel @ b + coupling
    matrix[3:, 3:] = c1 @ kernel @ c1.T + c2 @ kernel @ c2.T + rotary
    matrix = np.triu(matrix) + np.triu(matrix, 1).T
    force_1, force_2, torque = loads(t, theta)
    pull_1, pull_2 = om**2 * a + 2 * om * b_t - a_b, om**2 * b - 2 * om * a_t - b_b
    right = np.concatenate([
        [force_1 + lever @ pull_1, force_2 + lever @ pull_2,
         torque - 2 * om * (a @ kernel @ a_t + b @ kernel @ b_t) - a @ kernel @ b_b
         + b @ kernel @ a_b],
        c1 @ kernel @ pull_1 + c2 @ kernel @ pull_2 - model.modes.omega**2 * q
        - 2 * model.damping * model.modes.omega * qdot])
    return np.linalg.solve(matrix, right)


def newton(model, t, theta, q, om, qdot):
    body, points, mass = model.manipulator, model.points, model.point_mass
    w, xi = points.deflection, points.xi
    a, c, s = w @ mass, w @ (mass * xi), mass @ xi
    b = c + points.rotation @ model.point_inertia
    gram = (w * mass) @ w.T
    matrix = np.zeros((3 + MODES, 3 + MODES))
    matrix[0, 0] = matrix[1, 1] = body.mass
    matrix[0, 2] = -a @ q
    matrix[1, 2] = matrix[2, 1] = s
    matrix[1, 3:] = matrix[3:, 1] = a
    matrix[2, 2] = body.section_inertia + mass @ xi**2
    matrix[2, 3:] = matrix[3:, 2] = b
    matrix[3:, 3:] = np.eye(MODES)
    force_1, force_2, torque = loads(t, theta)
    right = np.concatenate([
        [force_1 + 2 * om * a @ qdot + om**2 * s, force_2 + om**2 * a @ q,
         torque + om**2 * c @ q],
        om**2 * gram @ q - model.modes.omega**2 * q
        - 2 * model.damping * model.modes.omega * qdot])
    return np.linalg.solve(matrix, right)


@pytest.mark.parametrize('formulation, equations', [('exact', exact), ('newton', newton)])
def test_momentum_form_is_the_velocity_form(formulation, equations):
    scene = scene_of(formulation)
    run = timo_sim.simulate(scene, DURATION, every=40)
    truth = solve(scene, equations)
    # Shear is at work: it makes a good part of the tip's deflection.
    assert np.abs(run.deflection(2.0)[:, 1]).max() > 0.05
    # ETDRK4 at 0.5 ms: 1e-9, found by halving the step.
    assert np.abs(run.motion[:, :3 + MODES] - truth).max() < 2e-8


def test_exact_conserves_energy_when_shear_matters():
    free = {f'load.{channel}.{term}.{key}': [] for channel, term, key in (
        ('force_x', 'harmonic', 'amplitude'), ('force_x', 'harmonic', 'frequency'),
        ('force_y', 'table', 'time'), ('force_y', 'table', 'value'),
        ('torque', 'harmonic', 'amplitude'), ('torque', 'harmonic', 'frequency'))}
    scene = timo_sim.load_scene(scene_of('exact', damping=0.0).values, free)
    energy = timo_sim.simulate(scene, 2.0).energy()
    assert np.abs(energy / energy[0] - 1).max() < 1e-8
