# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What else a user of JAX might take for an arm on a held carrier: a rod of soromox."""

from contextlib import contextmanager
import os
import time

# XLA reads them once. They leave a second thread busy: pin the process to one core to time it.
os.environ.setdefault('XLA_FLAGS', '--xla_cpu_multi_thread_eigen=false '
                      'intra_op_parallelism_threads=1')
os.environ.setdefault('JAX_PLATFORMS', 'cpu')

import diffrax  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from soromox.systems.components import JointSpec, LinkSpec  # noqa: E402
from soromox.systems.gvs import GVS, GVSSegment, StrainBasisSpec  # noqa: E402

jax.config.update('jax_enable_x64', True)
_CORE = {min(os.sched_getaffinity(0))}
_DRIVEN = 1e12  # inertia that makes a shaft follow its drive, whatever the arm does [kg m2]


@contextmanager
def _one_core():
    """Keep this thread, and those that it starts, on one core: they would wait for each other."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, _CORE)
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def rod(scene, segments, order, shear=None, points=8, joint=None):
    """
    Return the variable-strain model (GVS) of the arm of a scene, along x at first.

    Curvature is a sum of Legendre polynomials on each segment, and so is the shear strain, if any;
    there is no stretch. (With shear, explicit steps are
    limited by rotary inertia, and implicit ones took longer; links of constant strain, PCS, had
    errors of 0.1 m with 5 and diverged with 10.)

    Parameters
    ----------
    scene : Scene
        Its arm is uniform; it carries nothing.
    segments, order : int
        Of the arm, and of the polynomials of the curvature.
    shear : int, optional
        Order of those of the shear strain; None: rigid in shear.
    points : int
        Gauss points of a segment, at least 5.
    joint : JointSpec, optional
        At the root, in place of a clamp.

    Returns
    -------
    GVS

    """
    values = scene.values
    if values['end_effector.mass'] or values['end_effector.inertia']:
        raise ValueError('soromox knows no body on the tip of a rod')
    section = scene.manipulator.arm.section
    link = LinkSpec.rectangular(
        length=values['arm.length'] / segments, height=values['arm.height'],
        width=values['arm.width'], density=values['arm.density'],
        reference_strain=[0.0, 0.0, 0.0, 1.0, 0.0, 0.0], young_modulus=values['arm.young_modulus'],
        shear_modulus=section.shear_stiffness / section.area)
    strains = ('kappa_z',) if shear is None else ('kappa_z', 'sigma_y')
    basis = StrainBasisSpec('legendre', strains, [0, 0, order, 0, shear or 0, 0])
    parts = [GVSSegment(link=link, joint=(joint if joint and not k else JointSpec.fixed()),
                        basis=basis, num_gauss_points=points) for k in range(segments)]
    return GVS.from_segments(parts, gravity=jnp.array([*values['gravity'], 0.0]),
                             base_pose=jnp.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))


def spin_up():
    """Return `oracles.references.spin_up` for JAX."""
    rate = 2.0 * jnp.pi / 15.0
    return (
        lambda t: jnp.where(t < 15, 0.4 * (t**2 / 2 + (jnp.cos(rate * t) - 1) / rate**2),
                            6 * t - 45),
        lambda t: jnp.where(t < 15, 0.4 * (t - jnp.sin(rate * t) / rate), 6.0),
        lambda t: jnp.where(t < 15, 0.4 * (1 - jnp.cos(rate * t)), 0.0))


def rate_with_shaft(model, inertia):
    """Return y'(t) of a rod on a revolute joint with an inertia [kg m2], as f(y, torque)."""
    shaft = jnp.zeros(model.num_velocities).at[0].set(inertia)

    def rate(y, torque):
        q, v, _ = model.split_state(y)
        mass, turning, weight = model.dynamics_terms(q, v)
        force = -turning - weight - model.elastic_force(q)
        return jnp.concatenate([v, jnp.linalg.solve(mass + jnp.diag(shaft),
                                                    force.at[0].add(torque))])
    return rate


def soft_rod(scene, segments, step, duration, every, drive=None, order=4, shear=None, points=8):
    """
    Simulate a scene by soromox, straight and at rest at first, in explicit steps (Tsit5).

    Parameters
    ----------
    scene : Scene
        Its shaft is driven, or locked at 0, on a held carrier.
    segments : int
    step, duration : float
        [s]
    every : int
        Steps from sample to sample.
    drive : tuple of function(float) -> float, optional
        theta(t) and its derivatives, which JAX can follow; theta(0) = 0.
    order, shear, points
        As for `rod`.

    Returns
    -------
    seconds : float
        CPU time of a call after that which compiles [s].
    theta, carrier, along, across : ndarray, shapes (n,), (n, 2), (n,), (n,)
        At the samples after the start; the tip in axes of the shaft.

    """
    model = rod(scene, segments, order, shear, points,
                JointSpec('revolute', axis='z') if drive else None)
    times = jnp.arange(1, round(duration / step / every) + 1) * (step * every)
    count = 2 * (model.num_velocities if drive else model.num_internal_dofs)

    def rate(t, y, _):
        if drive:
            return rate_with_shaft(model, _DRIVEN)(y, _DRIVEN * drive[2](t))
        return model.forward_dynamics(t, y)

    @jax.jit
    def run(start):
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(rate), diffrax.Tsit5(), 0.0, times[-1], step, start,
            saveat=diffrax.SaveAt(ts=times), max_steps=None, throw=False)
        length = model.segment_length.sum()
        return found.ys[:, 0], jax.vmap(lambda y: model.forward_kinematics(
            y[:count // 2], length))(found.ys)[:, :2, 3]

    with _one_core():
        start = jnp.zeros(count)
        jax.block_until_ready(run(start))  # compiles
        begun = time.process_time()
        theta, tip = (np.array(part) for part in jax.block_until_ready(run(start)))
        seconds = time.process_time() - begun
    theta = theta if drive else np.zeros(len(tip))
    cosine, sine = np.cos(theta), np.sin(theta)
    return (seconds, theta, np.zeros((len(tip), 2)), cosine * tip[:, 0] + sine * tip[:, 1],
            cosine * tip[:, 1] - sine * tip[:, 0])
