"""Look at a running simulator in RViz: `ros2 launch timo_sim rviz.launch.py`."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    """Describe what turns joint states into frames, and RViz."""
    share = Path(get_package_share_directory('timo_sim'))
    return LaunchDescription([
        Node(package='robot_state_publisher', executable='robot_state_publisher',
             parameters=[{'robot_description': (share / 'urdf/timo_sim.urdf').read_text()}]),
        Node(package='rviz2', executable='rviz2',
             arguments=['-d', str(share / 'urdf/timo_sim.rviz')]),
    ])
