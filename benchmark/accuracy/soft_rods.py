# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""What else a user of JAX might take for an arm on a held carrier: a rod of soromox."""

from contextlib import contextmanager
from functools import lru_cache
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

from timo_sim import load_scene  # noqa: E402

jax.config.update('jax_enable_x64', True)
_DRIVEN = 1e12  # inertia that makes a shaft follow its drive, whatever the arm does [kg m2]


@contextmanager
def _one_core():
    """Keep this thread, and those that it starts, on one core: they would wait for each other."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def rod(scene, order, driven):
    """
    Return the variable-strain model (GVS) of the arm of a scene, along x at first.

    Curvature is a sum of Legendre polynomials up to an order; there is no shear and no stretch.
    (With shear, explicit steps are limited by rotary inertia, and implicit ones took longer; links
    of constant strain, PCS, had errors of 0.1 m with 5 and diverged with 10.) A driven rod has a
    revolute joint at its root, in place of a clamp.
    """
    values, section = scene.values, scene.manipulator.arm.section
    if values['end_effector.mass'] or values['end_effector.inertia']:
        raise ValueError('soromox knows no body on the tip of a rod')
    link = LinkSpec.rectangular(
        length=values['arm.length'], height=section.height, width=section.width,
        density=values['arm.density'], reference_strain=[0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        young_modulus=values['arm.young_modulus'],
        shear_modulus=section.shear_stiffness / section.area)
    segment = GVSSegment(
        link=link, joint=JointSpec('revolute', axis='z') if driven else JointSpec.fixed(),
        basis=StrainBasisSpec('legendre', ('kappa_z',), [0, 0, order, 0, 0, 0]),
        num_gauss_points=max(5, 2 * order + 2))
    return GVS.from_segments([segment], gravity=jnp.array([*values['gravity'], 0.0]),
                             base_pose=jnp.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))


@lru_cache(maxsize=None)
def _compiled(values, order, times, driven):
    # The function of the start and of the step that runs a scene of `values`.
    model = rod(load_scene(dict(values)), order, driven)
    times, length = jnp.array(times), model.segment_length.sum()
    count = model.num_velocities if driven else model.num_internal_dofs
    shaft = jnp.zeros(model.num_velocities).at[0].set(_DRIVEN)

    def rate(t, y, _):
        if not driven:
            return model.forward_dynamics(t, y)
        q, v, _ = model.split_state(y)
        mass, turning, weight = model.dynamics_terms(q, v)
        force = -turning - weight - model.elastic_force(q)
        # That of `oracles.references.spin_up`, for JAX.
        acceleration = jnp.where(t < 15, 0.4 * (1 - jnp.cos(2.0 * jnp.pi / 15.0 * t)), 0.0)
        return jnp.concatenate([v, jnp.linalg.solve(
            mass + jnp.diag(shaft), force.at[0].add(_DRIVEN * acceleration))])

    @jax.jit
    def run(start, step):
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(rate), diffrax.Tsit5(), 0.0, times[-1], step, start,
            saveat=diffrax.SaveAt(ts=times), max_steps=None, throw=False)
        return found.ys[:, 0], jax.vmap(
            lambda y: model.forward_kinematics(y[:count], length))(found.ys)[:, :2, 3]

    start = jnp.zeros(2 * count)
    jax.block_until_ready(run(start, float(times[0])))  # compiles
    return run, start


def soft_rod(scene, order, step, duration, every, drive=None):
    """
    Simulate a scene by soromox, straight and at rest at first, in explicit steps (Tsit5).

    The shaft is locked at 0, or has the drive `oracles.references.spin_up`. What is returned is
    that of `rivals.chain`; a scene is compiled once for each order.
    """
    times = np.arange(1, round(duration / step / every) + 1) * round(step * every, 12)
    with _one_core():
        run, start = _compiled(tuple(scene.values.items()), order, tuple(times), bool(drive))
        begun = time.process_time()
        theta, tip = (np.array(part) for part in jax.block_until_ready(run(start, step)))
        seconds = time.process_time() - begun
    theta = theta if drive else np.zeros(len(tip))
    cosine, sine = np.cos(theta), np.sin(theta)
    return (seconds, theta, np.zeros((len(tip), 2)), cosine * tip[:, 0] + sine * tip[:, 1],
            cosine * tip[:, 1] - sine * tip[:, 0])
