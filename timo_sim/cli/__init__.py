# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The command `timo_sim` with its subcommands; `sim_node` is a module of its own.

Each subcommand imports what it needs when it runs, for a quick start. This package may import
everything; nothing imports it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial, wraps
from importlib import import_module
import os
from pathlib import Path
import re
import shlex
import signal
import sys
from typing import Any, TYPE_CHECKING
import warnings

import click

from timo_sim.extras import optional
from timo_sim.version import __version__

if TYPE_CHECKING:
    from timo_sim.scene.scene import Scene

# Errors by name, because most of their modules are not imported here.
_WRONG_INPUT = ('FileExistsError', 'FileNotFoundError', 'IsADirectoryError', 'LogError',
                'ParameterError')


def _show_warning(message, category, filename, lineno, file=None, line=None):
    """Print a warning; a ModelWarning is one line, without a place in this package or click."""
    text = warnings.formatwarning(message, category, filename, lineno, line).rstrip()
    if category.__name__ == 'ModelWarning':
        text = 'timo_sim: ' + ' '.join(str(message).split())
    click.echo(text, err=True)


class _Command(click.Command):
    """A subcommand that reports an error as one line and an exit code."""

    def __init__(self, name, **options):
        # In a raw docstring, click's mark of a preformatted paragraph is two characters.
        # There is none with `python -OO`.
        options['help'] = (options['help'] or '').replace('\\b', '\b')
        super().__init__(name, **options)

    def parse_args(self, context, args):
        """Read the command line; several may follow one `--set` or `--bounds`."""
        given, option = [], ''
        for argument in args:
            value = re.match(r'[\w.[\]]+=', argument)
            if option and value and given[-1] != option:
                given.append(option)
            found = re.match('(--set|--bounds)(=|$)', argument)
            option = found[1] if found else option if value else ''
            given.append(argument)
        return super().parse_args(context, given)

    def invoke(self, context):
        """Run it; exit with 2 for wrong input, 1 for a failed import, MemoryError or OSError."""
        try:
            with warnings.catch_warnings(), optional():
                warnings.showwarning = _show_warning
                super().invoke(context)
            sys.stdout.flush()
            return
        except BrokenPipeError:  # the reader of the output, such as head, has left
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # for what is still in the buffer
            sys.exit(128 + signal.SIGPIPE)
        except Exception as error:
            code, text = 1, str(error)
            if any(each.__name__ in _WRONG_INPUT for each in type(error).__mro__):
                code = 2
            elif not isinstance(error, (ImportError, MemoryError, OSError)):
                raise
        text = ''.join(char if char.isprintable() else ' ' for char in ' '.join(text.split()))
        click.echo(f'timo_sim: {text}', err=True)  # what files contain rules no terminal
        sys.exit(code)


@click.group()
@click.version_option(__version__, prog_name='timo_sim')
def main() -> None:
    """Simulate a mobile manipulator with a flexible arm."""


main.command_class = _Command
_FILE = click.Path(dir_okay=False)
_settings = click.option('--set', 'settings', multiple=True, metavar='NAME=VALUE',
                         help='A parameter that differs from the scene; several may follow.')
_deflection_scale = click.option(
    '--deflection-scale', type=click.FloatRange(min=0.0, max=1e9, min_open=True), default=1.0,
    show_default=True, help='Draw the arm with so many times its deflection; pictures state it.')


def _check_gif(context, option, path):
    if path and not path.endswith('.gif'):
        raise click.BadParameter(f'an animation must end with .gif, got {path}')
    return path


_gif = click.option('--gif', type=_FILE, metavar='OUT.gif', callback=_check_gif,
                    help='Animation to write: the arm in the plane, and how its tip bends.')
_node = click.option('--node', metavar='NAME', help='Full name of the node, if a bag has several.')
_estimate = click.option('--estimate/--no-estimate', default=True, show_default=True, help=(
    'Measure the error of the tip by a finer run; doc/scene.md says what it costs.'))
_png = partial(click.option, '--png', type=_FILE, metavar='OUT.png')


def _takes_scene(command: Callable) -> Callable:
    """Give a subcommand the argument SCENE and the option --set; it gets the Scene of these."""
    @click.argument('scene')
    @_settings
    @wraps(command)
    def with_scene(scene: str, settings: tuple[str, ...], **options: Any) -> None:
        from timo_sim.scene.scene import load_scene
        command(load_scene(scene, parse_settings(settings)), **options)
    return with_scene


def _require(*files, **wanted):
    """Check files that are to be written and import packages: before minutes are spent."""
    from timo_sim.scene.files import check_folder
    for file in filter(None, files):
        check_folder(file)
    for package, needed in wanted.items():
        if needed:
            import_module(package)


_CONTACT = click.option(
    '--contact', default='', metavar='closed|open',
    help='Of a gear with backlash that nothing loads at rest: as if it had none, or within it.')


def _draw(figure, path):
    from timo_sim.view.plot import write
    write(figure, path)
    click.echo(f'{path} is drawn')


@main.command()
@_takes_scene
@click.option('--input', 'cause', default='torque_N_m', show_default=True, metavar='NAME',
              help='Input of the model: force_x_N, force_y_N, torque_N_m, voltage_V (of a DC '
                   'motor), tip_force_x_N, tip_force_y_N, tip_torque_N_m, push_x_N, push_y_N.')
@click.option('--response', 'effects', multiple=True, metavar='NAME', show_default=True,
              default=['shaft_rad', 'tip_transverse_m', 'root_strain'],
              help='Output of the model, once for each curve: also tip_angle_rad, gyro_rad_per_s, '
                   'tip_acceleration_m_per_s2, ...; a wrong name lists them all.')
@click.option('--png', '--output', '-o', 'picture', type=_FILE, default='bode.png',
              show_default=True, help='Picture to write: PNG, PDF or SVG.')
@_CONTACT
def bode(scene: Scene, cause: str, effects: tuple[str, ...], picture: str,
         contact: str) -> None:
    r"""
    Draw the Bode diagram of SCENE, a file or a name, about its initial state.

    \b
        timo_sim bode paper --set arm.damping_ratio=0.01 --png bode.png
    """
    from timo_sim.runs.linear import linearize
    from timo_sim.runs.modes import modes
    from timo_sim.view.plot import bode
    model = linearize(scene, None, contact, [cause], effects)
    _draw(bode(model, modes(scene, contact=contact).frequency), picture)


@main.command()
@click.argument('file', type=click.Path())
@click.option('--output', '-o', type=click.Path(), required=True, help=(
    'New file, *.parquet or *.csv; with --bag a new folder.'))
@click.option('--topic', metavar='NAME', help=(
    "Write this topic alone, such as '~/motor_torque' (~ is the node's name) or joint_states."))
@click.option('--bag', is_flag=True, help=(
    'Make the folder that rosbag2 writes: FILE as OUTPUT_0.mcap, with metadata.yaml beside it.'))
@_node
def export(file: str, output: str, topic: str | None, bag: bool, node: str | None) -> None:
    r"""
    Write FILE, a log or a bag, as a table with units in the names of columns.

    \b
        timo_sim export run.mcap -o run.parquet
        timo_sim export run.mcap -o torque.csv --topic '~/motor_torque'
        timo_sim export run.mcap -o my_bag --bag

    There is one row for each message of joint_states. It also has the messages of the other topics
    with the same stamp, and nothing (NaN) if there is none. At a reset two rows have the same
    time, before and after it.
    """
    from timo_sim.log.read import LogError
    from timo_sim.log.tables import export, export_bag
    if bag and (topic or node):
        raise LogError(f'--bag takes the whole file: leave out {"--topic" if topic else "--node"}')
    click.echo(export_bag(file, output) if bag else export(file, output, topic, node))


@main.command()
@_takes_scene
@click.option('--output', '-o', type=click.Path(file_okay=False), required=True,
              metavar='FOLDER', help='Folder to write to.')
@click.option('--target', default='host', show_default=True,
              help='Processor: host, x86-64-v2, x86-64-v3, aarch64, riscv64, wasm32 or '
                   'wasm32-simd128.')
@click.option('--estimate', is_flag=True,
              help='Advance a finer run beside, which measures the error of the tip.')
@click.option('--name', default='arm', show_default=True, help='First part of all names in C.')
def export_c(scene: Scene, output: str, target: str, estimate: bool, name: str) -> None:
    r"""
    Write SCENE, a parameter file or the name of an installed scene, as a C library.

    \b
        timo_sim export-c paper -o paper_in_c
        cmake -S paper_in_c -B paper_in_c/build && cmake --build paper_in_c/build
        paper_in_c/build/main

    The folder gets arm.h, arm.o, main.c and CMakeLists.txt; older ones are replaced. The object
    file needs no Python and no other library.
    """
    from timo_sim.export.c import export_c
    click.echo('compiling, which takes up to half a minute', err=True)
    folder = export_c(scene, output, target, estimate, name)
    click.echo(f'{folder} is written: {name}.h, {name}.o, main.c, CMakeLists.txt')


@main.command('export-fmu')
@_takes_scene
@click.option('--output', '-o', type=_FILE, required=True, metavar='FILE.fmu',
              help='FMU to write; an older one is replaced.')
@click.option('--fmi', type=click.Choice(['2', '3']), default='3', show_default=True,
              help='Version of FMI: 2.0 or 3.0.')
@_estimate
@click.option('--target', default='host', show_default=True, metavar='NAME', help=(
    'Processor that runs it: host (this one), x86-64-v2 or x86-64-v3 (many).'))
def export_fmu(scene: Scene, output: str, fmi: str, estimate: bool, target: str) -> None:
    r"""
    Write SCENE, a file or a name, as an FMU for co-simulation on Linux x86-64.

    \b
        timo_sim export-fmu paper -o paper.fmu
        timo_sim export-fmu paper -o arm.fmu --fmi 2 --set model.modes=5 --no-estimate

    It needs the C compiler cc.
    """
    from timo_sim.export.fmu import export_fmu
    click.echo('compiling, which takes up to half a minute', err=True)
    click.echo(export_fmu(scene, output, int(fmi), estimate, target))


@main.command('export-web')
@click.argument('scenes', nargs=-1, required=True, metavar='SCENE...')
@_settings
@click.option('--output', '-o', type=_FILE, required=True, metavar='FILE.html',
              help='Page to write; an older one is replaced.')
@_estimate
def export_web(scenes: tuple[str, ...], settings: tuple[str, ...], output: str,
               estimate: bool) -> None:
    r"""
    Write each SCENE, a file or a name, into one page that simulates it in a browser.

    \b
        timo_sim export-web paper -o arm.html
        timo_sim export-web paper arm standing -o arms.html --no-estimate

    The page needs no network, and opens from a folder. It needs the linker wasm-ld.
    """
    from timo_sim.export.web import export_web
    from timo_sim.scene.scene import load_scene
    changes, names = parse_settings(settings), [Path(each).stem for each in scenes]
    if len({*names}) < len(names):
        names = [*scenes]
    click.echo(export_web({name: load_scene(each, changes) for name, each in zip(names, scenes)},
                          output, estimate, lambda text: click.echo(text, err=True)))


@main.command()
@click.argument('file', type=click.Path())
def info(file: str) -> None:
    r"""
    Describe FILE, a log or a bag's folder: scene, duration, topics with mean rates.

    \b
        timo_sim info run.mcap
    """
    from timo_sim.log.info import info
    click.echo('\n'.join(info(file)))


@main.command()
@_takes_scene
@click.argument('more', nargs=-1, type=float, metavar='[RAD/S]...')
@click.option('--speed', multiple=True, type=float, metavar='RAD/S [RAD/S]...', help=(
    'Speeds at which the shaft is turned steadily, with the carrier held.'))
@_png(help='Picture to write: shapes; with --speed the Campbell diagram.')
@_CONTACT
def modes(scene: Scene, more: tuple[float, ...], speed: tuple[float, ...],
          png: str | None, contact: str) -> None:
    r"""
    Print frequencies and damping ratios of SCENE, a file or a name, about rest or at shaft speeds.

    \b
        timo_sim modes paper --set arm.damping_ratio=0.01 --png modes.png
        timo_sim modes spin_up --speed 0 3 6 --png campbell.png

    The error is relative, from a model with two more modes.
    """
    from timo_sim.runs.modes import modes
    _require(png, matplotlib=png)
    speeds = *speed, *more
    found = {each: modes(scene, each, contact) for each in speeds or (None, 0.0)}
    names = {None: 'carrier and shaft as in the scene', 0.0: 'clamped arm'}
    for each, vibrations in found.items():
        click.echo(f'{names.get(each, f"shaft at {each} rad/s")}:\n{vibrations}')
    if png:
        from timo_sim.view.plot import campbell
        _draw(campbell(found) if speeds else found[None].plot(), png)


@main.command()
@click.argument('file', type=_FILE)
def new(file: str) -> None:
    r"""
    Write a short scene to a new FILE, to be changed into your own arm.

    \b
        timo_sim new my_arm.yaml
        timo_sim simulate my_arm.yaml --duration 2 --png run.png
    """
    from timo_sim.scene.files import scene_file, whole_file
    text, name = scene_file('arm').read_text(encoding='utf-8'), click.format_filename(file)
    with whole_file(file, new=True) as part:
        part.write_text(text.replace('arm.yaml', shlex.quote(os.path.basename(name))),
                        encoding='utf-8')
    click.echo(f'{name} is written; try timo_sim simulate {shlex.quote(name)} --duration 2 --png '
               'run.png')


@main.command()
@click.argument('file', type=click.Path())
@click.option('--output', '-o', type=click.Path(),
              help="New log; by default beside FILE, a log or a bag's folder, with _recovered "
                   'after its name.')
def recover(file: str, output: str | None) -> None:
    r"""
    Write what is intact in FILE, a log that ends early or is damaged, to a new log.

    \b
        timo_sim recover run.mcap

    FILE is not changed. If it is complete, nothing is written.
    """
    from timo_sim.log.read import recover
    click.echo(recover(file, output))


@main.command()
@click.argument('file', type=click.Path())
@_settings
@click.option('--scene', type=click.Path(),
              help='Parameter file to use instead of the recorded scene; a bag without '
                   '~/scene needs it.')
@click.option('--output', '-o', type=click.Path(), help=(
    'New log; by default FILE with _replay after its name in the working directory if anything '
    'is changed, else none. Never overwrites: _1, _2, ... is appended.'))
@click.option('--duration', type=float,
              help='Sim time of the end [s]; by default that of the last message.')
@_node
def replay(file: str, settings: tuple[str, ...], scene: str | None, output: str | None,
           duration: float | None, node: str | None) -> None:
    r"""
    Run the commands and resets of FILE again, at full speed, and compare.

    With the recorded scene, a log of this package gives the same numbers to the last bit. With a
    changed scene the same commands are run, a new log is written and the differences are shown:
    largest, its time, rms.

    \b
        timo_sim replay run.mcap
        timo_sim replay run.mcap --set model.modes=5 model.formulation=newton

    A bag without ~/scene, such as one of commands alone, needs the scene; doc/log.md says when its
    commands act:

    \b
        timo_sim replay bag --scene my_scene.yaml --duration 20

    Exit codes: 0 good; 1 the unchanged scene does not give the same bits, or not all are compared,
    or the run diverges; 2 bad input.
    """
    from timo_sim.runs.replay import replay
    changes = parse_settings(settings)
    if not replay(file, changes, output, scene, duration, node, click.echo):
        sys.exit(1)


@main.command()
@_takes_scene
@click.option('--duration', type=float, default=10.0, show_default=True, help='Sim time [s].')
@click.option('--output', '-o', type=_FILE, help=(
    'File of the run: *.mcap (a log), *.parquet or *.csv. An existing log is never overwritten; '
    '_1, _2, ... is appended.'))
@click.option('--rate', type=float, metavar='HZ', help=(
    'Samples per second of sim time; by default every step, of a long run every n-th one, '
    'for 20000 samples at most if some n divides the number of steps.'))
@_estimate
@_png(help='Picture to write: curves over time, and the arm in the plane.')
@_gif
@_deflection_scale
def simulate(scene: Scene, duration: float, output: str | None, rate: float | None,
             estimate: bool, png: str | None, gif: str | None, deflection_scale: float) -> None:
    r"""
    Simulate SCENE, a parameter file or the name of an installed scene, without ROS.

    \b
        timo_sim simulate paper --png paper.png
        timo_sim simulate my_scene.yaml --duration 20 --set model.modes=5 -o run.mcap

    Exit codes: 0 good; 1 the run diverges (samples up to there are written); 2 bad input.
    """
    from timo_sim.log.tables import check_table
    from timo_sim.runs.simulate import enough_samples, resolve, simulate
    from timo_sim.scene.files import check_target
    from timo_sim.scene.parameters import ModelWarning, whole_ratio
    from timo_sim.simulation.warnings import DivergenceError
    if output and output.endswith('.mcap'):
        check_target(Path(output))
    elif output:
        check_table(Path(output), also='.mcap, ')
    _require(png, gif, matplotlib=png or gif, pyarrow=output and output.endswith('.parquet'))
    scene, steps = resolve(scene, duration, click.echo)
    every = whole_ratio('1/integrator.step', 1.0 / scene.step, '--rate', rate) if rate else (
        enough_samples(steps))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', ModelWarning)  # `run.message` has its text
            run, diverged = simulate(scene, duration, every, estimate), None
    except DivergenceError as error:
        run, diverged = error.run, error
    click.echo(run.message)
    if not rate and every > 1:
        click.echo(f'{1.0 / (every * scene.step):.6g} samples a second: --rate chooses others')
    if output:
        click.echo(f'{run.save(output)} is written')
    if png:
        _draw(run.plot(deflection_scale), png)
    if gif:
        from timo_sim.view.plot import animate
        from timo_sim.view.track import Track
        animate([Track(run, 'run', deflection_scale)], gif)
        click.echo(f'{gif} is written')
    if diverged:
        click.echo(f'timo_sim: {diverged}', err=True)
        sys.exit(1)


@main.command()
@click.argument('file', type=click.Path(exists=True, dir_okay=False))
@click.option('--output', '-o', type=click.Path(),
              help='New file, *.parquet or *.csv; by default FILE.parquet in the working folder.')
@click.option('--workers', type=click.IntRange(min=1), help='Processes; by default one a core.')
@click.option('--scheduler', metavar='ADDRESS',
              help='Use workers of this Dask scheduler instead of processes of this machine.')
def sweep(file: str, output: str | None, workers: int | None, scheduler: str | None) -> None:
    r"""
    Do the runs of FILE and write a table of their results.

    \b
        timo_sim sweep config/sweep.yaml

    Exit codes: 0 good; 1 every run fails (the table says why); 2 bad input.
    """
    from timo_sim.runs.sweep import run_sweep
    if not run_sweep(file, output, workers, scheduler):
        sys.exit(1)


@main.command()
@click.argument('records', nargs=-1, required=True, type=click.Path(), metavar='RECORD...')
@click.option('--scene', type=click.Path(), help=(
    'Parameter file or name of an installed scene, whose values are first guesses; by default '
    'that of RECORD, if it is a log of the node.'))
@click.option('--free', multiple=True, metavar='NAME,NAME', help=(
    'Parameters to be fitted: of the scene; QUANTITY.gain, .bias, .delay or .lag of an input or '
    'output, .dead_zone of an input; or initial for the whole initial state. NAME=VALUE~WIDTH '
    'gives a first guess and how well it is known: 5%, x3 (a factor), a number, or inf; a ~WIDTH '
    'alone is that of all that have none. It may be given again for further ones.'))
@click.option('--bounds', multiple=True, metavar='NAME=LOW:HIGH',
              help='Bounds of one of them; several may follow.')
@_settings
@click.option('--mapping', type=_FILE, metavar='FILE', multiple=True, help=(
    'YAML file that says which column of a table is which quantity; one for all records, or one '
    'for each, those of --hold-out-record at the end.'))
@click.option('--outputs', metavar='NAME,NAME', help='Outputs to be fitted; by default all.')
@click.option('--hold-out', type=float, default=0.0, show_default=True,
              help='Part of each RECORD, at its end, that is predicted and not fitted.')
@click.option('--hold-out-record', type=click.Path(), multiple=True, metavar='RECORD',
              help='Record that is predicted and not fitted.')
@click.option('--starts', type=int, metavar='COUNT', help=(
    'Starts to be tried; by default up to 16, until the minimum is good or found again.'))
@click.option('--quick', is_flag=True, help=(
    'End with the search: no intervals by profile and no suspects, which can take longer.'))
@click.option('--time', type=float, metavar='SECONDS', help=(
    'Wall time after which the search ends with the best so far, and time for intervals is left; '
    'on a busy machine they may be missing.'))
@click.option('--auto', is_flag=True, help=(
    'Choose the effects, too: each is tried in turn, from the plain arm or from what --free '
    'names, and kept if it predicts better what is held out of the fitted part for that.'))
@click.option('--loss', default='linear', show_default=True,
              help='Or soft_l1, huber or cauchy, with which outliers weigh less.')
@click.option('--output', '-o', type=_FILE, metavar='FITTED.yaml',
              help='Parameter file to write: the fitted scene.')
@_png(help='Picture to write: measured and predicted outputs of all records.')
def fit(records: tuple[str, ...], scene: str | None, free: tuple[str, ...],
        bounds: tuple[str, ...], settings: tuple[str, ...], mapping: tuple[str, ...],
        outputs: str | None, hold_out: float, hold_out_record: tuple[str, ...],
        starts: int | None, quick: bool, time: float | None, auto: bool, loss: str,
        output: str | None, png: str | None) -> None:
    r"""
    Fit parameters of a scene to RECORDs: logs, bags or tables, and predict the rest of them.

    \b
        timo_sim fit run.mcap --free motor.viscous_friction,arm.young_modulus
        timo_sim fit arm.csv --mapping columns.yaml --scene arm.yaml --hold-out 0.5 \
            --free arm.young_modulus=200e9~5%,shaft.bias -o fitted.yaml --png fit.png
        timo_sim fit arm.csv --mapping columns.yaml --scene arm.yaml --hold-out 0.5 --auto
        timo_sim fit a.csv b.csv --hold-out-record c.csv --mapping columns.yaml \
            --scene arm.yaml --free arm.young_modulus,motor.shaft_inertia

    Ctrl-C and SIGTERM end the search with the best so far.

    Exit codes: 0 good; 1 the search was stopped, by a signal, its time or an error: the best so
    far is reported and written; 2 bad input.
    """
    from timo_sim.fitting.result import fit, read_scene_and_records
    from timo_sim.scene.files import check_new, scene_text, whole_file
    from timo_sim.scene.parameters import ModelWarning
    from timo_sim.scene.scene import load_scene
    _require(png, matplotlib=png)

    def keep(scene, text):
        if output:
            with whole_file(output) as part:
                part.write_text(f'# Best so far of timo_sim fit --auto: {text}\n'
                                + scene_text(scene.values), encoding='utf-8')

    if output:
        check_new(output)
    changes, ends = parse_settings(settings), _parse_bounds(bounds)
    guess, measured, held = read_scene_and_records(
        scene, records, mapping[0] if len(mapping) == 1 else [*mapping] or None,
        hold_out_record)
    if outputs:
        measured, held = ([each.select(*outputs.split(',')) for each in some]
                          for some in (measured, held))
    # As Ctrl-C; one that was started in the background ignores that.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', ModelWarning)  # the report has its text
        names = [name for each in free for name in each.split(',')]
        found = fit(load_scene(guess, changes), measured, names, ends,
                    hold_out, loss, starts=starts, hold_out_records=held,
                    tell=partial(click.echo, err=True), quick=quick, time=time, auto=auto,
                    keep=keep)
    click.echo(found.report())
    if output:
        Path(output).unlink(missing_ok=True)  # the best so far
        click.echo(f'{found.save(output)} is written')
    if png:
        _draw(found.plot(), png)
    if found.stopped:
        sys.exit(1)


@main.command()
@click.argument('record', type=click.Path())
@click.option('--column', metavar='NAME', help=(
    'Column with what was measured; a wrong name lists them all. Of a log, or with --mapping, a '
    'quantity such as tip_acceleration.'))
@click.option('--mapping', type=_FILE, metavar='FILE', help=(
    'As of fit; without it the first column of a table is the time [s].'))
@click.option('--from', 'start', type=float, metavar='SECONDS', help='Where the ring-down starts.')
@click.option('--to', 'end', type=float, metavar='SECONDS', help='Where it ends, at the latest.')
@click.option('--shaper', 'kind', default='ZVD', show_default=True, help='Or ZV or EI.')
@click.option('--modes', type=click.IntRange(min=1), default=1, show_default=True,
              help='Vibrations that the shaper ends, the strongest first.')
@click.option('--move', type=_FILE, metavar='FILE', help=(
    'Move to shape: a table with the time [s], then joints; or a trajectory_msgs/JointTrajectory '
    'as *.yaml.'))
@click.option('--output', '-o', type=_FILE, metavar='FILE', help=(
    'New file with the shaped move, *.csv, *.parquet or *.yaml; by default MOVE_shaped.'))
@_png(help='Picture to write: the ring-down.')
def ringdown(record: str, column: str | None, mapping: str | None, start: float | None,
             end: float | None, kind: str, modes: int, move: str | None, output: str | None,
             png: str | None) -> None:
    r"""
    Find how an arm vibrates after a stop in RECORD, and shape a move that ends it.

    \b
        timo_sim ringdown phone.csv --column 'Linear Acceleration x (m/s^2)' --png rings.png
        timo_sim ringdown phone.csv --column 1 --from 2.4 --shaper EI \
            --move move.csv -o shaped.yaml

    RECORD is a table of an accelerometer, an encoder or a strain gauge, or a log.
    """
    from timo_sim.control.moves import read_move, read_signal, shape_move, write_move
    from timo_sim.control.ringdown import ringdown
    from timo_sim.control.shaping import shaper
    _require(png, matplotlib=png)
    given = read_move(move) if move else None
    found = ringdown(*read_signal(record, column, mapping), start, end)
    click.echo(found.report())
    if png:
        _draw(found.plot(), png)
    made = shaper(found.poles[:modes], kind)
    click.echo(f'{kind} for {min(modes, len(found.poles))} of them: ' + ', '.join(
        f'{100.0 * part:.2f} % after {time:.4f} s'
        for time, part in zip(made.times, made.amplitudes)))
    if move and given:
        output = output or str(Path(move).with_stem(Path(move).stem + '_shaped'))
        write_move(shape_move(given, made), output)
        click.echo(f'{output} is written')


@main.command(context_settings={'ignore_unknown_options': True})  # a negative number is a value
@click.argument('topic')
@click.argument('message')
@click.option('--node', default='/timo_sim', show_default=True, help='Full name of the node.')
@click.option('--wait', type=click.FloatRange(min=0.0, max=3600.0), default=10.0,
              show_default=True, help='How long to wait for the node [s].')
def send(topic: str, message: str, node: str, wait: float) -> None:
    r"""
    Send one command to a running node.

    \b
        timo_sim send motor_torque 1.0
        timo_sim send carrier_wrench '{header: {frame_id: arm}, wrench: {force: {y: -5}}}'
        timo_sim send joint_command '{name: [shaft], effort: [1.0]}'

    TOPIC is the name of a command topic of the node; a wrong one lists them all. MESSAGE is in
    YAML, as of ros2 topic pub, or its field data alone [N, N m, V].
    """
    from timo_sim.ros.send import send
    click.echo(send(topic, message, node, wait))


@main.command()
@click.argument('scene')
@_settings
@click.option('--ros2-control', 'library', type=_FILE, metavar='LIBRARY.so',
              help='Write the scene as a shared object for timo_sim_hardware, and name it in the '
                   'block <ros2_control>; needs the C compiler cc.')
def urdf(scene: str, settings: tuple[str, ...], library: str | None) -> None:
    r"""
    Print the URDF of SCENE, a parameter file or the name of an installed scene.

    \b
        timo_sim urdf my_scene.yaml > my_scene.urdf
        timo_sim urdf my_scene.yaml --ros2-control my_scene.so > my_scene.urdf

    Lengths, masses, centres of mass and moments of inertia are those of the scene with a straight
    arm; the link arm includes the inertia of the shaft. Links have the names of the frames.
    """
    from timo_sim.scene.parameters import frame_names
    from timo_sim.scene.scene import scene_from, values_of
    from timo_sim.scene.urdf import urdf_of
    values = values_of(scene, parse_settings(settings))
    loaded = scene_from(values)
    control = None
    if library:
        from timo_sim.export.ros2_control import write_hardware
        click.echo('compiling, which takes up to half a minute', err=True)
        control = write_hardware(loaded, values, library)
    click.echo(urdf_of(loaded.manipulator, frame_names(values), control))


@main.command()
@click.argument('files', nargs=-1, required=True, type=click.Path(exists=True))
@click.option('--save', type=_FILE, metavar='OUT.rrd',
              help='Write a file for rerun instead of opening it.')
@_png(help='Draw a picture instead, without a screen.')
@_gif
@click.option('--at', type=float, metavar='SECONDS',
              help='Sim time of the picture of --png, and of a frame in the file of --save [s]; '
                   'by default the end.')
@click.option('--fps', type=click.FloatRange(min=0.0, min_open=True), default=30.0,
              show_default=True, help='Frames per second of the arm, in an animation at most 20; '
              'curves have all samples.')
@_deflection_scale
@_node
def view(files: tuple[str, ...], save: str | None, png: str | None, gif: str | None,
         at: float | None, fps: float, deflection_scale: float, node: str | None) -> None:
    r"""
    Show recorded runs, laid over each other, in rerun or as an animation.

    FILES are logs of the node, or bags with its ~/scene. Everything stays on this machine.

    \b
        timo_sim view run.mcap
        timo_sim view before.mcap after.mcap --png compared.png --at 1.81
        timo_sim view run.mcap --gif run.gif --deflection-scale 5
    """
    in_rerun = save or png or not gif
    if at is not None and not (png or save):
        from timo_sim.scene.parameters import ParameterError
        raise ParameterError('--at is the time of a picture: it needs --png or --save')
    _require(gif, save, rerun=in_rerun, matplotlib=gif)
    from timo_sim.log.write import numbered
    from timo_sim.runs.replay import open_log
    from timo_sim.view.track import Track

    tracks: dict[str, Any] = {}
    for file in files:
        run = open_log(file, node)
        name = next(path.stem for path in numbered(run.recording.path) if path.stem not in tracks)
        tracks[name] = Track(run, name, deflection_scale)
    if gif:
        from timo_sim.view.plot import animate
        animate([*tracks.values()], gif, fps)
    if in_rerun:
        from timo_sim.view.rerun import show_tracks
        show_tracks([*tracks.values()], save, png, at, fps)
    for path in filter(None, (save, png, gif)):
        click.echo(f'{path} is written')


def parse_settings(settings: Iterable[str]) -> dict[str, Any]:
    """Return values by name from texts such as 'model.modes=5', with values in YAML."""
    from timo_sim.scene.files import parse_yaml
    return _parse(settings, lambda value: parse_yaml(value, '--set'),
                  '--set takes NAME=VALUE, such as model.modes=5')


def _parse_bounds(texts):
    def ends_of(text):
        low, high = text.split(':')
        return float(low or '-inf'), float(high or 'inf')
    return _parse(texts, ends_of, '--bounds takes NAME=LOW:HIGH, such as '
                  'motor.shaft_inertia=1e-4:0.1')


def _parse(texts, value_of, rule):
    """Return values by name from texts NAME=VALUE; ParameterError, with the rule, for another."""
    from timo_sim.scene.parameters import ParameterError
    found = {}
    for text in texts:
        name, equals, value = text.partition('=')
        try:
            if not equals:
                raise ValueError
            found[name.strip()] = value_of(value)
        except ValueError:
            raise ParameterError(f'{rule}; got {text!r}') from None
    return found
