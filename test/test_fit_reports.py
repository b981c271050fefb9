# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0


"""What a fit says beyond its estimates: suspects, profile intervals, samples."""

from pathlib import Path
import re

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

import timo_sim
from timo_sim.fitting import auto, suspects
from timo_sim.fitting.look import look, turned
from timo_sim.fitting.objective import Objective
from timo_sim.fitting.problem import Problem, TimeIsUp
from timo_sim.fitting.record import Channel
from timo_sim.fitting.search import Minimum, Search
from timo_sim.fitting.suspects import moves_one_way

T = 0.002 * np.arange(1001)
VOLTAGE = 2.0 * np.sign(np.sin(9.0 * T)) + np.sin(2.0 * np.pi * (0.5 + 2.0 * T) * T)
NOISE = {'shaft': 1e-3, 'tip_transverse': 3e-4}  # standard deviations [rad, m]
ARM = timo_sim.load_scene({}, {
    'arm.length': 0.42, 'arm.section.height': 0.001, 'arm.density': 7800.0,
    'arm.young_modulus': 2e11,
    'arm.shear_modulus': 77e9, 'arm.damping_ratio': [0.01], 'carrier.held': 'both',
    'end_effector.mass': 0.05, 'end_effector.inertia': 1e-5, 'initial.shaft': 0.0,
    'integrator.step': 0.002, 'motor.shaft_inertia': 2e-3, 'motor.viscous_friction': 0.02,
    'motor.dc.resistance': 2.6, 'motor.dc.torque_constant': 0.0077, 'motor.dc.gear_ratio': 70.0})
GAIN = 0.0077 * 70.0 / 2.6  # torque per voltage [N m/V]
FREE = ['arm.young_modulus', 'end_effector.mass', 'motor.viscous_friction', 'motor.shaft_inertia']
GEAR = {'motor.gear.stiffness': 100.0, 'motor.gear.damping': 0.05, 'motor.gear.backlash': 0.02,
        'motor.shaft_inertia': 1e-3, 'motor.rotor.inertia': 1e-3 / 70.0**2}


def record(more=None, volts=VOLTAGE, late=0, signs=(1.0, 1.0), told=VOLTAGE):
    """Return a Record whose voltage is said to be `told`; the tip is `late` by 0.5 ms each."""
    run = timo_sim.simulate(ARM.vary({
        'integrator.step': 0.0005, 'load.torque.piecewise.time': T,
        'load.torque.piecewise.value': GAIN * volts, **(more or {})}), T[-1], estimate=False)
    tip = run.deflection()[np.maximum(np.arange(0, len(run.t), 4) - late, 0), 1]
    random = np.random.default_rng(1)
    return timo_sim.Record.of({'voltage': (T, told)}, {
        name: (T, sign * values + NOISE[name] * random.standard_normal(len(T)))
        for sign, (name, values) in zip(signs, {
            'shaft': run.shaft[::4], 'tip_transverse': tip}.items())})


def fit(measured, free=FREE, factor=1.1, more=None, **options):
    guess = {name: [1.1 * value[0]] if isinstance(value, tuple) else factor * value
             for name, value in ARM.values.items() if name in free}
    return timo_sim.fit(ARM.vary({**guess, **(more or {})}), measured, free, starts=1,
                        **options)


@pytest.mark.parametrize('name, made', [
    ('', {}), ('dry friction of the motor', {'more': {'motor.coulomb_friction': 0.03}}),
    ('a delay of tip_transverse', {'late': 9}),
    ('a limit of the voltage', {'volts': np.clip(VOLTAGE, -2.4, 2.4)}),
    ('gravity, as of a tilted plane', {'more': {'gravity': [0.2, -0.4]}}),
    ('backlash of the gear', {'more': GEAR}),
    ('a spring on the shaft, as of a cable', {'more': {'motor.spring.stiffness': 0.1}}),
    ('a clamp that gives', {'more': {'arm.root_stiffness': 3.0}}),
    ('a dead zone of voltage', {'volts': VOLTAGE - np.clip(VOLTAGE, -0.3, 0.3)})])
def test_what_a_record_has_and_the_scene_lacks_is_the_first_suspect(name, made):
    found = fit(record(**made))
    told = [text for text in found.warnings if 'look like' in text]
    if not name:
        assert found.white and not told
        return
    assert found.suspects[0].name == name
    assert told[0].startswith(f'the residuals look like {name} (') and told[0] in found.report()
    shares = [each.share for each in found.suspects]
    assert shares == sorted(shares, reverse=True) and 0.0 <= shares[-1] <= shares[0] <= 1.0
    if name.startswith('dry friction'):  # its size is that of the record, to first order
        assert float(found.suspects[0].advice.partition('=')[2]) == pytest.approx(0.03, rel=0.2)


@pytest.mark.parametrize('name, factor, unit', [
    ('arm.young_modulus', 1.3, 'Pa'), ('motor.shaft_inertia', 1.5, 'kg m2'),
    ('arm.length', 1.1, 'm'), ('end_effector.mass', 1.4, 'kg')])
def test_a_wrong_value_that_is_held_is_the_first_suspect(name, factor, unit):
    """Not an effect that looks alike, as a clamp that gives does; its value is the true one."""
    true = ARM.values[name]
    found = fit(record(), [each for each in FREE if each != name], more={name: factor * true})
    text, = (text for text in found.warnings if 'look like' in text)
    held = f'another value of {name} than {factor * true:.4g} {unit}'
    assert text.startswith(f'the residuals look like {held} (')
    assert float(re.search(rf'free {name}=([^)]*)\)', text)[1]) == pytest.approx(true, rel=0.03)


@pytest.mark.parametrize('part, stiffness', [(0.2, 8.0), (0.8, 10.0)])
def test_a_soft_gear_is_told_from_a_delay(part, stiffness):
    """Both let the shaft follow late; `part` of its inertia is before the gear."""
    found = fit(record({
        'motor.gear.stiffness': stiffness, 'motor.gear.damping': 0.05,
        'motor.shaft_inertia': (1.0 - part) * 2e-3,
        'motor.rotor.inertia': part * 2e-3 / 70.0**2}))
    assert found.suspects[0].name == 'an elastic gear'
    assert sum('look like an elastic gear' in text for text in found.warnings) == 1


def test_a_mode_is_told_from_a_resonance():
    """Which no first order can: the parameters have fitted one mode to what two of them do."""
    volts = 12.0 * np.sin(2.0 * np.pi * (22.0 + 10.0 * T) * T)
    found = fit(record(volts=volts, told=volts), [*FREE, 'motor.dc.torque_constant'],
                more={'model.modes': 1})
    assert found.suspects[0].name == 'one more mode'
    assert found.suspects[0].advice == 'set model.modes=2'


@pytest.mark.parametrize('assumed', [0.0, 0.1])
def test_friction_that_builds_up_over_another_speed_is_friction_near_rest(assumed):
    found = fit(record({'motor.coulomb_friction': 0.05, 'motor.coulomb_speed': 1.0}), more={
        'motor.coulomb_friction': 0.05, 'motor.coulomb_speed': assumed})
    assert found.suspects[0].name == 'another friction of the motor near rest'


def test_a_shaft_that_rests_as_on_a_spring_has_presliding():
    dry = {'motor.coulomb_friction': 0.06, 'motor.coulomb_speed': 0.2}
    measured = record({**dry, 'motor.coulomb_presliding': 0.02, 'motor.coulomb_static': 0.6})
    found = fit(measured, [*FREE, 'motor.coulomb_friction'], more=dry)
    assert found.suspects[0].name.startswith('presliding of the motor'), found.suspects
    assert found.suspects[0].share > 0.9


def test_offsets_and_starts_that_a_scene_lacks_are_suspects():
    plain = record()
    moved = timo_sim.Record.of(plain.inputs, {
        name: channel._replace(values=channel.values + offset) for offset, (name, channel)
        in zip((0.0, 0.01), plain.outputs.items())})
    found = fit(moved)
    assert found.suspects[0].name == 'an offset of tip_transverse'
    assert not found.white and found.suspects[0].advice == 'free tip_transverse.bias=0.01'


def test_a_run_begins_where_the_record_does():
    """A first angle and speed that the scene has not got are never searched on."""
    free = ['motor.viscous_friction', 'motor.shaft_inertia']
    found = fit(record({'initial.shaft': 0.5, 'initial.shaft_velocity': 3.0}), free, quick=True)
    assert found.scene.values['initial.shaft'] == pytest.approx(0.5, abs=3e-3)
    assert found.scene.values['initial.shaft_velocity'] == pytest.approx(3.0, rel=0.1)
    assert found.look[0].startswith('initial.shaft = 0.5') and found.look[0] in found.report()
    kept = fit(record({'initial.shaft': 0.5}), [*free, 'initial.shaft=0.1'], quick=True)
    assert kept.estimates['initial.shaft'].start == 0.1
    # A start from rest, however fast, has no speed; nor is a beginning moved that is right.
    assert not any('is taken' in line for line in fit(record(), free, quick=True).look)


@pytest.mark.parametrize('size', [0.3, 1e-4])
def test_friction_that_is_added_builds_up_as_fast_as_steps_allow(size):
    """In a record with large torques at small speeds, too, such as one with a wrong gain."""
    t = 0.01 * np.arange(400)
    measured = timo_sim.Record.of({'torque': (t, np.sin(t))}, {'shaft': (t, size * np.sin(t))})
    scene, free = auto.plain(ARM.vary({'integrator.step': 0.01}), measured)
    assert scene.step == 0.01 and 'motor.coulomb_friction' in free
    with pytest.raises(timo_sim.ParameterError, match='coulomb_speed'):
        scene.vary({'motor.coulomb_speed': 0.9 * scene.values['motor.coulomb_speed']})


def test_what_a_record_says_is_told_before_the_search():
    volts = np.clip(VOLTAGE, -2.4, 2.4)
    measured = record(volts=volts, told=volts, signs=(1.0, -1.0))
    shaft, tip = measured.outputs.values()
    told = []
    fit(timo_sim.Record.of(measured.inputs, {
        'shaft': shaft._replace(values=0.01 * np.rint(shaft.values / 0.01)),
        'tip_transverse': tip._replace(t=np.delete(tip.t, range(400, 440)),
                                       values=np.delete(tip.values, range(400, 440)))}),
        ['motor.viscous_friction'], quick=True, tell=told.append)
    page, = (each for each in told if 'before the search' in each)
    assert 'start 1' in ''.join(told).partition(page)[2]
    assert 'shaft is in steps of 0.01 rad' in page and 'voltage stands at 2.4 V for' in page
    assert 'tip_transverse has 1 gaps, the longest of 0.082 s at 0.798 s' in page
    assert any(line.strip().startswith('tip_transverse and the run') and 'scale: -1' in line
               for line in page.splitlines())


def test_an_angle_that_wraps_is_told_before_the_search():
    measured = record({'initial.shaft': 3.1})
    shaft = measured.outputs['shaft']
    measured.outputs['shaft'] = shaft._replace(
        values=(shaft.values + np.pi) % (2.0 * np.pi) - np.pi)
    page = fit(measured, ['motor.viscous_friction'], quick=True).look
    assert any(line.startswith('shaft jumps by 6.2') for line in page)
    assert not any(' jumps ' in line for line in fit(record(), ['motor.viscous_friction'],
                                                     quick=True).look)


@pytest.mark.parametrize('signs, wrong', [
    ((1.0, 1.0), []), ((1.0, -1.0), ['root_strain']), ((-1.0, -1.0), [])])
def test_a_gauge_that_moves_against_the_run_as_nothing_else_does_has_the_wrong_sign(signs, wrong):
    run = timo_sim.simulate(ARM.vary({
        'load.torque.piecewise.time': T, 'load.torque.piecewise.value': GAIN * VOLTAGE}), T[-1],
        estimate=False)
    measured = timo_sim.Record.of({'voltage': (T, VOLTAGE)}, {
        'shaft': (T, signs[0] * run.shaft), 'root_strain': (T, signs[1] * run.root_strain())})
    guess = ARM.vary({'arm.young_modulus': 3e11})
    assert turned(Problem(guess, measured, ['arm.length'], {}, T[-1]), {}) == wrong


def test_a_gauge_that_is_not_read_at_first_is_told():
    t = 0.002 * np.arange(1001)
    way = np.sin(3.0 * t)
    problem = Problem(ARM, timo_sim.Record.of({'voltage': (t, way)}, {
        'shaft': (t, way), 'root_strain': (t, np.where(t < 0.7, 0.0, 1e-4 * way))}),
        ['arm.length'], {}, 2.0)
    assert [line for line in look(problem, {}) if 'not yet read' in line and '0.7 s' in line]
    problem.record.outputs['root_strain'].values[0] = 1e-6
    assert not [line for line in look(problem, {}) if 'not yet read' in line]


def test_what_pushes_to_one_side_is_not_chosen_where_the_arm_is_turned_to_one_side():
    t = np.linspace(0.0, 3.0, 301)
    one, both = (moves_one_way(Problem(ARM, timo_sim.Record.of(
        {'voltage': (t, way)}, {'shaft': (t, way)}), ['arm.length'], {}, 3.0))
        for way in (np.clip(t - 1.0, 0.0, 1.0), np.sin(t)))
    assert one and not both


@pytest.mark.parametrize('made, own', [({}, True), ({'motor.coulomb_friction': 0.15}, False)])
def test_outputs_weigh_by_their_noise_and_where_the_model_is_wrong_alike(made, own):
    measured = record(made)
    objective = Objective([Problem(ARM, measured, FREE, {}, T[-1])])
    objective.estimate_deviations(objective.start)
    found, = objective.deviations
    parts = [found[name] / (NOISE[name] if own else np.std(each.values))
             for name, each in measured.outputs.items()]
    assert parts[0] == pytest.approx(parts[1], rel=0.1)
    assert not own or parts == pytest.approx([1.0, 1.0], rel=0.1)


@pytest.mark.parametrize('made, kept', [
    ({}, []), ({'motor.coulomb_presliding': 0.02, 'motor.coulomb_static': 0.6},
               ['presliding of the motor, which rests as on a spring'])])
def test_the_effects_of_an_arm_are_chosen(made, kept):
    """Presliding where the record has it, and nothing where it has not."""
    dry, best = {'motor.coulomb_friction': 0.06, 'motor.coulomb_speed': 0.2, 'model.modes': 0}, []
    found = fit(record({**dry, **made}).select('shaft'), [
        'motor.shaft_inertia', 'motor.coulomb_friction', 'voltage.gain'], more=dry, auto=True,
        quick=True, keep=lambda scene, text: best.append((scene, text)))
    stay = [line.partition(': ')[0] for line in found.ladder if line[0] != ' ']
    assert stay == ['the plain arm', *kept]
    assert bool(found.scene.values['motor.coulomb_presliding']) == bool(kept)
    assert found.values['motor.shaft_inertia'] == pytest.approx(2e-3, rel=0.03)
    assert len(best) == 1 + len(kept) and 'voltage.gain' in best[-1][1]
    assert all(line in found.report() for line in found.ladder)


DRY = {'motor.coulomb_friction': 0.06, 'motor.coulomb_speed': 0.2, 'model.modes': 0}
HELD = {**DRY, 'motor.coulomb_presliding': 0.02, 'motor.coulomb_static': 0.6}
PRESLIDING = 'presliding of the motor, which rests as on a spring'


def choose_for(made, **options):
    """Return a Fit of a rigid arm with friction, whose effects are chosen, to a record of it."""
    return fit(record(made).select('shaft'), ['motor.shaft_inertia', 'motor.coulomb_friction'],
               more=DRY, auto=True, quick=True, **options)


def try_alone(monkeypatch, names):
    """Let a scene lack those effects alone whose name has some text, as a regular expression."""
    monkeypatch.setattr(suspects, '_effects', lambda *arguments, effects=suspects._effects: (
        each for each in effects(*arguments) if re.search(names, each.name)))


@pytest.mark.parametrize('stops, line', [
    ('trials', f'{PRESLIDING}: '), ('search', f'{PRESLIDING}: .*best so far of its search'),
    ('judgement', f'{PRESLIDING}: better where it was tried, and in all'),
    ('first', f'{PRESLIDING}: '), ('', f'    {PRESLIDING}: ')])
def test_an_effect_is_kept_as_it_is_fitted_to_all(stops, line, monkeypatch):
    """
    Time is up in later trials, in the fit or after it.

    Or the first third alone is predicted much better with it; or far worse.
    """
    calls, tried, ends = [], [], []

    def settle(search, *arguments, settle=Search._settle, **options):
        calls.append(None)
        if stops == 'search' and len(calls) == 2:
            raise TimeIsUp('its time was up')
        return settle(search, *arguments, **options)

    def predict(*arguments, first, predict=auto.predict):
        if stops == 'judgement' and len(calls) == 2:
            raise TimeIsUp('its time was up')
        found = predict(*arguments, first=first)
        ends.append(found.errors)
        if stops == 'first' and len(calls) == 2 and not first:
            return found._replace(errors=ends[0] - 0.05)
        return found._replace(errors=found.errors + 9.0 * (
            not stops and first and len(calls) == 2))

    def try_it(objective, x, effect, *more, predict=suspects.predict):
        if stops == 'trials' and 'presliding' in str(tried) and 'presliding' not in effect.name:
            raise TimeIsUp('its time was up')
        tried.append(effect.name)
        return predict(objective, x, effect, *more)

    try_alone(monkeypatch, 'presliding|an elastic gear')
    monkeypatch.setattr(Search, '_settle', settle)
    monkeypatch.setattr(suspects, 'predict', try_it)
    monkeypatch.setattr(auto, 'predict', predict)
    found = choose_for(HELD)
    assert bool(found.scene.values['motor.coulomb_presliding']) == bool(stops)
    assert any(re.match(line, each) for each in found.ladder)
    assert stops or any(re.match('an elastic gear: ', each) for each in found.ladder)  # the next


def test_an_effect_that_was_better_in_its_trial_alone_is_not_kept(monkeypatch):
    """A trial is lucky, and time is up before the fit with it is judged."""
    def lucky(*arguments, predict=suspects.predict):
        found = predict(*arguments)
        return found._replace(errors=found.errors - 9.0)

    def predict(objective, x, first, predict=auto.predict):
        if 'asymmetry' in str(objective.free):
            raise TimeIsUp('its time was up')
        return predict(objective, x, first=first)

    try_alone(monkeypatch, 'direction')
    monkeypatch.setattr(suspects, 'predict', lucky)
    monkeypatch.setattr(auto, 'predict', predict)
    found = choose_for(DRY)
    assert found.scene.values['motor.coulomb_asymmetry'] == 0.0
    assert '    friction that depends on the direction: not better in all' in found.ladder


def test_effects_are_tried_although_the_search_of_the_plain_arm_does_not_end(monkeypatch):
    """By a clock on which a run takes 1 s, and 100 s where the search does not end."""
    clock = [0.0]

    def run(problem, *arguments, run=Problem.run, **options):
        clock[0] += 1.0
        return run(problem, *arguments, **options)

    def settle(search, x, *arguments, settle=Search._settle):
        while 'presliding' not in str(search.objective.free):
            x = x + 1e-9
            search.objective.residuals(x)
            clock[0] += 100.0
        return settle(search, x, *arguments)

    try_alone(monkeypatch, 'presliding')
    monkeypatch.setattr(Problem, 'run', run)
    monkeypatch.setattr(Search, '_settle', settle)
    for name in ('time.monotonic', 'timo_sim.fitting.result.monotonic'):
        monkeypatch.setattr(name, lambda: clock[0])
    found = choose_for(HELD, time=9000.0)
    assert re.match('the plain arm: .*best so far of its search', found.ladder[0])
    assert found.scene.values['motor.coulomb_presliding'] == pytest.approx(0.02, rel=0.3)


@pytest.mark.parametrize('made, volts, kept', [
    ({'gravity': [0.5, 0.5]}, 4.0 * VOLTAGE, 'gravity, as of a tilted plane'),
    ({'motor.spring.stiffness': 0.1}, 0.3 * VOLTAGE, 'gravity, as of a tilted plane'),
    ({'motor.spring.stiffness': 0.1}, 4.0 * VOLTAGE, 'a spring on the shaft, as of a cable')])
def test_a_spring_is_kept_where_a_tilted_plane_fits_worse(made, volts, kept, monkeypatch):
    """Within small angles they are alike; beyond those of a record a spring pulls too hard."""
    try_alone(monkeypatch, 'a spring|gravity')
    found = fit(record({**DRY, **made}, volts, told=volts).select('shaft'), [
        'motor.shaft_inertia', 'motor.coulomb_friction'], more=DRY, auto=True, quick=True)
    assert found.ladder[-1].startswith(kept) or found.ladder[-2].startswith(kept)


@pytest.mark.parametrize('first', [False, True])
def test_a_third_of_the_motion_is_predicted_by_a_fit_to_the_rest(first, monkeypatch):
    """What was measured in it has no say: that is off by 1 rad, and the fit is the true one."""
    monkeypatch.setattr(suspects, 'times_of_motion', lambda problem, part: [part * T[-1]])
    third = T <= T[-1] / 3.0 if first else T > T[-1] / 1.5
    rigid, true = {'model.modes': 0}, [2e-3, 0.02]
    measured = record(rigid).select('shaft')
    measured.outputs['shaft'].values[third] += 1.0
    objective = Objective([Problem(ARM.vary(rigid), measured, [
        'motor.shaft_inertia=0.0026~inf', 'motor.viscous_friction=0.015~inf'], {}, T[-1])])
    found = suspects.predict(objective, objective.start, first=first)
    assert np.exp(found.x) == pytest.approx(true, rel=0.02)
    spread = np.std(measured.outputs['shaft'].values)
    assert np.exp(found.errors) * spread == pytest.approx([1.0], rel=0.01)


@pytest.mark.parametrize('found, count', [
    ([(1.0, 4e-4), (0.99997, 2e-4), (0.99996, 2e-4), (0.99995, 2e-4)], 3),
    ([(1.0, 5e-2), (1.0, 5e-2), (0.96, 1e-2), (0.955, 1e-5)], 4), ([(1.0, 1e-5)], 1)])
def test_a_search_goes_on_while_the_fall_that_its_gradient_foresees_is_found(found, count):
    """By differences with a wide or a narrow step, which take turns."""
    search = Search(Objective([Problem(ARM, record(), FREE, {}, T[-1])]))
    minima = [Minimum(cost, search.x, fall) for cost, fall in found]
    search._solve = lambda *arguments: minima.pop(0)
    assert search._end(search.x).cost == found[count - 1][0]
    assert len(minima) == len(found) - count


def test_presliding_is_fitted_from_ways_of_the_motion(monkeypatch):
    """What it would explain to first order says nothing about its way."""
    dry, ways = {'motor.coulomb_friction': 0.06, 'motor.coulomb_speed': 0.2, 'model.modes': 0}, []
    problem = Problem(ARM.vary(dry), record({**dry, 'motor.coulomb_presliding': 0.02}).select(
        'shaft'), ['motor.shaft_inertia', 'motor.coulomb_friction'], {}, T[-1])

    def predict(objective, x, effect=None, sizes=(), stages=1, predict=suspects.predict):
        ways.extend(sizes[:1] if effect and 'presliding' in effect.name else [])
        return predict(objective, x)._replace(sizes=sizes)

    monkeypatch.setattr(suspects, 'predict', predict)
    objective = Objective([problem])
    suspects.suspects(objective, objective.start, 6)
    spread = problem.run(objective.values(objective.start, 0)).shaft.std()
    assert sorted(ways) == pytest.approx([0.005 * spread, 0.05 * spread])


def test_no_interval_is_printed_where_the_model_lacks_much():
    """Of an arm with much dry friction, which the second half of the record shows alone."""
    held = np.where(T < 1.0, VOLTAGE, 0.15 * VOLTAGE)
    measured = record({'motor.coulomb_friction': 0.15}, volts=held, told=held)
    found = fit(measured, ['motor.viscous_friction', 'motor.shaft_inertia'], hold_out=0.5,
                quick=True)
    assert found.misfit > 5.0 and 'no interval' in found.report()
    assert np.isnan([(each.low, each.high) for each in found.estimates.values()]).all()
    assert any('as far off as what was fitted' in each for each in found.warnings)
    each = found.errors['shaft']
    assert found.report().endswith(found.verdict) and found.verdict.startswith(
        f'predicts what was held out with rms errors of {each.hold_out_rms:.2g} rad of shaft (')


def test_outputs_that_are_not_predicted_and_a_first_angle_that_runs_away_are_told():
    """The voltage that is told is not the one that moved the arm."""
    found = fit(record(told=VOLTAGE[::-1]), ['motor.viscous_friction', 'initial.shaft'],
                hold_out=0.5, quick=True)
    told = ' '.join(found.warnings)
    assert found.errors['shaft'].hold_out_r_squared < 0.5
    assert 'what was held out of shaft is not predicted: R^2 is ' in told
    assert 'initial.shaft lets the shaft begin at' in told


def test_the_stiffness_that_a_resonance_would_need_is_told():
    """Of a clamped arm that rings out, beside a scene with twice the stiffness."""
    scene = ARM.vary({'motor.shaft': 'locked', 'initial.modal_coordinates': [0.002, 0.0, 0.0]})
    run = timo_sim.simulate(scene, 8.0, sample_every=2, estimate=False)
    measured = timo_sim.Record.of({}, {'tip_transverse': (run.t, run.deflection()[:, 1])})
    problem = Problem(scene.vary({'arm.young_modulus': 4e11}), measured, ['arm.length'], {}, 8.0)
    line = [*look(problem, {})][-1]
    assert float(re.search('need (.*) times', line)[1]) == pytest.approx(0.5, abs=0.1)


def test_what_a_scene_does_not_hold_of_inputs_is_told():
    found = fit(record(told=0.5 * VOLTAGE), [*FREE, 'voltage.gain'])
    text, = (each for each in found.warnings if 'does not hold' in each)
    gain = float(text.split('voltage.gain = ')[1].split(':')[0])
    assert gain == pytest.approx(2.0, rel=0.05) and text in found.report()
    assert text.endswith(': multiply it by its gain, before an input goes to the scene')


def test_inputs_whose_rates_are_limited_are_not_limited_again():
    measured = record({'motor.coulomb_friction': 0.03})
    measured.inputs['torque'] = measured.inputs.pop('voltage')._replace(values=GAIN * VOLTAGE)
    found = fit(measured, more={'motor.torque_rate_limit': 500.0})
    assert found.suspects[0].name == 'dry friction of the motor'


COARSE = T[::4]


def shaft_of(damping, inertia):
    """Return the angles of rigid shafts under 0.1 N m that begin at rest, shape (..., n)."""
    damping, inertia = np.expand_dims(damping, -1), np.expand_dims(inertia, -1)
    rate = damping / inertia
    return 0.1 / damping * (COARSE + np.expm1(-rate * COARSE) / rate)


@pytest.fixture(scope='module')
def rigid():
    """Return the squares of residuals of a rigid shaft by logarithms, (2,), and its Fit."""
    inertia, damping, noise = 2.0, 0.5, 4.5e-3
    scene = timo_sim.load_scene({}, {
        'carrier.held': 'both', 'model.modes': 0, 'initial.shaft': 0.0, 'integrator.step': 0.008,
        'arm.length': 0.1, 'arm.section.height': 1e-4, 'end_effector.mass': 0.0,
        'end_effector.inertia': 0.0, 'motor.shaft_inertia': inertia,
        'motor.viscous_friction': damping})
    count = len(COARSE)
    seen = shaft_of(damping, inertia) + noise * np.random.default_rng(4).standard_normal(count)
    measured = timo_sim.Record.of({'torque': (COARSE, np.full(count, 0.1))}, {
        'shaft': Channel(COARSE, seen, noise)})
    found = timo_sim.fit(scene, measured, [
        '~inf', 'motor.viscous_friction', 'motor.shaft_inertia'])
    return lambda x: np.sum(((shaft_of(*np.exp(x)) - seen) / noise)**2, axis=-1), found


def test_profile_intervals_are_those_of_the_least_squares(rigid):
    """Of a rigid shaft, whose motion has a closed form; a quadratic one is off by a third."""
    squares, found = rigid
    each, inertia = found.estimates['motor.viscous_friction'], found.values['motor.shaft_inertia']
    assert each.profile and ' N m s/rad  by profile' in found.report()

    def least(friction):
        """Return the least squares with this logarithm of the friction."""
        return minimize_scalar(lambda other: squares([friction, other]),
                               np.log(inertia) + np.array([-0.1, 0.1]), tol=1e-10).fun

    best = np.log(each.value)
    for end, far in ((each.low, best - 4.0), (each.high, best + 2.0)):
        exact = brentq(lambda at: least(at) - least(best) - 1.959964**2, far, best)
        # An end is accepted where the root of the rise is within 3 % of what it should be.
        assert np.log(end) - best == pytest.approx(exact - best, rel=0.04)


def test_samples_are_those_of_the_posterior(rigid):
    """Of all values on a grid of logarithms, each weighted by its likelihood."""
    squares, found = rigid
    samples = found.sample(4000, seed=3)
    axes = [np.linspace(-3.5, 0.5, 200), np.linspace(0.4, 0.9, 100)]
    least = squares(np.log([*found.values.values()]))
    weights = np.exp(-0.5 * (squares(np.meshgrid(*axes, indexing='ij')) - least))
    for k, (name, axis) in enumerate(zip(found.estimates, axes)):
        whole = np.cumsum(weights.sum(axis=1 - k))
        drawn = np.log(samples.values[name])
        for part in (0.05, 0.5, 0.95):
            exact = np.interp(part, whole / whole[-1], axis)
            share = np.mean(drawn <= exact)
            # Four standard deviations of a share of `effective` samples.
            assert abs(share - part) < 4.0 * np.sqrt(part * (1.0 - part) / samples.effective)
    first = found.scene.vary(samples.variations[0])
    assert first.values['motor.viscous_friction'] == samples.values['motor.viscous_friction'][0]


def test_the_certified_loop_is_that_of_a_simulator(monkeypatch):
    """Overshoot and settling of example/certify.py, from a Simulator in a loop."""
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / 'example')
    import certify
    scenes = [timo_sim.load_scene(certify.ARM, {'end_effector.mass': mass}) for mass in (
        0.05, 0.08)]
    found = np.transpose(certify.slew(scenes, *np.array([[0.5, -1.0], [0.3, 0.6]])))
    for scene, stroke, begin, (overshoot, settled) in zip(scenes, (0.5, -1.0), (0.3, 0.6), found):
        simulator, last, angles = timo_sim.Simulator(scene), 0.0, []
        for k in range(round(certify.DURATION / certify.PERIOD)):
            t, shaft = k * certify.PERIOD, simulator.motion.shaft
            s = min(t / certify.SLEW, 1.0)
            goal = certify.GOAL * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
            speed = certify.GOAL * 30.0 * (s * (1.0 - s))**2 / certify.SLEW
            simulator.step(
                voltage=certify.STIFFNESS * (goal - shaft) + certify.DAMPING * (
                    speed - (shaft - last) / certify.PERIOD),
                tip_force=(0.0, stroke * (begin <= t < begin + certify.STROKE_LASTS)),
                duration=certify.PERIOD)
            last = shaft
            x, y = simulator.position()
            angles.append(np.arctan2(y, x) / certify.GOAL - 1.0)
        assert overshoot == pytest.approx(max(angles), rel=1e-6)
        late = max(k for k, angle in enumerate(angles) if abs(angle) > certify.BAND)
        assert certify.PERIOD * (late + 1) <= settled <= certify.PERIOD * (late + 2)
        assert settled < certify.DURATION - 0.1
    # If all of n are good, the lower end is where this has a probability of 2.5 %.
    assert certify.between(100, 100) == (pytest.approx(0.025**0.01), 1.0)
