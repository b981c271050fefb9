# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Random scenes for the stress test of the numerics, each drawn from a seed and its number.

Every continuous parameter varies in every scene: sizes by the logarithm, loads and speeds in terms
of the first clamped frequency and of the stiffness at the tip, so that arms of grams and of tons
bend and turn alike. The number of a scene also says which of `KINDS` it is; each 16th round of
kinds has scenes that finite elements can do, too.
"""

import math
from typing import NamedTuple

import numpy as np

import timo_sim

CHANNELS = ('force_x', 'force_y', 'torque', 'tip_force_x', 'tip_force_y', 'tip_torque')
ROUND = 16  # rounds of kinds, of which the first has no damping, friction and initial bend
# Each number is compiled once; others would take minutes and test nothing new.
_MODES, _CORNER_MODES = (3, 5), (0, 1, 8, 12)
_MOST_STEPS = 2000
_HARD_STEPS = 2100, 3200  # least and most
HARD = 'buckling', 'near critical', 'standing', 'resonance', 'far bend', 'long', 'pick-up at rest'
_STANDING = 7.837  # q l^3 / (E I) at which a uniform column buckles under its weight q per length


class Cell(NamedTuple):
    """A scene and how long it runs."""

    number: int
    kind: str
    values: dict
    steps: int
    every: int
    elements: bool  # whether finite elements can do it


class _Draw:
    """Random values and sizes of which a scene is made, after its kind has changed some."""

    def __init__(self, random):
        self.random, self.log = random, lambda low, high: float(
            np.exp(random.uniform(np.log(low), np.log(high))))
        log = self.log
        self.length, self.slenderness, self.young = log(0.1, 10.0), log(10, 300), log(1e8, 4e11)
        self.shear_ratio = log(0.05, 0.5)  # G / E
        self.density, self.aspect = log(500.0, 1e4), log(0.3, 3.0)
        self.tip = [self.maybe(0.8) * log(1e-3, 10.0), self.maybe(0.8) * log(1e-5, 1.0)]
        self.carrier, self.motor, self.shaft = log(1e-2, 1e3), log(1e-2, 10.0), log(1e-3, 10.0)
        self.held, self.joint = 'none', 'free'
        if self.maybe(0.3):
            self.held = self.one('x', 'y', 'both', 'both')
        if self.maybe(0.25):
            self.joint = self.one('locked', 'driven')
        self.formulation = 'exact' if self.maybe(0.8) else 'newton'
        self.modes, self.axial = int(random.choice(_MODES)), int(self.maybe(0.2))
        # Steps in a period of the first clamped mode, and how many periods.
        self.per_period, self.periods = log(30.0, 2000.0), log(1.0, 30.0)
        self.step = self.duration = self.steps = self.every = None
        self.speed = self.maybe(0.7) * self.sign() * log(0.01, 5.0)  # first frequencies
        self.strain = 3e-3  # of a stretched arm, at most
        self.bend = self.maybe(0.4) * log(1e-4, 0.1)  # of the tip at first, in lengths
        self.damping, self.viscous = self.maybe(0.5) * log(1e-4, 0.5), self.maybe(0.4)
        self.coulomb = self.spun_up = False
        self.loads = int(random.integers(1, 4))  # their number, or the kind of one

    def maybe(self, share):
        """Return True with a probability of `share`."""
        return self.random.random() < share

    def one(self, *choices):
        """Return one of some choices."""
        return choices[self.random.integers(len(choices))]

    def sign(self):
        """Return 1 or -1."""
        return self.one(-1.0, 1.0)


def _random(draw):
    """Change nothing: everything varies in all kinds."""


def _knots(draw):
    draw.per_period, draw.loads = draw.log(20.0, 200.0), draw.one('spike', 'jump')
    if draw.maybe(0.3):
        draw.joint, draw.loads = 'driven', 'knots'


def _short(draw):
    draw.steps = round(draw.log(1.0, 200.0))


def _every(draw):
    draw.every = int(draw.one(3, 5, 7, 11, 30, 50, 90, 100, 127, 129, 250, 300, 1000))


def _one_axis(draw):
    draw.held, draw.carrier = draw.one('x', 'y'), draw.log(1e-3, 10.0)
    draw.motor = 0.1 * draw.carrier
    draw.joint = draw.one('free', 'free', 'locked', 'driven')


def _mix(draw):
    draw.held, draw.joint = draw.one('none', 'x', 'y', 'both'), draw.one('locked', 'driven')
    draw.formulation = draw.one('exact', 'newton')


def _newton(draw):
    draw.formulation = 'newton'


def _thin_spin(draw):
    draw.slenderness, draw.length = draw.log(300.0, 1000.0), draw.log(0.5, 3.0)
    draw.young, draw.density = draw.log(1e10, 2e11), draw.log(1e3, 8e3)
    draw.tip = [draw.maybe(0.5) * draw.log(1e-2, 1.0), 0.0]
    draw.joint, draw.loads = 'driven', 1
    draw.speed = [draw.log(10.0, 20.0)]  # rad/s
    draw.step, draw.duration = draw.log(5e-4, 5e-3), draw.log(0.5, 2.0)
    draw.formulation = 'exact'


def _sandwich(draw):
    # Compliance in shear over that in bending, E I / (kappa G A l^2).
    share = draw.log(0.01, 1.0)
    draw.slenderness = draw.log(10.0, 100.0)
    draw.shear_ratio = 1.0 / (12.0 * 0.85 * draw.slenderness**2 * share)


def _stretch(draw):
    draw.formulation, draw.axial, draw.modes = 'exact', draw.one(0, 1), 5
    draw.slenderness, draw.strain = draw.log(4.0, 30.0), draw.log(1e-5, 5e-3)
    draw.speed, draw.periods = draw.sign() * 1e6, draw.log(10.0, 100.0)  # `strain` limits it
    draw.joint, draw.spun_up = 'free', draw.maybe(0.5)


def _heavy_tip(draw):
    draw.tip = [draw.log(10.0, 1e3), draw.log(1.0, 100.0)]


def _resonance(draw):
    draw.loads, draw.periods = 'resonance', draw.log(10.0, 60.0)


def _dry(draw):
    draw.coulomb, draw.formulation, draw.modes, draw.axial = True, 'exact', 3, 0
    draw.held, draw.joint = draw.one('none', 'none', 'both', 'x'), 'free'


def _corner(draw):
    ends = {'slenderness': (4.0, 1000.0), 'carrier': (1e-6, 1e6), 'shaft': (1e-5, 1e3),
            'per_period': (10.0, 3000.0), 'speed': (0.0, 30.0), 'bend': (0.0, 0.3),
            'damping': (0.0, 1.0), 'tip': ([0.0, 0.0], [100.0, 100.0], [100.0, 0.0], [0.0, 100.0])}
    for name, values in ends.items():
        if draw.maybe(0.4):
            setattr(draw, name, draw.one(*values))
    draw.formulation, draw.held, draw.joint, draw.axial = 'exact', 'none', 'free', 0
    draw.modes = int(draw.one(*_CORNER_MODES))


KINDS = [_random, _knots, _short, _random, _every, _one_axis, _thin_spin, _random, _sandwich,
         _stretch, _mix, _random, _heavy_tip, _newton, _resonance, _dry, _corner]


def cell(number, seed=1):
    """Return a Cell: that of a number is the same in every run with the seed."""
    draw = _Draw(np.random.default_rng([seed, number]))
    kind = KINDS[number % len(KINDS)]
    kind(draw)
    elements = number // len(KINDS) % ROUND == 0 and not draw.coulomb and draw.modes > 0
    if elements:
        draw.bend = draw.damping = draw.viscous = 0.0
    if draw.formulation != 'exact':
        draw.modes, draw.axial = 3, 0
    if draw.axial:
        draw.modes = 5  # the one size that is compiled with it
    return _cell(draw, number, kind.__name__[1:].replace('_', ' '), elements)


def _cell(draw, number, kind, elements):
    length, height = draw.length, draw.length / draw.slenderness
    width, shear = height * draw.aspect, draw.young * draw.shear_ratio
    mass, kappa = draw.density * length * width * height, draw.random.uniform(0.5, 1.0)
    stiffness = 1.0 / (length**3 / (3.0 * draw.young * width * height**3 / 12.0)
                       + length / (kappa * shear * width * height))  # at the tip [N/m]
    modal = mass * (0.24 + draw.tip[0] + 2.25 * draw.tip[1])
    omega = np.sqrt(stiffness / modal)  # of the first clamped mode, about [rad/s]
    period = 2.0 * np.pi / omega
    step = float(draw.step or np.clip(period / draw.per_period, 1e-6, 0.02))
    duration = draw.duration or draw.periods * period
    steps = draw.steps or int(np.clip(duration / step, 20, _MOST_STEPS))
    every = draw.every or max(1, steps // 20)
    steps = max(1, steps // every) * every
    values = {
        'model.formulation': draw.formulation, 'model.modes': draw.modes,
        'model.axial_modes': draw.axial, 'integrator.step': step,
        'arm.length': length, 'arm.section.height': height, 'arm.section.width': width,
        'arm.density': draw.density, 'arm.young_modulus': draw.young, 'arm.shear_modulus': shear,
        'arm.section.shear_correction': kappa, 'arm.damping_ratio': [draw.damping],
        'end_effector.mass': mass * draw.tip[0],
        'end_effector.inertia': mass * length**2 * draw.tip[1],
        'carrier.mass': mass * draw.carrier, 'motor.mass': mass * draw.motor,
        'motor.shaft_inertia': mass * length**2 * draw.shaft,
        'carrier.held': draw.held, 'motor.shaft': draw.joint,
        'initial.shaft': draw.random.uniform(-np.pi, np.pi)}
    # A fast arm stretches by about rho (omega l)^2 / (3 E).
    fastest = np.sqrt(3.0 * draw.strain * draw.young / draw.density) / length
    duration = steps * step
    if draw.joint == 'driven':
        values.update(_drive(draw, omega, min(5.0 * omega, fastest), step, duration))
    elif draw.joint == 'free':
        speed = float(np.clip(draw.speed * omega, -fastest, fastest))
        values['initial.shaft_velocity'] = 0.0 if draw.spun_up else speed
        if draw.spun_up:  # by a torque that grows and falls
            inertia = mass * length**2 * (1.0 / 3.0 + draw.shaft + sum(draw.tip))
            values['load.torque.table.time'] = [0.0, 0.3 * duration, 0.6 * duration]
            values['load.torque.table.value'] = [0.0, inertia * speed / (0.3 * duration), 0.0]
    for axis in 'xy':
        if draw.held not in (axis, 'both') and draw.maybe(0.3):
            values[f'initial.carrier_{axis}_velocity'] = (
                draw.sign() * draw.log(1e-2, 3.0) * length / duration)
    if draw.bend and draw.modes:
        values['initial.modal_coordinates'] = [draw.bend * length * np.sqrt(modal)] + (
            draw.modes + draw.axial - 1) * [0.0]
    if draw.viscous:
        values['carrier.viscous_friction'] = draw.log(1e-3, 3.0) * omega * mass
        values['motor.viscous_friction'] = draw.log(1e-3, 3.0) * omega * mass * length**2
    if draw.coulomb:
        for body, inertia, way in (('carrier', mass * (draw.carrier + draw.motor), length),
                                   ('motor', mass * length**2 * draw.shaft, 1.0)):
            limit = draw.log(1e-3, 1.0) * stiffness * length**2 / way
            values[f'{body}.coulomb_friction'] = limit
            # At least what steps resolve for joints without the arm.
            values[f'{body}.coulomb_presliding'] = max(
                1e-4 * way, 6.0 * step**2 * limit / inertia)
    useful = [channel for channel in CHANNELS if channel.startswith('tip') or (
        draw.joint == 'free' and not draw.spun_up if channel == 'torque' else
        draw.held not in ('both', channel[-1]))]
    count = draw.loads if isinstance(draw.loads, int) else 1
    for channel in draw.random.choice(useful, min(count, len(useful)), replace=False):
        form = draw.loads if isinstance(draw.loads, str) else draw.one(
            'harmonic', 'piecewise', 'table')
        if form != 'knots':
            values.update(_load(draw, form, channel, values, omega, stiffness * length, steps))
    return Cell(number, kind, values, steps, every, elements)


def _drive(draw, omega, fastest, step, duration):
    # From rest to a speed, or, for 'knots', a turn by up to 0.1 rad within 0.2 to 3 steps.
    if draw.loads == 'knots':
        begin = (draw.random.integers(1, 10) + draw.random.random()) * step
        times, angles, speeds = [0.0, begin, begin + draw.random.uniform(0.2, 3.0) * step], [
            0.0, 0.0, draw.log(1e-3, 0.1)], 3 * [0.0]
    else:
        speed = draw.speed[0] if isinstance(draw.speed, list) else np.clip(
            draw.speed * omega, -fastest, fastest)
        end = draw.random.uniform(0.3, 1.0) * duration
        times, angles, speeds = [0.0, end], [0.0, 0.5 * speed * end], [0.0, speed]
    return {f'motor.drive.{name}': list(map(float, numbers)) for name, numbers in (
        ('time', times), ('angle', angles), ('speed', speeds),
        ('acceleration', len(times) * [0.0]))}


def _load(draw, form, channel, values, omega, force, steps):
    """Return the values of a load that would bend the arm by 0.001 to 0.3 of its length."""
    step, random = values['integrator.step'], draw.random
    size = draw.sign() * draw.log(1e-3, 0.3) * force * (
        values['arm.length'] if 'torque' in channel else 1.0)
    prefix = f'load.{channel}'
    if form in ('harmonic', 'resonance'):
        frequency = draw.log(0.05, 10.0) * omega / (2.0 * np.pi)
        if form == 'resonance':
            found = np.linalg.eigvals(timo_sim.load_scene(values).build().linear).imag
            found = np.sort(found[found > 0.1 * omega])
            if len(found):
                number = random.integers(min(3, len(found)))
                frequency = found[number] * draw.one(1.0, 1.05) / (2.0 * np.pi)
            size *= 0.1
        return {f'{prefix}.harmonic.{what}': [float(number)] for what, number in (
            ('amplitude', size), ('frequency', frequency),
            ('phase', random.uniform(0.0, 2.0 * np.pi)))}
    begin = random.uniform(0.0, 0.8) * steps * step
    if form == 'jump':  # at a step boundary, or beside it by more or less than what rounds to it
        begin = (1 + random.integers(max(1, steps // 2))) * step
        begin += draw.sign() * draw.one(0.0, 2e-12 * begin, 1e-10 * step, 4e-8 * step)
    length = draw.log(0.02, 2.0) * 2.0 * np.pi / omega
    if form == 'spike':  # within a step
        length = draw.log(0.01, 2.0) * step
        size *= 1.0 / (omega * step)
    if form == 'piecewise':
        first, count = round(begin / step), max(1, round(length / step))
        return {f'{prefix}.piecewise.time': [first * step, (first + count) * step],
                f'{prefix}.piecewise.value': [size, draw.one(0.0, -0.5 * size)]}
    times, sizes = [begin, begin + 0.4 * length, begin + length], [0.0, size, 0.0]
    if form == 'jump':
        times, sizes = [0.0, begin, begin, begin + length], [0.0, 0.0, size, 0.0]
    return {f'{prefix}.table.time': list(map(float, times)), f'{prefix}.table.value': sizes}


def laden_cell(number, seed=1):
    """Return the Cell of a number in gravity, whose load at the tip changes, or one of both."""
    given = cell(number, seed)
    random, values = np.random.default_rng([seed, 2, number]), dict(given.values)
    length, mass = values['arm.length'], values['arm.density'] * math.prod(
        values[f'arm.{side}'] for side in ('length', 'section.width', 'section.height'))

    def log(low, high):
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    kind = random.choice(['gravity', 'payload', 'both'])
    if kind != 'payload':
        # By its weight the clamped arm sags by 1e-3 to 0.3 lengths.
        first = timo_sim.load_scene({}, {**values, 'model.modes': 3, 'model.axial_modes': 0,
                                         'initial.modal_coordinates': []}).build().modes.omega[0]
        angle, strength = random.uniform(-np.pi, np.pi), 0.7 * log(1e-3, 0.3) * length * first**2
        values['gravity'] = [strength * np.cos(angle), strength * np.sin(angle)]
    if kind != 'gravity':
        count = int(random.integers(1, 3))
        steps = np.sort(random.choice(given.steps, min(count, given.steps), replace=False)) + 1
        values['payload.time'] = (steps * values['integrator.step']).tolist()
        values['payload.mass'] = [mass * log(1e-2, 10.0) for _ in steps]
        values['payload.inertia'] = [mass * length**2 * log(1e-4, 1.0) for _ in steps]
        values['end_effector.pick_up'] = random.choice(['moving', 'moving', 'at_rest']).item()
    return given._replace(kind=f'{given.kind}, {kind}', values=values, elements=False)


def hard_cell(number, seed=1):
    """
    Return a Cell of more than 2048 steps in which errors grow.

    The arm buckles, stands or is pressed near its critical load, vibrates in resonance, bends by
    half its length, or picks up loads at rest; others are ordinary scenes that run long.
    """
    random, kind = np.random.default_rng([seed, 2, number]), HARD[number % len(HARD)]
    base = cell(17 * number + (14 if kind == 'resonance' else 0), seed)  # 14: kind resonance
    values = {name: value for name, value in base.values.items()
              if kind in ('long', 'resonance') or not name.startswith(
                  ('load.', 'motor.drive', 'initial.'))}
    steps = int(random.integers(*_HARD_STEPS)) // 20 * 20
    values.update({'model.formulation': 'exact', 'model.modes': int(random.choice([3, 5])),
                   'model.axial_modes': 0})
    if kind in ('long', 'resonance'):
        values.pop('initial.modal_coordinates', None)
        return Cell(number, kind, values, steps, steps // 20, False)
    length, height = values['arm.length'], values['arm.section.height']
    area = height * values['arm.section.width']
    stiffness = values['arm.young_modulus'] * area * height**2 / 12.0
    mass = values['arm.density'] * area * length
    omega = np.sqrt(3.0 * stiffness / length**3 / (0.24 * mass + values['end_effector.mass']))
    step = float(np.clip(2.0 * np.pi / omega * random.uniform(2.0, 8.0) / steps, 1e-6, 0.02))
    end = steps * step
    values.update({'integrator.step': step, 'carrier.held': str(random.choice(['both', 'y'])),
                   'motor.shaft': 'locked', 'initial.shaft': 0.0})
    critical = np.pi**2 * stiffness / (4.0 * length**2)
    push = float(np.exp(random.uniform(np.log(1e-5), np.log(1e-2)))) * stiffness / length**2
    across = {'load.tip_force_y.piecewise.time': [0.0], 'load.tip_force_y.piecewise.value': [push]}
    if kind in ('buckling', 'near critical'):
        share = random.uniform(1.02, 1.6) if kind == 'buckling' else random.uniform(0.9, 0.995)
        values.update({**across, 'load.tip_force_x.table.time': [0.0, 0.3 * end],
                       'load.tip_force_x.table.value': [0.0, float(-share * critical)]})
    elif kind == 'standing':
        values.update({**across, 'initial.shaft': np.pi / 2.0, 'carrier.held': 'both'})
        values['load.tip_force_x.piecewise.time'] = values.pop('load.tip_force_y.piecewise.time')
        values['load.tip_force_x.piecewise.value'] = values.pop('load.tip_force_y.piecewise.value')
        tip = values['end_effector.mass'] = mass * random.uniform(0.0, 2.0)
        limit = stiffness / length**2 / (mass / _STANDING + tip / (np.pi**2 / 4.0))
        values['gravity'] = [0.0, float(-random.uniform(0.8, 1.1) * limit)]
    elif kind == 'far bend':
        size = random.uniform(1.5, 6.0) * stiffness / length**2
        values.update({'load.tip_force_y.table.time': [0.0, 0.5 * end],
                       'load.tip_force_y.table.value': [0.0, float(size)]})
    else:
        values.update({
            'carrier.held': 'both', 'motor.shaft': 'free', 'initial.shaft': -0.6,
            'end_effector.mass': 0.3 * mass, 'end_effector.inertia': 0.02 * mass * length**2,
            'motor.shaft_inertia': mass * length**2, 'end_effector.pick_up': 'at_rest',
            'payload.time': [steps // 4 * step, steps // 2 * step],
            'payload.mass': [mass * random.uniform(0.5, 2.0), 0.3 * mass],
            'payload.inertia': [0.1 * mass * length**2, 0.02 * mass * length**2],
            'load.torque.piecewise.time': [0.0],
            'load.torque.piecewise.value': [random.uniform(0.05, 0.5) * stiffness / length]})
    return Cell(number, kind, {name: np.asarray(value).tolist() for name, value in values.items()},
                steps, steps // 20, False)
