# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Installs files alone."""

from glob import glob

from setuptools import setup

setup(
    name='timo_sim_bringup',
    version='0.3.0',
    packages=[],
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/timo_sim_bringup']),
        ('share/timo_sim_bringup', ['package.xml']),
        ('share/timo_sim_bringup/config', glob('config/*')),
        ('share/timo_sim_bringup/launch', glob('launch/*.launch.py')),
    ],
)
