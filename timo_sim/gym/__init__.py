# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Environments of gymnasium, for reinforcement learning: the extra `rl`.

Importing it registers `timo_sim/Reach-v0`. It may import `simulation` and what is below it.
"""

from timo_sim.extras import optional

with optional():
    import gymnasium

from timo_sim.gym.reach import ReachEnv
from timo_sim.gym.reach_vector import ReachVectorEnv

__all__ = ['ReachEnv', 'ReachVectorEnv']

gymnasium.register('timo_sim/Reach-v0', entry_point='timo_sim.gym.reach:ReachEnv',
                   vector_entry_point='timo_sim.gym.reach_vector:ReachVectorEnv')
