# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""`timo_sim recover`."""

import click

from timo_sim.cli.errors import Command, one_line_for_errors


@click.command(cls=Command)
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
    from timo_sim.log.records import LogError
    with one_line_for_errors(LogError):
        from timo_sim.log.recover import recover
        click.echo(recover(file, output))
