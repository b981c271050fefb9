# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
Print each message of the program, to read them all: `python doc/messages.py [FILE...]`.

A message is the text of an error, of a warning, of a line of a log or of the terminal. It says
what happened, with name and value, and then what to do. Values stand in braces.
"""

import ast
from pathlib import Path
import sys

ROOT = Path(__file__).resolve().parents[1]
SAYING = {'debug', 'echo', 'error', 'fatal', 'info', 'print', 'tell', 'warn', 'warning', '_refuse'}


def text_of(node):
    """Return the text of an expression, with values in braces; '' if it has none."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ''
    if isinstance(node, ast.JoinedStr):
        return ''.join(map(text_of, node.values))
    if isinstance(node, ast.FormattedValue):
        return f'{{{ast.unparse(node.value)}}}'
    if isinstance(node, ast.BinOp):
        return ' '.join(filter(None, (text_of(node.left), text_of(node.right))))
    return ''


def messages(path):
    """Yield line and text of the messages in a file."""
    tree = ast.parse(path.read_text(encoding='utf-8'))
    raised = [node.exc for node in ast.walk(tree) if isinstance(node, ast.Raise)]
    for call in ast.walk(tree):
        if isinstance(call, ast.Call) and (call in raised or getattr(
                call.func, 'attr', getattr(call.func, 'id', '')) in SAYING):
            for text in filter(None, map(text_of, call.args)):
                yield call.lineno, text


if __name__ == '__main__':
    files = [*map(Path, sys.argv[1:])] or sorted((ROOT / 'timo_sim').rglob('*.py'))
    for file in files:
        for line, text in sorted(messages(file.resolve())):
            print(f'{file}:{line}: {text}')
