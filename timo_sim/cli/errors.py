# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""How subcommands look in help, and how they end with an error: one line and an exit code."""

from contextlib import contextmanager
import sys

import click

_EXTRAS = {'pyarrow': 'sweep', 'distributed': 'cluster', 'rclpy': 'ros', 'rerun': 'view',
           'rerun_cli': 'view', 'matplotlib': 'plot'}


class Command(click.Command):
    """A command whose raw docstring may have click's mark of lines that are kept as they are."""

    def __init__(self, name, **options):
        options['help'] = options['help'].replace('\\b', '\b')
        super().__init__(name, **options)


@contextmanager
def one_line_for_errors(*wrong_input):
    """End the process with one line: code 2 for wrong input, 1 for what the machine lacks."""
    try:
        yield
    except (FileNotFoundError, *wrong_input) as error:
        code, text = 2, str(error)
    except OSError as error:
        code, text = 1, str(error)
    except ModuleNotFoundError as error:
        if error.name not in _EXTRAS:
            raise
        code, text = 1, f"{error.name} is missing: pip install 'timo_sim[{_EXTRAS[error.name]}]'"
    else:
        return
    click.echo('timo_sim: ' + ' '.join(text.split()), err=True)
    sys.exit(code)
