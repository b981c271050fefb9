# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Export of a scene as a C library: an object file, its header and a program that runs it."""

from __future__ import annotations

from pathlib import Path
import re
import shutil
from string import Template
import subprocess

from timo_sim.compiled.machine import TARGETS
from timo_sim.export.constants import Interface, Quantity, refuse
from timo_sim.export.instance import Code
from timo_sim.export.library import library, TEXTS
from timo_sim.model.formulation import DRAWN
from timo_sim.scene.files import check_target, whole_file
from timo_sim.scene.parameters import checked, FLAG, ParameterError, PATH, short, TEXT
from timo_sim.scene.scene import load_scene, SceneLike
from timo_sim.version import __version__


@checked(folder=PATH, target=TEXT, estimate=FLAG, name=TEXT)
def export_c(scene: SceneLike, folder: Path | str, target: str = 'host', estimate: bool = False,
             name: str = 'arm') -> Path:
    """
    Write a scene as a C library: NAME.h, NAME.o, main.c and CMakeLists.txt.

    The object file has the machine code of `Simulator`'s step, the constants of the scene, and
    plain C functions; it needs no other library. No compiler is needed to write it. For the
    target 'host' a run of it has the same motions as one of `Simulator`, to the last bit.

    Parameters
    ----------
    scene : Scene, or what `load_scene` takes
    folder : Path or str
        Made if it does not exist; files of these names in it are replaced.
    target : str
        'host', this computer's processor; 'x86-64-v2', 'x86-64-v3', 'aarch64' or 'riscv64', for
        Linux; 'wasm32' or 'wasm32-simd128', for WebAssembly.
    estimate : bool
        Whether a finer run is advanced beside, to estimate the error of the tip; doc/scene.md
        says what that costs.
    name : str
        First part of all names in C; a compiler refuses words of C and of its library.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ParameterError
        If the scene has what an exported arm cannot do, or another argument is wrong.

    Examples
    --------
    >>> import timo_sim
    >>> timo_sim.export_c('paper', 'paper_in_c').name
    'paper_in_c'

    """
    return write_c(scene, folder, target, estimate, name)


def write_c(scene: SceneLike, folder: Path | str, target: str = 'host', estimate: bool = False,
            name: str = 'arm', derivatives: bool = True) -> Path:
    """Do what `export_c` does; without `derivatives` NAME_step_derivatives is only declared."""
    scene, folder = load_scene(scene), Path(folder)
    if target not in ('host', *TARGETS):
        raise ParameterError(f'target must be host, {", ".join(TARGETS)}, got {short(target)}')
    if not re.fullmatch('[a-z][a-z0-9_]*', name):
        raise ParameterError('name must be lower-case letters, digits and _, got '
                             f'{short(name)}')
    for file in (f'{name}.h', f'{name}.o', 'main.c', 'CMakeLists.txt'):
        check_target(folder / file)
    refuse(scene, estimate)
    made = library(scene, estimate, target, name, derivatives)
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in {
            f'{name}.h': _header(made, scene.step, target, name),
            f'{name}.o': made.content,
            'main.c': _main(made.interface, scene.step, name),
            'CMakeLists.txt': _fill('CMakeLists.txt', name)}.items():
        with whole_file(folder / file) as path:
            path.write_bytes(content)
    return folder


def find_compiler() -> None:
    """Raise OSError if there is no C compiler."""
    if not shutil.which('cc'):
        raise OSError('a shared object is linked by the C compiler cc, which is not on the PATH: '
                      'install gcc or clang')


def link(folder: Path | str, sources: list[str], exports: str) -> bytes:
    """Return a shared object of C sources and object files in a folder; only `exports` is seen."""
    find_compiler()
    Path(folder, 'exports').write_text(f'{{ global: {exports}; local: *; }};\n')
    done = subprocess.run(
        ['cc', '-std=c11', '-O2', '-fPIC', '-shared', '-Wl,-z,defs', '-Wl,-z,text',
         '-Wl,-z,noexecstack', '-Wl,--version-script=exports', '-o', 'linked.so', *sources],
        cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise OSError(f'cc cannot link {", ".join(sources)}: {done.stderr.strip()}')
    return Path(folder, 'linked.so').read_bytes()


def _named(text, name):
    return re.sub(r'\b(name|NAME)(?=\b|_)', lambda found: (
        name if found[0] == 'name' else name.upper()), text)


def _fill(template, name, **words):
    # Templates are files of this folder, with `name` and `NAME` as words or first parts of words.
    text = Path(__file__).with_name(template).read_text(encoding='utf-8')
    return Template(_named(text, name)).substitute(words).encode()


def _enum(name, quantities):
    return '\n'.join(
        f'    {name.upper()}_{each.title.upper()} = {number}, '
        f'/* {each.meaning}{f" [{each.unit}]" if each.unit else ""} */'
        for number, each in enumerate(quantities))


# What a header has besides if the error is estimated.
_FINER = """\
/*
 * The finer run has the same inputs. If a controller gives them, give the finer run its own, so
 * that the error is that of the loop: after `name_set_input`, which sets inputs of both runs, set
 * what the controller would do about these values: carrier x, y and shaft angle of the finer run,
 * their rates, and x, y and rotation of its tip.
 */
int name_get_finer(name *instance, double values[9]);
int name_set_finer_input(name *instance, int input, double value);

"""


def _header(made, step, target, name):
    inputs, outputs, parameters, parts = made.interface
    return _fill(
        'name.h', name, version=__version__, target=target, step=repr(step), size=made.size,
        saved=made.saved, inputs=len(inputs), outputs=len(outputs), parameters=len(parameters),
        codes=_enum(name, [Quantity(code.name, '', TEXTS[code]) for code in Code]),
        input_list=_enum(name, inputs), output_list=_enum(name, outputs),
        parameter_list=_enum(name, parameters), motion=made.motion, drawn=DRAWN,
        finer=_named(_FINER, name) if parts else '')


def _main(interface: Interface, step: float, name: str) -> bytes:
    # A tenth of a second or at least a step a row; a torque, where it does anything.
    torque = any(each.title == 'torque' for each in interface.inputs)
    command = ('    if (code == NAME_OK)\n'
               '        code = name_set_input(instance, NAME_TORQUE, 1.0);') if torque else ''
    return _fill('main.c', name, command=_named(command, name), steps=max(1, round(0.1 / step)),
                 under=' under a torque of 1 N m besides the loads of the scene' if torque else '')
