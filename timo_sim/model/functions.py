# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Declarations of the compiled functions of a formulation, and what their bodies share.

An integrator calls `rate` and `observe` by these names. The body is chosen by the kind of the
`tables`, packed constants of the formulation, for which `@rate.of(Tables)` registers it. A motion
is described in `formulation.Formulation`, a load in `layout`.
"""

from typing import Annotated, NamedTuple

import numpy as np

from timo_sim.compiled.constants import local_arrays
from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import (
    Array, chain, Constants, declare, floor, inner, magnitude, some, strict, value_of, where)
from timo_sim.model.layout import (
    ACCELERATION, ACCELERATION_X, ACCELERATION_Y, ANGLE, LOADS, MOTOR_FRICTION, PLACE_X, PLACE_Y,
    SPEED, SPEED_X, SPEED_Y, TORQUE)


@declare
def rate(tables, state, load, out):
    """Write n(y, load), (m,), the state's rate less its linear part; loads are included."""


@declare
def linear_part_is_valid(tables, state, load):
    """Return whether the linear part that belongs to the constants is the one for this state."""


@declare
def observe(tables, state, load, out):
    """Write the motion that belongs to a state and a load."""


@declare
def state_of(tables, motion, out):
    """Write the state that belongs to a motion: what `observe` makes a motion of."""


@declare
def momenta(tables, motion, out):
    """Write the momenta of all coordinates, (3 + N,)."""


@declare
def joint_place(tables, state, load, joint):
    """Return the place of a joint: carrier x, y, rotor (the shaft of a rigid gear), shaft."""


@inner
def copy(vector, out):
    for i in range(min(len(vector), len(out))):
        out[i] = vector[i]


@inner
def add_base(load, half, out):
    """Add place and speed of a driven carrier to those of a motion."""
    out[0] += load[PLACE_X]
    out[1] += load[PLACE_Y]
    out[half] += load[SPEED_X]
    out[half + 1] += load[SPEED_Y]


# Laws of joints. Python calls them, too, with a `Manipulator` for tables, and arrays.

@inner
def within(limit, value):
    """Return a value, or what is next to it from -limit to limit."""
    return where(value > limit, limit, where(value < -limit, -limit, value))


@inner
def coulomb(tables, joint, speed):
    """Return the friction against a speed of carrier, joint 0, shaft, 1, or rotor, 2 (T63)."""
    friction = 0.0
    if some(tables.coulomb[joint][0] != 0.0):
        share = tanh(speed / tables.coulomb[joint][1])
        friction = tables.coulomb[joint][0] * share * (1.0 + tables.coulomb[joint][2] * share)
    return friction


@inner
def gear_torque(stiffness, damping, play, twist, rate):
    """Return the torque of spring and damper of a gear, whose contacts do not pull (T62)."""
    torque = stiffness * twist + damping * rate
    if some(play != 0.0):
        left = torque - stiffness * within(play, twist)
        contact = where(twist > play, where(left > 0.0, left, 0.0),
                        where((twist < -play) & (left < 0.0), left, 0.0))
        torque = where(play > 0.0, contact, torque)
    return torque


PER_COORDINATE, DRAG, PLAY = range(3)  # columns of `Tables.gear`, of an elastic gear (T60)


@inner
def missing_contact(tables, n, place, q, qdot):
    """
    Return the force of spring and damper of the n-th gear that backlash takes away (T62).

    Its coordinate has this place among those of a formulation, as have stiffness and damping.
    """
    play, missing, twist, rate = tables.gear[n, PLAY], 0.0, q[place], qdot[place]
    stiffness, damping = tables.stiffness[place], tables.damping[place]
    if some(play != 0.0):
        missing = stiffness * twist + damping * rate - gear_torque(
            stiffness, damping, play, twist, rate)
    return missing


@inner
def loose_energy(tables, n, stiffness, twist):
    """Return twice the energy that the spring of the n-th gear has less within its play [J]."""
    loose = within(tables.gear[n, PLAY], twist)
    return stiffness * loose * (2.0 * twist - loose)


@inner
def rotor_torque(tables, load, shaft_speed, rates, place):
    """
    Return the torque on the rotor less its friction; without a gear it is that on the shaft.

    `rates[place]` is the rate of the coordinate of an elastic gear (T61).
    """
    rotor, friction = shaft_speed, -0.0
    for n in range(len(tables.gear)):  # 0 or 1: an `if` that LLVM decides, see `compiled`
        rotor += tables.gear[n, PER_COORDINATE] * rates[place]
        friction = tables.gear[n, DRAG] * rotor + coulomb(tables, 2, rotor)
    return motor_torque(tables, load, rotor) - friction


@inner
def motor_torque(tables, load, speed):
    """Return the torque of loads where the motor acts, at its speed, and dry friction (T66)."""
    torque = load[TORQUE]
    for n in range(len(tables.motor_limit)):  # 0 or 1: an `if` that LLVM decides, see `compiled`
        wanted = load[TORQUE] - load[MOTOR_FRICTION] - tables.motor_limit[n][1] * speed
        torque = torque - (wanted - within(tables.motor_limit[n][0], wanted))
    return torque


@inner
def motor_effort(tables, load, speed):
    """Return the effort of the torque of loads, without friction, at the motor's speed (T66)."""
    torque = motor_torque(tables, load, speed)
    for _ in range(len(tables.motor_limit)):
        least = where(load[TORQUE] < 0.0, load[TORQUE], 0.0)
        most = where(load[TORQUE] > 0.0, load[TORQUE], 0.0)
        torque = where(torque < least, least, where(torque > most, most, torque))
    return torque


@inner
def spring_torque(tables, angle):
    """Return the torque of a spring on the shaft at its angle (T70)."""
    torque = -0.0
    for n in range(len(tables.spring)):
        torque = torque - tables.spring[n][0] * (angle - tables.spring[n][1])
    return torque


@declare
def tip(tables, motion, out):
    """
    Write the position and rotation of the tip in a motion, (3,).

    Along axes I and II from the shaft's axis [m], rotation relative to the shaft [rad].
    """


class Outline(NamedTuple):
    """Constants of `place_point`, of `formulation.Points`; each formulation uses its own."""

    lever: Annotated[np.ndarray, 'drawn']
    deflection: Annotated[np.ndarray, 'modes', 'drawn']
    integral: Annotated[np.ndarray, 'drawn', 'padded_nodes']


@declare
def place_point(tables, outline, number, motion, out):
    """Write the position of a point of an `Outline`, as `tip` does, (2,)."""


@declare
def tip_rate(tables, motion, out):
    """Write the rate of what `tip` writes, components along the turning axes, (3,)."""


@declare
def effort(tables, motion, accelerations, load, out):
    """
    Write the force on the carrier and torque on the shaft that accelerations need (T44).

    `accelerations`, (3 + N,), are less gravity; of the load those on tip and arm are used. `out`,
    (3,), is in world axes [N], then [N m].
    """


@declare
def energy(tables, motion, gravity):
    """Return the energy [J], see `Formulation.energy`."""


@inner
def energy_of_momenta(tables, axial, motion, momenta):
    """Return kinetic and strain energy [J]; the gear's coordinate precedes the axial ones."""
    half, modes = len(motion) // 2, len(motion) // 2 - 3
    first, twice = len(tables.stiffness) - modes, 0.0
    for i in range(half):
        twice += motion[half + i] * momenta[i]
    for n in range(modes):
        twice += tables.stiffness[first + n] * motion[3 + n] * motion[3 + n]
    for n in range(len(tables.spring)):
        turn = motion[2] - tables.spring[n, 1]
        twice += tables.spring[n, 0] * turn * turn
    for n in range(len(tables.gear)):  # the spring of a gear is relaxed within its play
        place = modes - axial - 1
        twice -= loose_energy(tables, n, tables.stiffness[first + place], motion[3 + place])
    return 0.5 * twice


class Root(NamedTuple):
    """
    Constants of forces at the root of the arm, and of its strain gauge.

    `gauges` is 1 if the gauge is not at the root, else 0. These fields of it are those of an
    `Outline`, beside what of a load acts beyond it, and rotations of its section.
    """

    base_mass: float       # of carrier and motor [kg]
    shaft_inertia: float   # [kg m2]
    hub_radius: float      # [m]
    shaft_friction: float  # viscous [N m s/rad]
    constrained: Annotated[np.ndarray, int, 3]  # whether carrier x, y and shaft are
    # What accelerations of all coordinates need of torque at the rotor of an elastic gear.
    rotor: Annotated[np.ndarray, 'gears', 'accelerations']
    # Strain of the outer fibre per moment and axial force at the gauge, and per modal rate.
    strain_of_moment: float
    strain_of_force: float  # 0 if the arm does not stretch
    strain_of_rates: Annotated[np.ndarray, 'modes']
    lever: Annotated[np.ndarray, 'gauges']
    deflection: Annotated[np.ndarray, 'modes', 'gauges']
    integral: Annotated[np.ndarray, 'gauges', 'padded_nodes']
    acts: Annotated[np.ndarray, 'gauges', LOADS]
    rotation: Annotated[np.ndarray, 'gauges', 'modes']


@inner
def root_forces(tables, root, motion, accelerations, needed, load):
    """
    Return axial force [N] and moment [N m] in the arm at its root.

    They follow from the balance of carrier and shaft (T45), (T51): `accelerations`, less gravity,
    need what `effort` writes, and the load acts, dry friction included.
    """
    half, moment = len(motion) // 2, root.shaft_inertia * accelerations[2]
    speed = motion[half + 2]
    for n in range(len(root.rotor)):
        for i in range(half):
            moment = moment + root.rotor[n, i] * accelerations[i]
    if root.constrained[2] != 0 or len(root.rotor) != 0:
        moment = moment - needed[2]
    else:
        moment = moment + (root.shaft_friction * speed + coulomb(tables, 1, speed)
                           - motor_torque(tables, load, speed))
        moment = moment - spring_torque(tables, motion[2])
    x = root.base_mass * accelerations[0] - needed[0]
    y = root.base_mass * accelerations[1] - needed[1]
    sine, cosine = sincos(motion[2])
    return cosine * x + sine * y, moment - root.hub_radius * (cosine * y - sine * x)


@inner
def gauge_forces(rotation, motion, needed, along, across):
    """
    Return axial force and moment in a section, by the balance of the arm beyond it (T72).

    That `needed` the force and torque about the shaft that `effort` writes. The section has these
    rotations by mode, (N,), and is `along` and `across` the arm from the shaft's axis.
    """
    sine, cosine = sincos(motion[2])
    x, y = cosine * needed[0] + sine * needed[1], cosine * needed[1] - sine * needed[0]
    turn = 0.0
    for n in range(len(rotation)):
        turn = turn + rotation[n] * motion[3 + n]
    sine, cosine = sincos(turn)
    return -(cosine * x + sine * y), along * y - across * x - needed[2]


@inner
def rotor_turn(root, motion, begin):
    """Return the angle (begin = 0) or speed of the rotor, or the shaft, where motors act."""
    value = motion[begin + 2]
    for n in range(len(root.rotor)):
        value = 0.0
        for i in range(len(motion) // 2):
            value += root.rotor[n, i] / root.rotor[n, 2] * motion[begin + i]
    return value


@inner
def root_strain(root, motion, force, moment):
    """Return the strain of the outer fibre; modal damping adds to the forces, but not to it."""
    strain, half = root.strain_of_moment * moment + root.strain_of_force * force, len(motion) // 2
    for n in range(len(root.strain_of_rates)):
        strain = strain + root.strain_of_rates[n] * motion[half + 3 + n]
    return strain


class Flow(NamedTuple):
    """Constants of `accelerate`."""

    linear: Annotated[np.ndarray, 'state', 'state']  # L of the straight arm
    points_rotation: Annotated[np.ndarray, 'modes', 'points']  # of sections by each mode


class _Room(NamedTuple):
    """Work arrays of `accelerate`."""

    slope: Annotated[np.ndarray, 'state']
    moved: Annotated[np.ndarray, 'state']
    drift: Annotated[np.ndarray, LOADS]
    motion: Annotated[np.ndarray, 'motion']
    place: Annotated[np.ndarray, 3]
    speed: Annotated[np.ndarray, 3]


_TURN = 1e-5  # largest turn of a section in half of the time between two motions [rad]


@inner
def accelerate(tables, seen, flow, motion, state, load, accelerations):
    """
    Write the accelerations of all coordinates under a load; return those of an IMU in world axes.

    That is at the tip of the tables `seen`. They are central differences of speeds along the flow:
    states and drives are extrapolated linearly.
    """
    room = local_arrays(_Room, tables)
    slope, moved, drift = room.slope, room.moved, room.drift
    half, size = len(motion) // 2, len(state)
    rate(tables, state, load, slope)
    for i in range(size):
        for j in range(size):
            slope[i] += flow.linear[i, j] * state[j]
    turning = 0.0
    for p in range(flow.points_rotation.shape[1]):
        here = motion[half + 2]
        for n in range(flow.points_rotation.shape[0]):
            here += flow.points_rotation[n, p] * motion[half + 3 + n]
        turning = max(turning, magnitude(value_of(here)))
    time = _TURN / (_TURN + turning)
    x, y = 0.0, 0.0
    for k in range(2):
        sign = time if k else -time
        for i in range(size):
            moved[i] = state[i] + sign * slope[i]
        copy(load, drift)
        drift[ANGLE] += sign * load[SPEED]
        drift[SPEED] += sign * load[ACCELERATION]
        drift[PLACE_X] += sign * load[SPEED_X]
        drift[PLACE_Y] += sign * load[SPEED_Y]
        drift[SPEED_X] += sign * load[ACCELERATION_X]
        drift[SPEED_Y] += sign * load[ACCELERATION_Y]
        observe(tables, moved, drift, room.motion)
        tip_x, tip_y = tip_velocity(seen, room)
        if k:
            x, y = (tip_x - x) / (2.0 * time), (tip_y - y) / (2.0 * time)
        else:
            x, y = tip_x, tip_y
        for i in range(half):
            speed = room.motion[half + i]
            accelerations[i] = (speed - accelerations[i]) / (2.0 * time) if k else speed
    return x, y


@inner
def tip_velocity(tables, room):
    """Return the velocity of the tip in world axes."""
    motion, place, speed = room.motion, room.place, room.speed
    half = len(motion) // 2
    tip(tables, motion, place)
    tip_rate(tables, motion, speed)
    along = speed[0] - motion[half + 2] * place[1]
    across = speed[1] + motion[half + 2] * place[0]
    sine, cosine = sincos(motion[2])
    return (motion[half] + (cosine * along - sine * across),
            motion[half + 1] + (sine * along + cosine * across))


class _Sensing(NamedTuple):
    """Work arrays: a load beyond the gauge, what it needs there; places of gauge and IMU."""

    acting: Annotated[np.ndarray, LOADS]
    needed: Annotated[np.ndarray, 3]
    place: Annotated[np.ndarray, 3]


@inner
def sense_forces(tables, beyond, seen, flow, root, gravity, motion, state, load, accelerations,
                 needed):
    """
    Return moment at the root, strain at the gauge, specific force at the IMU along the axes there.

    `beyond` and `seen` are tables of `Formulation.beyond` and `.seen`; a load acts, dry friction
    included. Accelerations, less gravity, and what they need, see `effort`, are written.
    """
    room = local_arrays(_Sensing, tables)
    x, y = accelerate(tables, seen, flow, motion, state, load, accelerations)
    x, y = x - gravity[0], y - gravity[1]
    for axis in range(2):
        accelerations[axis] -= gravity[axis]
    effort(tables, motion, accelerations, load, needed)
    force, moment = root_forces(tables, root, motion, accelerations, needed, load)
    at_root = moment
    for n in range(len(root.lever)):
        for i in range(LOADS):
            room.acting[i] = root.acts[n, i] * load[i]
        effort(beyond, motion, accelerations, room.acting, room.needed)
        place_point(beyond, root, n, motion, room.place)
        force, moment = gauge_forces(
            root.rotation[n], motion, room.needed, room.place[0], room.place[1])
    tip(seen, motion, room.place)
    sine, cosine = sincos(motion[2] + room.place[2])
    return (at_root, root_strain(root, motion, force, moment), cosine * x + sine * y,
            cosine * y - sine * x)


@entry_point(tables=Constants(), beyond=Constants(), seen=Constants(), flow=Constants(),
             root=Constants(), gravity=Array((2,)), motions=Array((None, 'motion')),
             states=Array((None, 'state')), loads=Array((None, LOADS)), count=int,
             accelerations=Array((None, 'accelerations')), needed=Array((None, 3)),
             shown=Array((None, 4)))
def sense(tables, beyond, seen, flow, root, gravity, motions, states, loads, count, accelerations,
          needed, shown):
    """Call `sense_forces` from Python for each of `count` motions."""
    for k in range(count):
        shown[k, 0], shown[k, 1], shown[k, 2], shown[k, 3] = sense_forces(
            tables, beyond, seen, flow, root, gravity, motions[k], states[k], loads[k],
            accelerations[k], needed[k])


@entry_point(tables=Constants(), state=Array(('state',)), load=Array((LOADS,)),
             out=Array(('state',)))
def rate_once(tables, state, load, out):
    """Call `rate` from Python."""
    rate(tables, state, load, out)


@entry_point(tables=Constants(), motions=Array((None, 'motion')), count=int,
             out=Array((None, 'state')))
def states(tables, motions, count, out):
    """Call `state_of` from Python for each of `count` motions."""
    for k in range(count):
        state_of(tables, motions[k], out[k])


@entry_point(tables=Constants(), motions=Array((None, 'motion')), count=int,
             out=Array((None, 3)))
def tips(tables, motions, count, out):
    """Call `tip` from Python for each of `count` motions."""
    for k in range(count):
        tip(tables, motions[k], out[k])


@entry_point(tables=Constants(), motions=Array((None, 'motion')), gravity=Array((2,)), count=int,
             out=Array((None,)))
def energies(tables, motions, gravity, count, out):
    """Call `energy` from Python for each of `count` motions."""
    for k in range(count):
        out[k] = energy(tables, motions[k], gravity)


# Sine, cosine and hyperbolic tangent for compiled loops, of floats or of lanes.
#
# The library's functions need a call for each number. These are arithmetic without branches, which
# the compiler turns into vector code. Errors of sine and cosine are below 1 unit in the last place
# up to 1e5 rad, those of the hyperbolic tangent below 10.

# pi / 2 in two parts, the first with 33 bits: its whole multiples up to 2^20 are exact.
_HIGH, _LOW = 1.57079632673412561417, 6.07710050650619224932e-11


@inner
def sincos(angle):
    """Return sine and cosine of an angle [rad]."""
    sine, cosine = _sincos(value_of(angle))
    return chain(sine, cosine, angle), chain(cosine, -sine, angle)


@strict
def _sincos(angle):
    """
    Return sine and cosine of an angle without derivatives.

    The angle is reduced to [-pi/4, pi/4]. Source of the polynomials there: fdlibm by Sun
    Microsystems, k_sin.c and k_cos.c.
    """
    quarters = floor(angle * (2.0 / np.pi) + 0.5)
    x = (angle - quarters * _HIGH) - quarters * _LOW
    z = x * x
    sine = x + x * z * (
        -1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (
            -1.98412698298579493134e-04 + z * (2.75573137070700676789e-06 + z * (
                -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))))
    cosine = 1.0 - (0.5 * z - z * z * (
        4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * (
            2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * (
                2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))))))
    quadrant = quarters - 4.0 * floor(0.25 * quarters)
    odd = (quadrant == 1.0) | (quadrant == 3.0)
    first, second = where(odd, cosine, sine), where(odd, sine, cosine)
    return (where(quadrant >= 2.0, -first, first),
            where((quadrant == 1.0) | (quadrant == 2.0), -second, second))


@strict
def tanh(x):
    """
    Return the hyperbolic tangent.

    It is 1 beyond 20. A Pade approximant of `x / 64` is doubled six times as a fraction, by
    `tanh 2z = 2 p q / (q^2 + p^2)`, where `tanh z = p / q`.
    """
    z = where(x > 20.0, 20.0, where(x < -20.0, -20.0, x)) / 64.0
    square = z * z
    p = z * (135135.0 + square * (17325.0 + square * (378.0 + square))) / (
        135135.0 + square * (62370.0 + square * (3150.0 + square * 28.0)))
    q = 1.0
    for _ in range(6):
        p, q = 2.0 * p * q, q * q + p * p
    return p / q
