"""The command `timo_sim`; what a subcommand needs is imported when it runs."""

from contextlib import contextmanager
from functools import partial
import sys

import click

_EXTRAS = {'pyarrow': 'sweep', 'distributed': 'cluster', 'rclpy': 'ros', 'rerun': 'view',
           'rerun_cli': 'view', 'matplotlib': 'plot'}


class _Command(click.Command):
    """A command whose raw docstring may have click's mark of lines that are kept as they are."""

    def __init__(self, *args, help=None, **options):
        super().__init__(*args, help=help and help.replace('\\b', '\b'), **options)


class _Commands(click.Group):
    command_class = _Command


@click.group(cls=_Commands)
@click.version_option(package_name='timo_sim')
def main():
    """Simulate a mobile manipulator with a flexible arm."""


@contextmanager
def one_line_for_errors(*wrong_input):
    """End the process with one line: code 2 for wrong input, 1 for what the machine lacks."""
    try:
        yield
    except (FileNotFoundError, *wrong_input) as error:
        code, text = 2, str(error)
    except OSError as error:
        code, text = 1, str(error)
    except ModuleNotFoundError as error:
        if error.name not in _EXTRAS:
            raise
        code, text = 1, f"{error.name} is missing: pip install 'timo_sim[{_EXTRAS[error.name]}]'"
    else:
        return
    click.echo('timo_sim: ' + ' '.join(text.split()), err=True)
    sys.exit(code)


@main.command()
@click.argument('file', type=click.Path(exists=True, dir_okay=False))
@click.option('--output', '-o', type=click.Path(dir_okay=False),
              help='Parquet file; by default FILE with this ending, in the working directory.')
@click.option('--workers', type=click.IntRange(min=1), help='Processes; by default one a core.')
@click.option('--scheduler', metavar='ADDRESS',
              help='Of a Dask scheduler, instead of processes of this machine.')
def sweep(file, output, workers, scheduler):
    r"""
    Do the runs of FILE and write a table of their results.

    \b
        timo_sim sweep config/sweep.yaml

    A sweep that was stopped goes on where it was when the command is given again.
    """
    from timo_sim.parameters import ParameterError
    with one_line_for_errors(ParameterError):
        from timo_sim.sweep.command import run_sweep
        run_sweep(file, output, workers, scheduler)


@main.command()
@click.argument('file', type=click.Path())
@click.option('--output', '-o', type=click.Path(),
              help='New log; by default beside FILE, with _recovered after its name.')
def recover(file, output):
    r"""
    Write what is intact in FILE, a log that ends early or is damaged, to a new log.

    \b
        timo_sim recover run.mcap

    FILE is only read. Of a complete log nothing is written.
    """
    from timo_sim.log.reader import LogError
    with one_line_for_errors(LogError):
        from timo_sim.log.recover import recover
        click.echo(recover(file, output))


@main.command()
@click.argument('file', type=click.Path())
@click.option('--set', 'settings', multiple=True, metavar='NAME=VALUE',
              help='A parameter that differs from the recorded scene; several are allowed.')
@click.option('--formulation', metavar='NAME', help='Short for --set model.formulation=NAME.')
@click.option('--scene', type=click.Path(),
              help='Parameter file to take instead of the recorded scene; a plain bag needs it.')
@click.option('--output', '-o', type=click.Path(), help=(
    'New log; by default FILE with _replay after its name in the working directory if anything '
    'is changed, else none. Never overwrites: _1, _2, ... is appended.'))
@click.option('--start', type=float, default=0.0, show_default=True,
              help='Sim time of the first command of a bag without sim time [s].')
@click.option('--duration', type=float,
              help='Sim time of the end [s]; by default that of the last message.')
@click.option('--node', metavar='NAME', help='Full name of the node, for a bag of several.')
def replay(file, settings, formulation, scene, output, start, duration, node):
    r"""
    Run the commands and resets of FILE again, at full speed, and compare.

    A log of this package gives the same numbers to the last bit. With a changed scene the same
    commands are run, a new log is written and the differences are shown: largest, when, rms.

    \b
        timo_sim replay run.mcap
        timo_sim replay run.mcap --set model.modes=5 --formulation newton

    A plain bag of commands needs the scene. Its commands act from the first time step at or after
    their stamp. Stamps are sim time if the bag has one of the node's topics with sim time in its
    headers, else log time, counted from the first command, which acts at --start:

    \b
        timo_sim replay bag --scene my_scene.yaml --duration 20

    Exit codes: 0 good; 1 the unchanged scene does not give the same bits, or the run diverges; 2
    bad input.
    """
    from timo_sim.log.reader import LogError
    from timo_sim.parameters import ParameterError
    from timo_sim.replay.plan import ReplayError
    with one_line_for_errors(LogError, ParameterError, ReplayError):
        from timo_sim.replay.command import parsed, replay
        changes = parsed(settings)
        if formulation:
            changes['model.formulation'] = formulation
        good = replay(file, changes, output, scene, start, duration, node, click.echo)
    if not good:
        sys.exit(1)


@main.command()
@click.argument('file', type=click.Path())
def info(file):
    r"""
    Say what FILE, a log or a bag, is about: scene, duration, rates, gaps, commands, peak.

    \b
        timo_sim info run.mcap
    """
    from timo_sim.log.reader import LogError
    with one_line_for_errors(LogError):
        from timo_sim.log.info import info
        click.echo('\n'.join(info(file)))


@main.command()
@click.argument('file', type=click.Path())
@click.option('--output', '-o', type=click.Path(), required=True, help=(
    'New file, *.parquet or *.csv; with --bag a new folder.'))
@click.option('--topic', metavar='NAME', help=(
    "Write this topic alone, such as '~/motor_torque' (~ is the node's name) or joint_states."))
@click.option('--bag', is_flag=True, help=(
    'Make the folder that rosbag2 writes: FILE with metadata.yaml beside it.'))
@click.option('--node', metavar='NAME', help='Full name of the node, for a bag of several.')
def export(file, output, topic, bag, node):
    r"""
    Write FILE, a log or a bag, as a table with units in the names of columns.

    \b
        timo_sim export run.mcap -o run.parquet
        timo_sim export run.mcap -o torque.csv --topic '~/motor_torque'
        timo_sim export run.mcap -o my_bag --bag

    One row for each message of joint_states; of the other topics it has the message with the same
    stamp, and nothing (NaN) where there is none. At a reset two rows have the same time, before
    and after it.
    """
    from timo_sim.log.reader import LogError
    with one_line_for_errors(LogError):
        from timo_sim.log.export import export, export_bag
        click.echo(export_bag(file, output) if bag else export(file, output, topic, node))


@main.command()
@click.argument('files', nargs=-1, required=True, type=click.Path(exists=True))
@click.option('--save', type=click.Path(dir_okay=False), metavar='OUT.rrd',
              help='Write a file for rerun instead of opening it.')
@click.option('--png', type=click.Path(dir_okay=False), metavar='OUT.png',
              help='Draw a picture instead, without a screen.')
@click.option('--at', type=float, metavar='SECONDS', help='Sim time of the picture; the end.')
@click.option('--web', is_flag=True, help='Open the browser instead of a window.')
@click.option('--fps', type=click.FloatRange(min=0.0, min_open=True), default=30.0,
              show_default=True, help='Frames of the moving arm per second; curves have all.')
@click.option('--node', metavar='NAME', help='Which node of a bag with several.')
def view(files, save, png, at, web, fps, node):
    r"""
    Show recorded runs, laid over each other, in rerun.

    FILES are logs of the node, or bags of its topics. Everything stays on this machine.

    \b
        timo_sim view run.mcap
        timo_sim view before.mcap after.mcap --png compared.png --at 1.81
    """
    from timo_sim.log.reader import LogError
    from timo_sim.track import TrackError
    with one_line_for_errors(LogError, TrackError):
        import rerun  # noqa: F401  # before minutes are spent on reading
        from timo_sim.log.recording import Recording
        from timo_sim.track import of_recording, unique_names
        from timo_sim.view.command import convert_and_show
        recordings = [Recording(path, node) for path in files]
        names = unique_names([recording.path.stem for recording in recordings])
        convert_and_show([partial(of_recording, *pair) for pair in zip(recordings, names)],
                         save, png, at, web, fps)


@main.command()
@click.argument('file', type=click.Path(exists=True, dir_okay=False))
@click.option('--input', 'cause', default='torque_N_m', show_default=True,
              help='force_x_N, force_y_N or torque_N_m.')
@click.option('--output', 'effects', multiple=True, metavar='NAME', show_default=True,
              default=['shaft_rad', 'tip_transverse_m', 'root_strain'],
              help='Once for each curve, such as tip_acceleration_m_per_s2.')
@click.option('-o', 'picture', type=click.Path(dir_okay=False), default='bode.png',
              show_default=True, help='PNG, PDF or SVG.')
def bode(file, cause, effects, picture):
    r"""
    Draw Bode diagram and poles of FILE, a scene, about its initial state.

    \b
        timo_sim bode config/paper.yaml --output tip_transverse_m -o bode.png
    """
    from timo_sim.parameters import ParameterError
    with one_line_for_errors(ParameterError):
        from timo_sim.linear import linearize
        from timo_sim.scene import load_scene
        from timo_sim.view.bode import draw
        model = linearize(load_scene(file)).select([cause], effects)
        draw(model, picture)
        click.echo(f'poles [Hz]: {", ".join(f"{each:.3g}" for each in model.frequencies())}')
        click.echo(f'{picture} is drawn')
