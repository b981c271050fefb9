"""The command `timo_sim`; what a subcommand needs is imported when it runs."""

from contextlib import contextmanager
import sys

import click

_EXTRAS = {'pyarrow': 'sweep', 'distributed': 'cluster'}


@click.group()
@click.version_option(package_name='timo_sim')
def main():
    """Simulate a mobile manipulator with a flexible arm."""


@contextmanager
def one_line_for_errors(wrong_input):
    """End the process with one line: code 2 for wrong input, 1 for what the machine lacks."""
    try:
        yield
    except (wrong_input, FileNotFoundError) as error:
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
    """
    Do the runs of FILE and write a table of their results.

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
    """
    Write what is intact in FILE, a log that ends early or is damaged, to a new log.

    FILE is only read. Of a complete log nothing is written.
    """
    from timo_sim.log.reader import LogError
    with one_line_for_errors(LogError):
        from timo_sim.log.recover import recover
        click.echo(recover(file, output))
