# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Look at a simulator with publish_tf in RViz: `ros2 launch timo_sim_bringup rviz.launch.py`."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

_VIEW = Path(__file__).resolve().parents[1] / 'config/timo_sim.rviz'


def generate_launch_description():
    """Describe RViz alone: URDF and frames come from the simulator."""
    return LaunchDescription([
        DeclareLaunchArgument('namespace', default_value='',
                              description='namespace of the simulator'),
        DeclareLaunchArgument('clock', default_value='true',
                              choices=['true', 'false', 'True', 'False'],
                              description='whether time is that of /clock'),
        # The topics in the file are relative, and so in this namespace.
        Node(package='rviz2', executable='rviz2', arguments=['-d', str(_VIEW)], output='screen',
             namespace=LaunchConfiguration('namespace'),
             parameters=[{'use_sim_time': ParameterValue(
                 LaunchConfiguration('clock'), value_type=bool)}]),
    ])
