"""Settings that colcon needs besides pyproject.toml."""

from glob import glob

from setuptools import setup

setup(
    # No spelling in pyproject.toml suits both setuptools 68 (Ubuntu 24.04) and newer ones.
    license='Apache-2.0',
    # colcon reads metadata as literals; from pyproject.toml setuptools makes an object of this.
    python_requires='>=3.11',
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/timo_sim']),
        # The last two are for `colcon build --symlink-install`: it builds in a folder that has
        # links to setup.py, setup.cfg, the package and these files alone.
        ('share/timo_sim', ['package.xml', 'pyproject.toml', 'README.md']),
        ('share/timo_sim/config', sorted(glob('config/*.yaml'))),
        ('share/timo_sim/launch', sorted(glob('launch/*.launch.py'))),
        ('share/timo_sim/urdf', sorted(glob('urdf/timo_sim.*'))),
    ],
)
