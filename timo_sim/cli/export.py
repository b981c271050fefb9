# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""`timo_sim export`."""

import click

from timo_sim.cli.errors import Command, one_line_for_errors


@click.command(cls=Command)
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
    from timo_sim.log.records import LogError
    with one_line_for_errors(LogError):
        from timo_sim.log.export import export, export_bag
        click.echo(export_bag(file, output) if bag else export(file, output, topic, node))
