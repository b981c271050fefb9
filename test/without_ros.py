# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Plugin for a Python without ROS: `PYTHONPATH=test pytest -p without_ros` skips what needs it.

A test is skipped if it, one of its fixtures or its file asks for a ROS package, or for one of the
fixtures of `ros_process`.
"""

import re

import pytest

PACKAGE = re.compile(r'rclpy|ament_index_python|std_srvs|\w+_(msgs|interfaces)')


def missing(error):
    """Return the name of the ROS package that is missing, or None if the error is another one."""
    while error is not None:
        if isinstance(error, ModuleNotFoundError) and PACKAGE.match(error.name or ''):
            return error.name
        error = error.__cause__ or error.__context__
    return None


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    report = yield
    name = report.failed and missing(report.call.excinfo.value)
    if name:
        report.outcome = 'skipped'
        report.longrepr = (str(collector.path), 0, f'needs {name}')
    return report


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup():
    try:
        return (yield)
    except Exception as error:
        if not missing(error):
            raise
        pytest.skip(f'needs {missing(error)}')


pytest_pyfunc_call = pytest_fixture_setup


@pytest.fixture(name='start', scope='session')
def _start():
    pytest.skip('needs the node')


@pytest.fixture(name='client', scope='session')
def _client():
    pytest.skip('needs rclpy')


@pytest.fixture(name='ros', scope='session')
def _ros():
    pytest.skip('needs rclpy')
