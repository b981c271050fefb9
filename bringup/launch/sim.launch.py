# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Start the simulator: `ros2 launch timo_sim_bringup sim.launch.py params_file:=FILE`."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

_SWITCH = 'true', 'false', 'True', 'False'
# By argument: parameter, default, choices and meaning. With an empty value the file's applies.
_PARAMETERS = {
    'clock': ('publish_clock', 'true', _SWITCH, 'whether sim time goes to /clock'),
    'tf': ('publish_tf', '', ('', *_SWITCH), 'whether frames go to /tf; empty: as in the file'),
    'record_file': ('record_file', '', None, 'path of the log; empty: as in the file'),
    'frame_prefix': ('frame_prefix', '', None, 'prefix of all frames but world, such as left/; '
                                               'empty: as in the file'),
}


def _node(context):
    scene = Path(LaunchConfiguration('params_file').perform(context))
    if not scene.is_file():  # launch would ignore a missing file
        raise FileNotFoundError(f'params_file must be a file, got {scene}')
    given = {}
    for name, (parameter, _, choices, _) in _PARAMETERS.items():
        value = LaunchConfiguration(name).perform(context)
        if value:
            given[parameter] = value in ('true', 'True') if choices else ParameterValue(
                value, value_type=str)
    return [Node(
        package='timo_sim', executable='sim_node', name='timo_sim', output='screen',
        namespace=LaunchConfiguration('namespace'), parameters=[str(scene), given],
        respawn=LaunchConfiguration('respawn'), respawn_delay=1.0)]


def generate_launch_description():
    """Describe one node with one parameter file, the paper's scene by default."""
    paper = Path(get_package_share_directory('timo_sim'), 'config/paper.yaml')
    return LaunchDescription([
        DeclareLaunchArgument('params_file', default_value=str(paper),
                              description='ROS parameter file with the scene, below /** '
                                          'if there is a namespace'),
        DeclareLaunchArgument('namespace', default_value='', description='namespace of the node'),
        DeclareLaunchArgument('respawn', default_value='false', choices=_SWITCH,
                              description='whether the node is started again when it has ended'),
        *[DeclareLaunchArgument(name, default_value=default, choices=choices,
                                description=meaning)
          for name, (_, default, choices, meaning) in _PARAMETERS.items()],
        OpaqueFunction(function=_node),
    ])
