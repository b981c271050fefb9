# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.


"""The site that `make docs` builds; skipped where Sphinx is missing."""

from html import unescape
from pathlib import Path
from posixpath import dirname, join, normpath
import re
import subprocess
import sys

import pytest
import timo_sim

pytest.importorskip('sphinx')
ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope='module')
def site(tmp_path_factory):
    """Return the text of the pages by name; a warning, such as a broken link, is an error."""
    folder = tmp_path_factory.mktemp('site')
    built = subprocess.run([sys.executable, '-m', 'sphinx', '-EqW', '--keep-going', ROOT / 'doc',
                            folder], capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    return {str(path.relative_to(folder)): unescape(path.read_text())
            for path in folder.rglob('*.html') if '_static' not in path.parts}


def test_every_page_is_one_click_from_every_other(site):
    pages = {str(path.relative_to(ROOT / 'doc').with_suffix('.html'))
             for path in (ROOT / 'doc').rglob('*.md')}
    assert pages <= site.keys()
    for page, text in site.items():
        linked = {normpath(join(dirname(page), href))
                  for href in re.findall(r'href="([^"#]+)', text)}
        assert pages - {'index.html', page} <= linked, page


def test_links_between_pages_are_links(site):
    for path in (ROOT / 'doc').rglob('*.md'):
        text = site[str(path.relative_to(ROOT / 'doc').with_suffix('.html'))]
        there = re.findall(r'<a class="reference internal" href="([^"]+)"><span class="std', text)
        for name, place in re.findall(r'\]\(([\w/.]+)\.md(#[\w-]+)?\)', path.read_text()):
            assert re.sub(r'\.\./README$', 'index', name) + '.html' + place in there, (path, name)


def test_api_and_equations_are_there(site):
    for name in {*timo_sim.__all__} - {'__version__'}:
        assert f'id="timo_sim.{name}"' in site['api.html'], name
    assert 'ndarray, shape (n,)' in site['api.html']
    tags = r'\\tag\{(T\d+)\}'
    assert re.findall(tags, site['theory.html']) == re.findall(
        tags, (ROOT / 'doc' / 'theory.md').read_text())
    # Nothing is loaded from the network: MathJax is part of the site.
    assert not re.findall(r'<(?:script|link|img)[^>]*(?:src|href)="(https?:[^"]*)',
                          '\n'.join(site.values()))
