"""Settings that colcon needs besides pyproject.toml."""

from glob import glob
import os
import subprocess
import sys

from setuptools import setup
from setuptools.command.build_py import build_py


class Build(build_py):
    """Compiles the physics, too; without it, the first run does."""

    def run(self):
        super().run()
        # An editable installation has it beside the sources.
        built = os.path.abspath('' if self.editable_mode else self.build_lib)
        # pip hands on by PYTHONPATH what it has installed for the build.
        paths = [built, *filter(None, [os.environ.get('PYTHONPATH')])]
        done = subprocess.run(
            [sys.executable, '-m', 'timo_sim.export.prebuilt',
             os.path.join(built, 'timo_sim', 'compiled', 'prebuilt'),
             *['editable'] * self.editable_mode],
            cwd=built, env={**os.environ, 'PYTHONPATH': os.pathsep.join(paths)})
        if done.returncode:
            print('timo_sim: the first runs will compile for some 10 s', file=sys.stderr)


setup(
    cmdclass={'build_py': Build},
    # No spelling in pyproject.toml suits both setuptools 68 (Ubuntu 24.04) and newer ones.
    license='Apache-2.0',
    # colcon reads metadata as literals; from pyproject.toml setuptools makes an object of this.
    python_requires='>=3.11',
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/timo_sim']),
        # The last two are for `colcon build --symlink-install`: it builds in a folder that has
        # links to setup.py, setup.cfg, the package and these files alone.
        ('share/timo_sim', ['package.xml', 'pyproject.toml', 'README.md']),
        ('share/timo_sim/config', sorted(glob('config/*'))),
        ('share/timo_sim/example', sorted(glob('example/*.*'))),
    ],
)
