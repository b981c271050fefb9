# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Summaries of objects for notebooks."""

from html import escape


def html_table(title, rows):
    """Return a table of names and values as HTML."""
    cells = ''.join(f'<tr><th style="text-align:left">{escape(str(name))}</th>'
                    f'<td style="text-align:left">{escape(str(value))}</td></tr>'
                    for name, value in rows.items())
    return f'<table><caption>{escape(title)}</caption>{cells}</table>'
