# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Export of a scene as a C library: an object file, its header and a program that runs it."""

from __future__ import annotations

from pathlib import Path
import shutil
from string import Template
import subprocess

from timo_sim.compiled.machine import TARGETS
from timo_sim.export.constants import Interface, Quantity, refuse
from timo_sim.export.instance import Code
from timo_sim.export.library import library, TEXTS
from timo_sim.model.formulation import DRAWN
from timo_sim.scene.files import check_target, whole_file
from timo_sim.scene.parameters import checked, FLAG, ParameterError, PATH, short
from timo_sim.scene.scene import load_scene, SceneLike
from timo_sim.version import __version__

_HEADER = """\
/*
 * A flexible arm, exported by timo_sim $version for $target.
 *
 * An instance lives in memory that its caller owns, ARM_SIZE bytes at an address that is a
 * multiple of 8. Nothing is allocated or printed. Instances are independent; one instance is for
 * one thread at a time. Functions return ARM_OK or another code of enum arm_code; a call that
 * fails changes nothing, but a step that diverges leaves the steps before it done.
 */
#ifndef ARM_H
#define ARM_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ARM_STEP $step /* time step [s] */
#define ARM_SIZE $size /* of an instance [bytes] */
#define ARM_STATE_SIZE $saved /* count of numbers of a saved state */
#define ARM_INPUTS $inputs /* count of inputs */
#define ARM_OUTPUTS $outputs /* count of outputs */
#define ARM_PARAMETERS $parameters /* count of parameters */
#define ARM_MOTION $motion /* count of numbers of a motion */
#define ARM_SHAPE $drawn /* count of points of a shape */

enum arm_code {
$codes
};

/* Inputs act besides the loads of the scene, from the next step on until they are set again. */
enum arm_input {
$input_list
};

enum arm_output {
$output_list
};

/* Parameters are the scene's until they are set; they are > 0, and INFINITY is no limit. */
enum arm_parameter {
$parameter_list
};

typedef struct arm arm;

/* Size of an instance in bytes, ARM_SIZE. */
size_t arm_size(void);

/* Make an instance of `size` bytes of memory, at the start of the scene; it is a arm * then. */
int arm_create(void *memory, size_t size);

/* Return to the start of the scene, with inputs 0; parameters stay. */
int arm_reset(arm *instance);

/* Set or get an input. */
int arm_set_input(arm *instance, int input, double value);
int arm_get_input(const arm *instance, int input, double *value);

/* Set or get a parameter; what acts of inputs goes on from its value at this step. */
int arm_set_parameter(arm *instance, int parameter, double value);
int arm_get_parameter(const arm *instance, int parameter, double *value);

/* Advance by some time steps, under constant inputs. */
int arm_step(arm *instance, int64_t steps);

/*
 * Get the derivatives of the motion after the next step, which is not done, under the inputs of
 * now: values[k][i] is that of number i by number k of the motion now or, from ARM_MOTION on, by
 * input k - ARM_MOTION. A motion is carrier x, y and shaft, the modal coordinates, then the rate
 * of each; rows and columns of what is held, locked or driven are 0.
 */
int arm_step_derivatives(arm *instance,
                          double values[ARM_MOTION + ARM_INPUTS][ARM_MOTION]);

/* Get an output, or all of them, at the end of the last step; the first call computes them. */
int arm_get_output(arm *instance, int output, double *value);
int arm_get_outputs(arm *instance, double values[ARM_OUTPUTS]);

/*
 * Get the arm's shape, to draw: x and y of points of the centre line in the world [m], at equal
 * distances along the arm from its root, which is the hub's radius from the carrier, to its tip.
 */
int arm_get_shape(arm *instance, double values[ARM_SHAPE][2]);

/* Get or set the state: time, inputs, parameters, motion; runs go on from it to the last bit. */
int arm_get_state(const arm *instance, double values[ARM_STATE_SIZE]);
int arm_set_state(arm *instance, const double values[ARM_STATE_SIZE]);

/* Texts; "unknown" for a number that is none. */
const char *arm_error_text(int code);
const char *arm_input_name(int input);
const char *arm_input_unit(int input);
const char *arm_output_name(int output);
const char *arm_output_unit(int output);
const char *arm_parameter_name(int parameter);
const char *arm_parameter_unit(int parameter);

#ifdef __cplusplus
}
#endif

#endif
"""

_MAIN = """\
/* Run it$under and print a table. */
#include <stdio.h>

#include "arm.h"

static double memory[(ARM_SIZE + 7) / 8];

int main(void)
{
    static const int shown[] = {
        ARM_TIME, ARM_SHAFT, ARM_TIP_X, ARM_TIP_Y, ARM_TIP_TRANSVERSE};
    const int count = sizeof shown / sizeof *shown;
    arm *instance = (arm *)memory;
    int code = arm_create(memory, sizeof memory);
$command
    for (int k = 0; k < count; ++k)
        printf("%16s%s", arm_output_name(shown[k]), k + 1 < count ? " " : "\\n");
    for (int row = 0; code == ARM_OK && row <= 20; ++row) {
        double outputs[ARM_OUTPUTS];
        arm_get_outputs(instance, outputs);
        for (int k = 0; k < count; ++k)
            printf("%16.9g%s", outputs[shown[k]], k + 1 < count ? " " : "\\n");
        code = arm_step(instance, $steps);
    }
    if (code != ARM_OK)
        fprintf(stderr, "%s\\n", arm_error_text(code));
    return code;
}
"""

_CMAKE = """\
cmake_minimum_required(VERSION 3.16)
project(arm C)

add_library(arm STATIC ${CMAKE_CURRENT_SOURCE_DIR}/arm.o)
set_target_properties(arm PROPERTIES LINKER_LANGUAGE C)
target_include_directories(arm INTERFACE ${CMAKE_CURRENT_SOURCE_DIR})

add_executable(main main.c)
target_link_libraries(main arm)
"""


@checked(folder=PATH, estimate=FLAG)
def export_c(scene: SceneLike, folder: Path | str, target: str = 'host',
             estimate: bool = False) -> Path:
    """
    Write a scene as a C library: arm.h, arm.o, main.c and CMakeLists.txt.

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
    return write_c(scene, folder, target, estimate)


def write_c(scene: SceneLike, folder: Path | str, target: str = 'host', estimate: bool = False,
            derivatives: bool = True) -> Path:
    """Do what `export_c` does; without `derivatives` arm_step_derivatives is only declared."""
    scene, folder = load_scene(scene), Path(folder)
    if target not in ('host', *TARGETS):
        raise ParameterError(f'target must be host, {", ".join(TARGETS)}, got {short(target)}')
    for file in ('arm.h', 'arm.o', 'main.c', 'CMakeLists.txt'):
        check_target(folder / file)
    refuse(scene, estimate)
    made = library(scene, estimate, target, derivatives)
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in {
            'arm.h': _header(made, scene.step, target).encode(), 'arm.o': made.content,
            'main.c': _main(made.interface, scene.step).encode(),
            'CMakeLists.txt': _CMAKE.encode()}.items():
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


def _enum(quantities):
    return '\n'.join(
        f'    ARM_{each.title.upper()} = {number}, '
        f'/* {each.meaning}{f" [{each.unit}]" if each.unit else ""} */'
        for number, each in enumerate(quantities))


def _header(made, step, target):
    inputs, outputs, parameters, _ = made.interface
    return Template(_HEADER).substitute(
        version=__version__, target=target, step=repr(step), size=made.size, saved=made.saved,
        inputs=len(inputs), outputs=len(outputs), parameters=len(parameters),
        codes=_enum([Quantity(code.name, '', TEXTS[code]) for code in Code]),
        input_list=_enum(inputs), output_list=_enum(outputs), parameter_list=_enum(parameters),
        motion=made.motion, drawn=DRAWN)


def _main(interface: Interface, step: float) -> str:
    # A tenth of a second or at least a step a row; a torque, where it does anything.
    torque = any(each.title == 'torque' for each in interface.inputs)
    command = ('    if (code == ARM_OK)\n'
               '        code = arm_set_input(instance, ARM_TORQUE, 1.0);') if torque else ''
    return Template(_MAIN).substitute(
        command=command, steps=max(1, round(0.1 / step)),
        under=' under a torque of 1 N m' if torque else '')
