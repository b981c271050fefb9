# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""README.md and the pages of doc/: tables that the code knows, links, and code that runs."""

from decimal import Decimal
import importlib.util
import json
from pathlib import Path
import re

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
_SPEC = importlib.util.spec_from_file_location('tables', ROOT / 'doc' / 'tables.py')
tables = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(tables)
_NUMBER = re.compile(r'-?\d+(?:\.\d+)?(?:e[-+]\d+)?')


def named(path):
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize('page', tables.PAGES, ids=named)
def test_tables_are_those_of_the_code(page):
    """`make pages` writes them anew."""
    text = page.read_text()
    assert text.count('<!-- table: ') == text.count('<!-- end -->')
    assert tables.filled(text) == text


@pytest.mark.parametrize('page', tables.PAGES, ids=named)
def test_links_lead_somewhere(page):
    text = page.read_text()
    for target in re.findall(r'\]\(([^)\s]+)\)', text):
        path, _, place = target.partition('#')
        if not target.startswith(('http://', 'https://')):
            assert (page.parent / path).exists(), target
            heading = page if not path else page.parent / path
            if place:
                assert place in {_anchor(line) for line in heading.read_text().splitlines()
                                 if line.startswith('#')}, target


def _anchor(heading):
    return re.sub(r'[^\w\- ]', '', heading.lstrip('# ').lower()).replace(' ', '-')


def test_every_page_is_named_in_the_readme_and_in_the_contents_of_the_site():
    readme, contents = ((ROOT / name).read_text() for name in ('README.md', 'doc/index.md'))
    pages = {page.relative_to(ROOT / 'doc').with_suffix('').as_posix()
             for page in tables.PAGES[1:]} - {'index', 'api'}
    assert {*re.findall(r'\(doc/([\w/]+)\.md\)', readme)} >= pages
    assert {*re.findall(r'^(?:.*<)?([\w/]+)>?$', contents, re.MULTILINE)} >= {*pages, 'api'}


def test_the_readme_is_short():
    lines = (ROOT / 'README.md').read_text().splitlines()
    assert len(lines) <= 150
    # Rows of tables may be longer.
    assert all(len(line) <= 120 for line in lines if not line.startswith(('|', '![')))


@pytest.mark.parametrize('page', [
    'README.md', 'doc/python.md', 'doc/tutorial/python.md', 'doc/tutorial/control.md'])
@pytest.mark.filterwarnings('ignore::timo_sim.ModelWarning')
def test_its_python_runs(page, tmp_path, monkeypatch, capsys):
    """Run all blocks of a page in turn; a block `text` is the output of the one before."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(ROOT / 'example')
    text, scope = (ROOT / page).read_text(), {}
    for code, shown in re.findall(
            r'```python\n(.*?)```(?:\n\n```text\n(.*?)```)?', text, re.DOTALL):
        exec(compile(code, page, 'exec'), scope)
        printed = capsys.readouterr().out
        if shown:
            assert _NUMBER.sub('', printed) == _NUMBER.sub('', shown)
            for number, other in zip(_NUMBER.findall(shown), _NUMBER.findall(printed)):
                # Within a unit of the last digit, because last bits depend on the processor.
                unit = 10.0**Decimal(number).as_tuple().exponent
                assert float(other) == pytest.approx(float(number), abs=1.01 * unit)
    for name in re.findall(r"save(?:fig)?\('(.*?)'\)", text):
        assert (tmp_path / name).stat().st_size > 0


def test_the_notebook_runs():
    """Run its cells in turn; it is kept without outputs."""
    import matplotlib.pyplot as plt
    cells = json.loads((ROOT / 'doc' / 'tutorial' / 'arm.ipynb').read_text())['cells']
    scope = {}
    with plt.rc_context({'animation.embed_limit': 0.1}):  # [MB] of frames, for speed
        for cell in cells:
            assert not cell.get('outputs')
            if cell['cell_type'] == 'code':
                exec(''.join(cell['source']), scope)
        assert '<img' in scope['animation'].to_jshtml()
        plt.close('all')
    modes, xi, slender = scope['modes'], scope['xi'], scope['slender']
    # Shear and rotary inertia lower the frequencies, the more the shorter the wave.
    lower = 1.0 - modes.omega / slender
    assert lower[0] > 0.0 and np.all(np.diff(lower) > 0.0) and lower[-1] < 4e-3
    assert modes.deflection(xi) == pytest.approx(scope['shapes'], abs=0.01)
    # The second mode has a thousandth of the deflection.
    assert scope['decrement'] == pytest.approx(scope['expected'], rel=2e-3)
    lowest = [run.deflection(10.0)[:, 1].min() for run in (scope['exact'], scope['newton'])]
    assert lowest[0] == pytest.approx(-0.5738, abs=2e-4) and lowest[1] < -10.0
