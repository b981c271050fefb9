# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
The commands `timo_sim` and `sim_node`: a file a subcommand, which imports what it needs when run.

It may import everything; nothing imports it.
"""

from importlib import import_module

import click

from timo_sim.version import __version__

_SUBCOMMANDS = ('bode', 'export', 'info', 'recover', 'replay', 'simulate', 'sweep', 'view')


class _Commands(click.Group):
    """The subcommands, each imported when it is named."""

    def list_commands(self, context):
        """Return the names of the subcommands."""
        return list(_SUBCOMMANDS)

    def get_command(self, context, name):
        """Return a subcommand, or None."""
        if name not in _SUBCOMMANDS:
            return None
        return getattr(import_module(f'timo_sim.cli.{name}'), name)


@click.group(cls=_Commands)
@click.version_option(__version__, prog_name='timo_sim')
def main():
    """Simulate a mobile manipulator with a flexible arm."""
