# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""
Tables of the pages that the code, or another page, knows: `make pages` writes them anew.

A page has them between `<!-- table: NAME -->` and `<!-- end -->`.
"""

import math
from pathlib import Path
import re

from timo_sim.messages.commands import COMMANDS
from timo_sim.messages.outputs import outputs, TRANSFORMS
from timo_sim.scene.parameter import NODE
from timo_sim.scene.parameters import PARAMETERS

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / 'README.md', *sorted((ROOT / 'doc').rglob('*.md'))]
_TABLE = re.compile(r'(<!-- table: (\w+) -->\n).*?(<!-- end -->)', re.DOTALL)
_COMMANDS = {
    '~/carrier_wrench': 'force x, y on the carrier',
    '~/motor_torque': 'torque on the shaft',
    '~/tip_wrench': 'force x, y and torque z on the end effector',
    '~/joint_command': 'efforts of `carrier_x`, `carrier_y`, `shaft`, by name; others are ignored',
    '~/commands': 'the same three, as an array',
    '~/motor_voltage': 'voltage at a DC motor, with `motor.dc`',
}
# Rows that README.md quotes of the paper's scene in doc/benchmark.md, and their names there.
_QUOTED = {'exact': 'timo_sim, `exact`', 'exudyn, geometrically exact, robust':
           'exudyn, geometrically exact', '**exudyn over `exact`, both robust**': 'ratio'}


def _table(*rows):
    head, *rest = [f'| {" | ".join(row)} |' for row in rows]
    return '\n'.join([head, f'|{len(rows[0]) * "---|"}', *rest]) + '\n'


def _short(type_name):
    return type_name.replace('/msg/', '/')


def commands():
    """Return the table of the topics that the node subscribes to."""
    return _table(('topic', 'type', 'sets'), *(
        (f'`{each.name}`', _short(each.type_name), _COMMANDS[each.name]) for each in COMMANDS))


def published():
    """Return the table of the topics that carry the motion."""
    rows = []
    for output in [*outputs(1), TRANSFORMS]:
        names = [re.sub('mode_1', 'mode_N', name) for name in output.columns]
        rows.append((f'`{output.name}`', _short(output.type_name),
                     ', '.join(f'`{name}`' for name in names) or 'sim time',
                     f'{PARAMETERS[output.rate].default:g} Hz'))
    return _table(('topic', 'type', 'numbers, with units', 'default of `rate.TOPIC`'),
                  *rows)


def parameters():
    """Return a table of parameters for each group."""
    groups = {}
    for parameter in PARAMETERS.values():
        group, dot, _ = parameter.name.partition('.')
        groups.setdefault('node' if not dot and parameter.scope == NODE else group,
                          []).append(parameter)
    return '\n'.join(f'### {group}\n\n' + _table(
        ('parameter', 'default', 'rule', 'meaning'), *map(_row, entries))
        for group, entries in groups.items())


def _row(parameter):
    default = parameter.default
    shown = {bool: str(default).lower(), str: default or "''"}.get(type(default))
    if isinstance(default, tuple):
        shown = f'[{", ".join(f"{value:g}" for value in default)}]'
    elif shown is None:
        shown = '.inf' if default == math.inf else f'{default:g}'
    unit = f' [{parameter.unit}]' if parameter.unit else ''
    live = '; *live*' if parameter.runtime else ''
    return f'`{parameter.name}`', shown, parameter.rule, f'{parameter.meaning}{unit}{live}'


def benchmark():
    """Return the rows of the paper's scene in doc/benchmark.md that README.md quotes."""
    lines = (ROOT / 'doc' / 'benchmark.md').read_text().splitlines()
    rows = [[cell.strip() for cell in line.strip('| ').split(' | ')]
            for line in lines if line.startswith('|')]
    found = {row[0]: row[1:] for row in reversed(rows)}  # the first table wins
    return _table(rows[0], *([name, *found[row]] for row, name in _QUOTED.items()))


TABLES = {'commands': commands, 'outputs': published, 'parameters': parameters,
          'benchmark': benchmark}


def filled(text):
    """Return the text of a page with its tables made anew."""
    return _TABLE.sub(lambda found: found[1] + TABLES[found[2]]() + found[3], text)


if __name__ == '__main__':
    for page in PAGES:
        page.write_text(filled(page.read_text()))
