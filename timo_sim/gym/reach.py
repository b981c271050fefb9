# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""One manipulator whose tip should point to a goal, as an environment of gymnasium."""

from __future__ import annotations

from typing import Any

import gymnasium
from gymnasium.vector import AutoresetMode
import numpy as np

from timo_sim.gym.reach_vector import ReachVectorEnv


class ReachEnv(gymnasium.Env):
    """
    A `ReachVectorEnv` of one manipulator; many are much faster as one `ReachVectorEnv`.

    Parameters
    ----------
    **parameters : Any
        `scene`, `period`, `duration`, `farthest_goal`, `force`: see `ReachVectorEnv`.

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

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None
              ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin a new episode, see `ReachVectorEnv.reset`."""
        super().reset(seed=seed)
        self._one.randoms[0] = self.np_random
        observations, infos = self._one.reset(options=options)
        return observations[0], infos

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Let an action act for a period, see `ReachVectorEnv.step`."""
        found, rewards, terminations, truncations, infos = self._one.step(np.array([action]))
        return (found[0], float(rewards[0]), bool(terminations[0]), bool(truncations[0]), infos)
