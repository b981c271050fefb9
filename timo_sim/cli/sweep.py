# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""`timo_sim sweep`."""

import click

from timo_sim.cli.errors import Command, one_line_for_errors


@click.command(cls=Command)
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
    from timo_sim.scene.parameter import ParameterError
    with one_line_for_errors(ParameterError):
        from timo_sim.sweep.store import run_sweep
        run_sweep(file, output, workers, scheduler)
