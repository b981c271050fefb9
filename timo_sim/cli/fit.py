# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The subcommand `fit`, which fits a scene to a measured record."""

import warnings

import click

from timo_sim.cli.commands import main, parsed


@main.command()
@click.argument('record', type=click.Path())
@click.argument('more', nargs=-1, metavar='[NAME]...')
@click.option('--scene', type=click.Path(), help=(
    'Parameter file or name of an installed scene, whose values are first guesses; by default '
    'that of RECORD, if it is a log of the node.'))
@click.option('--free', multiple=True, required=True, metavar='NAME [NAME]...', help=(
    'Parameters to be fitted: of the scene; QUANTITY.gain, .bias or .delay of an input or output, '
    '.lag of an output; or initial for the whole initial state.'))
@click.option('--bounds', multiple=True, metavar='NAME=LOW:HIGH', help='Bounds of one of them.')
@click.option('--set', 'settings', multiple=True, metavar='NAME=VALUE',
              help='A parameter that differs from the scene; several are allowed.')
@click.option('--mapping', type=click.Path(dir_okay=False), metavar='FILE',
              help='YAML file that says which column of a table is which quantity.')
@click.option('--outputs', metavar='NAME,NAME', help='Outputs to be fitted; by default all.')
@click.option('--hold-out', type=float, default=0.0, show_default=True,
              help='Part of RECORD, at its end, that is predicted and not fitted.')
@click.option('--window', type=float, metavar='SECONDS', help=(
    'Fit windows of about this length, each with an initial state of its own.'))
@click.option('--loss', default='linear', show_default=True,
              help='Or soft_l1, huber or cauchy, with which outliers weigh less.')
@click.option('--output', '-o', type=click.Path(dir_okay=False), metavar='FITTED.yaml',
              help='Parameter file to write: the fitted scene.')
@click.option('--png', type=click.Path(dir_okay=False), metavar='OUT.png',
              help='Picture to write: measured and predicted outputs.')
def fit(record, more, scene, free, bounds, settings, mapping, outputs,
        hold_out, window, loss, output, png):
    r"""
    Fit parameters of a scene to RECORD, a log, a bag or a table, and predict the rest of it.

    \b
        timo_sim fit run.mcap --free motor.viscous_friction arm.young_modulus
        timo_sim fit arm.csv --mapping columns.yaml --scene arm.yaml --hold-out 0.5 \
            --free motor.shaft_inertia shaft.bias -o fitted.yaml --png fit.png

    Exit codes: 0 good; 2 bad input.
    """
    from timo_sim.fitting.fit import fit, read
    from timo_sim.scene.parameter import ModelWarning
    from timo_sim.scene.scene import load_scene
    if png:
        from timo_sim.view.plot import write
    changes, ends = parsed(settings), _bounds(bounds)
    scene, record = read(scene, record, mapping)
    if outputs:
        record = record.select(*outputs.split(','))
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', ModelWarning)  # the report has its text
        found = fit(load_scene(scene, changes), record, [*free, *more], ends, hold_out, window,
                    loss)
    click.echo(found.report())
    if output:
        click.echo(f'{found.save(output)} is written')
    if png:
        write(found.plot(), png)
        click.echo(f'{png} is drawn')


def _bounds(texts):
    from timo_sim.scene.parameter import ParameterError
    found = {}
    for text in texts:
        name, _, ends = text.partition('=')
        low, colon, high = ends.partition(':')
        try:
            if not colon:
                raise ValueError
            found[name.strip()] = float(low or '-inf'), float(high or 'inf')
        except ValueError:
            raise ParameterError(f'--bounds takes NAME=LOW:HIGH, such as '
                                 f'motor.shaft_inertia=1e-4:0.1; got {text!r}') from None
    return found
