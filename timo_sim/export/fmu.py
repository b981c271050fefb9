# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Export of a scene as an FMU, a unit of the Functional Mock-up Interface for co-simulation."""

from __future__ import annotations

from functools import partial
import hashlib
import math
from pathlib import Path
import platform
from tempfile import TemporaryDirectory
from typing import NamedTuple
from uuid import UUID
from xml.etree import ElementTree
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from timo_sim.export.c import find_compiler, link, write_c
from timo_sim.export.constants import Interface, interface_of, Quantity
from timo_sim.model.layout import with_unit
from timo_sim.scene.files import check_target, whole_file
from timo_sim.scene.parameters import (
    checked, FLAG, ParameterError, PATH, short, TEXT, WHOLE)
from timo_sim.scene.scene import load_scene, SceneLike
from timo_sim.version import __version__

TARGETS = 'host', 'x86-64-v2', 'x86-64-v3'
_NAME = 'arm'  # first part of all names in C, and the model identifier
_PLATFORMS = {2: 'linux64', 3: 'x86_64-linux'}
_MEANING = ('Planar mobile manipulator with a flexible arm, exported by timo_sim {}. Its internal '
            'time step is {} s; inputs are held during a communication step.')


class _Variable(NamedTuple):
    """A variable of the unit; its value reference is its place in the list of all."""

    name: str
    unit: str
    meaning: str
    causality: str  # independent, output, local, input or parameter
    start: float | None = None


@checked(path=PATH, version=WHOLE, estimate=FLAG, target=TEXT)
def export_fmu(scene: SceneLike, path: Path | str, version: int = 3, estimate: bool = True,
               target: str = 'host') -> Path:
    """
    Write a scene as an FMU for co-simulation on Linux x86-64, of FMI 3.0 or 2.0.

    It holds the object file of `export_c`, linked with the functions of FMI by the C compiler
    `cc`; motions are as exact as there. Equal scenes exported under equal names give equal files.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
    path : Path or str
        The file to write, such as `arm.fmu`; an older one is replaced.
    version : int
        Of FMI, 3 or 2.
    estimate : bool
        Whether it has the output `estimated_tip_error_m`, from a finer run that is advanced
        beside. doc/scene.md says what it costs.
    target : str
        'host', this computer's processor, or one for many: 'x86-64-v2' or 'x86-64-v3'.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ParameterError
        If the scene has what an exported arm cannot do, or another argument is wrong.
    OSError
        If this is not Linux x86-64, or there is no C compiler.

    Examples
    --------
    >>> import timo_sim
    >>> timo_sim.export_fmu('paper', 'paper.fmu').name
    'paper.fmu'

    """
    scene, path = load_scene(scene), Path(path)
    if version not in [*_PLATFORMS]:
        raise ParameterError(f'version must be 2 or 3, got {short(version)}')
    if target not in TARGETS:
        raise ParameterError(f'target must be {", ".join(TARGETS)}, got {short(target)}')
    if not path.stem.isprintable():
        raise ParameterError(f'the name of the FMU must be printable, got {short(path.stem)}')
    if (platform.system(), platform.machine()) != ('Linux', 'x86_64'):
        raise OSError('FMUs are written on Linux x86-64 alone')
    find_compiler()
    check_target(path)
    variables = _variables(interface_of(scene, estimate))

    describe = partial(_description, version, path.stem, step=scene.step, variables=variables)
    with TemporaryDirectory() as folder:
        write_c(scene, folder, target, estimate, _NAME, derivatives=False)
        files = {file: Path(folder, file).read_bytes() for file in (f'{_NAME}.h', f'{_NAME}.o')}
        files |= {file: Path(__file__).with_name(file).read_bytes()
                  for file in ('fmi.h', f'fmi{version}.c')}
        token = _token(describe(''), *files.values())
        files['token.h'] = f'#define TOKEN "{token}"\n'.encode()
        for name, content in files.items():
            Path(folder, name).write_bytes(content)
        binary = link(folder, [f'fmi{version}.c', f'{_NAME}.o'], 'fmi*')
    contents = {
        'modelDescription.xml': describe(token),
        f'binaries/{_PLATFORMS[version]}/{_NAME}.so': binary}
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part, ZipFile(part, 'w', ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            entry = ZipInfo(name)  # of 1980, so that equal scenes give equal files
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content, ZIP_DEFLATED)
    return path


def _token(*contents):
    digests = (hashlib.sha256(content).digest() for content in contents)
    return f'{{{UUID(bytes=hashlib.sha256(b"".join(digests)).digest()[:16])}}}'


def _variables(interface: Interface) -> list[_Variable]:
    """Return the variables in the order of their value references, see fmi.h."""
    def variable(quantity: Quantity, causality: str) -> _Variable:
        title, unit = quantity.title, quantity.unit
        name = with_unit(title, unit)
        if title == 'time':
            name, causality = title, 'independent'
        elif title.startswith('mode_'):
            name, causality = title, 'local'
        return _Variable(name, unit, quantity.meaning, causality)

    return [*(variable(each, 'output') for each in interface.outputs),
            *(variable(each, 'input')._replace(start=0.0) for each in interface.inputs),
            *(_Variable(with_unit(each.title, each.unit), each.unit, each.meaning, 'parameter',
                        each.start) for each in interface.parameters)]


def _add(parent, tag, **attributes):
    return ElementTree.SubElement(parent, tag, {
        name: str(value).lower() if isinstance(value, bool) else str(value)
        for name, value in attributes.items()})


def _kind(variable):
    if variable.causality == 'parameter':
        return {'causality': 'parameter', 'variability': 'tunable', 'initial': 'exact'}
    known = variable.causality in ('independent', 'input')
    return {'causality': variable.causality, 'variability': 'continuous',
            **({} if known else {'initial': 'calculated'})}


def _value(variable):
    found = {'unit': variable.unit} if variable.unit else {}
    if variable.start is not None:
        # Infinity as XML Schema writes it.
        found['start'] = 'INF' if variable.start == math.inf else variable.start
    return found


def _description(version, name, token, step, variables):
    """Return modelDescription.xml; FMI 2 has other names, and puts some elements into others."""
    old = version == 2
    root = ElementTree.Element('fmiModelDescription', {
        'fmiVersion': f'{version}.0', 'modelName': name,
        'guid' if old else 'instantiationToken': token,
        'description': _MEANING.format(__version__, step), 'version': __version__,
        'generationTool': f'timo_sim {__version__}', 'variableNamingConvention': 'flat'})
    state = 'FMUstate' if old else 'FMUState'
    _add(root, 'CoSimulation', modelIdentifier=_NAME, **{
        f'canGetAndSet{state}': True, f'canSerialize{state}': True,
        'canHandleVariableCommunicationStepSize': False,
        **({'canNotUseMemoryManagementFunctions': True} if old else
           {'fixedInternalStepSize': step})})
    units = _add(root, 'UnitDefinitions')
    for unit in dict.fromkeys(each.unit for each in variables if each.unit):
        _add(units, 'Unit', name=unit)
    _add(_add(root, 'LogCategories'), 'Category', name='logStatusError')
    _add(root, 'DefaultExperiment', startTime=0.0, stepSize=step)
    group = _add(root, 'ModelVariables')
    for number, each in enumerate(variables):
        said = {'name': each.name, 'valueReference': number, 'description': each.meaning,
                **_kind(each)}
        if old:
            _add(_add(group, 'ScalarVariable', **said), 'Real', **_value(each))
        else:
            _add(group, 'Float64', **said, **_value(each))
    structure = _add(root, 'ModelStructure')
    shown = [number for number, each in enumerate(variables) if each.causality == 'output']
    for tag in ('Output', 'InitialUnknown'):
        part = _add(structure, f'{tag}s') if old else structure
        for number in shown:  # which depends on no input of now: these act from the next step on
            if old:
                _add(part, 'Unknown', index=number + 1, dependencies='')
            else:
                _add(part, tag, valueReference=number, dependencies='')
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='UTF-8', xml_declaration=True) + b'\n'
