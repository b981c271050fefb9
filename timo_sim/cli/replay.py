# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""`timo_sim replay`."""

import sys

import click

from timo_sim.cli.errors import Command, one_line_for_errors
from timo_sim.cli.settings import parsed_settings


@click.command(cls=Command)
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
    from timo_sim.log.records import LogError
    from timo_sim.scene.parameter import ParameterError
    with one_line_for_errors(LogError, ParameterError):
        from timo_sim.replay.replay import replay
        changes = parsed_settings(settings)
        if formulation:
            changes['model.formulation'] = formulation
        good = replay(file, changes, output, scene, start, duration, node, click.echo)
    if not good:
        sys.exit(1)
