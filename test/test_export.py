# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A scene in C: the bits of `Simulator`, bad calls, what is refused, other processors."""

from functools import partial
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

from conftest import code_for_any_size, OF_SNAPSHOTS
import timo_sim
from timo_sim.export.c import write_c
from timo_sim.export.constants import interface_of
from timo_sim.model.layout import FORCE_X, LOADS, place, rotate, TORQUE
from timo_sim.export.instance import MODAL, SAVED
from timo_sim.scene.parameters import PARAMETERS
from timo_sim.simulation.finer import refine

ROOT = Path(__file__).resolve().parents[1]
RUN, ABUSE, LOOP = (ROOT / 'test/data' / name for name in (
    'run_arm.c', 'abuse_arm.c', 'loop_arm.c'))
CC = shutil.which('cc')
# Compiler and emulator of other processors, and their number in headers of ELF.
CROSS = {name: (shutil.which(f'{name}-linux-gnu-gcc'), shutil.which(f'qemu-{name}'), number)
         for name, number in (('aarch64', 183), ('riscv64', 243))}
pytestmark = pytest.mark.skipif(CC is None, reason='needs a C compiler')
NO_LOADS = {name: () for name in PARAMETERS if name.startswith('load.')}
GEAR = {'motor.gear.stiffness': 900.0, 'motor.gear.damping': 2.0, 'motor.gear.backlash': 0.01,
        'motor.rotor.inertia': 0.5, 'motor.rotor.coulomb_friction': 0.1,
        'motor.rotor.viscous_friction': 0.2, 'motor.coulomb_friction': 0.1,
        'motor.coulomb_speed': 0.2, 'motor.coulomb_asymmetry': 0.5}
LIMITED = {'motor.dc.resistance': 2.0, 'motor.dc.torque_constant': 0.5,
           'motor.dc.current_limit': 0.8, 'initial.shaft_velocity': 0.5}
DRIVEN = {'motor.shaft': 'driven', 'motor.drive.time': [0.0, 0.0303, 0.05],
          'motor.drive.angle': [0.0, 0.5, 1.0], 'motor.drive.speed': [0.0, 30.0, 10.0],
          'motor.drive.acceleration': [0.0, 100.0, 0.0],
          'load.tip_force_x.harmonic.amplitude': [3.0],
          'load.tip_force_x.harmonic.frequency': [11.0],
          'load.tip_force_x.harmonic.phase': [0.4]}
# Each has several features, since each takes two seconds to export and compile.
SCENES = {
    'free': {},
    'held': {'carrier.held': 'both', 'initial.shaft_velocity': 3.0, 'gravity': [0.0, -9.81],
             'arm.damping_ratio': [0.01], 'load.torque.harmonic.amplitude': [5.0, 2.0],
             'load.torque.harmonic.frequency': [3.0, 7.0]},
    # Knots on and between steps, a jump.
    'locked': {'motor.shaft': 'locked', 'initial.carrier_x_velocity': 0.5,
               'load.force_x.table.time': [0.001, 0.0105, 0.03, 0.03, 0.0717],
               'load.force_x.table.value': [0.0, 3.0, -1.0, 1.0, 0.0]},
    'viscous, smooth, limits of rates': {
        'motor.viscous_friction': 0.1, 'carrier.viscous_friction': 2.0,
        'motor.coulomb_friction': 0.2, 'motor.coulomb_speed': 0.1,
        'motor.torque_rate_limit': 150.0, 'carrier.force_rate_limit': 400.0,
        'motor.torque_limit': 1.5,
        'load.torque.piecewise.time': [0.0, 0.02, 0.05],
        'load.torque.piecewise.value': [1.0, -1.0, 0.5]},
    'limited current, presliding': {
        **LIMITED, 'motor.coulomb_friction': 0.8, 'motor.coulomb_presliding': 1e-3,
        'motor.coulomb_static': 0.6, 'motor.coulomb_speed': 0.2, 'carrier.coulomb_friction': 1.0,
        'carrier.force_limit': 3.0},
    'presliding behind a gear': {
        'model.modes': 2, 'motor.gear.stiffness': 900.0, 'motor.rotor.inertia': 0.5,
        'motor.rotor.coulomb_friction': 0.1, 'motor.rotor.coulomb_presliding': 2e-3,
        'motor.coulomb_friction': 0.2, 'motor.coulomb_presliding': 1e-3,
        'motor.coulomb_asymmetry': 0.5, 'initial.shaft_velocity': 0.05},
    'axial': {'model.modes': 2, 'model.axial_modes': 1, 'initial.shaft_velocity': 5.0,
              'hub.radius': 0.3},
    'rigid, with a motor': {
        'model.modes': 0, 'motor.dc.resistance': 2.0, 'motor.dc.torque_constant': 0.5,
        'motor.dc.voltage_limit': 1.0, 'load.torque.piecewise.time': [0.0],
        'load.torque.piecewise.value': [0.3], 'payload.time': [0.01, 0.05],
        'payload.mass': [4.0, 1.0], 'payload.inertia': [0.5, 0.1]},
    'limited current behind a gear, hub, gravity': {
        **LIMITED, **GEAR, 'hub.radius': 0.3, 'gravity': [1.0, 2.0],
        'arm.damping_ratio': [0.02]},
    'five modes, a static shape, push, an axial mode slowed down': {
        'model.modes': 5, 'push.position': 0.5, 'sensor.root_strain.position': 0.7,
        'sensor.tip_imu.position': 0.3, 'end_effector.mass': 0.0,
        'end_effector.inertia': 0.0, 'model.axial_modes': 1, 'initial.shaft_velocity': 5.0,
        'integrator.step': 0.005},
    'sectors, sticking': {'carrier.held': 'x', 'initial.shaft_velocity': 20.0,
                          'motor.torque_limit': 0.5, 'carrier.coulomb_friction': 0.5},
    'all held': {'carrier.held': 'both', 'model.axial_modes': 1, 'motor.shaft': 'locked',
                 'push.position': 0.7, 'gravity': [1.0, 2.0], 'arm.damping_ratio': [0.02]},
    'driven': DRIVEN,
    'newton': {'model.formulation': 'newton', 'model.modes': 1, 'carrier.held': 'x',
               'initial.shaft_velocity': 2.0, 'push.position': 0.4, 'gravity': [1.0, -9.0],
               'hub.radius': 0.3, 'sensor.root_strain.position': 0.3,
               'sensor.tip_imu.position': 0.8},
    'driven newton': {**DRIVEN, 'model.formulation': 'newton', 'model.modes': 1},
    'payloads, one axis held': {
        'payload.time': [0.03, 0.031, 0.06], 'payload.mass': [4.0, 5.0, 0.5],
        'payload.inertia': [0.2, 0.3, 0.0], 'payload.offset': [0.2, 0.1, 0.0],
        'end_effector.pick_up': 'at_rest', 'carrier.held': 'x',
        'carrier.coulomb_friction': 1.0, 'initial.shaft_velocity': 20.0,
        'sensor.root_strain.position': 0.6, 'sensor.tip_imu.position': 1.9},
}
# Derivatives of steps take most of the time of an export; these have them.
DIFFERENTIATED = ['held', 'locked', 'presliding behind a gear', 'sectors, sticking', 'newton']


export = partial(write_c, derivatives=False)


@pytest.fixture(autouse=True, scope='module')
def any_size_of_snapshots(any_size):
    """Let snapshots, whose accelerations are compared to 1e-6, run code for any size."""
    with code_for_any_size(OF_SNAPSHOTS):
        yield


def scene_of(changes):
    return timo_sim.load_scene('paper', {**NO_LOADS, **changes})


def compile_program(source, folder, *options, cc=CC):
    """Return the program of a C source and the object file in a folder."""
    program = folder / 'program'
    subprocess.run([cc, '-std=c99', '-Wall', '-Wextra', '-Werror', *options, f'-I{folder}', '-o',
                    program, source, folder / 'arm.o', '-lm'], check=True)
    return program


def run_program(program, lines, *emulator):
    """Return the numbers that the program of RUN prints, a row for each line."""
    found = subprocess.run([*emulator, program], input='\n'.join(lines), text=True, check=True,
                           stdout=subprocess.PIPE).stdout
    return [[float.fromhex(word) for word in line.split()] for line in found.splitlines()]


def compare(scene, program, calls=30):
    """
    Run a scene in C and in Python under the same random commands.

    Returns states, motions and outputs of sensors, forces and energy in C, then in Python.
    """
    simulator, random = timo_sim.Simulator(scene), np.random.default_rng(1)
    lines, states, motions, wanted = [], [], [], []
    for _ in range(calls):
        commanded = np.zeros(LOADS)
        for number, each in enumerate(interface_of(scene, False).inputs):
            commanded[each.column] = random.normal()
            lines.append(f'i {number} {commanded[each.column].hex()}')
        count = int(random.integers(1, 9))
        lines += [f's {count}', 'w', 'o']
        simulator.advance(count, commanded)
        states.append(simulator._state.copy())
        motions.append(simulator.motion.values)
        now, seen = simulator.snapshot(), simulator.sensors  # without noise
        along, across, rotation = now.tip
        wanted.append([along - now.model.tip_point.lever[0], across,
                       *place(*now.joint_positions, along, across),
                       now.joint_positions[2] + rotation, seen.gyro, seen.encoder, seen.rotor,
                       *seen.tip_acceleration, seen.root_strain, *now.effort, now.energy,
                       now.joint_positions[2] + now.model.seen.tip(now.motion)[2]])
    found = run_program(program, lines)
    state, output = np.array(found[0::2]), np.array(found[1::2])
    modes = len(simulator.model.modes)
    # The order of a motion: positions, modal coordinates, rates of both.
    order = [1, 2, 3, *range(MODAL, MODAL + modes), 4, 5, 6,
             *range(MODAL + modes, MODAL + 2 * modes)]
    np.testing.assert_allclose(output[-1, 0], simulator.t, rtol=1e-15)
    read = [10, 11, 7, 8, 9, *range(12, 22), MODAL + 2 * modes]
    return (state[:, SAVED:], output[:, order], output[:, read],
            np.array(states), np.array(motions), np.array(wanted))


def compare_shapes(scene, program):
    """Assert that the centre line is that of views, and ends at the tip."""
    simulator = timo_sim.Simulator(scene)
    line, outputs = run_program(program, ['s 70', 'c', 'o'])
    simulator.advance(70)
    wanted = simulator.model.shape(simulator.motion.values[np.newaxis])[0, 1:]  # without the hub
    np.testing.assert_allclose(np.reshape(line, (-1, 2)), wanted, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(line[-2:], outputs[7:9], rtol=0.0, atol=1e-12)


def compare_derivatives(scene, program):
    """Assert that derivatives have the bits of Python, and the steps after them, too."""
    locked = scene.values['motor.shaft'] == 'locked'
    simulator, numbers = timo_sim.Simulator(scene), interface_of(scene, False).inputs
    place = [each.column for each in numbers].index(FORCE_X if locked else TORQUE)
    inputs = ['force'] if locked else ['torque']
    held = np.where(np.arange(LOADS) == numbers[place].column, 0.7, 0.0)
    simulator.advance(9, held)
    simulator.advance(3, held)
    rows = run_program(program, [
        f'i {place} {0.7.hex()}', 's 9', f'i {place} {1.4.hex()}', 'd',  # of a step not done
        f'i {place} {0.7.hex()}', 's 3', f'i {place} {(-0.4).hex()}', 'd', 's 1', 'o'])[1:]
    command = (-0.4, 0.0) if locked else -0.4
    wanted = simulator.step_derivatives(inputs, **{inputs[0]: command})
    size = simulator.model.size
    found = np.reshape(rows[0], (-1, size)).T
    assert np.array_equal(found[:, :size], wanted.by_motion)
    assert np.array_equal(found[:, size + place], wanted.by_input[:, 0])
    assert rows[1][3] == simulator.motion.shaft


@pytest.mark.parametrize('name', SCENES)
def test_bits(name, tmp_path):
    """
    Motions and derivatives in C are those of Simulator, sensors, forces and energy of a Snapshot.

    Accelerations of both are differences, good to some 1e-8. The object file refers to nothing
    else.
    """
    scene, differentiated = scene_of(SCENES[name]), name in DIFFERENTIATED
    write_c(scene, tmp_path, derivatives=differentiated)
    found = subprocess.run(['nm', '-u', tmp_path / 'arm.o'], check=True, stdout=subprocess.PIPE)
    assert found.stdout == b''
    program = compile_program(RUN, tmp_path, *differentiated * ['-DDERIVATIVES'])
    state, motion, outputs, states, motions, wanted = compare(scene, program)
    assert np.ptp(motions, axis=0).max() > 1e-3 or name == 'all held'  # something moves
    np.testing.assert_array_equal(state, states)
    np.testing.assert_array_equal(motion, motions)
    np.testing.assert_array_equal(outputs[:, :2], wanted[:, :2])
    size = np.maximum(np.abs(wanted).max(axis=0), 1e-9)  # some are zero
    off = np.abs(outputs - wanted).max(axis=0) / size
    assert off[[2, 3, 4, 5, 6, 7, 14, 15]].max() < 1e-13 and off.max() < 1e-6
    if scene.values['hub.radius']:
        compare_shapes(scene, program)
    if differentiated:
        compare_derivatives(scene, program)


def test_sensors_have_the_errors_of_the_scene(tmp_path):
    """They read what a Simulator's do, or did a delay before; until then what the first was."""
    late = {'encoder': 5, 'tip_imu': 3, 'root_strain': 1}
    scene = scene_of({**GEAR, 'initial.shaft_velocity': 3.0, 'sensor.seed': 5, **{
        f'sensor.{name}.noise': 0.01 for name in (
            'root_strain', 'tip_acceleration', 'gyro', 'rotor', 'encoder')},
        'sensor.encoder.resolution': 1e-3, 'sensor.gyro.bias': 0.3, **{
        f'sensor.{name}.delay': steps * 0.001 for name, steps in late.items()}})
    export(scene, tmp_path)
    simulator, read = timo_sim.Simulator(scene), []
    for _ in range(13):
        seen = simulator.sensors
        read.append([seen.gyro, seen.encoder, seen.rotor, *seen.tip_acceleration,
                     seen.root_strain])
        simulator.step(torque=1.0)
    delays = [late.get(name, 0) for name in (
        'tip_imu', 'encoder', 'rotor', 'tip_imu', 'tip_imu', 'root_strain')]
    at = np.maximum(np.arange(13)[:, np.newaxis] - delays, 0)
    found = run_program(compile_program(RUN, tmp_path), [
        'i 4 1.0', 'o', *6 * ['s 1', 'o'], 'g', *6 * ['s 1', 'o'], 'r', 'p', 's 6', 'o'])
    wanted = np.array(read)[at, range(6)]
    np.testing.assert_allclose(np.array(found[:13])[:, 12:18], wanted, rtol=1e-6, atol=1e-12)
    np.testing.assert_array_equal(np.array(found[:13])[:, 13], wanted[:, 1])
    assert found[13] == found[12]  # a saved state has what is under way


def test_other_processors_differ_by_round_off(tmp_path):
    scene = scene_of({})
    export(scene, tmp_path, 'x86-64-v2')
    assert b'' == subprocess.run(['nm', '-u', tmp_path / 'arm.o'], check=True,
                                 stdout=subprocess.PIPE).stdout
    _, motion, _, _, motions, _ = compare(scene, compile_program(RUN, tmp_path))
    np.testing.assert_allclose(motion, motions, rtol=0.0, atol=1e-12 * np.abs(motions).max())


@pytest.mark.parametrize('other, name, estimate', [
    ('aarch64', 'free', True),
    ('aarch64', 'five modes, a static shape, push, an axial mode slowed down', False),
    ('riscv64', 'held', False)])
def test_an_emulated_processor_differs_by_round_off(other, name, estimate, tmp_path):
    """All outputs, 4 N m at the shaft for 1000 steps; tiny rates and accelerations to 1e-6."""
    cross, qemu, number = CROSS[other]
    scene, found = scene_of({**SCENES[name], 'sensor.encoder.noise': 0.1}), []
    torque = [each.column for each in interface_of(scene, False).inputs].index(TORQUE)
    for target, options, cc, emulator in (
            ('host', [], CC, []), (other, ['-static'], cross, [qemu])):
        folder = tmp_path / target
        export(scene, folder, target, estimate=estimate)
        if target == other:
            content = (folder / 'arm.o').read_bytes()
            assert content[:4] == b'\x7fELF' and content[18] == number
            if not cross or not qemu:
                pytest.skip(f'needs qemu-user and gcc-{other}-linux-gnu')
        found.append(run_program(compile_program(RUN, folder, *options, cc=cc), [
            f'i {torque} 4', *20 * ['s 50', 'o']], *emulator))
    here, there = np.array(found)
    scale = np.maximum(np.abs(here).max(axis=0), 1e-9)  # some are zero
    assert np.ptp(here, axis=0).max() > 0.1 and np.isfinite(there).all()
    difference = np.abs(there - here).max(axis=0) / scale
    assert difference.max() < 1e-6 and difference[:15].max() < 1e-12


def test_saved_state_goes_on_to_the_bit(tmp_path):
    """Also of the finer run, and before a load is picked up; and a reset begins anew."""
    export(timo_sim.load_scene('paper', {
        'model.modes': 1, 'payload.time': [0.03], 'payload.mass': [4.0],
        'payload.inertia': [0.2]}), tmp_path, estimate=True)
    begin, going_on = ['i 4 0.7', 's 20'], ['w', 's 15', 'o', 'w']
    found = run_program(compile_program(RUN, tmp_path), [
        *begin, 'g', *going_on, 'i 4 -1', 's 40', 'p', *going_on, 'r', *begin, *going_on])
    first, again, anew = (found[k:k + 3] for k in (0, 3, 6))
    assert first == again == anew


def test_parameters_that_are_set_are_those_of_a_changed_scene(tmp_path):
    """While a torque moves to its goal, and a force is held; a saved state has them."""
    scene = scene_of({'motor.torque_rate_limit': 40.0, 'carrier.force_limit': 3.0})
    changes = {'motor.torque_rate_limit': 17.0, 'carrier.force_limit': 1.5,
               'motor.torque_limit': 0.9}
    export(scene, tmp_path)
    interface, simulator = interface_of(scene, False), timo_sim.Simulator(scene)
    columns, titles = ([getattr(each, name) for each in group] for name, group in (
        ('column', interface.inputs), ('title', interface.parameters)))
    commanded = np.zeros(LOADS)
    commanded[[TORQUE, FORCE_X]] = 2.0, 7.0
    begin = [f'i {columns.index(column)} {commanded[column]}' for column in (TORQUE, FORCE_X)]
    limits = [f'l {titles.index(name.replace(".", "_"))} {value}'
              for name, value in changes.items()]
    after = ['s 60', 'w']
    found = run_program(compile_program(RUN, tmp_path), [
        *begin, 's 20', *limits, 'g', *after, 'r', 'p', *after, 'r', *begin, *after])
    simulator.advance(20, commanded)
    simulator.change(scene.vary(changes))
    simulator.advance(60, commanded)
    np.testing.assert_array_equal(found[0][SAVED:], simulator._state)
    assert found[1] == found[0]
    anew = timo_sim.Simulator(scene.vary(changes))  # parameters outlive a reset
    anew.advance(60, commanded)
    np.testing.assert_array_equal(found[2][SAVED:], anew._state)


def test_estimated_error(tmp_path):
    """It is that of Simulator, up to the round-off of two positions of the tip, about 1 m."""
    scene = timo_sim.load_scene('paper')
    export(scene, tmp_path, estimate=True)
    simulator, torque = timo_sim.EstimatingSimulator(scene), np.zeros(LOADS)
    torque[4], errors = 2.0, []
    for _ in range(100):
        simulator.advance(1, torque)
        errors.append(simulator.estimated_error)
    found = run_program(compile_program(RUN, tmp_path), ['i 4 2.0', *100 * ['s 1', 'o']])
    assert errors[-1] > 1e-8
    np.testing.assert_allclose([row[-1] for row in found], errors, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize('kp, kd, count, least, most', [
    (2000.0, 300.0, 900, 50.0, np.inf),  # alone it falls
    (30000.0, 100.0, 200, 0.0, 0.95)])   # its vibration is damped little
def test_estimated_error_of_a_closed_loop(kp, kd, count, least, most, tmp_path):
    """
    It is that of the loop of a much finer run, if the finer run has its own controller.

    An arm that stands on end: with the inputs of the scene's run the finer one falls, or errors
    that the controller makes are not seen.
    """
    scene = scene_of({'carrier.held': 'both', 'gravity': [0.0, -9.81], 'initial.shaft': 1.4,
                      'integrator.step': 0.005, 'model.modes': 2})
    export(scene, tmp_path, estimate=True)
    program = compile_program(LOOP, tmp_path, *(f'-D{name}={value}' for name, value in (
        ('KP', kp), ('KD', kd), ('GOAL', 1.5), ('COUNT', count))))
    tips, found = [], []
    for arguments in ['its own controller'], []:
        lines = subprocess.run([program, *arguments], check=True, text=True,
                               stdout=subprocess.PIPE).stdout.splitlines()
        *tips, (stated,) = ([float.fromhex(word) for word in line.split()] for line in lines)
        found.append(stated)
    finer = timo_sim.Simulator(refine(scene, 8, modes=4))
    motions = np.empty((count, finer.motion.values.size))
    for each in motions:
        shaft, speed = finer.motion.shaft, finer.motion.shaft_velocity
        each[:] = finer.step(torque=kp * (1.5 - shaft) - kd * speed, duration=scene.step).values
    places = rotate(motions[:, 2], *finer.model.tips(motions)[:, :2].T)
    apart = np.linalg.norm(np.transpose(places) - tips, axis=1)
    assert found[0] == pytest.approx(apart.max(), rel=0.02)  # the finer run has an error, too
    assert least * apart.max() <= found[1] <= most * apart.max()


@pytest.mark.parametrize('changes, estimate', [
    ({}, True), ({'carrier.held': 'y'}, False),
    ({'motor.shaft': 'locked', 'model.formulation': 'newton'}, False)])
def test_bad_calls_return_codes(changes, estimate, tmp_path):
    export(scene_of(changes), tmp_path, estimate=estimate)
    check = ['-fsanitize=address,undefined'] if subprocess.run(
        [CC, '-fsanitize=address,undefined', '-x', 'c', '-', '-o', tmp_path / 'tried'],
        input=b'int main(void) { return 0; }', capture_output=True).returncode == 0 else []
    found = subprocess.run([compile_program(ABUSE, tmp_path, '-g', *check)], text=True,
                           capture_output=True)
    assert (found.stdout, found.stderr, found.returncode) == ('', '', 0)


@pytest.mark.skipif(shutil.which('cmake') is None, reason='needs CMake')
def test_page(tmp_path):
    """The commands of doc/export.md and its program, literally."""
    page = (ROOT / 'doc/export.md').read_text()
    commands, *_ = re.findall(r'^```\n(.*?)^```', page, re.DOTALL | re.MULTILINE)  # others: FMUs
    more = re.findall(r'`(cc [^`]*)`', page)
    assert len(more) == 2
    script = commands.replace('timo_sim ', f'{sys.executable} -m timo_sim ')
    found = subprocess.run(['sh', '-ec', '\n'.join([script, *more])], cwd=tmp_path, text=True,
                           stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                           env={**os.environ, 'PYTHONPATH': str(ROOT)})
    assert found.returncode == 0, found.stdout
    rows = found.stdout[found.stdout.index('time'):].splitlines()[:22]
    assert 'tip_transverse' in rows[0]
    motion = timo_sim.Simulator(timo_sim.load_scene('paper')).step(torque=1.0, duration=2.0)
    assert float(rows[-1].split()[1]) == pytest.approx(motion.shaft, rel=1e-8)
    program, = re.findall(r'^```c\n(.*?)^```', page, re.DOTALL | re.MULTILINE)
    (tmp_path / 'program.c').write_text(program)
    (tmp_path / 'arm.o').write_bytes((tmp_path / 'paper_in_c/arm.o').read_bytes())
    (tmp_path / 'arm.h').write_bytes((tmp_path / 'paper_in_c/arm.h').read_bytes())
    subprocess.run([compile_program(tmp_path / 'program.c', tmp_path)], check=True)


def test_refused(tmp_path):
    for changes, options, message in (
            ({'model.accuracy': 1e-5}, {}, 'model.accuracy must be 0'),
            ({'carrier.held': 'x', 'model.axial_modes': 1}, {}, 'model.axial_modes must be 0'),
            ({}, {'target': 'pdp11'}, 'target must be host, x86-64-v2'),
            ({}, {'name': 'my arm'}, 'name must be')):
        with pytest.raises(timo_sim.ParameterError, match=message):
            timo_sim.export_c(scene_of(changes), tmp_path / 'arm', **options)
        assert not (tmp_path / 'arm').exists()


EXPORTS = """
from pathlib import Path
import timo_sim
from timo_sim.export.ros2_control import write_hardware
scene = timo_sim.load_scene('paper', {'model.modes': 0})
before = {*Path('code').rglob('*')}
for export, *arguments, path in (
        (timo_sim.export_c, 'pipe'), (timo_sim.export_c, '.'), (timo_sim.export_fmu, 'pipe'),
        (timo_sim.export_fmu, 'pipe/arm.fmu'), (write_hardware, scene.values, 'pipe')):
    try:
        export(scene, *arguments, path)
    except OSError as error:
        print(error)
print(len({*Path('code').rglob('*')} - before))
"""


def test_exports_onto_a_fifo_are_refused_before_anything_is_compiled(tmp_path):
    for name in 'pipe', 'arm.o':
        os.mkfifo(tmp_path / name)
    told = subprocess.run(
        [sys.executable, '-c', EXPORTS], cwd=tmp_path, text=True, capture_output=True, check=True,
        env={**os.environ, 'PYTHONPATH': str(ROOT), 'NUMBA_CACHE_DIR': str(tmp_path / 'code')})
    *lines, made = told.stdout.splitlines()
    assert made == '0' and len(lines) == 5
    assert 'arm.o must be a regular file or none yet' in lines.pop(1)
    assert all('pipe' in line for line in lines)
