# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Run the simulator under ros2_control: `ros2 launch timo_sim ros2_control.launch.py`.

doc/ros.md is the page about it.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage


def _find(context, nodes):
    """Raise an error before any program starts if one is missing: launch would end none."""
    for node in nodes:
        ExecutableInPackage(node.node_executable, node.node_package).perform(context)


def _end_if_failed(event, context):
    return [Shutdown()] if event.returncode else None


def generate_launch_description():
    """Describe the simulator, the controller manager and the spawner of one controller."""
    share = Path(__file__).resolve().parents[1]
    controllers = LaunchConfiguration('controllers_file')
    urdf = ParameterValue((share / 'urdf/timo_sim.urdf').read_text(), value_type=str)
    nodes = [
        # A missing file is an error in ros_arguments, but is ignored in parameters.
        # joint_state_broadcaster publishes joint_states; the hardware reads the simulator's.
        Node(package='timo_sim', executable='sim_node', name='timo_sim', output='screen',
             ros_arguments=['--params-file', LaunchConfiguration('params_file'),
                            '--params-file', controllers],
             parameters=[{'sync': LaunchConfiguration('sync')}],
             remappings=[('joint_states', 'timo_sim/joint_states')], on_exit=Shutdown()),
        Node(package='robot_state_publisher', executable='robot_state_publisher',
             parameters=[{'robot_description': urdf, 'use_sim_time': True}]),
        Node(package='controller_manager', executable='ros2_control_node', output='screen',
             ros_arguments=['--params-file', controllers], parameters=[{'use_sim_time': True}],
             on_exit=Shutdown()),
        # Controllers start with /clock, before which the simulator may have to compile.
        Node(package='controller_manager', executable='spawner', output='screen',
             arguments=['joint_state_broadcaster', LaunchConfiguration('controller'),
                        '--param-file', controllers,
                        '--switch-timeout', '120', '--service-call-timeout', '120'],
             on_exit=_end_if_failed),
    ]
    return LaunchDescription([
        DeclareLaunchArgument('controller', default_value='effort_controller',
                              description='controller of controllers_file that is activated'),
        DeclareLaunchArgument('sync', default_value='free', choices=['free', 'any_command'],
                              description='any_command: time waits for each command'),
        DeclareLaunchArgument('controllers_file',
                              default_value=str(share / 'config/controllers.yaml'),
                              description='parameters of the controllers and of their timing'),
        DeclareLaunchArgument('params_file', default_value=controllers,
                              description='ROS parameter file with the scene; by default that of '
                                          'the paper, at rest'),
        OpaqueFunction(function=_find, args=[nodes]),
        *nodes,
    ])
