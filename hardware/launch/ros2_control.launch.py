# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Run the simulator under ros2_control: `ros2 launch timo_sim_hardware ros2_control.launch.py`.

doc/ros.md is the page about it.
"""

from pathlib import Path
import shlex

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.logging import launch_config
from launch.substitutions import Command, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage

_SHARE = Path(__file__).resolve().parents[1]


def _end_if_failed(event, context):
    return [Shutdown()] if event.returncode else None


def _nodes(context):
    controller, controllers, scene = (LaunchConfiguration(name).perform(context) for name in (
        'controller', 'controllers_file', 'params_file'))
    timed = {'use_sim_time': True}
    library = Path(launch_config.log_dir, 'scene.so')
    urdf = Command([
        ExecutableInPackage('timo_sim', 'timo_sim'), ' urdf ', shlex.quote(scene),
        f' --ros2-control {shlex.quote(str(library))} --set publish_clock=true'],
        on_stderr='warn').perform(context)
    nodes = [
        Node(package='robot_state_publisher', executable='robot_state_publisher',
             parameters=[{'robot_description': ParameterValue(urdf, value_type=str), **timed}]),
        # A missing file is an error in ros_arguments, but is ignored in parameters. The clock of
        # the manager is set inside it, without the topic, which comes later.
        Node(package='controller_manager', executable='ros2_control_node', output='screen',
             ros_arguments=['--params-file', controllers,
                            '-r', 'controller_manager:/clock:=/clock_unheard'],
             parameters=[timed], on_exit=Shutdown()),
        # Controllers start with /clock.
        Node(package='controller_manager', executable='spawner', output='screen',
             arguments=['joint_state_broadcaster', controller, '--param-file', controllers,
                        '--switch-timeout', '120', '--service-call-timeout', '120'],
             on_exit=_end_if_failed),
    ]
    for node in nodes:  # if a program is missing, none must run: launch would end none
        ExecutableInPackage(node.node_executable, node.node_package).perform(context)
    return nodes


def generate_launch_description():
    """Describe the simulator, the controller manager and the spawner of one controller."""
    return LaunchDescription([
        DeclareLaunchArgument('controller', default_value='effort_controller',
                              description='controller of controllers_file that is activated'),
        DeclareLaunchArgument('controllers_file',
                              default_value=str(_SHARE / 'config/controllers.yaml'),
                              description='parameters of the controllers and of their timing'),
        DeclareLaunchArgument('params_file', default_value=LaunchConfiguration('controllers_file'),
                              description='ROS parameter file with the scene; by default that of '
                                          'the paper, at rest'),
        OpaqueFunction(function=_nodes),
    ])
