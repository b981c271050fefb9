# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Settings of Fast DDS that ROS 2 has no word for."""

import os
from pathlib import Path

_PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'
_USE_PROFILES = 'RMW_FASTRTPS_USE_QOS_FROM_XML'
# What says that the user has settings of his own: variables, and a file that is read unasked.
_OF_THE_USER = (_PROFILES, 'FASTDDS_DEFAULT_PROFILES_FILE', _USE_PROFILES)
_UNASKED = Path('DEFAULT_FASTRTPS_PROFILES.xml')


def use_profiles():
    """
    Let Fast DDS take `fastdds.xml`, unless its user has told it something else.

    For the process that calls this before rclpy is initialised; other middlewares do not care.
    """
    if _UNASKED.exists() or any(name in os.environ for name in _OF_THE_USER):
        return
    os.environ.update({_PROFILES: str(Path(__file__).with_name('fastdds.xml')),
                       _USE_PROFILES: '1'})
