# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""An elastic gear: closed forms, an integrator that stops at contacts, limits, balances."""

from command_line import call
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

import timo_sim
from timo_sim.scene.files import scene_text

STIFFNESS, ROTOR, TURNS = 50.0, 0.02, 10.0  # [N m/rad], [kg m2] at the shaft
RIGID = {'model.modes': 0, 'carrier.held': 'both', 'arm.length': 0.4, 'arm.section.height': 0.01,
         'end_effector.mass': 0.1, 'end_effector.inertia': 1e-4, 'motor.shaft_inertia': 0.01,
         'initial.shaft': 0.0}
GEAR = {'motor.gear.stiffness': STIFFNESS, 'motor.dc.gear_ratio': TURNS,
        'motor.rotor.inertia': ROTOR / TURNS**2}
SWING = {'load.torque.harmonic.amplitude': [1.0], 'load.torque.harmonic.frequency': [2.0]}
# On the shaft and, as seen from it, on the rotor.
RUBS = {'motor.viscous_friction': 0.02, 'motor.rotor.viscous_friction': 0.1 / TURNS**2}
# For the paper's arm, whose rotor has half of the inertia of its shaft.
BENDS = {'motor.shaft_inertia': 1.0, 'motor.rotor.inertia': 0.01, 'motor.dc.gear_ratio': 10.0}


def inertia_of(scene):
    """Return the moment of inertia of shaft and rigid arm [kg m2]."""
    return scene.build().mass_matrix(scene.initial_motion())[0][2, 2] - ROTOR


def rotor(run):
    """Return angle and speed of the rotor as seen from the shaft."""
    half, turns = run.model.size // 2, run.model.rotor
    return run.values[:, :half] @ turns, run.values[:, half:] @ turns


class TwoBodies:
    """Shaft and rotor with a spring and damper between stops; SciPy finds each contact."""

    def __init__(self, inertia, damping, play, friction=lambda v: 0.1 * v,
                 shaft_friction=lambda v: 0.02 * v):
        self.inertia, self.damping, self.play = inertia, damping, 0.5 * play
        self.friction, self.shaft_friction = friction, shaft_friction

    def spring(self, y, side):
        """Return the torque of the gear if it touches the stop on a side, 1 or -1."""
        return (STIFFNESS * (y[1] - y[0] - side * self.play) + self.damping * (y[3] - y[2]))

    def rate(self, t, y, side):
        torque = self.spring(y, side) if side else 0.0
        return [y[2], y[3], (torque - self.shaft_friction(y[2])) / self.inertia,
                (np.sin(4.0 * np.pi * t) - self.friction(y[3]) - torque) / ROTOR]

    def run(self, times):
        """Return both angles, both speeds at times, and the number of contacts."""
        def event(value, direction):
            value.terminal, value.direction = True, direction
            return value

        y, t, side, contacts = np.zeros(4), 0.0, int(self.play == 0.0), 0
        leaving = 0  # 1 or -1: apart, though the damper has not yet let the stop return
        found = np.empty((4, len(times)))
        while t < times[-1]:
            if self.play == 0.0:
                events = []
            elif leaving:
                events = [event(lambda t, y, *_: leaving * (y[1] - y[0]) - self.play, -1)]
            elif side:
                events = [event(lambda t, y, *_: side * self.spring(y, side), -1)]
            else:
                events = [event(lambda t, y, *_: y[1] - y[0] - self.play, 1),
                          event(lambda t, y, *_: y[1] - y[0] + self.play, -1)]
            part = solve_ivp(self.rate, (t, times[-1]), y, 'DOP853', rtol=1e-11, atol=1e-13,
                             events=events, dense_output=True, args=(side,))
            inside = (times >= t) & (times <= part.t[-1])
            if inside.any():
                found[:, inside] = part.sol(times[inside])
            t, y = part.t[-1], part.y[:, -1]
            if part.status != 1:
                break
            if leaving:
                leaving = 0
            elif side:
                # Without damping it is at the stop already.
                leaving, side = side if self.damping else 0, 0
            else:
                side, contacts = 1 if len(part.t_events[0]) else -1, contacts + 1
        return found, contacts


def test_two_bodies_vibrate_as_the_closed_form():
    scene = timo_sim.load_scene({}, {**RIGID, **GEAR, 'motor.gear.damping': 0.05})
    reduced = 1.0 / (1.0 / ROTOR + 1.0 / inertia_of(scene))
    found = timo_sim.modes(scene)
    assert found.omega == pytest.approx([np.sqrt(STIFFNESS / reduced)], rel=1e-7)
    assert found.damping == pytest.approx([0.025 / np.sqrt(STIFFNESS * reduced)], rel=1e-6)


@pytest.mark.parametrize('held', ['none', 'x', 'both'])
def test_frequencies_of_a_bending_arm_satisfy_those_of_its_root(held):
    """
    A gear joins rotor and shaft: `1/k = 1/(J w^2) + A(w)`, with A the shaft's own compliance.

    A is that of the same manipulator without rotor, by its linear model.
    """
    free = {'carrier.held': held, 'motor.shaft_inertia': 1.0}
    poles = timo_sim.modes(timo_sim.load_scene({}, {
        **free, **BENDS, 'motor.gear.stiffness': 4000.0})).omega
    without = timo_sim.linearize(timo_sim.load_scene(free)).select(['torque_N_m'], ['shaft_rad'])
    compliance = without.frequency_response(poles / (2.0 * np.pi))[:, 0, 0].real
    assert len(poles) == 4
    assert compliance - 1.0 / poles**2 == pytest.approx(np.full(4, -1.0 / 4000.0), rel=1e-4)


def test_is_of_fourth_order_with_friction_on_either_side():
    """Against SciPy; friction of the shaft builds up over a speed, that of the rotor is uneven."""
    scene = timo_sim.load_scene({}, {
        **RIGID, **GEAR, **SWING, 'motor.gear.damping': 0.05,
        'motor.coulomb_friction': 0.2, 'motor.coulomb_speed': 0.3,
        'motor.rotor.coulomb_friction': 0.3 / TURNS, 'motor.rotor.coulomb_speed': 0.5 * TURNS,
        'motor.rotor.coulomb_asymmetry': 0.4})

    def uneven(speed):
        return 0.3 * np.tanh(speed / 0.5) * (1.0 + 0.4 * np.tanh(speed / 0.5))

    times = np.linspace(0.0, 1.0, 26)
    wanted, _ = TwoBodies(inertia_of(scene), 0.05, 0.0, uneven,
                          lambda v: 0.2 * np.tanh(v / 0.3)).run(times)
    errors = []
    for step in (0.004, 0.002):
        run = timo_sim.simulate(scene.vary({'integrator.step': step}), 1.0, round(0.04 / step),
                                estimate=False)
        errors.append(max(np.abs(run.shaft - wanted[0]).max(),
                          np.abs(rotor(run)[0] - wanted[1]).max()))
    assert errors[1] < 1e-7 and 12.0 < errors[0] / errors[1] < 20.0


@pytest.mark.parametrize('damping, order, formulation', [
    (0.0, 2.0, 'exact'), (0.05, 1.0, 'exact'), (0.05, 1.0, 'newton')])
def test_backlash_against_an_integrator_that_stops_at_contacts(damping, order, formulation):
    """Without damping the torque has no jump at a contact. The estimated error is the true one."""
    scene = timo_sim.load_scene({}, {**RIGID, **GEAR, **SWING, **RUBS, 'motor.gear.backlash': 0.02,
                                     'motor.gear.damping': damping,
                                     'model.formulation': formulation})
    times = np.linspace(0.0, 1.0, 51)
    wanted, contacts = TwoBodies(inertia_of(scene), damping, 0.02).run(times)
    assert contacts >= 3
    errors, steps = [], np.array([0.004, 0.001, 0.00025])
    for step in steps:
        run = timo_sim.simulate(scene.vary({'integrator.step': step}), 1.0, round(0.02 / step))
        errors.append(0.4 * np.abs(run.shaft - wanted[0]).max())  # of the tip [m]
        assert 0.4 < run.stats['estimated_tip_error_m'] / errors[-1] < 2.5
    assert errors[-1] < 2e-6
    found = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order - 0.4 < found < order + 0.6


@pytest.mark.parametrize('more', [
    {}, {'carrier.held': 'x'}, {'carrier.held': 'both', 'gravity': [0.0, -9.81]},
    {'model.axial_modes': 1, 'hub.radius': 0.1}], ids=str)
def test_a_stiff_gear_is_a_rigid_one_whatever_the_step(more):
    """
    The distance is one over the stiffness; a step has twenty vibrations of the gear.

    With one axis held, where the state has rates, that leaves an error of 1e-5 m.
    """
    scene = timo_sim.load_scene('paper', {'motor.viscous_friction': 0.2, 'integrator.step': 0.01,
                                          **more})
    rigid, soft, stiff = (timo_sim.simulate(scene.vary(each), 1.0, estimate=False) for each in (
        {}, {**BENDS, 'motor.gear.stiffness': 1e6}, {**BENDS, 'motor.gear.stiffness': 1e8}))
    assert 0.01 / (2.0 * np.pi / np.sqrt(2e8)) > 20.0
    far, near = (np.abs(run.position() - rigid.position()).max() for run in (soft, stiff))
    assert near < 0.02 * far < 2e-6 or more.get('carrier.held') == 'x' and near < far < 4e-5


@pytest.mark.parametrize('more', [
    {}, {'carrier.held': 'x'}, {'model.axial_modes': 1},
    {'motor.gear.backlash': 0.02}, {'motor.gear.backlash': 0.02, 'carrier.held': 'x'},
    {'motor.rotor.coulomb_friction': 0.05}], ids=str)
def test_energy_is_what_friction_takes(more):
    """Contacts and breakaways lie within steps, whose errors are of lower order."""
    axial = more.get('model.axial_modes', 0)
    scene = timo_sim.load_scene({}, {
        **BENDS, 'motor.gear.stiffness': 2000.0, 'motor.gear.damping': 5.0, 'initial.shaft': 0.5,
        'motor.rotor.viscous_friction': 0.002, 'motor.viscous_friction': 0.1,
        'initial.shaft_velocity': 1.0, 'gravity': [0.0, -9.81],
        'initial.modal_coordinates': [0.1, 0.0, 0.0, 0.02, *axial * [0.0]], **more})
    run = timo_sim.simulate(scene, 1.0, estimate=False)
    balance = run.energy() + run.dissipated() + run.friction_heat
    assert run.dissipated()[-1] > 0.5
    smooth = not any('backlash' in name or 'coulomb' in name for name in more)
    assert balance == pytest.approx(np.full(len(balance), balance[0]),
                                    abs=1e-6 if smooth else 4e-3)


def test_a_free_manipulator_keeps_its_momenta():
    """Those of the carrier and, about the mass centre, of arm, shaft and rotor together."""
    run = timo_sim.simulate(timo_sim.load_scene({}, {
        **BENDS, 'motor.gear.stiffness': 2000.0, 'motor.gear.damping': 5.0,
        'motor.gear.backlash': 0.02, 'initial.shaft_velocity': 1.0,
        'initial.modal_coordinates': [0.1, 0.0, 0.0, 0.02]}), 1.0, estimate=False)
    momentum = run.momentum()
    assert momentum == pytest.approx(np.tile(momentum[0], (len(momentum), 1)), abs=1e-11)
    assert np.ptp(rotor(run)[1]) > 0.1  # while the gear hands spin to and fro


def test_friction_at_rest_holds_the_rotor_and_the_arm_swings_on_the_gear():
    """The shaft vibrates against the rotor, which stands still but for its presliding."""
    scene = timo_sim.load_scene({}, {
        **RIGID, **GEAR, 'motor.rotor.coulomb_friction': 1.0 / TURNS,
        'motor.rotor.coulomb_presliding': 1e-5 * TURNS, 'integrator.step': 1e-4,
        'initial.modal_coordinates': [-0.01 * np.sqrt(ROTOR)], 'initial.shaft': 0.01})
    run = timo_sim.simulate(scene, 0.5, estimate=False)
    angle, speed = rotor(run)
    assert np.abs(angle).max() < 1e-5
    omega = np.sqrt(STIFFNESS / inertia_of(scene))
    assert run.shaft == pytest.approx(0.01 * np.cos(omega * run.t), abs=1e-4)
    # Friction of 1 N m balances what a command of 0.4 N m and the spring do.
    simulator = timo_sim.Simulator(scene.vary({'motor.gear.backlash': 0.01}))
    assert simulator.step(torque=0.4, duration=0.1).values @ np.append(
        simulator.model.rotor, 0.0 * simulator.model.rotor) == pytest.approx(0.0, abs=2e-5)


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_friction_that_depends_on_direction(formulation):
    """Far above its speed it brakes by 1 + a times its limit forwards, 1 - a times backwards."""
    scene = timo_sim.load_scene({}, {
        **RIGID, 'model.formulation': formulation, 'motor.coulomb_friction': 0.2,
        'motor.coulomb_speed': 0.01, 'motor.coulomb_asymmetry': 0.3})
    inertia = inertia_of(scene) + ROTOR
    for speed, share in ((10.0, 1.3), (-10.0, -0.7)):
        run = timo_sim.simulate(scene.vary({'initial.shaft_velocity': speed}), 0.5, estimate=False)
        wanted = speed - 0.2 * share / inertia * run.t
        assert run.shaft_velocity == pytest.approx(wanted, abs=1e-10)
        lost = 0.5 * inertia * (speed**2 - run.shaft_velocity**2)
        assert run.dissipated() == pytest.approx(lost, abs=1e-8)


def test_rest_under_a_load_twists_the_gear():
    """Gravity at a horizontal arm, held by the torque on the rotor, through half of the play."""
    scene = timo_sim.load_scene({}, {
        **RIGID, **GEAR, 'gravity': [0.0, -9.81], 'motor.gear.backlash': 0.02})
    model, weight = scene.build(), 9.81 * scene.build().points.lever @ scene.build().point_mass
    held = scene.vary({'load.torque.piecewise.time': [0.0], 'initial.shaft': 0.3,
                       'load.torque.piecewise.value': [0.5 * weight],
                       'initial.equilibrium': True})
    motion = held.initial_motion()
    assert np.abs(np.cos(motion[2])) == pytest.approx(0.5, abs=1e-9)
    twist = model.rotor[3] * motion[3]
    assert twist == pytest.approx(0.01 + 0.5 * weight / STIFFNESS, abs=1e-9)
    assert model.gear_torque(motion[np.newaxis]) == pytest.approx([0.5 * weight], rel=1e-9)


PLAY = {**RIGID, **GEAR, 'motor.gear.backlash': 0.02, 'motor.mass': 1.0, 'carrier.mass': 1.0}


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_linear_models_are_in_contact_where_the_equilibrium_loads_the_gear(sign):
    """Two bodies on springs, of the gear and of gravity at the arm; gains at rest add up."""
    scene = timo_sim.load_scene({}, {**PLAY, 'gravity': [0.0, -9.81]})
    weight = 9.81 * scene.build().points.lever @ scene.build().point_mass
    held = scene.vary({'load.torque.piecewise.time': [0.0], 'initial.equilibrium': True,
                       'load.torque.piecewise.value': [sign * 0.5 * weight],
                       'initial.shaft': sign * 0.3 - 0.5 * np.pi})
    pull = 9.81 * np.sqrt(0.75) * weight / 9.81  # spring of gravity at half of the largest torque
    stiffness = [[STIFFNESS + pull, -STIFFNESS], [-STIFFNESS, STIFFNESS]]
    squares = eigh(stiffness, np.diag([inertia_of(scene), ROTOR]), eigvals_only=True)
    assert timo_sim.modes(held).omega == pytest.approx(np.sqrt(squares), rel=1e-6)
    linear = timo_sim.linearize(held).select(['torque_N_m'], ['rotor_rad', 'shaft_rad'])
    gains = linear.frequency_response([0.0])[0, :, 0].real
    assert gains == pytest.approx([1.0 / pull + 1.0 / STIFFNESS, 1.0 / pull], rel=1e-6)
    assert np.array_equal(linear.equilibrium, held.initial_motion())
    assert timo_sim.modes(held, contact='closed').omega == pytest.approx(np.sqrt(squares))
    with pytest.raises(timo_sim.ParameterError, match='closed where the gear is loaded, by'):
        timo_sim.linearize(held, contact='open')


def test_linear_models_of_a_gear_that_nothing_loads_need_its_contact():
    scene = timo_sim.load_scene({}, {**PLAY, 'motor.gear.damping': 0.05})
    for model in timo_sim.linearize, timo_sim.modes, timo_sim.shaper:
        with pytest.raises(timo_sim.ParameterError, match='closed or open with motor.gear.backl'):
            model(scene)
    reduced = 1.0 / (1.0 / ROTOR + 1.0 / inertia_of(scene))
    omega = np.sqrt(STIFFNESS / reduced)
    assert timo_sim.modes(scene, contact='closed').omega == pytest.approx([omega], rel=1e-7)
    period = timo_sim.shaper(scene, 'ZVD', contact='closed').times[-1]
    assert period == pytest.approx(2.0 * np.pi / omega, rel=1e-2)
    assert not len(timo_sim.modes(scene, contact='open').omega)
    apart = timo_sim.linearize(scene, contact='open').select(outputs=['rotor_rad', 'shaft_rad'])
    assert apart.select(['torque_N_m']).frequency_response([3.0])[0, :, 0] == pytest.approx(
        [-1.0 / (ROTOR * (6.0 * np.pi)**2), 0.0], rel=1e-7, abs=1e-15)
    with pytest.raises(timo_sim.ParameterError, match='gear has no backlash, got open'):
        timo_sim.linearize(scene.vary({'motor.gear.backlash': 0.0}), contact='open')
    with pytest.raises(timo_sim.ParameterError, match='contact must be closed, open or '''):
        timo_sim.linearize(scene, contact='shut')
    with pytest.raises(timo_sim.ParameterError, match='goal must be reachable'):
        timo_sim.feedforward(apart.select(['torque_N_m']).to_discrete(0.01), {'shaft_rad': 0.5}, 1)


def test_the_command_line_names_the_contact_of_a_gear(tmp_path):
    scene = tmp_path / 'scene.yaml'
    scene.write_text(scene_text(timo_sim.load_scene({}, PLAY).values))
    for command in ['modes', scene], ['bode', scene, '-o', tmp_path / 'bode.png']:
        assert 'contact must be closed or open' in call(*command, code=2)
        call(*command, '--contact', 'closed',
             *(command[0] == 'bode') * ['--response', 'shaft_rad'])


def test_sensors_and_the_linear_model_know_rotor_and_gear():
    scene = timo_sim.load_scene('paper', {
        **BENDS, 'motor.gear.stiffness': 2000.0, 'motor.gear.damping': 5.0, 'hub.radius': 0.1,
        'motor.rotor.coulomb_friction': 0.05, 'motor.rotor.coulomb_speed': 1.0,
        'motor.viscous_friction': 0.5})
    simulator = timo_sim.Simulator(scene)
    simulator.advance(500)
    sensors, motion, turns = simulator.sensors, simulator.motion.values, simulator.model.rotor
    assert sensors.rotor == motion[:len(turns)] @ turns
    assert abs(sensors.rotor - sensors.encoder) > 1e-4
    assert timo_sim.simulate(scene, 0.5, estimate=False).root_strain()[-1] == pytest.approx(
        sensors.root_strain, rel=1e-9)
    # The balance of the shaft, on which the gear and its own friction act.
    run = timo_sim.simulate(scene.vary({'hub.radius': 0.0}), 0.501, estimate=False)
    torque = run.model.gear_torque(run.values)[-2] - 0.5 * run.shaft_velocity[-2]
    rate = (run.shaft_velocity[-1] - run.shaft_velocity[-3]) / 0.002
    moments = run.root_moment()
    assert moments[-2] == pytest.approx(rate - torque, abs=2e-4 * np.abs(moments).max())
    # About rest the torque acts on the rotor: at high frequencies it alone is turned.
    linear = timo_sim.linearize(scene.vary({'initial.shaft': 0.0})).select(
        ['torque_N_m'], ['rotor_rad', 'shaft_rad', 'rotor_velocity_rad_per_s'])
    omega = 2.0 * np.pi * 500.0
    of_rotor, of_shaft, of_speed = linear.frequency_response([500.0])[0, :, 0]
    assert of_speed == pytest.approx(1j * omega * of_rotor, rel=1e-9)
    assert of_rotor == pytest.approx(-1.0 / omega**2, rel=0.02)
    assert abs(of_shaft) < 0.01 * abs(of_rotor)


@pytest.mark.parametrize('values, text', [
    ({'motor.gear.backlash': 0.01}, 'motor.gear.backlash needs motor.gear.stiffness > 0'),
    ({'motor.rotor.inertia': 0.01}, 'motor.rotor.inertia needs motor.gear.stiffness > 0'),
    ({'motor.gear.stiffness': 10.0}, 'motor.rotor.inertia must be > 0 kg m2 with motor.gear'),
    ({**GEAR, 'motor.shaft': 'locked'}, 'motor.shaft must be free with motor.gear.stiffness'),
    ({**GEAR, 'arm.damping_of': 'system'}, 'arm.damping_of must be clamped with motor.gear'),
    ({**GEAR, 'arm.damping_ratio': [0.01] * 4}, 'arm.damping_ratio must have 0 or 1 or 3 elem'),
    ({**GEAR, 'initial.modal_rates': [0.1] * 3}, 'initial.modal_rates must have 0 or 4 elements '
     'for model.modes = 3 and an elastic gear'),
    ({**GEAR, 'motor.gear.backlash': 0.1, 'motor.gear.stiffness': 1e6},
     'integrator.step = 0.001 s must be at most .* s for backlash of a gear with this stiffness')])
def test_what_does_not_fit_together_is_refused(values, text):
    with pytest.raises(timo_sim.ParameterError, match=text):
        timo_sim.load_scene({}, values)


@pytest.mark.parametrize('held', ['none', 'y', 'both'])
def test_formulations_have_the_same_small_vibrations_of_arm_and_gear(held):
    values = {**BENDS, 'motor.gear.stiffness': 2000.0, 'motor.gear.damping': 5.0,
              'motor.rotor.viscous_friction': 0.002, 'carrier.held': held}
    exact, newton = (timo_sim.linearize(timo_sim.load_scene({}, {
        **values, 'model.formulation': name})).select(
            ['torque_N_m'], ['shaft_rad', 'tip_transverse_m']).frequency_response(
                np.linspace(0.5, 100.0, 50)) for name in ('exact', 'newton'))
    assert newton == pytest.approx(exact, rel=1e-6)


def test_what_a_gear_has_no_part_in():
    """Modes of the arm at a speed of the shaft; a batch with rigid gears."""
    scene = timo_sim.load_scene({}, GEAR)
    rigid = scene.vary({name: 0.0 for name in GEAR if 'ratio' not in name})
    assert timo_sim.modes(scene, 5.0).frequency == pytest.approx(
        timo_sim.modes(rigid, 5.0).frequency, rel=1e-12)
    with pytest.raises(timo_sim.ParameterError, match='motor.gear.stiffness > 0 must be the same'):
        timo_sim.Batch([scene, rigid])
