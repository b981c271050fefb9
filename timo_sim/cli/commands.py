# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Most subcommands of `timo_sim`; each imports what it needs when it runs, for a quick start."""

import os
import re
import signal
import sys
import warnings

import click

from timo_sim.extras import optional
from timo_sim.version import __version__

# Errors by name, because most of their modules are not imported here.
_WRONG_INPUT = 'FileNotFoundError', 'LogError', 'ParameterError', 'TrackError'


def _shown(message, category, filename, lineno, file=None, line=None):
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
        """Read the command line; several values may follow one `--set`."""
        given, follows = [], False
        for argument in args:
            value = re.match(r'[\w.]+=', argument)
            if follows and value and given[-1] != '--set':
                given.append('--set')
            follows = argument.startswith('--set') or follows and bool(value)
            given.append(argument)
        return super().parse_args(context, given)

    def invoke(self, context):
        """Run it; exit with 2 for wrong input, 1 for a failed import, MemoryError or OSError."""
        try:
            with warnings.catch_warnings(), optional():
                warnings.showwarning = _shown
                super().invoke(context)
            sys.stdout.flush()
            return
        except BrokenPipeError:  # the reader of the output, such as head, has left
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # for what is still in the buffer
            sys.exit(128 + signal.SIGPIPE)
        except Exception as error:
            code, text = 1, str(error)
            if type(error).__name__ in _WRONG_INPUT:
                code = 2
            elif not isinstance(error, (ImportError, MemoryError, OSError)):
                raise
        click.echo('timo_sim: ' + ' '.join(text.split()), err=True)
        sys.exit(code)


@click.group()
@click.version_option(__version__, prog_name='timo_sim')
def main():
    """Simulate a mobile manipulator with a flexible arm."""


main.command_class = _Command


def parsed(settings):
    """Return values by name from texts such as 'model.modes=5', with values in YAML."""
    from timo_sim.scene.files import parse_yaml
    from timo_sim.scene.parameter import ParameterError
    values = {}
    for text in settings:
        name, equals, value = text.partition('=')
        try:
            values[name.strip()] = parse_yaml(value, name)
        except ParameterError:
            equals = ''
        if not equals:
            raise ParameterError(f'--set takes NAME=VALUE, such as model.modes=5; got {text!r}')
    return values


@main.command()
@click.argument('scene')
@click.option('--set', 'settings', multiple=True, metavar='NAME=VALUE',
              help='A parameter that differs from the scene; several may follow.')
@click.option('--input', 'cause', default='torque_N_m', show_default=True, metavar='NAME',
              help='Input of the model: force_x_N, force_y_N, torque_N_m, tip_force_x_N, '
                   'tip_force_y_N or tip_torque_N_m.')
@click.option('--response', 'effects', multiple=True, metavar='NAME', show_default=True,
              default=['shaft_rad', 'tip_transverse_m', 'root_strain'],
              help='Output of the model, such as tip_acceleration_m_per_s2; once for each curve.')
@click.option('--output', '-o', 'picture', type=click.Path(dir_okay=False), default='bode.png',
              show_default=True, help='Picture to write: PNG, PDF or SVG.')
def bode(scene, settings, cause, effects, picture):
    r"""
    Draw the Bode diagram of SCENE, a file or a name, about its initial state, and print its poles.

    \b
        timo_sim bode paper --set arm.damping_ratio=0.01 -o bode.png
    """
    from timo_sim.simulation.linear import linearize
    from timo_sim.scene.scene import load_scene
    from timo_sim.view import plot
    model = linearize(load_scene(scene, parsed(settings))).select([cause], effects)
    plot.write(plot.bode(model), picture)
    click.echo(f'poles [Hz]: {", ".join(f"{each:.3g}" for each in model.frequencies())}')
    click.echo(f'{picture} is drawn')


@main.command()
@click.argument('file', type=click.Path())
@click.option('--output', '-o', type=click.Path(), required=True, help=(
    'New file, *.parquet or *.csv; with --bag a new folder.'))
@click.option('--topic', metavar='NAME', help=(
    "Write this topic alone, such as '~/motor_torque' (~ is the node's name) or joint_states."))
@click.option('--bag', is_flag=True, help=(
    'Make the folder that rosbag2 writes: FILE as OUTPUT_0.mcap, with metadata.yaml beside it.'))
@click.option('--node', metavar='NAME', help='Full name of the node, if a bag has several.')
def export(file, output, topic, bag, node):
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
    from timo_sim.log.export import export, export_bag
    from timo_sim.log.records import LogError
    if bag and (topic or node):
        raise LogError(f'--bag takes the whole file: leave out {"--topic" if topic else "--node"}')
    click.echo(export_bag(file, output) if bag else export(file, output, topic, node))


@main.command()
@click.argument('file', type=click.Path())
def info(file):
    r"""
    Describe FILE, a log or a bag's folder: scene, duration, topics with rates and gaps, peak.

    \b
        timo_sim info run.mcap
    """
    from timo_sim.log.info import info
    click.echo('\n'.join(info(file)))


@main.command()
@click.argument('file', type=click.Path())
@click.option('--output', '-o', type=click.Path(),
              help="New log; by default beside FILE, a log or a bag's folder, with _recovered "
                   'after its name.')
def recover(file, output):
    r"""
    Write what is intact in FILE, a log that ends early or is damaged, to a new log.

    \b
        timo_sim recover run.mcap

    FILE is not changed. If it is complete, nothing is written.
    """
    from timo_sim.log.recover import recover
    click.echo(recover(file, output))


@main.command()
@click.argument('file', type=click.Path())
@click.option('--set', 'settings', multiple=True, metavar='NAME=VALUE',
              help='A parameter that differs from the recorded scene; several may follow.')
@click.option('--formulation', metavar='NAME', help='Short for --set model.formulation=NAME.')
@click.option('--scene', type=click.Path(),
              help='Parameter file to use instead of the recorded scene; a plain bag needs it.')
@click.option('--output', '-o', type=click.Path(), help=(
    'New log; by default FILE with _replay after its name in the working directory if anything '
    'is changed, else none. Never overwrites: _1, _2, ... is appended.'))
@click.option('--start', type=float, default=0.0, show_default=True,
              help='Sim time of the first command of a bag without sim time [s].')
@click.option('--duration', type=float,
              help='Sim time of the end [s]; by default that of the last message.')
@click.option('--node', metavar='NAME', help='Full name of the node, if a bag has several.')
def replay(file, settings, formulation, scene, output, start, duration, node):
    r"""
    Run the commands and resets of FILE again, at full speed, and compare.

    With the recorded scene, a log of this package gives the same numbers to the last bit. With a
    changed scene the same commands are run, a new log is written and the differences are shown:
    largest, its time, rms.

    \b
        timo_sim replay run.mcap
        timo_sim replay run.mcap --set model.modes=5 --formulation newton

    A plain bag of commands needs the scene. Its commands act from the first time step at or after
    their stamp. Stamps are sim time if the bag has one of the node's topics with sim time in its
    headers, else log time, counted from the first command, which acts at --start:

    \b
        timo_sim replay bag --scene my_scene.yaml --duration 20

    Exit codes: 0 good; 1 the unchanged scene does not give the same bits, or not all are compared,
    or the run diverges; 2 bad input.
    """
    from timo_sim.replay.replay import replay
    changes = parsed(settings)
    if formulation:
        changes['model.formulation'] = formulation
    if not replay(file, changes, output, scene, start, duration, node, click.echo):
        sys.exit(1)


@main.command()
@click.argument('scene')
@click.option('--duration', type=float, default=10.0, show_default=True, help='Sim time [s].')
@click.option('--set', 'settings', multiple=True, metavar='NAME=VALUE',
              help='A parameter that differs from the scene; several may follow.')
@click.option('--output', '-o', type=click.Path(dir_okay=False), help=(
    'File of the run: *.mcap (a log), *.parquet or *.csv. An existing log is never overwritten; '
    '_1, _2, ... is appended.'))
@click.option('--rate', type=float, metavar='HZ', help=(
    'Samples per second of sim time; by default about 100, or one each step if these do not fit.'))
@click.option('--estimate/--no-estimate', default=True, show_default=True,
              help='Measure the error by a finer run.')
@click.option('--view', is_flag=True, help='Show the run in rerun.')
@click.option('--png', type=click.Path(dir_okay=False), metavar='OUT.png',
              help='Picture to write: curves over time, and the arm in the plane.')
def simulate(scene, duration, settings, output, rate, estimate, view, png):
    r"""
    Simulate SCENE, a parameter file or the name of an installed scene, without ROS.

    \b
        timo_sim simulate paper --png paper.png
        timo_sim simulate my_scene.yaml --duration 20 --set model.modes=5 -o run.mcap

    Exit codes: 0 good; 1 the run diverges (samples up to there are written); 2 bad input.
    """
    from timo_sim.runs.simulate import simulate
    from timo_sim.scene.parameter import ModelWarning, whole_ratio
    from timo_sim.scene.scene import load_scene
    from timo_sim.simulation.resolution import resolved
    from timo_sim.simulation.model_warnings import DivergenceError
    # If these are missing, fail before minutes are spent on the run.
    if png:
        from timo_sim.view import plot
    if view:
        import rerun  # noqa: F401
    if output and output.endswith('.parquet'):
        import pyarrow  # noqa: F401
    scene, steps = resolved(load_scene(scene, parsed(settings)), duration, click.echo)
    if rate:
        every = whole_ratio('1/integrator.step', 1.0 / scene.step, '--rate', rate)
    else:
        every = max(1, round(0.01 / scene.step))
        every = every if steps % every == 0 else 1
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', ModelWarning)  # `run.message` has its text
            run, diverged = simulate(scene, duration, every, estimate), None
    except DivergenceError as error:
        run, diverged = error.run, error
    click.echo(run.message)
    if output:
        click.echo(f'{run.save(output)} is written')
    if png:
        plot.write(run.plot(), png)
        click.echo(f'{png} is drawn')
    if view:
        run.view()
    if diverged:
        click.echo(f'timo_sim: {diverged}', err=True)
        sys.exit(1)


@main.command()
@click.argument('file', type=click.Path(exists=True, dir_okay=False))
@click.option('--output', '-o', type=click.Path(),
              help='Parquet folder; by default named after FILE, in the working directory.')
@click.option('--workers', type=click.IntRange(min=1), help='Processes; by default one a core.')
@click.option('--scheduler', metavar='ADDRESS',
              help='Use workers of this Dask scheduler instead of processes of this machine.')
def sweep(file, output, workers, scheduler):
    r"""
    Do the runs of FILE and write a table of their results.

    \b
        timo_sim sweep config/sweep.yaml

    If a sweep was stopped, the same command continues it.
    """
    from timo_sim.sweep.store import run_sweep
    run_sweep(file, output, workers, scheduler)
