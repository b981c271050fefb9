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
