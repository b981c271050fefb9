# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""README.md and the pages of doc/: tables that the code knows, links, and code that runs."""

import importlib.util
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).resolve().parents[1]
_SPEC = importlib.util.spec_from_file_location('tables', ROOT / 'doc' / 'tables.py')
tables = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(tables)


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
    # Tables apart: each row of them is a line.
    assert all(len(line) <= 120 for line in lines if not line.startswith(('|', '![')))


@pytest.mark.parametrize('page', [ROOT / 'README.md', ROOT / 'doc' / 'python.md'], ids=named)
def test_its_python_runs(page, tmp_path, monkeypatch):
    """All blocks of a page one after the other, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    code = '\n'.join(re.findall(r'```python\n(.*?)```', page.read_text(), re.DOTALL))
    exec(compile(code, page.name, 'exec'), {})
    assert (tmp_path / 'run.mcap').stat().st_size > 0
