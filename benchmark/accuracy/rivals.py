# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
What else a user might take for this manipulator, each in its own way.

MuJoCo as a chain of hinged links and as one of its rods, and two libraries of elastic rods,
PyElastica and dismech-newton, for an arm on a held carrier. Both know the angle of an element in
its middle only. So the first element has its middle at the root: half of it is outside the arm,
and `elements` - 1/2 of them are the arm. That leaves errors of second order; to clamp an element
that starts at the root, errors of first order.

`chain`, `rod`, `elastica` and `dismech` take a scene, which is at rest and straight at first, the
number of parts or elements, step and duration [s], the number of steps from sample to sample, and
theta(t) of a driven shaft with its derivatives, theta(0) = 0. They return the CPU time of the
steps [s], and at the samples after the start theta, the carrier's position, and the place of the
tip along and across the shaft, shapes (n,), (n, 2), (n,), (n,). Each imports its own library.
"""

import math
import time

import numpy as np
from numpy.polynomial.legendre import leggauss, legval
from scipy import optimize
from scipy.linalg import eigvalsh

from oracles.references import world
from timo_sim import load_scene
from timo_sim.model.layout import END, FORCE_X, FORCE_Y, MIDDLE, START, TORQUE

_CHANNELS = [FORCE_X, FORCE_Y, TORQUE]
_NUMBERS = 2**22  # that a call of `rollout` returns
_DRIVEN = 1e9  # inertia that makes a shaft follow its drive, whatever the arm does [kg m2]


class Links:
    """
    The constants of a chain: links one after the other, with a spring between neighbours.

    Parameters
    ----------
    scene : Scene
    lengths : sequence of float
        Of the links [m]: the first turns with the shaft, the last carries the end effector.
    springs : sequence of float
        Between neighbours [N m/rad].
    lumped : bool
        The mass of a link between two others is at its ends.

    """

    def __init__(self, scene, lengths, springs, lumped=False):
        body, section = scene.manipulator, scene.manipulator.arm.section
        self.scene, self.lengths, self.springs = scene, np.array(lengths), np.array(springs)
        self.each = np.arange(len(lengths))
        self.rods, self.tip_mass = section.mass_per_length * self.lengths, body.end_effector_mass
        # From the carrier to the middle of each link and to the tip, link by link.
        arms = np.tril(np.tile(self.lengths, (len(lengths) + 1, 1)))
        arms[self.each, self.each] *= 0.5
        mass = np.append(self.rods, self.tip_mass)
        self.inertia = (section.inertia_per_length * self.lengths
                        + self.rods * self.lengths**2 / 12.0)
        if lumped:
            self.inertia[1:-1] = self.rods[1:-1] * self.lengths[1:-1]**2 / 4.0
        self.inertia[0] += body.shaft_inertia
        self.inertia[-1] += body.end_effector_inertia
        self.total = mass.sum() + body.base_mass
        self.first = mass @ arms
        self.second = arms.T @ (mass[:, np.newaxis] * arms) + np.diag(self.inertia)
        difference = np.diff(np.eye(len(lengths)), axis=0)
        self.stiffness = difference.T @ np.diag(self.springs) @ difference

    def frequencies(self):
        """Return the angular frequencies of the straight arm in bending [rad/s]."""
        angle = self.scene.values['initial.shaft']
        across = np.array([-math.sin(angle), math.cos(angle)])[self.scene.constraints.free_axes]
        mass = self.second - across @ across / self.total * np.outer(self.first, self.first)
        fixed = self.scene.values['motor.shaft'] != 'free'
        square = eigvalsh(self.stiffness[fixed:, fixed:], mass[fixed:, fixed:])
        return np.sqrt(square[not fixed:])


def chain_of(scene, count, gauss=True, matched=None, lumped=False):
    """
    Return the Links of an arm with `count` hinges.

    Parameters
    ----------
    scene : Scene
    count : int
    gauss : bool
        The hinges are at the points of Gauss's quadrature and as compliant as their weights say,
        so that forces on the end deflect it as they do an arm; else in the middles of equal parts.
    matched : int, optional
        How many frequencies are those of the arm, which an engineer measures: factors of the
        springs, a polynomial along the arm, see to it. 1 for Gauss's points, or if `lumped`,
        else 2, which had the least errors.
    lumped : bool
        As for `Links`.

    """
    arm = scene.manipulator.arm
    points, weights = leggauss(count) if gauss else (
        (2.0 * np.arange(count) + 1.0) / count - 1.0, np.full(count, 2.0 / count))
    lengths = 0.5 * arm.length * np.diff([-1.0, *points, 1.0])
    springs = arm.section.bending_stiffness / (0.5 * arm.length * weights)
    matched = (1 if gauss or lumped else 2) if matched is None else matched

    def chain(factors):
        return Links(scene, lengths, springs * (1.0 + legval(points, factors)), lumped)

    key = tuple(scene.values.items()), count, gauss, matched, lumped
    if key not in _FACTORS:
        _FACTORS[key] = _matching(scene, chain, matched) if matched else np.zeros(1)
    return chain(_FACTORS[key])


# Factors of springs by what `chain_of` is given: an engineer finds them once for an arm.
_FACTORS: dict = {}


def _matching(scene, chain, matched):
    # The factors for which a function of them gives a chain with the arm's first frequencies.
    model = load_scene({**scene.values, 'model.formulation': 'exact', 'model.modes': 6}).build()
    found = np.sort(np.abs(np.linalg.eigvals(model.linear).imag))  # pairs, and 0 of free motion
    true = found[found > 1e-3][:2 * matched:2]
    return optimize.root(
        lambda factors: (chain(factors).frequencies()[:matched] / true)**2 - 1.0,
        np.zeros(matched), tol=1e-12).x


def longest_step(scene, count, gauss=True, axial_factor=None):
    """Return the longest stable Runge-Kutta step [s] of `chain`, or of `rod` with its factor."""
    highest = chain_of(scene, count, gauss, lumped=axial_factor is not None).frequencies()[-1]
    if axial_factor:
        arm = scene.manipulator.arm
        highest = max(highest, 2.0 * count / arm.length * math.sqrt(
            axial_factor * arm.section.axial_stiffness / arm.section.mass_per_length))
    return 2.8 / highest


def chain(scene, links, step, duration, every, drive=None, gauss=True):
    """
    Simulate a scene by MuJoCo, as a chain of rigid links whose hinges have springs.

    They are those of `chain_of`; hinges know no shear and no stretch. Runge-Kutta steps,
    because the implicit integrators of MuJoCo are of first order and damp.
    """
    arm = chain_of(scene, links, gauss)
    seconds, carrier, turn, bent = _roll_out(
        scene, chain_model(arm, step, bool(drive)), step, duration, every, drive)
    turned = np.cumsum(np.column_stack([np.zeros(len(bent)), bent]), axis=1)
    return (seconds, turn + scene.values['initial.shaft'], carrier, np.cos(turned) @ arm.lengths,
            np.sin(turned) @ arm.lengths)


def rod(scene, parts, step, duration, every, drive=None, axial_factor=0.01, integrator='RK4'):
    """
    Simulate a scene by a rod of MuJoCo 4, a flex of dimension 1 with elasticity.

    It is a discrete elastic rod without rotary inertia and shear, whose mass is at its vertices.
    They are where `chain` has its hinges; the first edge is fixed to the shaft, the last one to
    the end effector. It bends as its section, times the factor of the first frequency.

    The edges have `axial_factor` times E A in Runge-Kutta steps, in those of the integrator
    'discrete', which is of first order, a constraint in place of it.
    """
    arm = chain_of(scene, parts, gauss=False, lumped=True)
    seconds, carrier, turn, moved = _roll_out(
        scene, rod_model(arm, step, bool(drive), axial_factor, integrator), step, duration, every,
        drive)
    start, length = scene.values['initial.shaft'], scene.manipulator.arm.length
    tip = moved[:, -3:-1] - carrier + length * np.array([math.cos(start), math.sin(start)])
    return seconds, start + turn, carrier, *world(-start - turn, 0.0, *tip.T).T


def _roll_out(scene, model, step, duration, every, drive):
    # Seconds, and at the samples the carrier's place, the shaft's turn and the other coordinates.
    import mujoco
    from mujoco import rollout

    count, axes = round(duration / step), len(scene.constraints.free_axes)
    loads = scene.load.stages(0, count, step)[:, :, _CHANNELS]
    loads = (loads[:, START] + 4.0 * loads[:, MIDDLE] + loads[:, END]) / 6.0
    loads = loads[:, 2 - axes:2 - axes + model.nu]
    if drive:
        middle = (np.arange(count) + 0.5) * step
        loads = _DRIVEN * np.array([[drive[2](t)] for t in middle])
    data = mujoco.MjData(model)
    state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    kept, seconds, part = [], 0.0, every * max(1, _NUMBERS // (every * len(state)))
    for first in range(0, count, part):
        begun = time.process_time()
        found, _ = rollout.rollout(model, data, state[np.newaxis],
                                   loads[np.newaxis, first:first + part])
        seconds += time.process_time() - begun
        kept.append(found[0, every - 1::every, 1:1 + model.nq])
        state = found[0, -1]
    position = np.concatenate(kept)
    nothing = np.zeros((len(position), 2))
    return (seconds, position[:, :2] if axes else nothing,
            position[:, axes] if model.nu > axes else nothing[:, 0], position[:, model.nu:])


def chain_model(arm, step, driven=False):
    """Return MuJoCo's model of `links.Links`."""
    inner, half = '', 0.5 * arm.lengths
    for link in reversed(arm.each[1:]):
        last = link == arm.each[-1]
        inner = (f'<body pos="{_numbers(arm.lengths[link - 1], 0, 0)}"><joint type="hinge" '
                 f'axis="0 0 1" stiffness="{_numbers(arm.springs[link - 1])}"/>'
                 + _inertial((arm.rods[link], arm.inertia[link], half[link]),
                             (last * arm.tip_mass, 0.0, arm.lengths[link])) + inner + '</body>')
    root = _inertial((arm.rods[0], arm.inertia[0], half[0]))
    return _model(arm.scene, step, driven, root, inner)


def rod_model(arm, step, driven=False, axial_factor=1.0, integrator='discrete'):
    """Return MuJoCo's model of `rod`, made of `links.Links`."""
    scene, section, part = arm.scene, arm.scene.manipulator.arm.section, arm.lengths[1]
    start, half, lump = scene.values['initial.shaft'], 0.5 * arm.lengths[0], 0.5 * arm.rods[1]
    along = np.array([math.cos(start), math.sin(start), 0.0])
    slides = '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
    bodies = ''.join(
        f'<body name="v{link}" pos="{_numbers(*(arm.lengths[:link].sum() * along))}">{slides}'
        + _inertial((2.0 * lump, 1e-9, 0.0)) + '</body>' for link in arm.each[2:-1])
    tip = _inertial((arm.rods[-1], arm.inertia[-1], -half), (lump, 0.0, -2.0 * half),
                    (arm.tip_mass, 0.0, 0.0), along=along)
    length = scene.manipulator.arm.length
    bodies += (f'<body name="tip" pos="{_numbers(*(length * along))}">{slides}'
               f'<joint type="hinge" axis="0 0 1"/>{tip}</body>')
    root = _inertial((arm.rods[0], arm.inertia[0], half), (lump, 0.0, 2.0 * half), along=along)
    names = ['shaft'] * 2 + [f'v{link}' for link in arm.each[2:-1]] + ['tip'] * 2
    places = [-0.5 * part * along, 0.5 * part * along]
    places = [*places, *[np.zeros(3)] * (len(names) - 4), *places]
    # A round section with the bending stiffness of the springs, of any radius.
    young = arm.springs[0] * part / (math.pi / 4.0)
    edges = ''.join(f'{edge} {edge + 1} ' for edge in range(len(names) - 1))
    explicit = integrator == 'RK4'
    stretch = axial_factor * section.axial_stiffness / part
    flex = (f'<deformable><flex name="rod" dim="1" radius="1" body="{" ".join(names)}" vertex="'
            f'{_numbers(*np.concatenate(places))}" element="{edges}">'
            '<contact contype="0" conaffinity="0" selfcollide="none"/>'
            + f'<edge stiffness="{_numbers(stretch)}"/>' * explicit
            + f'<elasticity young="{_numbers(young)}"/></flex></deformable>'
            + '<equality><flex flex="rod" solref="0.0001 1"/></equality>' * (not explicit))
    return _model(scene, step, driven, root, '', bodies, flex, integrator)


def _model(scene, step, driven, root, arm, bodies='', more='', integrator='RK4'):
    # `root` and `arm` are on the shaft, `bodies` in the world.
    import mujoco

    mujoco.set_mju_user_warning(lambda text: None)  # of steps that diverge, in a file
    joints = {name: f'<joint name="{name}" type="slide" axis="{axis}"/>' for name, axis in zip(
        'xy', ('1 0 0', '0 1 0'))} if len(scene.constraints.free_axes) else {}
    slides, turn = ''.join(joints.values()), 0.0 if bodies else scene.values['initial.shaft']
    shaft = ''
    if driven or scene.values['motor.shaft'] != 'locked':
        joints['shaft'] = shaft = ('<joint name="shaft" type="hinge" axis="0 0 1" '
                                   f'armature="{_DRIVEN * driven!r}"/>')
    motors = ''.join(f'<motor joint="{name}"/>' for name in joints)
    return mujoco.MjModel.from_xml_string(f"""<mujoco><compiler angle="radian"/>
<option timestep="{step!r}" integrator="{integrator}" tolerance="1e-10"
gravity="{_numbers(*scene.values['gravity'], 0)}">
<flag contact="disable" autoreset="disable" energy="disable"/></option>
<worldbody><body>{slides}{_inertial((scene.manipulator.base_mass, 1.0, 0.0))}
<body name="shaft" euler="0 0 {turn!r}">{shaft}{root}{arm}</body></body>{bodies}</worldbody>{more}
<actuator>{motors}</actuator></mujoco>""")


def _inertial(*parts, along=(1.0, 0.0, 0.0)):
    # Of parts: mass, inertia about its own middle, and place of the middle.
    mass, inertia, place = np.array(parts, dtype=float).T
    middle = mass @ place / mass.sum()
    inertia = inertia.sum() + mass @ (place - middle)**2
    return (f'<inertial pos="{_numbers(*(middle * np.array(along)))}" mass="'
            f'{_numbers(mass.sum())}" diaginertia="{_numbers(inertia, inertia, inertia)}"/>')


def _numbers(*values):
    return ' '.join(repr(float(value)) for value in values)


def longest_step_of_rod(scene, elements, axial_factor=1.0, inertia_factor=1.0):
    """
    Return the longest stable step of `elastica` [s]: 2 over its highest frequency.

    Of neighbours that move against each other, along or across; with shear and rotary inertia the
    latter have a high frequency on any mesh. Measured: it is stable at 1.00 times this, not
    at 1.02. Parameters are those of `elastica`.
    """
    section, part = scene.manipulator.arm.section, scene.manipulator.arm.length / (elements - 0.5)
    mass, inertia = section.mass_per_length, inertia_factor * section.inertia_per_length
    across = 4.0 * section.shear_stiffness / (mass * part**2)
    bend = 4.0 * section.bending_stiffness / (inertia * part**2)
    total = across + bend + section.shear_stiffness / inertia
    across = 0.5 * (total + math.sqrt(total**2 - 4.0 * across * bend))
    along = 4.0 * axial_factor * section.axial_stiffness / (mass * part**2)
    return 2.0 / math.sqrt(max(along, across))


def elastica(scene, elements, step, duration, every, drive=None, axial_factor=1.0,
             inertia_factor=1.0, tip_force=None, damping=None):
    """
    Simulate a scene by PyElastica, as a Cosserat rod of second order in explicit steps.

    Bending, shear, stretch, in three dimensions of which the arm uses two. A longer
    step needs more rotary inertia, which is small against the mass.

    `axial_factor` and `inertia_factor` multiply E A and rho I of the section. For the authors'
    example there are a force on the tip along y [N] and damping [1/s].
    """
    import elastica as library

    angle, speed = _checked(scene, drive)
    section, part = scene.manipulator.arm.section, scene.manipulator.arm.length / (elements - 0.5)
    along = np.array([math.cos(angle(0.0)), math.sin(angle(0.0)), 0.0])
    rod = library.CosseratRod.straight_rod(
        elements, -0.5 * part * along, along, np.array([0.0, 0.0, 1.0]), elements * part,
        base_radius=math.sqrt(section.area / math.pi), density=section.density,
        youngs_modulus=section.young_modulus, shear_modulus=section.shear_modulus)
    # Of a round section so far. Director 0 is z, about which the arm bends.
    each = np.eye(3)[:, :, np.newaxis]
    inertia = inertia_factor * section.inertia_per_length * part
    rod.mass_second_moment_of_inertia[:] = inertia * each
    rod.inv_mass_second_moment_of_inertia[:] = each / inertia
    rod.bend_matrix[:] = section.bending_stiffness * each
    rod.shear_matrix[:] = np.diag([section.shear_stiffness, section.shear_stiffness,
                                   axial_factor * section.axial_stiffness])[:, :, np.newaxis]
    rod.shear_matrix[:, :, 0] *= 2.0  # half an element

    class Root(library.ConstraintBase):
        # Of node 0 and of the directors of element 0.

        def constrain_values(self, system, time):
            cosine, sine = math.cos(angle(time)), math.sin(angle(time))
            place, director = system.position_collection, system.director_collection
            place[0, 0], place[1, 0] = -0.5 * part * cosine, -0.5 * part * sine
            director[1, 0, 0], director[1, 1, 0] = sine, -cosine
            director[2, 0, 0], director[2, 1, 0] = cosine, sine

        def constrain_rates(self, system, time):
            turn, rate = angle(time), system.velocity_collection
            system.omega_collection[0, 0] = spin = speed(time)
            rate[0, 0] = 0.5 * part * spin * math.sin(turn)
            rate[1, 0] = -0.5 * part * spin * math.cos(turn)

    class Rods(library.BaseSystemCollection, library.Constraints, library.Forcing,
               library.Damping):
        pass

    system, stepper, tips = Rods(), library.PositionVerlet(), []
    system.append(rod)
    system.constrain(rod).using(Root)
    if any(scene.values['gravity']):
        system.add_forcing_to(rod).using(
            library.GravityForces, acc_gravity=np.array([*scene.values['gravity'], 0.0]))
    if tip_force:
        system.add_forcing_to(rod).using(
            library.EndpointForces, np.zeros(3), np.array([0.0, tip_force, 0.0]), 1e-9)
    if damping:
        system.dampen(rod).using(library.AnalyticalLinearDamper,
                                 uniform_damping_constant=damping, time_step=step)
    system.finalize()
    stepper.step(system, 0.0, 1e-30)  # compiles
    begun = time.process_time()
    for sample in range(round(duration / step) // every):
        now = sample * every * step
        for _ in range(every):
            now = stepper.step(system, now, step)
        tips.append(rod.position_collection[:2, -1].copy())
    seconds = time.process_time() - begun
    return (seconds, *_found(tips, every * step, angle))


def dismech(scene, elements, step, duration, every, drive=None, axial_factor=1.0, iterations=2,
            linesearch=2):
    """
    Simulate a scene by dismech-newton, as a discrete elastic rod in implicit midpoint steps.

    It bends and stretches, without shear and without rotary inertia; it computes in single
    precision. `exact` steps, by Gauss-Newton: others pump energy into an arm without
    damping. Its line search may stop at rounding, so iterations are a fixed number.

    What it returns is not finite after a step that fails. `linesearch` is how many step lengths
    are tried in an iteration.
    """
    import warp
    _allow_optional_structs(warp)
    import dismech_newton as library
    import newton

    angle, _ = _checked(scene, drive)
    section, part = scene.manipulator.arm.section, scene.manipulator.arm.length / (elements - 0.5)
    along = np.array([math.cos(angle(0.0)), math.sin(angle(0.0)), 0.0])
    builder = newton.ModelBuilder(gravity=(*map(float, scene.values['gravity']), 0.0))
    radius = math.sqrt(section.area / math.pi)
    rod = newton.Rod(part * (np.arange(elements + 1) - 0.5)[:, np.newaxis] * along, radius=radius)
    edges = library.add_rod(
        builder, rod, cfg=newton.ModelBuilder.ShapeConfig(density=section.density), proxies=False,
        stretch_stiffness=axial_factor * section.axial_stiffness / part,
        bend_stiffness=section.bending_stiffness / part)
    library.fix_segment(builder, edge=edges[0])
    model = builder.finalize(device='cpu')
    solver = library.DiSMechSolver(model, theta=0.5, exact=True, iterations=iterations,
                                   linesearch=linesearch, self_contact=False)
    states, tips = [model.state() for _ in range(3)], []
    for state in states:
        library.flatten_state(state)
    solver.step(states[2], states[1], None, None, step)  # compiles
    solver.reset(states[0])
    before, after = states[:2]
    begun = time.process_time()
    try:
        for index in range(round(duration / step)):
            # A step solves for its middle, and takes the root from there.
            turn = angle((index + 0.5) * step)
            ahead = 0.5 * part * np.array([math.cos(turn), math.sin(turn)])
            before.particle_q.numpy()[:2, :2] = -ahead, ahead  # a view
            solver.step(before, after, None, None, step)
            before, after = after, before
            if (index + 1) % every == 0:
                tips.append(before.particle_q.numpy()[-1, :2].astype(float))
    except RuntimeError:  # of a matrix that is not finite
        tips.extend([np.full(2, np.nan)] * (round(duration / step) // every - len(tips)))
    seconds = time.process_time() - begun
    return (seconds, *_found(tips, every * step, angle))


def _allow_optional_structs(warp):
    # An annotation of dismech-newton 0.1.0.post4, `Slots | None`, fails before Python 3.14.
    kind = type(warp.struct(type('Empty', (), {'__annotations__': {}})))
    if '__or__' not in vars(kind):
        setattr(kind, '__or__', lambda self, other: self)


def _checked(scene, drive):
    # The angle of the shaft and its rate, as functions.
    body = scene.manipulator
    if body.end_effector_mass or body.end_effector_inertia:
        raise ValueError('these rods have no end effector, got '
                         f'{body.end_effector_mass} kg, {body.end_effector_inertia} kg m2')
    if len(scene.constraints.free_axes):
        raise ValueError('the carrier must be held: both')
    start = scene.values['initial.shaft']
    return drive[:2] if drive else (lambda t: start, lambda t: 0.0)


def _found(tips, period, angle):
    # What `chain` returns, of the tip in world axes.
    x, y = np.array(tips).T
    theta = np.array([angle(period * index) for index in range(1, len(x) + 1)])
    cosine, sine = np.cos(theta), np.sin(theta)
    return theta, np.zeros((len(x), 2)), cosine * x + sine * y, cosine * y - sine * x
