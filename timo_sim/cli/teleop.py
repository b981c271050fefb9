# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The subcommand `teleop`, which commands a node by keys."""

import click

from timo_sim.cli.commands import main


@main.command()
@click.option('--node', default='/timo_sim', show_default=True, help='Full name of the node.')
@click.option('--force', type=float, default=5.0, show_default=True,
              help='Force on the carrier, along the axes of the world [N].')
@click.option('--torque', type=float, default=5.0, show_default=True,
              help='Torque on the shaft [N m].')
def teleop(node, force, torque):
    r"""
    Push carrier and shaft of a live node by keys, in a terminal.

    \b
        timo_sim teleop --torque 2

    Arrows push the carrier, a and d turn the shaft, as long as they are held; space pauses or goes
    on, r resets, q or Ctrl-C quits. The latest command acts, whether from here or from others.
    """
    from timo_sim.ros.teleop import teleop
    teleop(node, force, torque)
