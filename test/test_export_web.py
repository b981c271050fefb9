# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A scene as WebAssembly and as a page: the motions of `Simulator`, in node."""

import json
from pathlib import Path
import re
import shutil
import subprocess

import numpy as np
import pytest
import timo_sim
from timo_sim.export import web
from timo_sim.export.c import write_c
from timo_sim.export.constants import interface_of
from timo_sim.export.web import export_web, link_wasm
from timo_sim.model.layout import LOADS, place, TORQUE
from timo_sim.simulation.finer import refine
from test_export import SCENES, scene_of

NEEDED = {'node': 'nodejs', 'wasm-ld': 'lld'}  # programs and packages of Debian
MISSING = [f'{name} ({package})' for name, package in NEEDED.items() if not shutil.which(name)]
pytestmark = pytest.mark.skipif(bool(MISSING), reason=f'needs {" and ".join(MISSING)}')
# Prints all outputs after each of 10 times 100 steps under a torque.
PROGRAM = """
const [path, torque, count] = process.argv.slice(1);
const content = require('fs').readFileSync(path);
const arm = new WebAssembly.Instance(new WebAssembly.Module(content), {}).exports;
const size = arm.arm_size(), place = (arm.__heap_base.value + 63) & ~63;
const room = (place + size + 63) & ~63;
arm.memory.grow(Math.ceil((room + 8 * count) / 65536));
const values = new Float64Array(arm.memory.buffer, room, Number(count));
if (arm.arm_create(place, size)) throw 'not created';
if (torque >= 0) arm.arm_set_input(place, Number(torque), 0.7);
for (let k = 0; k < 10; ++k) {
    if (arm.arm_step(place, 100n) || arm.arm_get_outputs(place, room)) throw 'not stepped';
    console.log(JSON.stringify(Array.from(values)));
}
"""
HUB = {'hub.radius': 0.3, 'gravity': [1.0, 2.0], 'arm.damping_ratio': [0.02]}


@pytest.mark.parametrize('name, target', [
    ('free', 'wasm32'), ('hub', 'wasm32-simd128'), ('presliding behind a gear', 'wasm32-simd128')])
def test_a_thousand_steps_are_those_of_simulator(name, target, tmp_path):
    """Scenes with a hub, an elastic gear, dry friction and gravity are among them."""
    scene = scene_of({'hub': HUB, **SCENES}[name])
    write_c(scene, tmp_path, target, derivatives=False)
    (tmp_path / 'arm.wasm').write_bytes(link_wasm((tmp_path / 'arm.o').read_bytes()))
    interface, simulator = interface_of(scene, False), timo_sim.Simulator(scene)
    torque = [each.column for each in interface.inputs].index(TORQUE)
    found = subprocess.run(['node', '-e', PROGRAM, tmp_path / 'arm.wasm', str(torque),
                            str(len(interface.outputs))], check=True, capture_output=True)
    commanded, modes = np.zeros(LOADS), len(simulator.model.modes)
    commanded[TORQUE] = 0.7
    motions = simulator.advance(1000, commanded, 100)[0][1:]
    names = ['carrier_x', 'carrier_y', 'shaft', *(f'mode_{n + 1}' for n in range(modes))]
    places = {output.title: place for place, output in enumerate(interface.outputs)}
    order = [places[name] for name in names] + [
        places[f'{name}_rate' if 'mode' in name else f'{name}_velocity'] for name in names]
    rows = np.array([json.loads(line) for line in found.stdout.splitlines()])[:, order]
    assert np.ptp(motions, axis=0).max() > 0.01
    assert np.abs(rows - motions).max() < 1e-13 * np.abs(motions).max()


# Prints shaft and tip after 300 steps of each arm of a page.
ARMS = """
const fs = require('fs'), [script, page] = process.argv.slice(1);
// The parts that need no page.
eval(fs.readFileSync(script, 'utf8').split('const scenes =')[0] + 'globalThis.load = load;');
const [scene] = JSON.parse(fs.readFileSync(page, 'utf8').match(/id="scenes">(.*?)<\\/script>/)[1]);
load(scene).then(arm => {
    for (let station = 0; station < scene.loops.length; ++station) {
        arm.choose(station);
        arm.reset();
        arm.step(300);
        console.log(JSON.stringify(['shaft', 'tip_x', 'tip_y'].map(name => arm.get(name))));
    }
});
"""


def test_sliders_of_a_page_choose_other_arms(tmp_path):
    """They run as a Simulator of another mass, damping or stiffness does."""
    scene = scene_of({'initial.shaft_velocity': 1.0, 'initial.modal_coordinates': [0.02, 0, 0]})
    page = export_web({'arm': scene}, tmp_path / 'arm.html', estimate=False)
    found = subprocess.run(['node', '-e', ARMS, Path(web.__file__).with_name('arm.js'), page],
                           check=True, capture_output=True)
    rows = [json.loads(line) for line in found.stdout.splitlines()]
    data, = json.loads(re.search('id="scenes">(.*?)</script>', page.read_text())[1])
    numbers = {each['label']: dict(each['stations']) for each in data['sliders']}
    for label, value, changes in (
            ('mass at the tip', 4.0, {'end_effector.mass': 4.0}),
            ('damping ratio', 0.02, {'arm.damping_ratio': [0.02]}), ('stiffness', 0.5, None)):
        simulator = timo_sim.Simulator(scene if changes else scene.vary({
            'arm.young_modulus': 0.5 * 70.5e9, 'arm.shear_modulus': 0.5 * 27e9}))
        if changes:
            simulator.change(scene.vary(changes))
        simulator.advance(300)
        snapshot = simulator.snapshot()
        x, y, theta = snapshot.joint_positions
        wanted = theta, *place(x, y, theta, *snapshot.tip[:2])
        assert rows[numbers[label][value]] == pytest.approx(wanted, abs=1e-12)
        assert np.abs(np.subtract(wanted, rows[0])).max() > 1e-4
    assert len(rows) == 13 and data['loops'][0]['frequency'] > 1.0


# Prints the torque at the shaft: at first, without the scene's loads, after a step, and with them;
# then the largest torque of a step of the closed loop, and where the shaft ends.
TORQUES = ARMS.split('load(scene)')[0].replace('load;', '[load, Loop, clamp];') + """
const [read, Goal] = globalThis.load;
const html = fs.readFileSync(script.replace(/js$/, 'html'), 'utf8');
const size = Number(html.match(/id="size".*value="(.*?)"/)[1]), law = scene.loops[0];
read(scene).then(arm => {
    const print = (...values) => console.log(JSON.stringify(values)), loop = new Goal();
    const now = () => arm.get('shaft_torque');
    const first = now();
    arm.useLoads(false);
    arm.reset();
    const without = now();
    arm.step(1);
    const after = now();
    arm.useLoads(true);
    arm.reset();
    print(first, without, after, now());
    arm.useLoads(false);
    arm.reset();
    const begin = arm.get('shaft');
    loop.hold(0, begin);
    loop.begin(0, begin + size, law, false);
    let most = 0;
    while (arm.get('time') < 60) {
        const torque = law.gains[0] * (loop.goalAt(arm.get('time')) - arm.get('shaft'))
            - law.gains[1] * arm.get('shaft_velocity');
        most = Math.max(most, Math.abs(torque));
        arm.set('torque', torque);
        arm.step(1);
    }
    print(most, (arm.get('shaft') - begin) / size);
});
"""


@pytest.mark.parametrize('name, values', [
    ('arm', {}), ('paper', {'load.torque.piecewise.time': [0.0], 'motor.torque_limit': 100.0,
                            'load.torque.piecewise.value': [3.0]}),
    ('arm', {'motor.dc.resistance': 2.0, 'motor.dc.torque_constant': 0.01,
             'motor.dc.gear_ratio': 10.0, 'motor.dc.current_limit': 15.0})], ids=str)
def test_a_page_without_the_scene_s_loads_has_no_torque_and_a_step_stays_below_the_limit(
        name, values, tmp_path):
    scene = timo_sim.load_scene(name, values)
    page = export_web({name: scene}, tmp_path / 'arm.html', estimate=False)
    found = subprocess.run(['node', '-e', TORQUES, Path(web.__file__).with_name('arm.js'), page],
                           check=True, capture_output=True)
    (first, *rest, again), (most, reached) = (
        json.loads(line) for line in found.stdout.splitlines())
    assert first == again == scene.load_at_start()[TORQUE] != 0.0 and rest == [0.0, 0.0]
    # A step at rest takes the stiffness times its size at once.
    of_current = 0.1 * scene.values['motor.dc.current_limit'] if name != 'paper' else np.inf
    limit = min(scene.values['motor.torque_limit'], of_current)
    assert 0.5 * limit < most < limit
    assert reached == pytest.approx(1.0, abs=0.02)


# Prints the estimated error after a step of the closed loop: with a controller of the finer run,
# and with the commands of the other one.
ERRORS = TORQUES.split('read(scene)')[0] + """
read(scene).then(arm => {
    for (const runs of [2, 1]) {
        arm.reset();
        const begin = arm.get('shaft');
        for (let k = 0; k < 6000; ++k) {
            arm.seen().slice(0, runs).forEach(([x, y, shaft, speed], run) => arm.set(
                'torque', law.gains[0] * (begin + 0.2 - shaft) - law.gains[1] * speed, run));
            arm.step(1);
        }
        console.log(JSON.stringify([arm.get('estimated_tip_error'), law.gains]));
    }
});
"""


def test_the_finer_run_has_a_controller_of_its_own(tmp_path):
    """
    So the error of an arm that stands on end is that of its loop, as two loops in Python differ.

    Its shaft is so light that a controller of a fast loop would ring between the time steps.
    """
    scene = timo_sim.load_scene({
        'arm.length': 0.6, 'arm.material': 'aluminium', 'arm.section.width': 0.03,
        'arm.section.height': 0.003, 'arm.damping_ratio': [0.01], 'end_effector.mass': 0.15,
        'motor.shaft_inertia': 0.002, 'carrier.held': 'both', 'gravity': [0.0, -9.81],
        'integrator.step': 0.002, 'initial.shaft': 0.5 * np.pi})
    page = export_web({'arm': scene}, tmp_path / 'arm.html')
    found = subprocess.run(['node', '-e', ERRORS, Path(web.__file__).with_name('arm.js'), page],
                           check=True, capture_output=True)
    (error, gains), (of_commands, _) = (json.loads(line) for line in found.stdout.splitlines())
    parts, places = interface_of(scene, True).parts, []
    goal = timo_sim.Simulator(scene).motion.shaft + 0.2
    for each, count in (scene, 1), (refine(scene, parts), parts):
        simulator, tips = timo_sim.Simulator(each), []
        for _ in range(6000):
            motion = simulator.motion
            torque = np.zeros(LOADS)
            torque[TORQUE] = gains[0] * (goal - motion.shaft) - gains[1] * motion.shaft_velocity
            simulator.advance(count, torque)
            tips.append(simulator.position())
        places.append(np.array(tips))
    assert error == pytest.approx(
        np.linalg.norm(places[0] - places[1], axis=1).max(), rel=1e-3)
    assert error < 1e-4 and of_commands > 0.1


def test_a_linker_that_is_missing_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv('PATH', '')
    with pytest.raises(OSError, match='apt-get install lld'):
        export_web({'paper': 'paper'}, tmp_path / 'arm.html')


def test_a_rigid_arm_behind_an_elastic_gear_has_a_page():
    """Clamped, it has no vibration of which a bandwidth could be taken; others say why."""
    gear = {'motor.gear.stiffness': 2000.0, 'motor.gear.damping': 30.0,
            'motor.rotor.inertia': 0.1, 'arm.damping_of': 'clamped'}
    loop = web._loop(timo_sim.load_scene('paper', {'model.modes': 0, **gear}))
    assert loop['gains'][0] > 0.0 if 'gains' in loop else 'no gains' in loop['why']
