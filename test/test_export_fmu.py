# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""FMUs, run by fmpy: the bits of `Simulator`, states, refusals, what the description says."""

import ctypes
import itertools
import math
from pathlib import Path
import re
import shutil
import subprocess

from command_line import call
import fmpy
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
import numpy as np
import pytest
import timo_sim
from timo_sim.export import fmu as export

pytestmark = pytest.mark.skipif(not shutil.which('cc'), reason='there is no C compiler')
SOURCES = Path(export.__file__).parent
HEADERS = Path(fmpy.__file__).parent / 'c-code'  # those of the standard
DISCARD, ERROR = 2, 3
STEP = 0.001


class Unit:
    """An instance of an FMU of any version."""

    log = []  # of all instances: fmpy keeps one logger

    def __init__(self, folder):
        self.description = fmpy.read_model_description(folder)
        self.version = int(self.description.fmiVersion[0])
        self.numbers = {each.name: each.valueReference
                        for each in self.description.modelVariables}
        self.fmu = fmpy.instantiate_fmu(
            folder, self.description, logger=lambda *arguments: self.log.append(
                arguments[-1].decode()))

    def begin(self, start=0.0, stop=None):
        if self.version == 2:
            self.fmu.setupExperiment(startTime=start, stopTime=stop)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=start, stopTime=stop)
        self.fmu.exitInitializationMode()
        return self

    def set(self, name, value):
        set_ = self.fmu.setReal if self.version == 2 else self.fmu.setFloat64
        set_([self.numbers[name]], [value])

    def get(self, *names):
        get = self.fmu.getReal if self.version == 2 else self.fmu.getFloat64
        return [*get([self.numbers[name] for name in names or self.numbers])]

    def step(self, size=0.01, point=None):
        point = self.get('time')[0] if point is None else point
        self.fmu.doStep(currentCommunicationPoint=point, communicationStepSize=size)

    def slew(self, count=20):
        """Take steps under a torque that changes."""
        for number in range(count):
            self.set('torque_N_m', math.cos(number))
            self.step()
        return self.get()

    def refuses(self, status, text, function, *arguments):
        """Check that a call fails with a status and logs a text."""
        before = len(self.log)
        with pytest.raises(FMICallException) as caught:
            function(*arguments)
        assert caught.value.status == status
        assert text in ' '.join(self.log[before:])


@pytest.fixture(scope='module')
def scene():
    """Return a scene without sines, whose motions are those of `Simulator` to the last bit."""
    return timo_sim.load_scene({})


@pytest.fixture(scope='module')
def folders(tmp_path_factory, scene):
    """Return the unpacked FMUs of the scene, by the version of FMI."""
    folder = tmp_path_factory.mktemp('fmu')
    return {version: Path(fmpy.extract(export.export_fmu(
        scene, folder / f'{version}.fmu', version), folder / str(version)))
        for version in (2, 3)}


@pytest.fixture(scope='module')
def sources(scene, tmp_path_factory):
    """Return a folder with what the binary of a unit is made of, but for the functions of FMI."""
    folder = timo_sim.export_c(scene, tmp_path_factory.mktemp('sources'), estimate=True)
    (folder / 'token.h').write_text('#define TOKEN "{}"\n')
    return folder


@pytest.fixture(params=[2, 3])
def folder(request, folders):
    return folders[request.param]


@pytest.fixture
def make(folder):
    """Return a function that makes instances, which are freed at the end."""
    made = []

    def make():
        made.append(Unit(folder))
        return made[-1]

    yield make
    for each in made:
        each.fmu.fmi2FreeInstance(each.fmu.component) if each.version == 2 else \
            each.fmu.fmi3FreeInstance(each.fmu.component)


def test_description(folder):
    assert validate_fmu(folder) == []
    description = fmpy.read_model_description(folder)
    model, variables = description.coSimulation, description.modelVariables
    assert model.canGetAndSetFMUstate and model.canSerializeFMUstate
    assert not model.canHandleVariableCommunicationStepSize
    assert not model.canBeInstantiatedOnlyOncePerProcess
    assert description.defaultExperiment.stepSize == str(STEP)
    if description.fmiVersion == '3.0':
        assert model.fixedInternalStepSize == str(STEP)
    kinds = {each.name: each.causality for each in variables}
    assert kinds['time'] == 'independent' and kinds['torque_N_m'] == 'input'
    assert kinds['estimated_tip_error_m'] == kinds['tip_x_m'] == 'output'
    assert kinds['mode_1'] == 'local'
    assert all(each.description for each in variables)
    assert {('torque_N_m', 'N m'), ('tip_turning_rad_per_s', 'rad/s')} < {
        (each.name, each.unit) for each in variables}


def test_run_has_the_bits_of_a_simulator(folder, scene):
    """Torque steps that fmpy makes act as those of `Simulator.step`."""
    torques, interval = [2.0, -1.0, 0.5], 0.05
    signals = np.array([(interval * k, torques[k // 4]) for k in range(12)],
                       dtype=[('time', float), ('torque_N_m', float)])
    # fmpy interpolates between the rows; where it reads them, at communication points, they hold.
    names = ['carrier_x_m', 'carrier_y_m', 'shaft_rad', 'mode_1', 'mode_2', 'mode_3',
             'carrier_x_velocity_m_per_s', 'carrier_y_velocity_m_per_s',
             'shaft_velocity_rad_per_s', 'mode_1_rate', 'mode_2_rate', 'mode_3_rate']
    found = fmpy.simulate_fmu(folder, stop_time=0.6, output_interval=interval, input=signals,
                              output=[*names, 'tip_transverse_m'])
    simulator = timo_sim.Simulator(scene)
    assert len(found) == 13
    for k, row in enumerate(found):
        assert [row[name] for name in names] == simulator.motion.values.tolist()
        assert row['tip_transverse_m'] == pytest.approx(simulator.deflection()[1], rel=1e-12)
        if k < 12:
            simulator.step(torque=torques[k // 4], duration=interval)


def test_inputs_act_in_the_next_step(make):
    """Outputs depend on no input of the same time, as the description says."""
    unit = make().begin()
    unit.slew(1)
    names = {each.name: each.causality for each in unit.description.modelVariables}
    outputs = [name for name, causality in names.items() if causality == 'output']
    before = unit.get(*outputs)
    for name, causality in names.items():
        if causality == 'input':
            unit.set(name, 3.0)
    assert unit.get(*outputs) == before
    unknowns = [*unit.description.outputs, *unit.description.initialUnknowns]
    assert len(unknowns) == 2 * len(outputs)
    assert all(each.dependencies == [] for each in unknowns)
    unit.step(STEP)
    assert unit.get(*outputs) != before


def test_estimated_error(make, scene):
    unit, simulator = make().begin(), timo_sim.EstimatingSimulator(scene)
    assert unit.get('estimated_tip_error_m') == [0.0]
    for torque in (1.0, -2.0):
        unit.set('torque_N_m', torque)
        for _ in range(100):
            unit.step(STEP)
            simulator.step(torque=torque, duration=STEP)
    error, = unit.get('estimated_tip_error_m')
    assert error == pytest.approx(simulator.estimated_error, rel=1e-6) and error > 0.0


def test_states_continue_to_the_bit(make):
    unit, other = make().begin(), make()
    unit.slew()
    fmu = unit.fmu
    state = fmu.getFMUState()
    content = fmu.serializeFMUState(state)
    expected = unit.slew()
    assert unit.slew() != expected
    fmu.setFMUState(state)
    assert unit.slew() == expected
    fmu.freeFMUState(state)
    # Another instance, which is in its phase of stepping then.
    state = other.fmu.deserializeFMUState(content)
    other.fmu.setFMUState(state)
    assert other.slew() == expected
    other.fmu.freeFMUState(state)
    # What is no state of this unit
    for wrong in (content[:-1], content + b'0', b'', b'x' + content[1:]):
        unit.refuses(ERROR, 'these bytes are no state of this unit', fmu.deserializeFMUState,
                     wrong)
    for place in range(44, len(content), 61):  # one bit of phase, checksum, stop or values
        flipped = bytearray(content)
        flipped[place] ^= 4
        unit.refuses(ERROR, 'the state is damaged', fmu.deserializeFMUState, bytes(flipped))
    unit.refuses(ERROR, 'this is no state', fmu.setFMUState, None)
    assert unit.slew()[0] > 0.0  # it goes on


def test_instances_and_resets(make):
    first, second = make().begin(), make().begin()
    start = second.get()
    moved = first.slew()
    assert second.get() == start and second.slew() == moved
    first.fmu.reset()
    assert first.get() == start
    assert first.begin().slew() == moved


def test_steps_are_whole_multiples(make):
    unit = make().begin(stop=1.0)
    unit.step(0.013)
    before = unit.get()
    status = ERROR if unit.version == 2 else DISCARD
    text = f'the communication step must be a whole multiple of {STEP}'
    for size in (0.0005, 0.0015, 0.013001, 0.0, -0.001, math.nan, math.inf, 1e300):
        unit.refuses(status, text, unit.step, size)
    for point in (0.012, 0.014, 0.0, math.nan):
        unit.refuses(ERROR, 'the communication point must be', unit.step, STEP, point)
    unit.refuses(ERROR, 'passes the stop time, 1 s', unit.step, 0.988)
    with pytest.raises(FMICallException):
        unit.step(1 / 60)  # the remedy divides it
    told = float(unit.log[-1].partition('integrator.step=')[2])
    assert told <= STEP and told * 17 == pytest.approx(1 / 60, rel=1e-15)
    assert unit.get() == before
    unit.step(0.987)
    assert unit.get('time') == [pytest.approx(1.0, abs=1e-15)]


def test_round_off_of_the_master_is_forgiven(make):
    unit, time = make().begin(), 0.0
    for _ in range(3000):
        unit.step(time + STEP - time, time)
        time += STEP
    assert unit.get('time') == [3.0] and time != 3.0


def test_wrong_values(make):
    unit = make()
    unit.set('torque_N_m', 1.0)
    for value in (math.nan, math.inf, -math.inf):
        unit.refuses(DISCARD, 'torque must be finite', unit.set, 'torque_N_m', value)
    assert unit.get('torque_N_m') == [1.0]
    unit.refuses(ERROR, 'is no input', unit.set, 'tip_x_m', 1.0)
    unit.numbers = {'none': len(unit.numbers)}
    unit.refuses(ERROR, 'there is no variable with the reference', unit.get, 'none')
    unit.refuses(ERROR, 'is no input', unit.set, 'none', 1.0)
    for start in (1.0, math.nan):
        unit.refuses(ERROR, 'the start time must be 0 s', unit.begin, start)
    unit.refuses(ERROR, 'the stop time must be >= 0 s', unit.begin, 0.0, -1.0)


def test_parameters_are_tunable(make, scene):
    """A limit that is set in a run acts as that of a changed scene; a reset undoes it."""
    unit, simulator = make().begin(), timo_sim.Simulator(scene)
    kinds = {each.name: each for each in unit.description.modelVariables}
    limit = 'motor_torque_limit_N_m'
    assert (kinds[limit].causality, kinds[limit].variability) == ('parameter', 'tunable')
    assert unit.get(limit) == [float(kinds[limit].start)] == [math.inf]
    unit.set('torque_N_m', 2.0)
    unit.step()
    unit.set(limit, 0.5)
    unit.step()
    simulator.step(torque=2.0, duration=0.01)
    simulator.change(scene.vary({'motor.torque_limit': 0.5}))
    assert unit.get('shaft_rad') == [simulator.step(torque=2.0, duration=0.01).shaft]
    for value in (0.0, -1.0, math.nan):
        unit.refuses(DISCARD, 'motor_torque_limit must be > 0', unit.set, limit, value)
    assert unit.get(limit) == [0.5]
    unit.fmu.reset()
    assert unit.get(limit) == [math.inf]


def test_order_of_calls(make):
    """What comes too early or too late is an error, and changes nothing."""
    unit, text = make(), 'must not be called in this state'
    early = unit.step, unit.fmu.exitInitializationMode, unit.fmu.terminate
    for function in early:
        unit.refuses(ERROR, text, function)
    unit.begin()
    moved = unit.slew(3)
    for function in unit.fmu.exitInitializationMode, unit.fmu.enterInitializationMode:
        unit.refuses(ERROR, text, function)
    assert unit.get() == moved
    unit.fmu.terminate()
    for function in (*early, lambda: unit.set('torque_N_m', 1.0)):
        unit.refuses(ERROR, text, function)
    assert unit.get() == moved  # outputs can be read after the end
    unit.fmu.reset()
    assert unit.begin().slew(3) == moved


def test_null_pointers(make, folder):
    """No function of the interface crashes for want of an instance or of arrays."""
    unit = make().begin()
    prefix, instance = f'fmi{unit.version}', ctypes.c_void_p(unit.fmu.component)
    binary, = folder.glob('binaries/*/arm.so')
    library = ctypes.CDLL(str(binary))  # without the types that fmpy declares
    header = (HEADERS / f'{prefix}Functions.h').read_text()
    names = re.findall(rf'\b({prefix}\w+);', header)
    known = [name for name in names if hasattr(library, name)]
    assert len(known) == (len(names) if unit.version == 3 else 34)
    assert not hasattr(library, 'arm_step')  # nothing but the interface is visible
    other = re.compile(
        '.*(GetVersion|GetTypesPlatform|Instantiate.*|FreeInstance|Reset|Terminate)')
    for name in known:
        if not other.fullmatch(name):
            function = getattr(library, name)
            assert function(None, *12 * [None]) == ERROR, name
            assert function(instance, *12 * [None]) in range(4), name
    library[f'{prefix}FreeInstance'](None)
    for kind, name in itertools.product(
            ('Get', 'Set'), ('Real', 'Integer') if unit.version == 2 else ('Float64', 'Int32')):
        one = ctypes.c_size_t(1)
        assert library[f'{prefix}{kind}{name}'](instance, None, one, None, one) == ERROR


def test_wrong_token(folder):
    description = fmpy.read_model_description(folder)
    description.guid = '{x}'
    told = []
    with pytest.raises(Exception, match='Failed to instantiate'):
        fmpy.instantiate_fmu(folder, description, logger=lambda *all_: told.append(all_[-1]))
    assert told == [b'the token is that of another unit']


def test_divergence(make):
    """A run that diverges ends with a text; reset or restored, the unit runs again."""
    unit = make()
    moved = unit.begin().slew()
    state = unit.fmu.getFMUState()
    after = unit.slew()
    unit.set('torque_N_m', 1e9)
    unit.refuses(ERROR, 'the run diverged', unit.step, 10.0)
    assert np.isfinite(unit.get('shaft_rad', 'tip_x_m', 'energy_J')).all()
    unit.refuses(ERROR, 'must not be called', unit.step)
    unit.fmu.setFMUState(state)
    assert unit.slew() == after
    unit.fmu.freeFMUState(state)
    unit.fmu.reset()
    assert unit.begin().slew() == moved


def test_files_are_reproducible(tmp_path, folders):
    first, second = (export.export_fmu('paper', tmp_path / name / 'arm.fmu', 3, False)
                     for name in 'ab' if not (tmp_path / name).mkdir())
    assert first.read_bytes() == second.read_bytes()
    tokens = {fmpy.read_model_description(unit).guid for unit in (first, *folders.values())}
    assert len(tokens) == 3  # of another scene or version


def test_declarations_are_those_of_the_standard(sources):
    for version in (2, 3):
        subprocess.run(['cc', '-std=c11', '-fsyntax-only', '-Wall', '-Werror', '-I', HEADERS,
                        '-include', f'fmi{version}Functions.h', '-I', sources,
                        SOURCES / f'fmi{version}.c'], check=True)


def test_memory(sources, tmp_path):
    """Calls in all orders leave no leak and touch no foreign memory, says AddressSanitizer."""
    for version in (2, 3):
        program = tmp_path / f'program{version}'
        built = subprocess.run(
            ['cc', '-std=c11', '-g', '-fsanitize=address,undefined', '-fno-sanitize-recover',
             f'-DVERSION={version}', '-I', sources, '-I', SOURCES, '-o', program,
             Path(__file__).parent / 'data/abuse_fmu.c', sources / 'arm.o'],
            capture_output=True, text=True)
        if 'asan' in built.stderr:
            pytest.skip('this compiler has no AddressSanitizer')
        assert built.returncode == 0, built.stderr
        done = subprocess.run([program], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        assert done.stdout.count('\n') > 5


def test_wrong_arguments(tmp_path, monkeypatch):
    path = tmp_path / 'arm.fmu'
    with pytest.raises(timo_sim.ParameterError, match='version must be 2 or 3, got 1'):
        timo_sim.export_fmu('paper', path, 1)
    with pytest.raises(timo_sim.ParameterError, match='target must be .*, got .aarch64'):
        timo_sim.export_fmu('paper', path, target='aarch64')
    for name in 'a\x01', 'a\nb', 'a\udc80':
        with pytest.raises(timo_sim.ParameterError, match='name of the FMU must be printable'):
            timo_sim.export_fmu('paper', tmp_path / f'{name}.fmu')
    monkeypatch.setenv('PATH', str(tmp_path))
    with pytest.raises(OSError, match='the C compiler cc, which is not on the PATH'):
        timo_sim.export_fmu('paper', path)
    assert not path.exists()


def test_command(tmp_path):
    path = tmp_path / 'arm.fmu'
    assert call(
        'export-fmu', 'paper', '-o', path, '--fmi', '2', '--set', 'arm.length=1.9',
        'motor.coulomb_friction=0.0', '--no-estimate', '--target', 'x86-64-v2'
    ).endswith(f'{path}\n')
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(path)
    names = {each.name for each in description.modelVariables}
    assert description.fmiVersion == '2.0' and 'mode_3' in names
    assert 'estimated_tip_error_m' not in names
