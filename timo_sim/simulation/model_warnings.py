# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Warnings of runs that should not be trusted: their conditions, and texts with the remedy."""

import math
from typing import Any

import numpy as np

from timo_sim.physics.layout import Motion

# Phase of the first axial vibration in a step with which no tested arm diverged [rad].
_AXIAL_PHASE = 0.5
# Longest step, in periods of a harmonic load; a step sees three values of the load.
_MOST_OF_A_PERIOD = 0.25
# Largest shift of the tip by what `newton`, or an arm without stretch, leaves out [arm lengths].
_MOST_LEFT_OUT = 1e-3
_MOST_APART = 7e-4  # largest distance from a second run, which has errors, too [arm lengths]
NO_SECOND_RUN = ('finer runs of the scene diverge, so that the error of this one is not known: '
                 'take a smaller integrator.step')
# Largest drift of joints with dry friction; largest error of the tip by steps, and by modes.
_MOST_DRIFT = _MOST_ERROR = 3e-4  # [arm lengths]


class DivergenceError(ArithmeticError):
    """
    The state is not finite, or the arm is bent by many lengths; the text has time and remedy.

    Attributes
    ----------
    run : Run or None
        The run so far, if `simulate` has raised the error.

    """

    run: Any = None


def unseen_load(scene):
    """Return the warning of a load that is too fast for the step, or None."""
    frequency, channel = scene.load.fastest()
    if frequency * scene.step <= _MOST_OF_A_PERIOD:
        return None
    return (f'load.{channel}.harmonic.frequency = {frequency:g} Hz is too high for '
            f'integrator.step = {scene.step:g} s: take at most '
            f'{_MOST_OF_A_PERIOD / frequency:.2g} s')


def after_steps(scene, steps, stretch, time, state, load, motions, warning):
    """
    Return the warning of a run after some steps, or None.

    An earlier warning stays, but one of an unstable shaft speed replaces all others, and one of
    stretch gives way to all others.

    Parameters
    ----------
    scene : Scene
    steps : Steps
    stretch : StretchError
    time : float
        Time at the end of the steps [s].
    state : ndarray, shape (m,)
    load : ndarray, shape (14,)
        Both at the end of the steps.
    motions : ndarray, shape (n, 2 (3 + N))
        Samples of the steps.
    warning : str or None
        Warning of the run before the steps.

    """
    if not math.isinf(steps.model.speed_limit):
        motions = np.vstack([motions, steps.motion(state, load)])
        warning = _fast_shaft(scene, steps.model, motions) or warning or _left_out(
            scene, steps.model, time, steps.model.axial_share(state, steps.acting(load)), motions)
    if warning and warning != stretch.told:  # an error by steps matters more than by stretch
        return warning
    errors, length = steps.errors, scene.manipulator.arm.length
    if not errors.tip <= _MOST_ERROR * length:
        return _inaccurate_steps(scene, errors.tip, errors.by_load, time)
    # Steps are too long to resolve events, or to hold a joint still: doc/theory.md, (T44).
    if steps.friction_drift > _MOST_DRIFT * length:
        return _friction_drift(steps, time)
    return _of_model(scene, errors.modes.tip, stretch, time)


def in_lanes(scene, step_error, modes_error, stretch, time, warning):
    """
    Return the warning of a run in lanes after some steps, or None, see `after_steps`.

    `step_error` and `modes_error` are distances of the tip [m].
    """
    if warning and warning != stretch.told:
        return warning
    if not step_error <= _MOST_ERROR * scene.manipulator.arm.length:
        return _inaccurate_steps(scene, step_error, False, time)
    return _of_model(scene, modes_error, stretch, time)


def _of_model(scene, modes_error, stretch, time):
    if not modes_error <= _MOST_ERROR * scene.manipulator.arm.length:
        return _few_modes(scene, modes_error, time)
    if not stretch.told and stretch.tip > _MOST_LEFT_OUT * scene.manipulator.arm.length:
        stretch.told = _stretching(scene, stretch, time)
    return stretch.told


def after_second_run(scene, finer, error, parts, warning):
    """
    Return the warning of a run that was compared with a finer one, or None.

    Parameters
    ----------
    scene, finer : Scene
        Scenes of the run and of the finer one.
    error : float
        Largest distance between the tips of both [m].
    parts : dict of str to float
        Parts of the run's estimated error, named as in `Run.stats`.
    warning : str or None
        Warning of the run alone.

    """
    if error <= _MOST_APART * scene.manipulator.arm.length:
        # What a formulation leaves out may make a motion unstable that both runs do not leave.
        exact = scene.values['model.formulation'] == 'exact'
        return unseen_load(finer) if exact else warning or unseen_load(finer)
    remedies = {'step_error_m': 'a smaller integrator.step', 'modes_error_m': 'more model.modes',
                'stretch_error_m': 'model.axial_modes 1'}
    remedy = remedies[max(remedies, key=lambda name: parts[name])]
    if scene.values['model.formulation'] != 'exact':
        remedy = f'model.formulation exact or {remedy}'
    return warning or f'the tip is {error:.1g} m from that of a finer run: take {remedy}'


def _inaccurate_steps(scene, error, by_load, time):
    cause = remedy = ''
    if by_load:
        cause = ', or vibrations beyond the modes when the load at the tip changed,'
        remedy = ' or more model.modes'
    return (f'by t = {time:.6g} s the steps{cause} have put the tip about '
            f'{error:.1g} m off: take a smaller integrator.step{remedy}')


def _few_modes(scene, error, time):
    return (f'by t = {time:.6g} s what {scene.values["model.modes"]} modes leave out has put the '
            f'tip about {error:.1g} m off: take more model.modes')


def _stretching(scene, stretch, time):
    exact = scene.values['model.formulation'] == 'exact'
    return (f'by t = {time:.6g} s the tip is about {stretch.tip:.1g} m from that of an arm that '
            f'stretches: take {"" if exact else "model.formulation exact with "}'
            'model.axial_modes 1')


def _fast_shaft(scene, model, motions):
    speed = np.abs(Motion(motions).shaft_velocity).max()
    if not speed > model.speed_limit:
        return None
    return (f'at {speed:.3g} rad/s the shaft is faster than {model.speed_limit:.3g} rad/s, where '
            f'the arm loses its stiffness in model.formulation '
            f'{scene.values["model.formulation"]}, which has no centrifugal '
            'stiffening: take model.formulation exact')


def _left_out(scene, model, time, share, motions):
    length = scene.manipulator.arm.length
    deflection = np.abs(Motion(motions).q @ model.tip_point.deflection[:, 0]).max()
    # The axial force makes the arm softer or stiffer; its shortening is of third order in w.
    if (abs(share) * deflection + (1.0 + share) * deflection**3 / length**2
            <= (1.0 + share) * _MOST_LEFT_OUT * length):
        return None
    return (f'before t = {time:.6g} s the tip is bent by {deflection:.2g} m and the axial force '
            f'changes the stiffness of the arm by {round(100.0 * share)} %: model.formulation '
            f'{scene.values["model.formulation"]} leaves out both effects, take '
            'model.formulation exact')


def _friction_drift(steps, time):
    return (f'before t = {time:.6g} s joints that Coulomb friction stops or holds have drifted by '
            f'{steps.friction_drift:.2g} m, as seen at the tip and summed up: take a smaller '
            'integrator.step or fewer model.modes')


def divergence(scene, step, motion, reach, bend, warning):
    """
    Return the text of a DivergenceError.

    Parameters
    ----------
    scene : Scene
    step : int
        Number of the last good step.
    motion : ndarray, shape (2 (3 + N),)
        The motion after it.
    reach : ndarray, shape (3 + N,)
        See `Formulation.reach`.
    bend : float
        Deflection of the arm [m].
    warning : str or None
        Warning of the run so far.

    """
    largest = np.argmax(np.abs(motion[:len(reach)]) * reach)
    name = (['carrier x', 'carrier y', 'shaft angle'] + [
        f'modal coordinate {n + 1}' for n in range(len(reach) - 3)])[largest]
    smaller = 'a smaller integrator.step'
    axial = scene.values['model.axial_modes']
    if axial:
        resolved = _AXIAL_PHASE / scene.build().modes.omega[-axial:].min()
        if scene.step > resolved:
            decade = 10.0**math.floor(math.log10(resolved))
            shorter = max(k for k in (1, 2, 5) if k * decade <= resolved) * decade
            smaller = (f'integrator.step = {shorter:.6g} s or less, which resolves axial '
                       'vibrations, model.axial_modes 0')
    return (f'the state diverges after t = {step * scene.step:.6g} s (step {step}), at {name} = '
            f'{motion[largest]:.3g} with the arm bent by {bend:.3g} m: take {smaller}, '
            'fewer model.modes or model.formulation exact' + (
                f'; {warning}' if warning else ''))
