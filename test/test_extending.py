# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The worked examples of doc/design.md, added to a copy of the package: topic, sensor, ..."""

import os
from pathlib import Path
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
(TOPIC, SENSOR, INPUT, EXACT, NEWTON, FORMULATION, LINE, INTEGRATOR, METHOD) = re.findall(
    r'```python\n(.*?)```',
    (ROOT / 'doc/design.md').read_text().split('## Add something')[1].split('\n## ')[0], re.S)

RUN = """
import timo_sim
scene = timo_sim.load_scene('paper', {
    'model.formulation': 'newton_small_speed', 'model.modes': 1, 'rate.carrier_velocity': 500.0,
    'sensor.middle_strain.noise': 0.0, 'sensor.middle_strain.bias': 0.5,
    # The modes of an arm with a profile need no compiled function.
    'arm.profile.position': [0.0, 2.0], 'arm.profile.height': [0.02, 0.02]})
run = timo_sim.simulate(scene, 1.0, 2, estimate=False)
simulator = timo_sim.Simulator(scene)
simulator.step(torque=1.0)
per_q = 0.01 * scene.build().modes.curvature([1.0])[0, 0]  # half the height times curvature
print(simulator.sensors.middle_strain - per_q * simulator.motion.q[0])
linear = timo_sim.linearize(scene).select(['torque_N_m', 'disturbance_N_m'], ['middle_strain'])
exact = timo_sim.linearize(scene.vary({'model.formulation': 'exact'}))
ours = exact.B[:, exact.inputs.index('disturbance_N_m')]
print(abs(ours - exact.B[:, 2]).max(), exact.inputs[2])
print(linear.C[0, 3] / per_q, abs(linear.B[:, 1] - linear.B[:, 0]).max(), abs(linear.B).max())
ends = [simulators.step(duration=0.1, **commands).values for simulators, commands in (
    (timo_sim.Simulator(scene), {'torque': 2.0}),
    (timo_sim.Simulator(scene), {'disturbance': 2.0}),
    (timo_sim.Simulator(scene.vary({'load.disturbance.piecewise.time': [0.0],
                                    'load.disturbance.piecewise.value': [2.0]})), {}))]
print(abs(ends[1] - ends[0]).max(), abs(ends[2] - ends[0]).max(), abs(ends[0]).max())
velocity = run.columns()['carrier_velocity_y_m_per_s']
print(abs(velocity - run.carrier_velocity[:, 1]).max(), abs(velocity).max())
newton = timo_sim.simulate(
    scene.vary({'model.formulation': 'newton'}), 1.0, 2, estimate=False)
print(newton.q[-1, 0], run.q[-1, 0])
bent = scene.vary({'carrier.held': 'both', 'motor.shaft': 'locked', 'integrator.step': 0.05,
                   'initial.modal_coordinates': [0.1]})
vibrating = timo_sim.simulate(bent, 1.0, estimate=False)
print(vibrating.model.modes.omega[0], *vibrating.q[:, 0])
"""


def insert(path, before, text):
    """Put text before the last occurrence of a line."""
    head, line, tail = path.read_text().rpartition(before)
    assert line
    path.write_text(head + text + line + tail)


@pytest.fixture(scope='module')
def extended(tmp_path_factory):
    """Return a folder with the package, its scenes and the additions of the page."""
    folder = tmp_path_factory.mktemp('extended')
    for name in ('timo_sim', 'config'):
        shutil.copytree(ROOT / name, folder / name,
                        ignore=shutil.ignore_patterns('__pycache__'))
    package = folder / 'timo_sim'
    insert(package / 'topics/outputs.py', '    ]\n\n\n# Frames', TOPIC)
    insert(package / 'topics/outputs.py', ')\n\n\n_GRAVITY', SENSOR)
    insert(package / 'model/layout.py', ')\nLOADS', INPUT)
    insert(package / 'model/newton.py', '        for n in range(count):\n            force[i]',
           NEWTON)
    insert(package / 'model/newton.py', 'ACCELERATION, ACCELERATION_X,', 'LOADS, ')
    insert(package / 'model/exact_code.py', '    for _ in range(len(tables.gear)):  # 0',
           EXACT)
    insert(package / 'model/exact_code.py', 'PUSH_X, PUSH_Y, SHAFT_FRICTION,', 'LOADS, ')
    (package / 'model/newton_small_speed.py').write_text(FORMULATION)
    insert(package / 'model/__init__.py', '}\n', LINE)
    (package / 'steps/rk4.py').write_text(INTEGRATOR)
    insert(package / 'steps/steps.py', '    return propagator(', METHOD)
    return folder


def python(folder, *arguments):
    """Run Python on the extended package; return what it prints."""
    environment = {name: value for name, value in os.environ.items()
                   if name not in ('_ROS_WHEELS_BOOTSTRAP_COMPLETE', 'LD_LIBRARY_PATH')}
    result = subprocess.run(
        [sys.executable, *arguments], cwd=folder, capture_output=True, text=True,
        env={**environment, 'PYTHONPATH': str(folder)})
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_in_python(extended):
    bias, unlike_exact, name, *numbers = python(extended, '-c', RUN).split()
    assert name == 'torque_N_m' and float(unlike_exact) < 1e-12
    (bias, slope, unlike, large, commanded, prescribed, far, error, size, newton, ours,
     omega, *vibration) = map(float, [bias, *numbers])
    assert bias == pytest.approx(0.5, abs=1e-12) and slope == pytest.approx(1.0, rel=1e-9)
    # The disturbance is another torque, in linear models, commands and scenes.
    assert max(unlike / large, commanded / far, prescribed / far) < 1e-12
    assert error == 0.0 and size > 0.01
    # The omitted terms are theta'^2, some 0.25 / s2, beside omega^2 > 20 / s2: 1 % at most.
    assert ours == pytest.approx(newton, rel=0.01) and ours != newton
    # The integrator: each step of 50 ms multiplies a vibration by the series of exp(i h omega).
    turn = 0.05j * omega
    growth = 1.0 + turn + turn**2 / 2.0 + turn**3 / 6.0 + turn**4 / 24.0
    assert vibration == pytest.approx(0.1 * (growth**np.arange(21)).real, abs=1e-12)


def test_in_the_node_its_log_and_a_table(extended):
    import rclpy  # noqa: F401  # without which there is no node
    python(extended, '-m', 'timo_sim.cli.sim_node', '--ros-args', '--params-file',
           'config/paper.yaml', '-p', 'duration:=0.5', '-p', 'record_file:=run.mcap', '-p',
           'model.modes:=1', '-p', 'model.formulation:=newton_small_speed', '-p',
           'real_time_factor:=0.0', '-p', 'estimate_error:=false', '-p',
           'arm.profile.position:=[0.0, 2.0]', '-p', 'arm.profile.height:=[0.02, 0.02]')
    told = python(extended, '-c', 'from timo_sim.cli import main; [main(line.split(), '
                  'standalone_mode=False) for line in ("replay run.mcap", '
                  '"export run.mcap -o run.csv")]')
    assert 'all are the same to the last bit' in told
    table = np.genfromtxt(extended / 'run.csv', delimiter=',', names=True)
    assert np.array_equal(table['carrier_velocity_x_m_per_s'], table['carrier_x_velocity_m_per_s'])
    assert np.abs(table['carrier_velocity_x_m_per_s']).max() > 0.001
