# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A Batch on a GPU does what it does on the CPU, to the last bit."""

from copy import deepcopy
from pathlib import Path
import re
import shutil
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from oracles.processor import Away, LIVE, Processor
from test_batch import commands, scene_of, SCENES
import timo_sim
from timo_sim.compiled import machine
from timo_sim.extras import MissingPackage
from timo_sim.model.layout import LOADS
from timo_sim.simulation import batch as batches
from timo_sim.simulation.batch import Batch
from timo_sim.simulation.cuda import Cuda
from timo_sim.steps import threads
from timo_sim.steps.threads import thread_alike, thread_each, ThreadSteps


@pytest.fixture
def processor(monkeypatch):
    """Let batches find that device in place of a GPU."""
    monkeypatch.setitem(batches.DEVICES, 'cuda', Processor)


def compare(scenes, count, **options):
    """Do the same with a batch of scenes on CPU and device; its bits must be the same."""
    there, here = Batch(scenes, device='cuda', **options), Batch(scenes, **options)
    random = np.random.default_rng(1)
    for steps in (1, count):
        commanded = commands(here.scenes[0], here.n, random)
        assert (there.advance(steps, commanded, sample_every=3)
                == here.advance(steps, commanded, sample_every=3)).all()
        again = random.random(here.n) < 0.2
        there.reset(again)
        here.reset(again)
        assert (there.advance_tips(7) == here.advance_tips(7)).all()
    for name in ('motion', 'failed', 't', 'friction_heat'):
        assert np.array_equal(getattr(there, name), getattr(here, name)), name
    for name in ('position', 'deflection', 'rotation'):
        assert (getattr(there, name)() == getattr(here, name)()).all()
    return there


def bodies(name, count, **more):
    """Return scenes of `test_batch`, each with its own mass at the tip."""
    return [scene_of(name, 'exact', **more, **{'end_effector.mass': mass})
            for mass in np.random.default_rng(1).uniform(0.5, 3.0, count)]


def test_the_kernel_compiled_for_the_cpu_gives_the_bits_of_a_batch(processor):
    """Friction of bristles, play, a gear, limits of rates; each lane has its own tip mass."""
    scenes = bodies('gear', 37, **SCENES['limits of rates'], **{
        'motor.rotor.coulomb_speed': 0.0, 'carrier.coulomb_friction': 2.0})
    compare(scenes, 40)


def test_arms_that_are_alike_share_their_constants_and_take_arrays_of_the_device(processor):
    scene = scene_of('free', 'exact')
    there, here = compare(scene, 20, n=45), Batch(scene, n=45)
    assert there._lanes._memory[0].nbytes < 1e4 and there._lanes.groups == 2
    torque = np.random.default_rng(1).normal(0.0, 5.0, 45)
    there.reset()
    for batch, own in (there, np.ndarray), (here, np.ndarray), (there, Away), (here, np.ndarray):
        batch.reset((torque > 0.0).view(own), motion=np.linspace(0.0, 0.01, 12))
        found = batch.step(torque=torque.view(own), tip_force=[1.0, 2.0], duration=0.02)
        # A loop of arrays of the device does not wait for the host.
        assert type(found.values) is type(found.shaft) is own
        batch.advance(3, np.ones((45, LOADS)).view(own))
    copied = deepcopy(there)
    for batch in here, copied:
        batch.step(duration=0.02)
    assert (copied.motion.values == here.motion.values).all()
    assert (there.motion.values != here.motion.values).any()
    found = copied.on_device()
    assert isinstance(found['motion'], Away) and not found['failed'].any()
    assert (np.array(found['motion']) == here.motion.values).all()
    with pytest.raises(timo_sim.ParameterError, match=r'torque must have shape \(45,\)'):
        there.step(torque=np.full(45, np.nan).view(Away))


@pytest.mark.parametrize('name', ['payload', 'one axis held'])
def test_a_lane_gets_another_body_or_sector_on_the_device(name, processor):
    """A load is picked up; a rail lets the linear part change with the angle of the shaft."""
    compare(bodies(name, 37), 60)


@pytest.mark.parametrize('modes, entry, processor', [
    (1, thread_alike, 'sm_80'), (5, thread_each, 'sm_90')])
def test_a_kernel_is_made_for_gpus(modes, entry, processor, tmp_path, monkeypatch):
    """LLVM writes PTX, in which all is rounded as on the CPU; ptxas, where it is, assembles it."""
    monkeypatch.setattr(Processor, 'kernel', lambda *_: None)  # that of the CPU takes as long
    scene = timo_sim.load_scene('paper', {'model.modes': modes})
    steps = ThreadSteps(Processor(), [scene.build()], scene.step, 10.0,
                        scene.bristles[np.newaxis], entry is thread_alike)
    text = machine.ptx(entry, steps._constants, processor).decode()
    assert f'.target {processor}' in text and f'.visible .entry {machine.KERNEL}(' in text
    assert '.extern' not in text and 'fma.rn.f64' in text
    assert not re.search(r'\t(add|sub|mul|fma|div|sqrt)(\.approx|\.ftz)*\.f64', text)
    wheels = [Path(each) for folder in sys.path
              for each in Path(folder).glob('nvidia/c*/bin/ptxas')]
    for ptxas in [shutil.which('ptxas'), *wheels][:1 + len(wheels)]:
        if ptxas:
            (tmp_path / 'arms.ptx').write_text(text)
            subprocess.run([ptxas, f'-arch={processor}', tmp_path / 'arms.ptx', '-o',
                            tmp_path / 'arms.cubin'], check=True)


def test_what_is_missing_is_refused_before_anything_is_made(processor, monkeypatch):
    monkeypatch.setattr(Processor, 'free', 10**6)
    with pytest.raises(timo_sim.ParameterError, match='n must fit'):
        Batch(scene_of('free', 'exact'), n=10**5, device='cuda')
    with pytest.raises(timo_sim.ParameterError, match='device must be one of cpu, cuda'):
        Batch('paper', device='gpu')


@pytest.mark.parametrize('alike', [True, False])
def test_room_is_asked_for_before_as_much_is_made(alike, processor, monkeypatch):
    """Arrays that are kept to the byte, others to what commands need for a moment."""
    count = 320 if alike else 64
    asked, spare = [], 8 * count * threads._MOMENTARY
    monkeypatch.setattr(Processor, 'make_room', lambda _, number: asked.append(number))

    def needed(call):
        before = LIVE[1] = LIVE[0]
        found = call()
        assert LIVE[1] - before <= asked[-1]
        return found, LIVE[1] - before
    scenes = count * [scene_of('free', 'exact')] if alike else bodies('free', count)
    batch, _ = needed(lambda: Batch(scenes, device='cuda'))
    assert asked == [spare + sum(each.nbytes for each in batch._lanes._memory)]
    batch.advance(3)
    batch.reset(np.arange(count) < 9)  # lanes whose loads differ
    for arguments in (250,), (250, np.ones(LOADS), 1), (300, None, 10):
        assert needed(lambda: batch.advance(*arguments))[1] >= asked[-1] - spare
    assert needed(lambda: batch.advance_tips(300))[1] >= asked[-1] - spare


class Driver(Cuda):
    """A GPU that loads kernels and has a kilobyte."""

    def __init__(self):
        self._processor, self.loaded, self.calls = 'sm_90', [], []

    @property
    def xp(self):
        def alloc(number):
            if number > 1000:
                raise MemoryError
        return SimpleNamespace(
            int64=np.int64, uint64=np.uint64,
            get_default_memory_pool=lambda: SimpleNamespace(free_bytes=lambda: 0),
            cuda=SimpleNamespace(
                alloc=alloc, Device=lambda: SimpleNamespace(id=-1, mem_info=(1000, 2000)),
                Module=lambda: SimpleNamespace(
                    load=self.loaded.append,
                    get_function=lambda _: lambda *given: self.calls.append(given))))


def test_kernels_are_loaded_once_and_take_room_for_their_stacks_at_once():
    device, scene = Driver(), timo_sim.load_scene('paper', {'model.modes': 1})
    steps = ThreadSteps(Processor(), [scene.build()], scene.step, 10.0,
                        scene.bristles[np.newaxis], True)
    for _ in range(2):
        launch = device.kernel(thread_alike, steps._constants)
    (grid, block, nothing), = device.calls
    assert len(device.loaded) == 1 and nothing[-1] == 0 and not any(nothing)
    launch(65, *range(1, len(nothing)))
    assert device.calls[1] == ((2,), block, (*range(1, len(nothing)), 65))
    device.make_room(1000)
    with pytest.raises(timo_sim.ParameterError, match='memory of the GPU: 0.0 GiB are needed'):
        device.make_room(1001)


def test_arrays_of_the_host_are_not_taken_for_those_of_a_gpu():
    """A tensor of torch may be either."""
    device = Driver()
    for memory, own in (1, False), (2, True), (13, True):
        given = SimpleNamespace(__dlpack_device__=lambda kind=memory: (kind, 0))
        assert device.owns(given) == own
    assert not device.owns(np.zeros(3)) and not device.owns([1.0]) and not device.owns(None)


def gpu():
    """Return why there is no GPU, or ''."""
    try:
        Cuda()
    except (MissingPackage, timo_sim.ParameterError) as error:
        return str(error)
    return ''


@pytest.mark.cuda
@pytest.mark.skipif(bool(gpu()), reason=gpu())
@pytest.mark.parametrize('name', [name for name in SCENES
                                  if name != 'limited current, static mode'])
def test_a_gpu_gives_the_bits_of_the_cpu(name):
    """10 000 lanes of ten scenes and more, each with its own mass at the tip and commands."""
    compare(bodies(name, 1000), 100)


@pytest.mark.cuda
@pytest.mark.skipif(bool(gpu()), reason=gpu())
def test_arrays_of_the_gpu_stay_there():
    cupy = Cuda().xp
    there, here = (Batch('paper', n=1000, device=device) for device in ('cuda', 'cpu'))
    torque = np.random.default_rng(1).normal(0.0, 5.0, 1000)
    there.step(torque=cupy.asarray(torque), duration=0.1)
    here.step(torque=torque, duration=0.1)
    found = cupy.from_dlpack(there.on_device()['motion'])
    assert (cupy.asnumpy(found) == here.motion.values).all()
