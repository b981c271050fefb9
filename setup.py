from setuptools import find_packages, setup

package_name = 'timo_sim'

setup(
    name=package_name,
    version='0.1.0',
    packages=find_packages(include=[package_name, package_name + '.*']),
    package_data={package_name: ['ros/fastdds.xml']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + package_name]),
        ('share/' + package_name, ['package.xml']),
        ('share/' + package_name + '/config', [
            'config/paper.yaml', 'config/spin_up.yaml', 'config/sweep.yaml']),
        ('share/' + package_name + '/launch', [
            'launch/sim.launch.py', 'launch/rviz.launch.py']),
        ('share/' + package_name + '/urdf', ['urdf/timo_sim.urdf', 'urdf/timo_sim.rviz']),
    ],
    python_requires='>=3.11',
    install_requires=['setuptools', 'click', 'mcap', 'lz4', 'numba', 'numpy>=1.26', 'PyYAML',
                      'scipy>=1.11', 'tqdm', 'zstandard'],
    extras_require={
        # ROS 2 Jazzy from its wheels, for machines without an installed ROS.
        'ros': ['ros-jazzy-diagnostic-msgs', 'ros-jazzy-geometry-msgs',
                'ros-jazzy-rcl-interfaces', 'ros-jazzy-rclpy', 'ros-jazzy-rmw-fastrtps-cpp',
                'ros-jazzy-rosgraph-msgs', 'ros-jazzy-sensor-msgs', 'ros-jazzy-std-msgs',
                'ros-jazzy-std-srvs'],
        # Needs numpy >= 2 by its own word; see the README for Ubuntu 24.04.
        'view': ['rerun-sdk'],
        'plot': ['matplotlib'],
        # Results of sweeps as Parquet; sweeps on many machines.
        'sweep': ['pyarrow'],
        'cluster': ['distributed'],
        # exudyn is the finite-element engine that this package is compared with.
        'benchmark': ['exudyn', 'matplotlib'],
        'test': ['colcon-core', 'colcon-library-path', 'colcon-metadata', 'colcon-output',
                 'colcon-package-information', 'colcon-package-selection',
                 'colcon-parallel-executor', 'colcon-python-setup-py', 'colcon-recursive-crawl',
                 'colcon-ros', 'colcon-test-result', 'distributed', 'flake8', 'flake8-quotes',
                 'hypothesis', 'matplotlib',
                 'mcap-ros2-support', 'mypy', 'pyarrow', 'pydocstyle', 'pytest', 'pytest-xdist',
                 'rerun-sdk', 'ros-jazzy-visualization-msgs',
                 'rosbags', 'types-PyYAML', 'types-tqdm'],
    },
    zip_safe=True,
    maintainer='The timo_sim authors',
    maintainer_email='timo_sim@example.org',
    description='A mobile manipulator with a flexible Timoshenko arm, simulated in real time.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'sim_node = timo_sim.ros.sim_node:main',
            'timo_sim = timo_sim.cli:main',
            # For `ros2 run timo_sim ...`, the same functions.
            *(f'{name} = timo_sim.cli:{name}' for name in (
                'bode', 'export', 'info', 'recover', 'replay', 'view')),
        ],
    },
)
