# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""`timo_sim bode`."""

import click

from timo_sim.cli.errors import Command, one_line_for_errors


@click.command(cls=Command)
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
    from timo_sim.scene.parameter import ParameterError
    with one_line_for_errors(ParameterError):
        from timo_sim.simulation.linear import linearize
        from timo_sim.scene.scene import load_scene
        from timo_sim.view.bode import draw
        model = linearize(load_scene(file)).select([cause], effects)
        draw(model, picture)
        click.echo(f'poles [Hz]: {", ".join(f"{each:.3g}" for each in model.frequencies())}')
        click.echo(f'{picture} is drawn')
