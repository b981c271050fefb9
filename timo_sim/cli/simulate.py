# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""`timo_sim simulate`."""

import sys

import click

from timo_sim.cli.errors import Command, one_line_for_errors


@click.command(cls=Command)
@click.argument('scene')
@click.option('--duration', type=float, default=10.0, show_default=True, help='Sim time [s].')
@click.option('--set', 'settings', multiple=True, metavar='NAME=VALUE',
              help='A parameter that differs from the scene; several are allowed.')
@click.option('--output', '-o', type=click.Path(dir_okay=False), help=(
    'File of the run: *.mcap (a log), *.parquet or *.csv. An existing log is never overwritten; '
    '_1, _2, ... is appended.'))
@click.option('--rate', type=float, metavar='HZ', help=(
    'Samples per second of sim time; by default 100, or what the step allows.'))
@click.option('--view', is_flag=True, help='Show the run in rerun.')
@click.option('--png', type=click.Path(dir_okay=False), metavar='OUT.png',
              help='Draw curves and the arm in the plane to a picture.')
def simulate(scene, duration, settings, output, rate, view, png):
    r"""
    Simulate SCENE, a parameter file or the name of an installed scene, without ROS.

    \b
        timo_sim simulate paper --png paper.png
        timo_sim simulate my_scene.yaml --duration 20 --set model.modes=5 -o run.mcap

    Exit codes: 0 good; 1 the run diverges, what it came to is written all the same; 2 bad input.
    """
    from timo_sim.log.records import LogError
    from timo_sim.scene.parameter import ParameterError
    with one_line_for_errors(LogError, ParameterError):
        run, error = _simulated(scene, duration, settings, rate)
        click.echo(run.message)
        if output:
            click.echo(f'{run.save(output)} is written')
        if png:
            run.plot().savefig(png, dpi=100)
            click.echo(f'{png} is drawn')
        if view:
            run.view()
    if error:
        click.echo(f'timo_sim: {error}', err=True)
        sys.exit(1)


def _simulated(scene, duration, settings, rate):
    """Return the run, or what there is of it and why it ends."""
    import warnings

    from timo_sim.cli.settings import parsed_settings
    from timo_sim.runs.simulate import simulate
    from timo_sim.scene.parameter import ModelWarning, whole_ratio
    from timo_sim.scene.scene import load_scene
    from timo_sim.simulation.resolution import resolved
    from timo_sim.simulation.model_warnings import DivergenceError
    scene, steps = resolved(load_scene(scene, parsed_settings(settings)), duration)
    if rate:
        every = whole_ratio('1/integrator.step', 1.0 / scene.step, '--rate', rate)
    else:
        every = max(1, round(0.01 / scene.step))
        every = every if steps % every == 0 else 1
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', ModelWarning)  # the run's message says it
            return simulate(scene, duration, every), None
    except DivergenceError as error:
        return error.run, error
