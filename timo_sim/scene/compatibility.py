# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Parameters as older versions wrote them to logs, under their present names and meanings."""

import math

# 0.2.0 renamed these.
_RENAMED = {'motor.dc.gear': 'motor.dc.gear_ratio', 'step_count': 'steps_per_call'}
# Before 0.2.0 a limit of 0 meant that there was none; today it is refused.
_LIMITS = {'carrier.force_limit', 'carrier.force_rate_limit', 'motor.torque_limit',
           'motor.torque_rate_limit', 'motor.dc.voltage_limit'}


def current(values):
    """
    Return logged values by their present names.

    Parameters
    ----------
    values : dict
        By dotted name.

    Returns
    -------
    dict

    """
    return {_RENAMED.get(name, name): math.inf if name in _LIMITS and value == 0.0 else value
            for name, value in values.items()}
