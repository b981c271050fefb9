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
    hardware, controller, sync, controllers, scene = (
        LaunchConfiguration(name).perform(context) for name in (
            'hardware', 'controller', 'sync', 'controllers_file', 'params_file'))
    inside, timed = hardware == 'inside', {'use_sim_time': True}
    library = Path(launch_config.log_dir, 'scene.so')
    urdf = Command([
        ExecutableInPackage('timo_sim', 'timo_sim'), ' urdf ', shlex.quote(scene),
        f' --ros2-control {shlex.quote(str(library))} --set publish_clock=true' * inside],
        on_stderr='warn').perform(context)
    nodes = [
        Node(package='robot_state_publisher', executable='robot_state_publisher',
             parameters=[{'robot_description': ParameterValue(urdf, value_type=str), **timed}]),
        # A missing file is an error in ros_arguments, but is ignored in parameters. The clock of
        # the manager is set inside it, without the topic, which comes later.
        Node(package='controller_manager', executable='ros2_control_node', output='screen',
             ros_arguments=['--params-file', controllers,
                            *['-r', 'controller_manager:/clock:=/clock_unheard'] * inside],
             parameters=[timed], on_exit=Shutdown()),
        # Controllers start with /clock, before which the simulator may have to compile.
        Node(package='controller_manager', executable='spawner', output='screen',
             arguments=['joint_state_broadcaster', controller, '--param-file', controllers,
                        '--switch-timeout', '120', '--service-call-timeout', '120'],
             on_exit=_end_if_failed),
    ]
    if not inside:
        # joint_state_broadcaster publishes joint_states; the hardware reads the simulator's.
        nodes.insert(0, Node(
            package='timo_sim', executable='sim_node', name='timo_sim', output='screen',
            ros_arguments=['--params-file', scene, '--params-file', controllers],
            parameters=[{'sync': sync}], remappings=[('joint_states', 'timo_sim/joint_states')],
            on_exit=Shutdown()))
    for node in nodes:  # if a program is missing, none must run: launch would end none
        ExecutableInPackage(node.node_executable, node.node_package).perform(context)
    return nodes


def generate_launch_description():
    """Describe the simulator, the controller manager and the spawner of one controller."""
    return LaunchDescription([
        DeclareLaunchArgument('hardware', default_value='inside', choices=['inside', 'topic'],
                              description='whether the arm steps inside the controller manager, '
                                          'or in a node of its own'),
        DeclareLaunchArgument('controller', default_value='effort_controller',
                              description='controller of controllers_file that is activated'),
        DeclareLaunchArgument('sync', default_value='free', choices=['free', 'any_command'],
                              description='any_command: time waits for each command, with '
                                          'hardware:=topic'),
        DeclareLaunchArgument('controllers_file',
                              default_value=str(_SHARE / 'config/controllers.yaml'),
                              description='parameters of the controllers and of their timing'),
        DeclareLaunchArgument('params_file', default_value=LaunchConfiguration('controllers_file'),
                              description='ROS parameter file with the scene; by default that of '
                                          'the paper, at rest'),
        OpaqueFunction(function=_nodes),
    ])
