# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
MPPI: model predictive control by 512 rollouts of 0.4 s, made anew every 20 ms.

    ros2 run timo_sim sim_node --ros-args --params-file example/slew.yaml \
        -p motor.torque_limit:=8.0 -p record_file:=mppi.mcap
    python example/mppi.py --plot mppi.png

The motor is too weak for the plan of the LQR, which takes 15 N m. Rollouts of the nonlinear arm
with two modes know its limit: random torques around the best ones so far are tried from the
observed state, and averaged with weights that fall exponentially with their costs. Source:
Williams et al., IEEE Trans. Robotics 34 (2018) 1603-1622.
"""

from loop import PERIOD
from lqr import LQR
import numpy as np
from slew import GOAL, LENGTH, main, SCENE
import timo_sim

LIMIT = 8.0                       # of the motor [N m]
ROLLOUTS, HORIZON, HOLD = 512, 20, 0.02  # rollouts, their torques, duration of each [s]
SHARE, GAIN = 0.85, 5.0           # of the limit, to slow the arm down; [1/s] near the goal
SPEED, SWAY, CHANGE = 0.02, 0.02, 4.0    # what costs 1: [rad/s], [m/s], [N m]
SPREAD, LEAST = 4.0, 0.5          # of the torques: [N m/rad] of the way left, and at least [N m]
TEMPERATURE = 0.1                 # in differences of the median cost from the least


class MPPI:
    """
    Turns the shaft as fast as its motor allows.

    Parameters
    ----------
    scene : timo_sim.Scene
        Has the limit of the torque, and the noise of encoder and strain gauge.

    """

    def __init__(self, scene):
        self.observer = LQR(scene, 3.0)  # whose plan is not used
        self.limit = scene.values['motor.torque_limit']
        self.batch = timo_sim.Batch(scene.vary({
            'model.modes': 2, 'integrator.step': 0.005, 'motor.torque_rate_limit': np.inf}),
            n=ROLLOUTS)
        model = timo_sim.linearize(scene.vary({'model.modes': 0}))
        self.slowing = SHARE * self.limit * model.B[1, 0]  # angular acceleration [rad/s2]
        self.plan, self.random = np.zeros(HORIZON), np.random.default_rng(1)

    def effort(self, t, seen):
        """Return the torque on the shaft [N m] that answers what is seen."""
        x = self.observer.observe(seen)
        if round(t / PERIOD) % round(HOLD / PERIOD) == 0:
            self.replan(x)
        self.observer.expect(x, self.plan[:1])
        return {'shaft': float(self.plan[0])}

    def replan(self, x):
        """Improve the torques of the horizon, from a state of the observer on."""
        half = len(x) // 2
        self.batch.reset(motion=[0.0, 0.0, *x[:3], 0.0, 0.0, *x[half:half + 3]])
        self.plan = np.append(self.plan[1:], self.plan[-1])
        # A constant and a ramp, because slow torques move the arm most, and independent changes.
        random = self.random.normal(size=(ROLLOUTS, 2 + HORIZON))
        random = random[:, :1] + random[:, 1:2] * np.linspace(-1.0, 1.0, HORIZON) + (
            0.3 * random[:, 2:])
        size = LEAST + SPREAD * abs(GOAL[2] - x[0])
        torque = np.clip(self.plan + size * random, -self.limit, self.limit)
        torque[0] = self.plan
        cost = np.sum(np.diff(torque, axis=1)**2, axis=1) / CHANGE**2
        before = self.batch.deflection()[:, 1]
        for k in range(HORIZON):
            motion = self.batch.step(torque=torque[:, k], duration=HOLD)
            bend = self.batch.deflection()[:, 1]
            sway = (bend - before) / HOLD
            left = GOAL[2] - motion.shaft - bend / LENGTH
            wanted = np.sign(left) * np.minimum(np.sqrt(2.0 * self.slowing * np.abs(left)),
                                                GAIN * np.abs(left))
            cost += ((motion.shaft_velocity + sway / LENGTH - wanted) / SPEED)**2
            cost += (sway / SWAY)**2
            before = bend
        weight = np.exp((cost.min() - cost) / (TEMPERATURE * (np.median(cost) - cost.min())))
        self.plan = weight @ torque / weight.sum()


if __name__ == '__main__':
    main(__doc__, timo_sim.load_scene(SCENE, {'motor.torque_limit': LIMIT}), {'MPPI': MPPI})
