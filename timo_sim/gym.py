# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Environments of gymnasium, for reinforcement learning: the extra `rl`.

Importing it registers `timo_sim/Reach-v0`. It may import `simulation` and what is below it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
from typing import Any

import numpy as np

from timo_sim.extras import optional
from timo_sim.model.layout import FORCE_X, FORCE_Y, LOADS, rotate, TORQUE
from timo_sim.scene.parameters import (
    checked, fixed_axes, LATEST, MAPPING, numbers, NUMBERS, Parameter, ParameterError, WHOLE,
    whole_ratio)
from timo_sim.scene.scene import load_scene, SceneLike
from timo_sim.simulation.batch import Batch, MOST_ARMS
from timo_sim.simulation.simulator import Stateful

with optional():
    import gymnasium
    from gymnasium.spaces import Box
    from gymnasium.utils.seeding import np_random
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space

# The paper's arm with the brakes of its carrier on; the tip is within 0.1 mm of a finer model's.
SCENE: dict[str, Any] = {'carrier.held': 'both', 'initial.shaft': 0.0, 'model.modes': 3,
                         'integrator.step': 0.005, 'motor.torque_limit': 10.0}
_COUNT = Parameter('num_envs', 1, '', 'number of manipulators', low=1, high=MOST_ARMS)
_FORCE = Parameter('force', 0.0, 'N', 'force on the carrier at an action of 1', low=0.0)
_DURATION = Parameter('duration', 4.0, 's', 'of an episode', low=0.0, high=LATEST,
                      open_low=True)
_PERIOD = Parameter('period', 0.02, 's', 'from one action to the next', low=0.0, open_low=True)
_FARTHEST_GOAL = Parameter('farthest_goal', 1.0, 'rad', 'largest angle to a goal', low=0.0)
_MODE = Parameter('autoreset_mode', '', '', '', choices=tuple(
    mode.value for mode in AutoresetMode))
_SEEDS = (lambda seed: all(each is None or WHOLE[0](each) for each in (
    seed if np.ndim(seed) else [seed])), 'a whole number, or a list of them')
_ROWS: Any = (lambda rows: np.ndim(rows) == 2 and NUMBERS[0](rows),
              'finite numbers, a row for each environment')
_SPEED, _EFFORT = 0.1, 0.01  # what speed [s] and squared action [rad] cost beside a distance


class ReachVectorEnv(Stateful, VectorEnv):
    """
    Manipulators whose tips should point to goals as soon as possible, and rest there.

    An action is the torque on the shaft, and optionally a force on the carrier, as a share of the
    largest, -1 to 1; more is clipped. An observation has, as float32: the angle that is left from
    the tip's direction to the goal [rad]; shaft speed [rad/s]; angle between shaft and tip's
    direction [rad]; its rate, linear in the modal rates [rad/s]; unless the carrier is held along
    both axes, its velocity along and across the shaft [m/s]. Directions are seen from the shaft.

    The reward of a period is `-period (|left| + 0.1 |rate of left| + 0.01 mean(action^2))`, so
    that a return is at most 0. An episode is truncated after its duration; it terminates if the
    state diverges, with the reward of an arm that points away from the goal for the time left.

    An environment's numbers depend on its seed and actions alone, to the last bit: they are those
    of `ReachEnv` with the same seed, as in gymnasium's SyncVectorEnv.

    Parameters
    ----------
    num_envs : int
    scene : Scene, or what `load_scene` takes
        Its loads act as well, from the beginning of each episode.
    variations : sequence of dict, optional
        Overrides of the scene in each environment, such as another mass at the tip.
    period, duration : float
        Time from one action to the next, a whole multiple of the time step, and of an episode, a
        whole multiple of the period [s].
    farthest_goal : float
        Largest angle from the initial direction of the shaft to a goal; uniformly random [rad].
    force : float
        Force on the carrier along world x and y at actions of 1 [N]; 0: no such action.
    autoreset_mode : gymnasium.vector.AutoresetMode or str
    device : str
        That of the `Batch`: 'cpu' or 'cuda'.

    Attributes
    ----------
    batch : Batch
    goal : ndarray, shape (num_envs,)
        Directions in the world, which `reset` also takes as `options['goal']` [rad].

    Raises
    ------
    ParameterError
        If a value breaks its rule, a scene cannot be in a `Batch`, or has no motor.torque_limit.

    Examples
    --------
    >>> from timo_sim.gym import ReachVectorEnv
    >>> envs = ReachVectorEnv(num_envs=8)
    >>> observations, infos = envs.reset(seed=1)
    >>> envs.step(envs.action_space.sample())[0].shape
    (8, 4)

    """

    @checked(variations=(lambda given: all(isinstance(each, Mapping) for each in [*given]),
                         'a list of values by name'))
    def __init__(self, num_envs: int = 1, scene: SceneLike = SCENE,
                 variations: Sequence[Mapping[str, Any]] | None = None, period: float = 0.02,
                 duration: float = 4.0, farthest_goal: float = 1.0, force: float = 0.0,
                 autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
                 device: str = 'cpu') -> None:
        scene, self.num_envs = load_scene(scene), _COUNT.check(num_envs)
        num_envs = self.num_envs
        if variations is not None and len(variations) != num_envs:
            raise ParameterError(f'variations must have num_envs = {num_envs} elements, got '
                                 f'{len(variations)}')
        scenes = [scene] * num_envs if variations is None else [
            scene.vary(values) for values in variations]
        scene = scenes[0]  # a Batch has one time step, and the same axes held, in all
        self._force, self._duration = _FORCE.check(force), _DURATION.check(duration)
        self._torque = np.array([each.values['motor.torque_limit'] for each in scenes])
        self._farthest = _FARTHEST_GOAL.check(farthest_goal)
        if np.isinf(self._torque).any():
            raise ParameterError('motor.torque_limit must be finite, for it is the torque at an '
                                 'action of 1; got .inf')
        if self._force and fixed_axes(scene.values) == 'both':
            raise ParameterError('force must be 0 with a carrier that is held or driven along x '
                                 f'and y, got {force:g} N')
        self._mode = autoreset_mode if isinstance(autoreset_mode, AutoresetMode) else (
            AutoresetMode(_MODE.check(autoreset_mode)))
        self.metadata = {'autoreset_mode': self._mode, 'render_modes': []}
        self.batch, self.period = Batch(scenes, device=device), _PERIOD.check(period)
        self._steps = whole_ratio('period', self.period, 'integrator.step', scene.step)
        self._periods = whole_ratio('duration', self._duration, 'period', self.period)
        models = [each.build() for each in scenes]
        self._length = np.array([model.tip_point.lever[0] for model in models])  # from the axis
        self._bend_rate = np.array([model.tip_point.deflection[:, 0] for model in models]
                                   ) / self._length[:, np.newaxis]
        self._moves = fixed_axes(scene.values) != 'both'
        self.single_action_space = Box(-1.0, 1.0, (3 if self._force else 1,), np.float32)
        self.single_observation_space = Box(-np.inf, np.inf, (6 if self._moves else 4,),
                                            np.float32)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._initial = np.array(self.batch.motion.shaft)
        self.randoms = [np_random()[0] for _ in range(num_envs)]
        self.goal, self._elapsed = self._initial.copy(), np.zeros(num_envs, dtype=int)
        self._over = np.zeros(num_envs, dtype=bool)

    @checked(seed=_SEEDS, options=MAPPING)
    def reset(self, *, seed: int | Sequence[int | None] | None = None,
              options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        """
        Begin new episodes; return observations, (num_envs, 4 or 6), and an empty dictionary.

        An int as `seed` is that of the first environment; those of the others follow it. Of
        `options`, `goal` is a float or of shape (num_envs,), goals instead of random ones [rad],
        and `reset_mask`, bool, (num_envs,), says which begin anew, by default all.
        """
        options = options or {}
        seeds = [None if seed is None else seed + k for k in range(self.num_envs)] if (
            seed is None or isinstance(seed, (int, np.integer))) else list(seed)
        if len(seeds) != self.num_envs:
            raise ParameterError(f'seed must be an int or num_envs = {self.num_envs} of them, got '
                                 f'{len(seeds)}')
        mask = np.asarray(options.get('reset_mask', np.ones(self.num_envs, dtype=bool)))
        self._restart(mask, seeds)
        if 'goal' in options:
            self.goal = np.where(mask, numbers('goal', options['goal'], (), mask.shape), self.goal)
        return self._observations(), {}

    def _restart(self, mask, seeds=None):
        self.batch.reset(mask)
        self._elapsed[mask], self._over[mask] = 0, False
        for k in np.flatnonzero(mask):
            if seeds and seeds[k] is not None:
                self.randoms[k] = np_random(seeds[k])[0]
            self.goal[k] = self._initial[k] + self.randoms[k].uniform(
                -self._farthest, self._farthest)

    def step(self, actions: np.ndarray) -> tuple[
            np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """
        Let actions, (num_envs, 1 or 3), act for a period.

        Returns observations, (num_envs, 4 or 6); rewards, terminations and truncations,
        (num_envs,); and with `AutoresetMode.SAME_STEP` `final_obs` of the environments that have
        been reset. Raises ParameterError if an action is not finite or the actions have another
        shape, or an episode is over that has not been reset, with `AutoresetMode.DISABLED`.
        """
        actions = numbers('actions', actions, self.action_space.shape)
        actions, begins = np.clip(actions, -1.0, 1.0), self._over.copy()
        if begins.any() and self._mode is not AutoresetMode.NEXT_STEP:
            raise ParameterError(f'the episodes of environments {np.flatnonzero(begins).tolist()} '
                                 'are over: reset them')
        commanded = np.zeros((self.num_envs, LOADS))
        commanded[:, TORQUE] = self._torque * actions[:, 0]
        if self._force:
            commanded[:, FORCE_X:FORCE_Y + 1] = self._force * actions[:, 1:]
        self.batch.advance(self._steps, commanded)
        self._elapsed += 1
        if begins.any():  # their actions have had no effect
            self._restart(begins)
        found, failed = self._observations(), self.batch.failed
        rewards = np.where(begins, 0.0, self.reward(found, actions))
        left = self._duration - (self._elapsed - 1) * self.period
        rewards[failed] = -math.pi * left[failed]
        truncations = ~failed & (self._elapsed >= self._periods)
        self._over, infos = failed | truncations, {}
        over = self._over.copy()
        if over.any() and self._mode is AutoresetMode.SAME_STEP:
            final = np.full(self.num_envs, None, dtype=object)
            for k in np.flatnonzero(over):
                final[k] = found[k].copy()
            infos = {'final_obs': final, '_final_obs': over, 'final_info': {},
                     '_final_info': over.copy()}
            self._restart(over)
            found = self._observations()
        return found, rewards, failed, truncations, infos

    @checked(observations=_ROWS, actions=_ROWS)
    def reward(self, observations: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Return the rewards of a period, (num_envs,); a class of another task overrides it."""
        left, speed, _, bend_rate = observations[:, :4].astype(float).T
        return -self.period * (np.abs(left) + _SPEED * np.abs(speed + bend_rate)
                               + _EFFORT * (actions**2).mean(axis=1))

    def _observations(self):
        motion, (along, across) = self.batch.motion, self.batch.deflection().T
        bend = np.arctan2(across, self._length + along)
        found = [self.goal - motion.shaft - bend, motion.shaft_velocity, bend,
                 (self._bend_rate * motion.qdot).sum(axis=1)]
        if self._moves:
            found.extend(rotate(-motion.shaft, *motion.carrier_velocity.T))
        return np.array(found, dtype=np.float32).T.copy()


class ReachEnv(Stateful, gymnasium.Env):
    """
    A `ReachVectorEnv` of one manipulator; many are much faster as one `ReachVectorEnv`.

    It takes `scene`, `period`, `duration`, `farthest_goal` and `force`.
    """

    metadata: dict[str, Any] = {'render_modes': []}

    def __init__(self, **parameters: Any) -> None:
        self._one = ReachVectorEnv(1, autoreset_mode=AutoresetMode.DISABLED, **parameters)
        self.action_space = self._one.single_action_space
        self.observation_space = self._one.single_observation_space

    @property
    def goal(self) -> float:
        """Direction of the goal in the world [rad]."""
        return float(self._one.goal[0])

    @checked(seed=WHOLE, options=MAPPING)
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None
              ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin a new episode, see `ReachVectorEnv.reset`."""
        super().reset(seed=seed)
        self._one.randoms[0] = self.np_random
        observations, infos = self._one.reset(options=options)
        return observations[0], infos

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Let an action act for a period, see `ReachVectorEnv.step`."""
        action = numbers('action', action, self.action_space.shape)
        found, rewards, terminations, truncations, infos = self._one.step(action[np.newaxis])
        return (found[0], float(rewards[0]), bool(terminations[0]), bool(truncations[0]), infos)


__all__ = ['ReachEnv', 'ReachVectorEnv']

gymnasium.register('timo_sim/Reach-v0', entry_point='timo_sim.gym:ReachEnv',
                   vector_entry_point='timo_sim.gym:ReachVectorEnv')
