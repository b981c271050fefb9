# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""`timo_sim info`."""

import click

from timo_sim.cli.errors import Command, one_line_for_errors


@click.command(cls=Command)
@click.argument('file', type=click.Path())
def info(file):
    r"""
    Say what FILE, a log or a bag, is about: scene, duration, rates, gaps, commands, peak.

    \b
        timo_sim info run.mcap
    """
    from timo_sim.log.records import LogError
    with one_line_for_errors(LogError):
        from timo_sim.log.info import info
        click.echo('\n'.join(info(file)))
