# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
NMPC: nonlinear model predictive control with casadi, which gets the arm with exact derivatives.

    python example/nmpc.py --loop --plot nmpc.png  # needs casadi

The motor has half the torque that the plan of the LQR takes. Every 50 ms sequential quadratic
programming finds the torques of the next 1.5 s. They and the states are unknowns (multiple
shooting); `Simulator.step_derivatives` has the derivatives of what ties them. An elastic gear and
dry friction of the scene are in the plan and in the observer.
"""

import casadi
from loop import PERIOD
from mppi import LIMIT
import numpy as np
from slew import GOAL, main, SCENE
import timo_sim

HOLD, HORIZON = 0.05, 30     # duration of each torque [s], and their number
# What costs 1 of coordinates, of their rates and of the torque, in limits of the motor; how far
# the shaft may overshoot [rad].
SCALE, SHAFT_RATE, RATE, TORQUE, BEYOND = 0.01, 0.1, 0.2, 5.0, 2e-3
QUIET = dict.fromkeys(['print_time', 'print_header', 'error_on_fail'], False)


class Plant(casadi.Callback):
    """The state after a torque was held, by state and torque; with `by`, its derivatives."""

    def __init__(self, simulator, name='plant', by=False):
        super().__init__()
        self.simulator, self.by, self.places = simulator, by, simulator.model.free_places
        self.construct(name, {})

    def get_sparsity_in(self, _):
        """Return the shape of state and torque."""
        return casadi.Sparsity.dense(len(self.places) + 1, 1)

    def get_sparsity_out(self, _):
        """Return the shape of the result."""
        return casadi.Sparsity.dense(len(self.places), len(self.places) + 1 if self.by else 1)

    def eval(self, arguments):
        """Let the simulator hold the torque; joints that move have slid before."""
        simulator, places = self.simulator, self.places
        motion, (*state, torque) = np.zeros(simulator.model.size), arguments[0].full().ravel()
        motion[places] = state
        simulator.set_motion(motion)
        simulator.integration.reset(motion)
        if not self.by:
            return [simulator.step(duration=HOLD, torque=torque).values[places]]
        found = simulator.step_derivatives(['torque'], duration=HOLD, torque=torque)
        return [np.hstack([found.by_motion[:, places], found.by_input])[places]]

    def has_jacobian(self):
        """Return whether there are derivatives."""
        return not self.by

    def get_jacobian(self, name, *_):
        """Return the function of the derivatives; casadi gives it the state reached, too."""
        self.derivatives, size = Plant(self.simulator, 'derivatives', True), len(self.places)
        given, reached = casadi.MX.sym('given', size + 1), casadi.MX.sym('reached', size)
        return casadi.Function(name, [given, reached], [self.derivatives(given)])


class NMPC:
    """
    Turns the shaft of a scene whose carrier is held, as fast as its motor allows.

    Parameters
    ----------
    scene : timo_sim.Scene
        Has the limit of the torque, and the noise of encoder and strain gauge.
    step : float
        Of the plan [s].

    """

    times: list[float] = []  # of solutions [s]

    def __init__(self, scene, step=0.005):
        self.observer, self.limit = timo_sim.observer(scene), scene.values['motor.torque_limit']
        self.plant = Plant(timo_sim.Simulator(scene.vary({
            'model.modes': 2, 'model.static_modes': 'none', 'integrator.step': step,
            'motor.torque_limit': np.inf, 'motor.torque_rate_limit': np.inf})))
        # Shaft, two modes and a gear's twist in a motion of the observer.
        model = self.observer.model
        self.seen = [2, 3, 4, *[model.gear_place] * bool(model.gear)]
        self.seen += [model.size // 2 + place for place in self.seen]
        count = len(self.seen)
        unknowns = casadi.MX.sym('z', (count + 1) * (HORIZON + 1))
        first, z = casadi.MX.sym('first', count), casadi.reshape(unknowns, count + 1, HORIZON + 1)
        goal = casadi.DM([GOAL[2]] + (count - 1) * [0.0])
        rest = count // 2 - 1
        scales = casadi.DM([SCALE, *rest * [SCALE], SHAFT_RATE, *rest * [RATE]])
        off = [(z[:count, k + 1] - goal) / scales for k in range(HORIZON)]
        cost = sum(map(casadi.sumsqr, [*off, z[count, :] / (TORQUE * self.limit)]))
        ties = [z[:count, 0] - first,
                *(z[:count, k + 1] - self.plant(z[:, k]) for k in range(HORIZON))]
        # Costs are squares: second derivatives of the plant are left out (Gauss and Newton).
        weight, multipliers = casadi.MX.sym('f'), casadi.MX.sym('g', count * (HORIZON + 1))
        hessian = casadi.Function('hessian', [unknowns, first, weight, multipliers], [
            weight * casadi.triu(casadi.hessian(cost, unknowns)[0])])
        self.solve = casadi.nlpsol('nmpc', 'sqpmethod', {
            'x': unknowns, 'p': first, 'f': cost, 'g': casadi.veccat(*ties)}, {
                'hess_lag': hessian, 'max_iter': 8, 'max_iter_ls': 0, 'qpsol': 'qrqp',
                'print_iteration': False, 'print_status': False, 'record_time': True, **QUIET,
                'qpsol_options': {'print_iter': False, **QUIET}})
        self.plan = np.zeros((HORIZON + 1, count + 1))

    def effort(self, t, seen):
        """Return the torque on the shaft [N m] that answers what is seen."""
        motion = self.observer.update(
            {'encoder': seen.encoder, 'root_strain': seen.root_strain},
            {'torque': self.plan[0, -1]}, PERIOD if t else 0.0)
        if round(t / PERIOD) % round(HOLD / PERIOD) == 0:
            self.replan(motion.values[self.seen])
        return {'shaft': float(self.plan[0, -1])}

    def replan(self, state):
        """Find the torques of the horizon, from a state on."""
        guess = np.vstack([self.plan[1:], self.plan[-1:]])
        low = np.full(guess.shape, [-np.inf] * len(state) + [-self.limit])
        high = -low
        high[1:, 0] = GOAL[2] + BEYOND  # the first state is what it is
        found = self.solve(x0=guess.ravel(), p=state, lbx=low.ravel(), ubx=high.ravel(), lbg=0.0,
                           ubg=0.0)['x']
        self.plan = found.full().reshape(guess.shape)
        self.times.append(self.solve.stats()['t_wall_total'])


if __name__ == '__main__':
    main(__doc__, timo_sim.load_scene(SCENE, {'motor.torque_limit': LIMIT}), {'NMPC': NMPC})
    print(f'a solution took {np.median(NMPC.times):.3f} s, at most {max(NMPC.times):.3f} s')
