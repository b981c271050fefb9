# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Export of scenes as a page: one HTML file that a browser opens from a folder, without a network.

The page has the object file of a scene as WebAssembly, and tables of constants that take the place
of its own: those of arms with another mass at the tip, damping or stiffness. Their propagators,
nine tenths of all, it makes of linear parts itself. `arm.js` runs and draws it.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from html import escape
import json
import math
from pathlib import Path
import shutil
import subprocess
import tempfile
from typing import Any
import warnings
import zlib

import numpy as np

from timo_sim.compiled import machine
from timo_sim.control.shaping import shaper
from timo_sim.export.constants import interface_of, refuse, simulators_of
from timo_sim.export.library import library
from timo_sim.model.layout import LOADS
from timo_sim.runs.linear import linearize
from timo_sim.runs.modes import modes
from timo_sim.scene.bodies import motor_constants
from timo_sim.scene.files import check_target, whole_file
from timo_sim.scene.parameters import checked, FLAG, FUNCTION, ParameterError, PATH
from timo_sim.scene.scene import load_scene, Scene, scene_from, SceneLike
from timo_sim.simulation.warnings import inaccurate, MOST_APART
from timo_sim.steps import etdrk4
from timo_sim.steps.loads import SceneLoads
from timo_sim.version import __version__
from timo_sim.view.track import body_of

TARGET = 'wasm32-simd128'  # every browser that can inflate the page has these instructions
_STACK = 2**18  # of the WebAssembly [B]; a step of 40 modes needs less
_FACTORS = 0.25, 0.5, 1.0, 2.0, 4.0  # of mass at the tip and of stiffness
_FRACTIONS = 0.0, 0.1, 0.25, 0.5, 1.0  # of the arm's mass, at a tip without one
_DAMPING = 0.0, 0.005, 0.01, 0.02, 0.05  # ratios of an arm without damping
_BEND = 0.03  # deflection to which the largest forces of sliders bend a clamped arm, in lengths
# Bandwidths of the closed loop that are tried, over the frequency of the clamped arm.
_BANDWIDTHS = 2.0, 1.0, 0.5, 0.2, 0.1
_STEP = 0.2   # size of the first step of its goal, in arm.html [rad]
_SHARE = 0.9  # of the motor's limit that this step takes


@checked(file=PATH, estimate=FLAG, tell=FUNCTION)
def export_web(scenes: Mapping[str, SceneLike], file: Path | str, estimate: bool = True,
               tell: Callable[[str], object] = str) -> Path:
    """
    Write scenes, by the names that the page shows, as one HTML file.

    It needs the linker `wasm-ld`. With `estimate` a finer run is advanced beside each; a scene
    that cannot have one, see `export_c`, goes without. `tell` is called with what is done.

    Raises
    ------
    ParameterError
        If a scene has what an exported arm cannot do.
    OSError
        If there is no linker.

    """
    find_linker()
    check_target(Path(file))
    loaded = {name: load_scene(scene) for name, scene in scenes.items()}
    for scene in loaded.values():
        refuse(scene, False)
    data = []
    for name, scene in loaded.items():
        tell(f'compiling {name}, which takes some 5 s, 20 s for a kind of arm that is new')
        data.append(_scene(name, scene, estimate and not scene.build().sectors))
    # In a script, `<` could end it.
    text = json.dumps(data, separators=(',', ':'), allow_nan=False).replace('<', '\\u003c')
    parts = {'TITLE': escape(', '.join(loaded)), 'VERSION': __version__, 'SCENES': text,
             'SCRIPT': Path(__file__).with_name('arm.js').read_text(encoding='utf-8')}
    page = Path(__file__).with_name('arm.html').read_text(encoding='utf-8')
    for name, content in parts.items():
        page = page.replace(f'<!-- {name} -->', content)
    with whole_file(file) as path:
        path.write_text(page, encoding='utf-8')
    return Path(file)


def find_linker() -> None:
    """Raise OSError if there is no linker for WebAssembly."""
    if not shutil.which('wasm-ld'):
        raise OSError('WebAssembly is linked by wasm-ld, which is not on the PATH: '
                      'apt-get install lld (brew install lld)')


def link_wasm(*contents: bytes) -> bytes:
    """Return the WebAssembly of object files; it imports nothing."""
    find_linker()
    with tempfile.TemporaryDirectory() as folder:
        files = [f'{number}.o' for number in range(len(contents))]
        for file, content in zip(files, contents):
            Path(folder, file).write_bytes(content)
        # A stack at the beginning of the memory traps where it overflows.
        done = subprocess.run(
            ['wasm-ld', '--no-entry', '--strip-all', '--export-dynamic', '--export=__heap_base',
             '--stack-first', '-z', f'stack-size={_STACK}', '-o', 'arm.wasm', *files],
            cwd=folder, capture_output=True, text=True)
        if done.returncode:
            raise OSError(f'wasm-ld cannot link the arm: {done.stderr.strip()}')
        return Path(folder, 'arm.wasm').read_bytes()


def _scene(name: str, scene: Scene, estimate: bool) -> dict[str, Any]:
    """Return what the page knows of a scene."""
    made = library(scene, estimate, TARGET, 'arm', False)
    interface, (tables, sliders, loops) = made.interface, _stations(scene, estimate, made)
    values, body, (along, _, meant) = scene.values, body_of(scene), (
        inaccurate(scene, 1.0, 0.0) or '').partition('1 m')
    target = machine.target_machine(TARGET)
    propagate = target.emit_object(machine.specialise(  # makes propagators of any size
        machine.intermediate_code(etdrk4.propagate, ()), {}, target, 'propagate'))
    return {
        'name': name, 'step': scene.step, 'size': made.size,
        'wasm': _deflated(link_wasm(made.content, propagate)), 'tables': _deflated(tables),
        'blocks': _blocks(made), 'series': etdrk4.SERIES.tolist(),
        'loads': bool(scene.load) and values['motor.shaft'] != 'driven',
        'inputs': [[each.title, each.unit, each.meaning] for each in interface.inputs],
        'outputs': [each.title for each in interface.outputs],
        'parameters': [[each.title, each.unit, each.meaning] for each in interface.parameters],
        'sliders': sliders, 'loops': loops, 'ranges': _ranges(scene), 'hub': values['hub.radius'],
        'body': body._asdict(), 'gravity': list(values['gravity']),
        'free': np.logical_not(scene.build().constrained[:2]).tolist(),
        'warning': [along, meant, MOST_APART * scene.manipulator.arm.length],
        'about': f'{name}: arm of {scene.manipulator.arm.length:g} m, '
        f'{values["model.modes"]} modes of bending, steps of {1e3 * scene.step:g} ms'}


def _blocks(made):
    """
    Return the constants: symbol, offset and length [B], and four numbers, 0 for other constants.

    They are size and step [s] of propagators, and from and to [B] of the scene's own loads.
    """
    steps = {id(each): model.step for model in made.models for each in model.parts[1]}

    def loads(packed):
        first = packed.offsets.get('first_load', 0)  # what an instance begins with
        return (first, first + 8 * LOADS if first else packed.length * (packed.kind is SceneLoads))
    return [[symbol, sum(each.length for each in group[:number]), packed.length,
             packed.sizes['state'] if id(packed) in steps else 0, steps.get(id(packed), 0.0),
             *loads(packed)]
            for symbol, group in made.constants.items() for number, packed in enumerate(group)]


def _deflated(content: bytes) -> str:
    return base64.b64encode(zlib.compress(content, 9)).decode()


def _stations(scene, estimate, made):
    """
    Return what the page needs of arms that differ.

    That is what is exclusive-or of their constants and those of the scene, one after another, but
    the linear parts of propagators as they are; the sliders that choose them, each with its values
    and the number of each arm, 0 is the scene's own; and the closed loops of all arms by number.
    """
    begin, own = 0, np.frombuffer(
        bytearray(made.constants_of(simulators_of(scene, estimate))), np.uint8)
    for _, _, length, size, *_ in _blocks(made):
        begin += 8 * size**2 or length
        own[begin - 8 * size**2:begin] = 0
    tables, sliders, loops = [], [], [_loop(scene)]
    for label, unit, present, changes in _variations(scene):
        chosen = []
        for value, change in changes.items():
            if value == present:
                chosen.append([value, 0])
                continue
            try:
                other = scene_from(scene.vary(change).values, scene.static)
                if interface_of(other, estimate).parts != made.interface.parts:
                    continue
                # Modes of another stiffness have the same shapes; with another mass the first ones
                # stay.
                simulators = simulators_of(other if label == 'stiffness' else scene, estimate)
                if label != 'stiffness':
                    simulators[0].change(other)
                constants = made.constants_of(simulators)
            except (ParameterError, ValueError):  # not of this arm, or of other sizes
                continue
            tables.append(np.frombuffer(constants, np.uint8) ^ own)
            loops.append(_loop(other))
            chosen.append([value, len(tables)])
        if len(chosen) > 1:
            sliders.append({'label': label, 'unit': unit, 'stations': chosen})
    return b''.join(each.tobytes() for each in tables), sliders, loops


def _variations(scene):
    """Yield label, unit and value of a slider, and the changes of the scene for five values."""
    values, mass = scene.values, scene.values['end_effector.mass']
    shown = [mass * factor for factor in _FACTORS] if mass else [
        scene.build().arm_mass * factor for factor in _FRACTIONS]
    yield 'mass at the tip', 'kg', mass, {value: {'end_effector.mass': value} for value in shown}
    if not scene.modal_count:  # it does not bend
        return
    first, *others = np.ravel(values['arm.damping_ratio']).tolist() or [0.0]
    shown = [first * factor for factor in (0.0, *_FACTORS[1:])] if first else [*_DAMPING]
    yield 'damping ratio', '', first, {value: {'arm.damping_ratio': [
        value, *(value / first * each for each in others if first)]} for value in shown}
    stiff = {name: value for name, value in values.items() if name.startswith('arm.')
             and name.endswith(('_modulus', '_stiffness'))}
    yield 'stiffness', 'x', 1.0, {factor: {
        'arm.material': 'none', 'arm.density': values['arm.density'],
        **{name: np.multiply(factor, value).tolist() for name, value in stiff.items()}}
        for factor in _FACTORS}


def _loop(scene):
    """
    Return gains of a controller of the shaft, and how a step of its goal is shaped.

    Or, as 'why', why there is none.
    """
    values = scene.values
    if values['motor.shaft'] != 'free':
        return {'why': f'the shaft is {values["motor.shaft"]}'}
    rest = scene.initial_motion()
    rest[len(rest) // 2:] = 0.0
    if not values['initial.equilibrium']:
        rest[3:] = 0.0
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # of friction, that the model holds for small motions
            model = linearize(scene, rest, 'closed', ['torque_N_m'],
                              ['shaft_rad', 'shaft_velocity_rad_per_s']).to_discrete(scene.step)
            clamped = [*modes(scene, 0.0, 'closed').frequency, 1.0]
    except ParameterError as error:
        return {'why': str(error)}
    # Of the straight arm that does not bend, on a carrier that may recoil.
    free = np.flatnonzero(np.logical_not(scene.build().constrained))
    inertia = 1.0 / np.linalg.inv(
        scene.build().mass_matrix(rest)[0][np.ix_(free, free)])[-1, -1]
    # The torque of a step that begins at rest stays below that of commands and motor.
    limit = min([values['motor.torque_limit'],
                 *(torque for torque, _ in scene.manipulator.motor_limit)])
    most = math.sqrt(_SHARE * limit / (_STEP * inertia))
    for share in _BANDWIDTHS:
        omega = min(2.0 * math.pi * share * clamped[0], most)
        gains = inertia * np.array([omega**2, 1.4 * omega])
        poles = np.log(np.linalg.eigvals(
            model.A - model.B @ gains[np.newaxis] @ model.C).astype(complex)) / scene.step
        if poles.real.max() <= 1e-6 * omega:
            break
    else:
        return {'why': 'no gains were found with which it is stable'}
    # The slowest vibration that takes more than a few periods to decay.
    found = sorted((pole for pole in poles if pole.imag > max(
        3.0 * abs(pole.real), 1e-3 * omega)), key=abs)
    shaped = shaper(found[:1], 'ZV') if found else None
    return {'gains': gains.tolist(),
            'frequency': abs(found[0]) / (2.0 * math.pi) if found else 0.0,
            'damping': -found[0].real / abs(found[0]) if found else 0.0,
            'times': shaped.times.tolist() if shaped else [0.0],
            'amplitudes': shaped.amplitudes.tolist() if shaped else [1.0]}


def _ranges(scene):
    """
    Return the largest values of the page's sliders of inputs, by name.

    And spring and damper by which a pointer pulls the tip, [N/m] and [N s/m].
    """
    arm, values = scene.manipulator.arm, scene.values
    spring = 3.0 * float(np.min(arm.section.bending_stiffness)) / arm.length**3
    force = _BEND * arm.length * spring
    torque = force * (arm.length + values['hub.radius'])
    found = {}
    if values['motor.shaft'] == 'free':
        found['torque'] = min(torque, values['motor.torque_limit'])
        if values['motor.dc.resistance']:
            found['voltage'] = min(
                torque / motor_constants(values)[0], values['motor.dc.voltage_limit'])
    for axis, held in zip('xy', scene.build().constrained):
        if not held:
            found[f'force_{axis}'] = min(2.0 * force, values['carrier.force_limit'])
    found['tip_force_across_arm'] = force
    # Two digits are enough for a slider.
    return {**{name: float(f'{value:.2g}') for name, value in found.items()}, 'spring': spring,
            'damper': math.sqrt(spring * scene.build().mass)}
