# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The notebooks of doc/tutorial: their cells in turn, and what they show against closed forms."""

import json
from pathlib import Path
import re

import numpy as np
from oracles.linear_beam import spinning
import pytest
from scipy.linalg import expm
import timo_sim

FOLDER = Path(__file__).resolve().parents[1] / 'doc' / 'tutorial'


def _words(text):
    return re.findall('[A-Za-z_]+', text)


@pytest.fixture
def run_notebook(capsys):
    """Return a function that runs the cells of a notebook and returns its names."""
    plt = pytest.importorskip('matplotlib.pyplot')

    def run(name):
        cells = json.loads((FOLDER / f'{name}.ipynb').read_text())['cells']
        scope = {}
        for cell in cells:
            if cell['cell_type'] == 'code':
                exec(''.join(cell['source']), scope)
                shown = ''.join(text for each in cell['outputs'] for text in each.get('text', ''))
                # `make notebooks` writes the outputs anew; numbers depend on the processor.
                assert _words(shown) == _words(capsys.readouterr().out)
        return scope
    with plt.rc_context({'animation.embed_limit': 0.1}):  # [MB] of frames, for speed
        yield run
    plt.close('all')


def test_an_arm(run_notebook):
    scope = run_notebook('arm')
    assert '<img' in scope['animation'].to_jshtml()
    # Shear and rotary inertia lower the frequencies, the more the shorter the wave.
    lower = 1.0 - scope['modes'].omega / scope['slender']
    assert lower[0] > 0.0 and np.all(np.diff(lower) > 0.0) and lower[-1] < 4e-3
    assert scope['modes'].deflection(scope['xi']) == pytest.approx(scope['shapes'], abs=0.01)
    # The second mode has a thousandth of the deflection.
    assert scope['decrement'] == pytest.approx(scope['expected'], rel=2e-3)
    lowest = [scope[name].deflection(10.0)[:, 1].min() for name in ('exact', 'newton')]
    assert lowest[0] == pytest.approx(-0.5738, abs=2e-4) and lowest[1] < -10.0


def _frequencies(section, shear, rotary, highest):
    """
    Return the frequencies of a clamped bar of 1 m by its transition matrix, up to the highest.

    Of Timoshenko's equations of first order for (w, phi, moment, force), with factors 0 or 1 of
    the compliance in shear and of the rotary inertia.
    """
    def free_end(omega):
        transition = expm(np.array([
            [0.0, 1.0, 0.0, shear / section.shear_stiffness],
            [0.0, 0.0, 1.0 / section.bending_stiffness, 0.0],
            [0.0, -rotary * section.inertia_per_length * omega**2, 0.0, -1.0],
            [-section.mass_per_length * omega**2, 0.0, 0.0, 0.0]]))
        return np.linalg.det(transition[2:, 2:])
    found, grid = [], np.linspace(0.01 * highest, highest, 40)
    value = [free_end(omega) for omega in grid]
    for k in range(len(grid) - 1):
        if value[k] * value[k + 1] < 0.0:
            low, high = grid[k:k + 2]
            for _ in range(25):
                middle = 0.5 * (low + high)
                low, high = ((middle, high) if free_end(middle) * value[k] > 0.0 else
                             (low, middle))
            found.append(low)
    return np.array(found)


def test_four_theories(run_notebook):
    scope = run_notebook('timoshenko')
    for k in (0, 12):
        section = scope['bar'](scope['thickness'][k]).manipulator.arm.section
        slender = scope['slender'](scope['thickness'][k])
        for theory, ratios in scope['ratio'].items():
            found = ratios[k] * slender
            expected = _frequencies(section, theory in ('shear', 'Timoshenko'),
                                    theory in ('Rayleigh', 'Timoshenko'), 1.001 * found[-1])
            # What is left out has a millionth of its effect, which is less than the frequency.
            assert found == pytest.approx(expected, rel=2e-6), theory
    assert scope['fall']['shear'] / scope['fall']['Rayleigh'] == pytest.approx(
        scope['of_moduli'], rel=5e-3)
    assert scope['ours'] == pytest.approx(scope['roots'], rel=1e-10)
    assert scope['ours'] == pytest.approx(
        _frequencies(scope['section'], 1, 1, 1.001 * scope['ours'][-1]), rel=1e-7)
    # The sandwich: Timoshenko, and slender in the other scene.
    for run, omega, kept in zip(scope['runs'].values(), scope['omega'], (1, 0)):
        arm = run.scene.vary({
            'end_effector.mass': 0.0, 'arm.length': 1.0, 'arm.damping_ratio': 0.0,
            'model.static_modes': 'none'})
        found = timo_sim.modes(arm, 0.0).omega
        assert found == pytest.approx(_frequencies(
            arm.manipulator.arm.section, kept, kept, 1.001 * found[-1]), rel=1e-6)
        assert (omega[:len(found)] < found).all()


def test_how_many_modes(run_notebook, reference):
    scope = run_notebook('modes')
    # A thickness of 1/200 changes the eighth share by half a percent.
    assert scope['of_deflection'] == pytest.approx(12 / scope['beta']**4, rel=0.02)
    assert np.abs(scope['of_moment']) == pytest.approx(4 / scope['beta']**2, rel=0.02)
    assert scope['effective'] == pytest.approx(
        4 * scope['sigma']**2 / scope['beta']**2, rel=0.02)
    truth = scope['truth']
    same = slice(len(truth.t))
    assert truth.t == pytest.approx(reference['t'][same], abs=1e-12)
    # Twice the errors of the reference, see `conftest`.
    assert truth.deflection()[:, 1] == pytest.approx(reference['w_l_m'][same], abs=2e-7)
    assert truth.shaft == pytest.approx(reference['theta_rad'][same], abs=1.6e-7)
    assert scope['stated'] == pytest.approx(scope['tip'], rel=0.2)
    assert (np.diff(scope['tip']) < 0.0).all() and scope['tip'][-1] < 1e-6


def test_spinning_arms(run_notebook):
    scope = run_notebook('spinning')
    # Of the table the last digit, of twelve modes the error in doc/modes.md.
    assert scope['across'] == pytest.approx(scope['table'], abs=9e-4)
    rest, speed = scope['table'][0, 0], np.array([*scope['WRIGHT']][1:])
    low, high = (np.sqrt(rest**2 + factor * speed**2) for factor in (1.0, scope['southwell']))
    assert (low < scope['table'][1:, 0]).all() and (scope['table'][1:, 0] < high).all()
    assert scope['southwell'] == pytest.approx(1.193, abs=5e-4)
    found, steady = scope['stiffened'][::8], scope['steady'][::8]
    expected = [spinning(scope['arm'], each, 1)[0] for each in steady]
    assert found == pytest.approx(expected, rel=3e-4)  # of five modes
    depth = {key: -run.deflection()[:, 1].min() for key, run in scope['runs'].items()}
    assert depth[6.0, 'exact'] == pytest.approx(0.5738, abs=2e-4)
    assert depth[6.0, 'newton'] > 10.0 and scope['runs'][6.0, 'newton'].t[-1] < 20.0
    assert depth[3.0, 'newton'] > 1.2 * depth[3.0, 'exact'] > 0.3
