# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Compiled code: sine and cosine, memory, sizes of models, the store on disk."""

import math
import os
import shutil
import subprocess
import sys
import threading
import warnings

import numba
from numba.core.runtime import _nrt_python, rtsys
import numpy as np
import pytest

import timo_sim
from timo_sim.compiled import cache
from timo_sim.compiled.cache import is_compiled, lock, size_mark, store_directory
from timo_sim.compiled.functions import entry_point, FASTMATH
from timo_sim.model.functions import rate_once, sincos, tanh
from timo_sim.model.layout import LOADS
from timo_sim.simulation.loads import LoadTable
from timo_sim.simulation.simulator import Simulator


@numba.njit(fastmath=FASTMATH)
def _sincos(angles, sines, cosines):
    for j in range(len(angles)):
        sines[j], cosines[j] = sincos(angles[j])


@pytest.mark.parametrize('largest, limit', [(1.0, 1.0), (1e5, 1.0), (1e6, 1.0)])
def test_sine_and_cosine_to_the_last_place(largest, limit):
    angles = np.concatenate([np.linspace(-largest, largest, 200001),
                             np.arange(-8, 9) * math.pi / 4])
    sines, cosines = np.empty_like(angles), np.empty_like(angles)
    _sincos(angles, sines, cosines)
    # In units of the last place; near a zero in those of 0.1, as the angle is no more accurate.
    for ours, libm in ((sines, np.sin(angles)), (cosines, np.cos(angles))):
        error = np.abs(ours - libm) / np.maximum(np.spacing(np.abs(libm)), np.spacing(0.1))
        assert error.max() <= limit


def test_sine_and_cosine_of_infinity_are_nan():
    angles = np.array([np.nan, np.inf, -np.inf])
    sines, cosines = np.zeros(3), np.zeros(3)
    _sincos(angles, sines, cosines)
    assert np.isnan(sines).all() and np.isnan(cosines).all()


@numba.njit(fastmath=FASTMATH)
def _tanh(values, out):
    for j in range(len(values)):
        out[j] = tanh(values[j])


def test_hyperbolic_tangent():
    values = np.concatenate([np.linspace(-25.0, 25.0, 100001), np.geomspace(1e-300, 25.0, 10001)])
    ours, ends = np.empty_like(values), np.array([np.inf, -np.inf, 0.0, np.nan])
    _tanh(values, ours)
    _tanh(ends, ends)
    # Six doublings add up to 8.3 units of the last place.
    assert (np.abs(ours - np.tanh(values)) <= 10.0 * np.spacing(np.abs(ours))).all()
    assert ends == pytest.approx([1.0, -1.0, 0.0, np.nan], rel=1e-15, abs=0.0, nan_ok=True)


@pytest.mark.parametrize('formulation', ['exact', 'newton'])
def test_a_step_allocates_nothing(paper, formulation):
    simulator = Simulator(timo_sim.load_scene(paper, {'model.formulation': formulation}))
    simulator.warm_up()
    table = LoadTable(simulator.scene)
    _nrt_python.memsys_enable_stats()

    def allocations(steps):
        state = simulator.model.state(simulator.motion.values)
        loads, samples = table.stages(0, steps), simulator.integration.samples(steps, 1)
        before = rtsys.get_allocation_stats()
        simulator.integration.advance(state, simulator.load, loads, 1, 0, *samples)
        after = rtsys.get_allocation_stats()
        return after.alloc - before.alloc, after.mi_alloc - before.mi_alloc

    # Each call allocates for the arrays that it is given.
    assert allocations(600) == allocations(10)


@pytest.mark.parametrize('values', [{}, {'motor.coulomb_friction': 1.0}], ids=str)
def test_loads_and_states_of_other_shapes_are_refused(values):
    simulator = Simulator(timo_sim.load_scene(values))
    steps, state, load = simulator.integration, simulator._state, simulator.load

    def advance(state, load, shape):
        return steps.advance(state, load, np.zeros((1, *shape)), 0, 0, *steps.samples(0, 0))

    assert advance(state, load, (4, LOADS)) == 1
    for wrong in ((state, load, (4, 8)), (state, load, (3, LOADS)),
                  (state, load[:8].copy(), (4, LOADS)), (state[:-2].copy(), load, (4, LOADS))):
        with pytest.raises(ValueError, match='a step takes a state of its model'):
            advance(*wrong)


def test_single_rates_have_one_code_for_all_sizes():
    def compiled(values):
        scene = timo_sim.load_scene(values)
        timo_sim.linearize(scene, at=np.zeros(scene.build().size))
        return len(rate_once.signatures)

    # A carrier held along one axis has constants of another type.
    for held in ({}, {'carrier.held': 'x'}):
        assert len({compiled({**held, **values}) for values in (
            {}, {'model.modes': 1}, {'motor.shaft': 'locked'})}) == 1


@pytest.mark.parametrize('values', [
    {}, {'carrier.held': 'x'}, {'model.axial_modes': 1}, {'model.formulation': 'newton'}], ids=str)
def test_code_for_any_size_gives_the_same_motion(values, request):
    """Sums have another order, so the last bits differ: by 1e-13 at most, measured."""
    scene = timo_sim.load_scene({
        'initial.shaft_velocity': 3.0, 'load.torque.harmonic.amplitude': [40.0],
        'load.torque.harmonic.frequency': [1.3], **values})
    own = timo_sim.simulate(scene, 1.0, 100, estimate=False)
    request.getfixturevalue('any_size')
    other = timo_sim.simulate(scene.vary({}), 1.0, 100, estimate=False)
    assert other.model.pack is not own.model.pack
    assert other.motion == pytest.approx(own.motion, abs=1e-11)


RUN = """
import timo_sim
for modes in {}:
    scene = timo_sim.load_scene({{
        'model.modes': modes, 'model.formulation': 'newton', 'initial.shaft_velocity': 3.0,
        # The modes of an arm with a profile call no compiled function.
        'arm.profile.position': [0.0, 2.0], 'arm.profile.height': [0.02, 0.02]}})
    print(timo_sim.simulate(scene, 0.1, estimate=False).motion[-1].tobytes().hex())
"""


def take_single_rates(folder):
    """Copy the code of single rates, the same for all sizes, to another store, to save time."""
    store = folder / store_directory().name
    store.mkdir(mode=0o700)
    for file in store_directory().glob('*.functions.*.code'):
        shutil.copy(file, store)


def test_sizes_compiled_by_two_processes_work_in_a_third(tmp_path):
    """Two processes compile a size each at once; a third loads both and gives the same bits."""
    def start(*modes):
        return subprocess.Popen(
            [sys.executable, '-c', RUN.format(modes)], text=True, stdout=subprocess.PIPE,
            env={**os.environ, 'NUMBA_CACHE_DIR': tmp_path})

    take_single_rates(tmp_path)
    apart = [start(2), start(0)]
    outputs = [process.communicate()[0] for process in apart]
    assert all(outputs) and start(2, 0).communicate()[0] == ''.join(outputs)


SPEEDS = """
import timo_sim
scene = timo_sim.load_scene('paper', {
    'model.formulation': 'newton', 'carrier.held': 'y', 'motor.shaft': 'driven',
    'motor.drive': {'time': [0.0, 1.0], 'angle': [0.0, 1.0], 'speed': [0.0, 0.0],
                    'acceleration': [0.0, 0.0]}})
print(timo_sim.simulate(scene, 1.5, estimate=False).motion.tobytes().hex())
"""


def test_bits_do_not_depend_on_what_was_compiled_before(tmp_path):
    """Code of the modes' waves may be compiled in the process or loaded; powers must agree."""
    def run():
        return subprocess.run([sys.executable, '-c', SPEEDS], stdout=subprocess.PIPE, text=True,
                              env={**os.environ, 'NUMBA_CACHE_DIR': tmp_path}).stdout

    take_single_rates(tmp_path)
    together = run()
    advance, = tmp_path.glob('*/*.etdrk4.advance-*.code')
    advance.unlink()
    assert len([*tmp_path.glob('*/*.modes.*.code')]) == 3
    assert run() == together != '' and advance.exists()


def test_one_process_at_a_time_compiles():
    entered = threading.Event()

    def enter():
        with lock('test.lock'):
            entered.set()

    other = threading.Thread(target=enter)
    with lock('test.lock'):
        other.start()
        assert not entered.wait(0.2)
    other.join()
    assert entered.is_set()


@pytest.fixture
def store(tmp_path, monkeypatch):
    """Keep machine code in a folder of the test's own; return the folder."""
    store = tmp_path / 'store'
    store.mkdir(mode=0o700)
    monkeypatch.setattr(cache, 'store_directory', lambda: store)
    return store


def doubled(number):
    return 2.0 * number


def compile_and_call():
    """Compile or load a function as a new process would; return whether it was loaded."""
    function = entry_point(doubled)
    assert function(1.5) == 3.0
    return sum(function._cache_hits.values()) == 1


def test_code_is_loaded_from_disk(store):
    assert not compile_and_call()
    assert compile_and_call()


@pytest.mark.parametrize('damage', [
    lambda content: b'', lambda content: content[:20], lambda content: content[:-100],
    lambda content: bytes(len(content)), lambda content: content[::-1],
    lambda content: content[:5000] + bytes([content[5000] ^ 1]) + content[5001:]],
    ids=['empty', 'within the checksum', 'cut', 'zeros', 'garbage', 'one bit'])
def test_damaged_code_is_compiled_again(store, damage):
    compile_and_call()
    file, = store.glob('*.code')
    file.write_bytes(damage(file.read_bytes()))
    assert not compile_and_call()
    assert compile_and_call()


def test_unreadable_code_is_compiled_and_unwritable_code_gives_a_warning(store):
    compile_and_call()
    file, = store.glob('*.code')
    file.unlink()
    file.mkdir()
    with pytest.warns(UserWarning, match='machine code is not kept'):
        assert not compile_and_call()
    assert [*store.iterdir()] == [file]


@pytest.mark.parametrize('kept', [True, False], ids=['made again', 'a file in its place'])
def test_a_folder_of_code_that_disappears_does_no_harm(store, kept):
    """It disappears before a simulator warms up."""
    simulator = Simulator(timo_sim.load_scene({}))
    store.rmdir()
    if not kept:
        store.touch()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter('always')
        simulator.warm_up()
        assert is_compiled(*simulator.integration.constants) == kept
        assert not compile_and_call()
    assert any('machine code is not kept' in str(each.message) for each in told) != kept
    assert any(store.glob('*.code')) == kept


def test_sizes_are_marked_once_compiled(paper, store):
    simulator = Simulator(timo_sim.load_scene(paper))
    assert not is_compiled(*simulator.integration.constants)
    simulator.warm_up()
    assert is_compiled(*simulator.integration.constants)
    assert size_mark(simulator.model.packed) != size_mark(
        timo_sim.load_scene({'model.modes': 17}).build().packed)
