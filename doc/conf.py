# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Settings of Sphinx for `make docs`."""

from pathlib import Path
import re

from sphinx.addnodes import pending_xref
from timo_sim.version import __version__

project = html_title = 'timo_sim'
author = 'The timo_sim authors'
copyright = f'2026, {author}'
release = __version__

# MathJax is part of the site, which needs no network.
extensions = ['myst_parser', 'numpydoc', 'sphinx.ext.autodoc', 'sphinx.ext.mathjax',
              'sphinx-mathjax-offline']
myst_enable_extensions = ['dollarmath']
myst_heading_anchors = 4
highlight_language = 'none'
mathjax3_config = {'chtml': {'scale': 0.9}}
# Docstrings say types with shapes and units.
autodoc_typehints = 'none'
autodoc_member_order = 'bysource'
autodoc_default_options = {'members': True, 'inherited-members': 'BaseException'}
toc_object_entries_show_parents = 'hide'
default_role = 'py:obj'
numpydoc_show_class_members = False
# All but those that want more sections, parameters of a dataclass beside its attributes, or a
# blank line before the closing quotes.
numpydoc_validation_checks = {'all', 'ES01', 'EX01', 'GL02', 'GL03', 'PR01', 'PR07', 'RT01',
                              'RT03', 'SA01'}

html_theme = 'pydata_sphinx_theme'
html_theme_options = {'navbar_center': []}
templates_path = html_static_path = ['site']
html_css_files = ['site.css']
html_sidebars = {'**': ['contents']}
html_show_sourcelink = False


def _relative_to_doc(app, path, page, text):
    """Make what links of README.md lead to outside doc/ downloads of the front page."""
    text[0] = re.sub(r'\]\((?!https?:|#|doc/)', '](path:../', text[0])


def _adapt_links(app, page):
    """Point links to README.md at the front page; leave the text of those to folders."""
    here = Path(app.env.doc2path(app.env.docname)).parent
    for link in list(page.findall(pending_xref)):
        if link['reftype'] == 'myst' and link['reftarget'] == str(app.srcdir.parent / 'README'):
            link['reftarget'] = 'index'
        elif link['reftype'] == 'myst' and not link['refdomain']:
            if (here / link['reftarget']).is_dir():
                link.replace_self(link.children)


def setup(app):
    app.connect('include-read', _relative_to_doc)
    app.connect('doctree-read', _adapt_links)
