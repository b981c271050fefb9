# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Start the simulator: `ros2 launch timo_sim sim.launch.py params_file:=FILE`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    """Describe one node with one parameter file, the paper's scene by default."""
    paper = PathJoinSubstitution([FindPackageShare('timo_sim'), 'config', 'paper.yaml'])
    return LaunchDescription([
        DeclareLaunchArgument('params_file', default_value=paper,
                              description='ROS parameter file with the scene'),
        DeclareLaunchArgument('namespace', default_value='',
                              description='namespace of the node'),
        Node(package='timo_sim', executable='sim_node', name='timo_sim',
             namespace=LaunchConfiguration('namespace'),
             parameters=[LaunchConfiguration('params_file')], output='screen'),
    ])
