# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Compiled code: it computes what its source says, for any size, whoever compiled it before."""

from concurrent.futures import ThreadPoolExecutor
import math
import os
import shutil
import subprocess
import sys
from typing import Annotated, NamedTuple

import numba
import numpy as np
import pytest

import timo_sim
from timo_sim.compiled import machine, store
from timo_sim.compiled.constants import pack, pack_lanes
from timo_sim.compiled.emit import emit
from timo_sim.compiled.entry import entry_point
from timo_sim.compiled.functions import (
    Array, as_vectors, Constants, floor, inner, local, magnitude, where)
from timo_sim.compiled.functions import WIDTH
from timo_sim.model.functions import rate_once, sincos, tanh
from timo_sim.model.layout import LOADS
from timo_sim.steps import etdrk4
from timo_sim.steps.steps import matrices_of, Steps


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder for the code of this file's functions; others may be of earlier sources."""
    folder = tmp_path_factory.mktemp('store')
    folder.chmod(0o700)
    return folder


@pytest.fixture
def own_store(folder, monkeypatch):
    """Keep code in that folder."""
    monkeypatch.setattr(store, 'store_directory', lambda: folder)


# Sine, cosine and hyperbolic tangent.

@entry_point(angles=Array((None,)), sines=Array((None,)), cosines=Array((None,)), count=int)
def _sincos(angles, sines, cosines, count):
    for j in range(count):
        sines[j], cosines[j] = sincos(angles[j])


def test_sine_and_cosine_to_the_last_place(own_store):
    angles = np.concatenate([np.linspace(-1.0, 1.0, 200001), np.linspace(-1e6, 1e6, 200001),
                             np.arange(-8, 9) * math.pi / 4, [np.nan, np.inf, -np.inf]])
    sines, cosines = np.empty_like(angles), np.empty_like(angles)
    _sincos(angles, sines, cosines, len(angles))
    # In units of the last place; near a zero in those of 0.1, as the angle is no more accurate.
    for ours, function in (sines, np.sin), (cosines, np.cos):
        assert np.isnan(ours[-3:]).all()
        libm = function(angles[:-3])
        unit = np.maximum(np.spacing(np.abs(libm)), np.spacing(0.1))
        assert (np.abs(ours[:-3] - libm) <= unit).all()


@entry_point(values=Array((None,)), out=Array((None,)), count=int)
def _tanh(values, out, count):
    for j in range(count):
        out[j] = tanh(values[j])


def test_hyperbolic_tangent(own_store):
    values = np.concatenate([np.linspace(-25.0, 25.0, 100001), np.geomspace(1e-300, 25.0, 10001)])
    ours, ends = np.empty_like(values), np.array([np.inf, -np.inf, 0.0, np.nan])
    _tanh(values, ours, len(values))
    _tanh(ends, ends, 4)
    # Six doublings add up to 8.3 units of the last place.
    assert (np.abs(ours - np.tanh(values)) <= 10.0 * np.spacing(np.abs(ours))).all()
    assert ends == pytest.approx([1.0, -1.0, 0.0, np.nan], rel=1e-15, abs=0.0, nan_ok=True)


# A function that uses all that there is, for floats and for lanes.

class Toy(NamedTuple):
    """Constants of sizes that are not known when the source is compiled."""

    factor: float
    shift: int
    matrix: Annotated[np.ndarray, 'rows', 'columns']
    order: Annotated[np.ndarray, int, 'rows']


@inner
def _compute(toy, vector, out):
    sums = local((toy.matrix,))
    for i in range(len(toy.matrix)):
        sums[i] = toy.factor
        for j in range(len(vector)):
            sums[i] += toy.matrix[i, j] * vector[j]
    rows, vectors = as_vectors(toy.matrix), as_vectors(out)
    for j in range(len(vectors)):
        vectors[j] = rows[toy.order[0], j] * sums[0]
    for i in range(len(toy.matrix)):
        chosen = sums[toy.order[i]]
        out[i] = where((chosen > 0.0) & (chosen != 1.0), floor(chosen), magnitude(chosen)) + (
            toy.shift - out[i] / toy.factor)


def expected(toy, vector):
    """Return what `_compute` writes, by NumPy."""
    sums = toy.factor + toy.matrix @ vector
    out, chosen = toy.matrix[toy.order[0]] * sums[0], sums[toy.order]
    out[:len(sums)] = (np.where(chosen > 0.0, np.floor(chosen), np.abs(chosen)) + toy.shift
                       - out[:len(sums)] / toy.factor)
    return out


@entry_point(toy=Constants(), vector=Array(('columns',)), out=Array(('columns',)))
def _alone(toy, vector, out):
    _compute(toy, vector, out)


def _arguments(form):
    return {'toy': Constants(form), 'vector': Array((None, 'columns'), lanes=True),
            'out': Array((None, 'columns'), lanes=True), 'groups': int}


@entry_point(**_arguments('lanes'))
def _together(toy, vector, out, groups):
    for g in range(groups):
        _compute(toy[g], vector[g], out[g])
    return groups


@entry_point(**_arguments('shared'))
def _alike(toy, vector, out, groups):
    for g in range(groups):
        _compute(toy, vector[g], out[g])
    return groups


def some_toy(random, rows, columns):
    """Return constants with random numbers."""
    return Toy(random.uniform(1.0, 2.0), 3, random.normal(size=(rows, columns)),
               random.permutation(rows))


@pytest.mark.parametrize('rows, columns', [(3, 8), (5, 16), (20, 24)])
def test_floats_and_lanes_of_any_size_agree_with_numpy(rows, columns, own_store):
    random = np.random.default_rng(1)
    toys = [some_toy(random, rows, columns) for _ in range(2 * WIDTH)]
    toys = [toy._replace(order=toys[0].order) for toy in toys]  # whole numbers are the same
    vectors = random.normal(size=(2 * WIDTH, columns))
    by_numpy = np.array([expected(toy, vector) for toy, vector in zip(toys, vectors)])

    alone = np.empty((2 * WIDTH, columns))
    for toy, vector, out in zip(toys, vectors, alone):
        _alone(pack(toy), vector, out)
    # Round-off of sums of up to 24 numbers of about 1.
    np.testing.assert_allclose(alone, by_numpy, rtol=0, atol=1e-13)

    def in_lanes(entry, constants):
        rows = np.ascontiguousarray(np.moveaxis(vectors.reshape(2, WIDTH, columns), 1, 2))
        out = np.empty_like(rows)
        assert entry.of(constants)(rows, out, 2) == 2
        return np.moveaxis(out, 2, 1).reshape(-1, columns)

    together = pack_lanes(Toy(*(np.array(each) for each in zip(*toys))))
    np.testing.assert_allclose(in_lanes(_together, together), by_numpy, rtol=0, atol=1e-13)
    same = [expected(toys[0], vector) for vector in vectors]
    np.testing.assert_allclose(in_lanes(_alike, pack(toys[0])), same, rtol=0, atol=1e-13)


def test_what_machine_code_would_misread_is_refused(own_store):
    toy, vector, out = some_toy(np.random.default_rng(1), 3, 8), np.ones(8), np.empty(8)
    call = _alone.of(pack(toy))
    vector.flags.writeable = False
    call(vector, out)
    assert out == pytest.approx(expected(toy, vector))
    for wrong in (np.ones(7), np.ones(9), np.ones((8, 1)), np.ones(8, dtype=np.float32),
                  np.ones(8, dtype=np.int64), np.ones(16)[::2]):
        with pytest.raises(ValueError, match='compiled code needs'):
            call(wrong, out)
    again = np.ones(8)
    for number in range(3):  # its numbers are read each time
        again[:] = number
        call(again, out)
        assert out == pytest.approx(expected(toy, again))
    again.resize(10**6, refcheck=False)  # the memory that was passed is free now
    with pytest.raises(ValueError, match='compiled code needs'):
        call(again, out)
    lanes, groups = np.ones((1, 8, WIDTH)), _alike.of(pack(toy))
    for wrong in (lanes[0], lanes[:, :7].copy(), lanes[:, :, :1].copy()):
        with pytest.raises(ValueError, match='compiled code needs float64 of shape'):
            groups(wrong, lanes.copy(), 1)
    for number in ((vector,), (vector, out, out)):
        with pytest.raises(ValueError, match='argument'):
            call(*number)
    with pytest.raises(ValueError, match='order of Toy has shape'):
        pack(toy._replace(order=np.arange(2)))


# The code of steps.

@pytest.mark.parametrize('formulation, dry', [
    ('exact', 0), ('newton', 0), ('newton', 1)])
def test_a_step_allocates_nothing(formulation, dry, tmp_path):
    """Its machine code has no calls but those that set and copy memory."""
    scene = timo_sim.load_scene({'model.formulation': formulation})
    model = scene.build()
    constants = model.packed, pack(matrices_of(model.linear, scene.step))
    constants += Steps(model, scene.step, dry * np.ones((4, 5))).bristles,
    path = tmp_path / 'step.o'
    code = machine.intermediate_code(etdrk4.advance, tuple(each.kind for each in constants))
    host = machine.target_machine('host')
    path.write_bytes(host.emit_object(machine.specialise(
        code, machine.symbols_of(constants), host, 'step')))
    undefined = subprocess.run(['nm', '-u', path], check=True, capture_output=True, text=True)
    assert {*undefined.stdout.split()} <= {'U', 'memcpy', 'memmove', 'memset'}


def test_the_caller_may_compile_the_same_functions_with_numba_in_between():
    def entry():
        @entry_point(one=int, other=int)
        def least(one, other):
            return min(one, other)
        return least
    emit(entry(), ())
    assert numba.njit(lambda one, other: min(one, other))(2, 1) == 1
    emit(entry(), ())


def test_code_for_any_size_does_the_same_in_threads_that_take_turns():
    """A rate is that of the code for its size, whoever else uses the code for any size."""
    models = [timo_sim.load_scene({'model.modes': modes}).build() for modes in (1, 2)]
    states = [np.linspace(0.1, 0.2, len(model.linear)) for model in models]
    load, expected = np.zeros(LOADS), [np.empty_like(state) for state in states]
    for model, state, rate in zip(models, states, expected):
        rate_once(model.packed, state, load, rate)
        rate += model.linear @ state
    with ThreadPoolExecutor(2) as pool:
        rates = pool.map(lambda k: models[k % 2].rate(states[k % 2], load), range(2000))
        for k, rate in enumerate(rates):
            np.testing.assert_allclose(rate, expected[k % 2], rtol=1e-12)


@pytest.mark.parametrize('values', [
    {}, {'model.modes': 1, 'model.axial_modes': 1},
    {'model.modes': 2, 'carrier.held': 'both', 'motor.gear.stiffness': 900.0,
     'motor.rotor.inertia': 0.05, 'motor.coulomb_friction': 1.0}], ids=str)
def test_steps_of_code_for_any_size_are_those_of_code_for_a_size(values):
    """But for round-off; so most tests, which are of short runs, take code for any size."""
    ends = []
    for any_size in (False, True):
        simulator = timo_sim.Simulator(timo_sim.load_scene({}, {
            **values, 'initial.shaft_velocity': 3.0}))
        steps = simulator.integration
        steps._advance[None] = etdrk4.advance.of(
            *steps.part(None), steps.bristles, any_size=any_size)
        simulator.advance(200)
        ends.append(simulator.motion.values)
    np.testing.assert_allclose(*ends, rtol=1e-10, atol=1e-12)


RUN = """
import sys, numba, timo_sim
from timo_sim.compiled import machine, store
store.PREBUILT /= 'none'  # an installation may have code of these sizes
print(numba.njit(lambda: 1).__class__.__name__)
for modes in sys.argv[1]:
    scene = timo_sim.load_scene({}, {
        'model.modes': int(modes), 'model.formulation': 'newton', 'initial.shaft_velocity': 3.0,
        # The modes of an arm with a profile call no compiled function.
        'arm.profile.position': [0.0, 2.0], 'arm.profile.height': [0.02, 0.02]})
    with machine.telling(lambda text: print(text, file=sys.stderr)):
        print(timo_sim.Simulator(scene).advance(20, sample_every=20)[0][-1].tobytes().hex())
"""


def test_bits_do_not_depend_on_who_compiled_what_in_which_order(tmp_path):
    """
    Two processes compile a size each at once; another compiles them anew, in another order.

    The last one disables numba's compilation of the caller's functions, which is left to them.
    """
    known = store.store_directory()
    if known:  # the intermediate code is that of this process, or of another one
        (tmp_path / known.name).mkdir(0o700)
        for file in known.glob('*.*-*.bc'):
            shutil.copy(file, tmp_path / known.name)

    def start(modes, **setting):
        return subprocess.Popen(
            [sys.executable, '-c', RUN, modes], text=True, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, env={**os.environ, 'NUMBA_CACHE_DIR': tmp_path, **setting})

    def ends(process):
        output, told = process.communicate()
        return output.split(), told

    apart = [ends(process)[0] for process in [start(modes) for modes in '20']]
    (plain, two), (_, zero) = apart
    assert plain == 'CPUDispatcher'
    for file in [*tmp_path.glob('*/*.advance-*.bc'), *tmp_path.glob('*/*.o')]:
        file.unlink()
    again, told = ends(start('02', NUMBA_DISABLE_JIT='1'))
    assert again == ['function', zero, two] and machine.COMPILING in told
