"""When a run is not to be trusted: what is looked at, and the text that says what to do."""

import math

import numpy as np

from timo_sim.step_control import FINEST

# Part of the period of a harmonic load that a step may cover: its three values then are the load.
_MOST_OF_A_PERIOD = 0.25
# How far joints may go astray in steps with dry friction, in arm lengths.
_ASTRAY = 3e-4


def _now(simulator):
    return f't = {simulator.steps * simulator.scene.step:.6g} s'


def unseen_load(scene):
    """Return what to say of a load that is too fast for the step, or None."""
    frequency, channel = scene.load.fastest()
    if frequency * scene.step <= _MOST_OF_A_PERIOD:
        return None
    return (f'load.{channel}.harmonic.frequency = {frequency:g} Hz is too high for '
            f'integrator.step = {scene.step:g} s: take at most '
            f'{_MOST_OF_A_PERIOD / frequency:.2g} s')


def wrong_step(simulator, error):
    """Return what to say of a step whose estimated error [m] is alarming."""
    remedy = '' if simulator.scene.friction.any() else (
        ', or let it be split by an integrator.tolerance')
    return (f'at {_now(simulator)} a step is wrong by about {error:.1g} m at the tip: take a '
            f'smaller integrator.step{remedy}')


def after_steps(simulator, motions):
    """
    Return what to say of a simulator after some steps, or None.

    Parameters
    ----------
    simulator : Simulator
    motions : ndarray, shape (k, 2 (3 + N))
        Samples of these steps.

    """
    return (_fast_shaft(simulator, motions) or _coarse_steps(simulator)
            or _astray(simulator))


def _fast_shaft(simulator, motions):
    formulation, name = simulator.formulation, simulator.scene.values['model.formulation']
    limit, column = formulation.speed_limit, formulation.size // 2 + 2
    if math.isinf(limit):
        return None
    speed = max(abs(simulator.motion()[column]), np.abs(motions[:, column]).max(initial=0.0))
    if speed <= limit:
        return None
    return (f'at {speed:.3g} rad/s the shaft is faster than {limit:.3g} rad/s, where the arm '
            f'loses its stiffness in model.formulation {name}, which has no centrifugal '
            'stiffening: take model.formulation exact')


def _coarse_steps(simulator):
    control = simulator.control
    if not control.coarse:
        return None
    return ('the error of a step was above integrator.tolerance = '
            f'{control.tolerance:g} m when done in {2**(FINEST + 1)} parts, too, before '
            f'{_now(simulator)}: take a smaller integrator.step or fewer model.modes')


def _astray(simulator):
    # Steps are too long for events in them, or to hold a joint still: doc/theory.md, (T35).
    if simulator.astray <= _ASTRAY * simulator.scene.manipulator.arm.length:
        return None
    return (f'before {_now(simulator)} joints that Coulomb friction stops or holds have gone '
            f'{simulator.astray:.2g} m astray, as seen at the tip and summed up: take a smaller '
            'integrator.step or fewer model.modes')


def divergence(simulator, bent):
    """Return where a state with the arm bent by so much [m] diverges, and what to do."""
    motion, reach = simulator.motion(), simulator.formulation.reach
    largest = np.argmax(np.abs(motion[:len(reach)]) * reach)
    name = (['carrier x', 'carrier y', 'shaft angle'] + [
        f'modal coordinate {n + 1}' for n in range(len(reach) - 3)])[largest]
    splitting = '' if simulator.scene.friction.any() else ' an integrator.tolerance,'
    return (f'the state diverges after {_now(simulator)} (step {simulator.steps}), at {name} = '
            f'{motion[largest]:.3g} with the arm bent by {bent:.3g} m: take a smaller '
            f'integrator.step,{splitting} fewer model.modes or model.formulation exact' + (
                f'; {simulator.caution}' if simulator.caution else ''))
