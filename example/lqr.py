# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
LQR with an observer: feedback from encoder and strain gauge keeps the arm to a planned slew.

    ros2 run timo_sim sim_node --ros-args --params-file example/slew.yaml -p record_file:=lqr.mcap
    python example/lqr.py --plot lqr.png

Plan, regulator and Kalman filter are made from the linear model of the scene; the node simulates
the nonlinear one, with noise and with limits on the torque.
"""

from loop import PERIOD
import numpy as np
from scipy.linalg import solve_discrete_are
from slew import DURATION, GOAL, main, SCENE
import timo_sim

# Deviations that cost as much as a torque of 1 N m.
SCALES = {'shaft_rad': 0.002, 'shaft_velocity_rad_per_s': 0.02, 'tip_transverse_m': 0.002}
SHARE = 0.9            # of the torque's limit, for the plan; the rest is for feedback
PROCESS_NOISE = 3e-4  # standard deviation of each rate's change in a period that is not modelled


class LQR:
    """
    Turns the shaft along a plan.

    Parameters
    ----------
    scene : timo_sim.Scene
        Has the noise of encoder and strain gauge, and the limit of the torque.
    duration : float or None
        Duration of the plan [s]; None: the shortest that the limit allows.

    """

    def __init__(self, scene, duration=DURATION):
        model = timo_sim.linearize(scene, inputs=['torque_N_m'])
        weighed = model.select(outputs=list(SCALES)).C / [[scale] for scale in SCALES.values()]
        model = model.select(outputs=['shaft_rad', 'root_strain']).to_discrete(PERIOD)
        self.a, self.b, self.c = a, b, c = model.A, model.B, model.C
        self.d = model.D  # the torque strains the root at once, by the shaft's acceleration
        self.limit = scene.values['motor.torque_limit']

        self.plan = timo_sim.feedforward(model, {'shaft_rad': GOAL[2]}, duration,
                                         SHARE * self.limit)
        p = solve_discrete_are(a, b, weighed.T @ weighed, np.eye(1))
        self.gain = np.linalg.solve(1.0 + b.T @ p @ b, b.T @ p @ a)

        noise = np.diag([scene.values['sensor.encoder.noise']**2
                         + scene.values['sensor.encoder.resolution']**2 / 12.0,
                         scene.values['sensor.root_strain.noise']**2])
        process = np.diag([PROCESS_NOISE**2 * name.endswith('_per_s') for name in model.states])
        p = solve_discrete_are(a.T, c.T, process, noise)
        self.correction = p @ c.T @ np.linalg.inv(c @ p @ c.T + noise)
        self.expected, self.acting = model.state(scene.initial_motion()), np.zeros(1)

    def effort(self, t, seen):
        """Return the torque on the shaft [N m] that answers what is seen."""
        plan, x = self.plan.at(t), self.observe(seen)
        wanted = plan.u - self.gain @ (x - plan.x)
        self.expect(x, np.clip(wanted, -self.limit, self.limit))
        return {'shaft': float(self.acting[0])}

    def observe(self, seen):
        """Return the state, as the Kalman filter estimates it from encoder and strain gauge."""
        return self.expected + self.correction @ (
            [seen.encoder, seen.root_strain] - self.c @ self.expected - self.d @ self.acting)

    def expect(self, x, torque):
        """Predict the state after a period, from one with a torque, shape (1,) [N m]."""
        self.acting, self.expected = torque, self.a @ x + self.b @ torque


if __name__ == '__main__':
    main(__doc__, timo_sim.load_scene(SCENE), {'LQR': LQR})
