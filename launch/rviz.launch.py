# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Look at a running simulator in RViz: `ros2 launch timo_sim rviz.launch.py`."""

from pathlib import Path
import shlex

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import Command, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage

_SHARE = Path(__file__).resolve().parents[1]


def _nodes(context):
    scene, namespace, prefix, clock = (LaunchConfiguration(name).perform(context) for name in (
        'params_file', 'namespace', 'frame_prefix', 'clock'))
    urdf = Command([ExecutableInPackage('timo_sim', 'timo_sim'), ' urdf ', shlex.quote(scene),
                    f' --set {shlex.quote(f"frame_prefix={prefix}")}' if prefix else ''],
                   on_stderr='warn').perform(context)
    common = {'namespace': namespace, 'output': 'screen'}
    timed = {'use_sim_time': clock in ('true', 'True')}
    for program in 'robot_state_publisher', 'rviz2':  # if one is missing, the other must not run
        ExecutableInPackage(program, program).perform(context)
    return [
        Node(package='robot_state_publisher', executable='robot_state_publisher', **common,
             parameters=[{'robot_description': ParameterValue(urdf, value_type=str), **timed}]),
        # The topics in the file are relative, and so in this namespace.
        Node(package='rviz2', executable='rviz2', **common, parameters=[timed],
             arguments=['-d', str(_SHARE / 'urdf/timo_sim.rviz')]),
    ]


def generate_launch_description():
    """Describe RViz, and the publisher that turns joint states into frames."""
    return LaunchDescription([
        DeclareLaunchArgument('params_file', default_value=str(_SHARE / 'config/paper.yaml'),
                              description='ROS parameter file with the scene, below /** '
                                          'if there is a namespace'),
        DeclareLaunchArgument('namespace', default_value='',
                              description='namespace of the simulator'),
        DeclareLaunchArgument('frame_prefix', default_value='', description=(
            'prefix of all frames but world, such as left/; empty: as in the file')),
        DeclareLaunchArgument('clock', default_value='true', choices=['true', 'false', 'True', 'False'],
                              description='whether time is that of /clock'),
        OpaqueFunction(function=_nodes),
    ])
