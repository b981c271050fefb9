# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Warnings of runs that should not be trusted: their conditions, and texts with the remedy."""

from typing import Any

import numpy as np

from timo_sim.model.layout import Motion
from timo_sim.scene.parameters import PARAMETERS
from timo_sim.scene.scene import Scene

# Longest step, in periods of a harmonic load; a step sees three values of the load.
_MOST_OF_A_PERIOD = 0.25
# Largest shift of the tip by what `newton` leaves out, and largest distance from a finer run,
# which has errors, too [arm lengths].
_MOST_LEFT_OUT, MOST_APART = 1e-3, 6e-4
NO_FINER_RUN = ('finer runs of the scene diverge, so that the error of this one is not known: '
                'take a smaller integrator.step')
_SAME_COMMANDS = (
    '. It is that of the same commands: if a controller gives them, run the loop again with half '
    'the integrator.step and one more of model.modes, and compare')


class DivergenceError(ArithmeticError):
    """
    The state is not finite, or the arm is bent by many lengths; the text has time and remedy.

    `run` is the Run so far, if `simulate` has raised the error, else None.
    """

    run: Any = None


def unseen_load(scene: Scene) -> str | None:
    """Return the warning of a load that is too fast for the step, or None."""
    frequency, channel = scene.load.fastest()
    if frequency * scene.step <= _MOST_OF_A_PERIOD:
        return None
    driven = channel.startswith('carrier_') and frequency in scene.values[
        'carrier.drive.harmonic.frequency']
    name = 'carrier.drive' if driven else f'load.{channel}'
    return (f'{name}.harmonic.frequency = {frequency:g} Hz is too high for '
            f'integrator.step = {scene.step:g} s: take at most '
            f'{_MOST_OF_A_PERIOD / frequency:.2g} s')


def after_steps(scene: Scene, model: Any, share: float, time: float,
                motions: np.ndarray) -> str | None:
    """
    Return the warning that some motions of a run call for, or None.

    Only `newton` has conditions of its own: speeds at which it is unstable, and effects that it
    leaves out. `share` is that by which the axial force changes the stiffness, see
    `Formulation.axial_share`; `time` that of the last motion [s]; `motions` has the shape
    (n, 2 (3 + N)).
    """
    formulation = scene.values['model.formulation']
    speed = np.abs(Motion(motions).shaft_velocity).max()
    if speed > model.speed_limit:
        return (f'at {speed:.3g} rad/s the shaft is faster than {model.speed_limit:.3g} rad/s, '
                f'where the arm loses its stiffness in model.formulation {formulation}, which has '
                'no centrifugal stiffening: take model.formulation exact')
    length = scene.manipulator.arm.length
    deflection = np.abs(Motion(motions).q @ model.tip_point.deflection[:, 0]).max()
    # The axial force makes the arm softer or stiffer; its shortening is of third order in w.
    if (abs(share) * deflection + (1.0 + share) * deflection**3 / length**2
            <= (1.0 + share) * _MOST_LEFT_OUT * length):
        return None
    return (f'before t = {time:.6g} s the tip is bent by {deflection:.2g} m and the axial force '
            f'changes the stiffness of the arm by {round(100.0 * share)} %: model.formulation '
            f'{formulation} leaves out the shortening of the bent arm and this change, take '
            'model.formulation exact')


def inaccurate(scene: Scene, error: float, deflection: float,
               remedy: str | None = None, commanded: bool = False) -> str | None:
    """
    Return the warning of a run whose tip is far from that of a finer run, or None.

    `error` and `deflection` are their distances in world and arm frame [m], `remedy` what moves
    the tip most, '' if no change of the scene does; by default all are named. If loads were
    `commanded`, a controller may have chosen them, who would choose others for the finer run.
    """
    limit = MOST_APART * scene.manipulator.arm.length
    if max(error, deflection) <= limit:
        return None
    if remedy is None:
        remedy = 'a smaller integrator.step, more model.modes'
        if scene.manipulator.arm.stretches and (axial := more_axial(scene)):
            remedy += f' or {axial}'
        if scene.values['model.formulation'] != 'exact':
            remedy = f'model.formulation exact, {remedy}'
    return (f'the estimated tip error is {error:.1g} m' if error > limit else
            f'the estimated error of the tip deflection is {deflection:.1g} m, because of the '
            f'shaft angle; that of the tip is {error:.1g} m') + (
        f': take {remedy}' if remedy else ', and no change of step, modes or equations alone '
        'mends that') + _SAME_COMMANDS * commanded


def more_axial(scene: Scene) -> str:
    """Return what gives a scene one more axial mode, '' if it has the most."""
    more = scene.values['model.axial_modes'] + 1
    return f'model.axial_modes {more}' if more <= PARAMETERS['model.axial_modes'].high else ''


def divergence(scene: Scene, model: Any, step: int, motion: np.ndarray,
               warning: str | None) -> str:
    """
    Return the text of a DivergenceError.

    `step` is the number of the last good step, `motion` the motion after it, (2 (3 + N),), of a
    Formulation; `warning` is that of the run so far.
    """
    travel = np.abs(motion[:len(model.tip_travel)]) * model.tip_travel
    bend, largest = np.sum(travel[3:]), np.argmax(travel)
    name = (['carrier x', 'carrier y', 'shaft angle'] + [
        f'modal coordinate {n + 1}' for n in range(len(travel) - 3)])[largest]
    exact = scene.values['model.formulation'] == 'exact'
    return (f'the state diverges after t = {step * scene.step:.6g} s (step {step}), at {name} = '
            f'{motion[largest]:.3g} with the arm bent by {bend:.3g} m: take a smaller '
            'integrator.step, fewer model.modes or ' + (
                'loads that bend it less' if exact else 'model.formulation exact') + (
                f'; {warning}' if warning else ''))
