# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
NMPC: nonlinear model predictive control with casadi, which gets the arm with exact derivatives.

    python example/nmpc.py --loop --plot nmpc.png  # needs casadi

The motor has half the torque that the plan of the LQR takes. Every 50 ms sequential quadratic
programming finds the torques of the next 1.5 s. They and the states are unknowns (multiple
shooting); `Simulator.step_derivatives` has the derivatives of what ties them.
"""

import casadi
from loop import PERIOD
from lqr import LQR
from mppi import LIMIT
import numpy as np
from slew import GOAL, main, SCENE
import timo_sim

HOLD, HORIZON = 0.05, 30     # duration of each torque [s], and their number
STATES = [2, 3, 4, 7, 8, 9]  # of a motion: shaft, two modal coordinates, and the rate of each
# What costs 1 of each of them and of the torque [N m]; how far the shaft may overshoot [rad].
SCALES, TORQUE, BEYOND = [0.01, 0.01, 0.01, 0.1, 0.1, 0.2], 40.0, 2e-3
QUIET = dict.fromkeys(['print_time', 'print_header', 'error_on_fail'], False)


class Plant(casadi.Callback):
    """The state after a torque was held, by state and torque; with `by`, its derivatives."""

    def __init__(self, simulator, name='plant', by=False):
        super().__init__()
        self.simulator, self.by = simulator, by
        self.construct(name, {})

    def get_sparsity_in(self, _):
        """Return the shape of state and torque."""
        return casadi.Sparsity.dense(7, 1)

    def get_sparsity_out(self, _):
        """Return the shape of the result."""
        return casadi.Sparsity.dense(6, 7 if self.by else 1)

    def eval(self, arguments):
        """Let the simulator hold the torque."""
        motion, (*state, torque) = np.zeros(10), arguments[0].full().ravel()
        motion[STATES] = state
        self.simulator.set_motion(motion)
        if not self.by:
            return [self.simulator.step(duration=HOLD, torque=torque).values[STATES]]
        found = self.simulator.step_derivatives(['torque'], duration=HOLD, torque=torque)
        return [np.hstack([found.by_motion[:, STATES], found.by_input])[STATES]]

    def has_jacobian(self):
        """Return whether there are derivatives."""
        return not self.by

    def get_jacobian(self, name, *_):
        """Return the function of the derivatives; casadi gives it the state reached, too."""
        self.derivatives = Plant(self.simulator, 'derivatives', True)
        given, reached = casadi.MX.sym('given', 7), casadi.MX.sym('reached', 6)
        return casadi.Function(name, [given, reached], [self.derivatives(given)])


class NMPC:
    """Turns the shaft of a scene as fast as its motor allows."""

    times: list[float] = []  # of solutions [s]

    def __init__(self, scene):
        self.observer = LQR(scene, 3.0)  # whose plan is not used
        self.limit = scene.values['motor.torque_limit']
        self.plant = Plant(timo_sim.Simulator(scene.vary({
            'model.modes': 2, 'integrator.step': 0.005, 'motor.torque_limit': np.inf,
            'motor.torque_rate_limit': np.inf})))
        unknowns, first = casadi.MX.sym('z', 7 * (HORIZON + 1)), casadi.MX.sym('first', 6)
        z, goal = casadi.reshape(unknowns, 7, HORIZON + 1), casadi.DM([GOAL[2], 0, 0, 0, 0, 0])
        off = [(z[:6, k + 1] - goal) / casadi.DM(SCALES) for k in range(HORIZON)]
        cost = sum(map(casadi.sumsqr, [*off, z[6, :] / TORQUE]))
        ties = [z[:6, 0] - first, *(z[:6, k + 1] - self.plant(z[:, k]) for k in range(HORIZON))]
        # Costs are squares: second derivatives of the plant are left out (Gauss and Newton).
        weight, multipliers = casadi.MX.sym('f'), casadi.MX.sym('g', 6 * (HORIZON + 1))
        hessian = casadi.Function('hessian', [unknowns, first, weight, multipliers], [
            weight * casadi.triu(casadi.hessian(cost, unknowns)[0])])
        self.solve = casadi.nlpsol('nmpc', 'sqpmethod', {
            'x': unknowns, 'p': first, 'f': cost, 'g': casadi.veccat(*ties)}, {
                'hess_lag': hessian, 'max_iter': 8, 'max_iter_ls': 0, 'qpsol': 'qrqp',
                'print_iteration': False, 'print_status': False, 'record_time': True, **QUIET,
                'qpsol_options': {'print_iter': False, **QUIET}})
        self.plan = np.zeros((HORIZON + 1, 7))

    def effort(self, t, seen):
        """Return the torque on the shaft [N m] that answers what is seen."""
        x = self.observer.observe(seen)
        if round(t / PERIOD) % round(HOLD / PERIOD) == 0:
            self.replan(np.append(x[:3], x[len(x) // 2:][:3]))
        self.observer.expect(x, self.plan[0, 6:])
        return {'shaft': float(self.plan[0, 6])}

    def replan(self, state):
        """Find the torques of the horizon, from a state on."""
        guess = np.vstack([self.plan[1:], self.plan[-1:]])
        low = np.full(guess.shape, [-np.inf] * 6 + [-self.limit])
        high = -low
        high[1:, 0] = GOAL[2] + BEYOND  # the first state is what it is
        found = self.solve(x0=guess.ravel(), p=state, lbx=low.ravel(), ubx=high.ravel(), lbg=0.0,
                           ubg=0.0)['x']
        self.plan = found.full().reshape(guess.shape)
        self.times.append(self.solve.stats()['t_wall_total'])


if __name__ == '__main__':
    main(__doc__, timo_sim.load_scene(SCENE, {'motor.torque_limit': LIMIT}), {'NMPC': NMPC})
    print(f'a solution took {np.median(NMPC.times):.3f} s, at most {max(NMPC.times):.3f} s')
