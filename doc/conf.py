# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Settings of Sphinx for `make docs`."""

from pathlib import Path
import re
import shutil
import subprocess

from docutils.nodes import image, raw, Text
from sphinx.addnodes import pending_xref
import timo_sim
from timo_sim.export.web import export_web

project = html_title = 'timo_sim'
author = 'The timo_sim authors'
copyright = f'2026, {author}'
release = timo_sim.__version__

# MathJax is part of the site, which needs no network.
extensions = ['myst_nb', 'numpydoc', 'sphinx.ext.autodoc', 'sphinx.ext.autosummary',
              'sphinx.ext.mathjax', 'sphinx-mathjax-offline']
# Notebooks have their outputs (`make notebooks`).
nb_execution_mode = 'off'
myst_enable_extensions = ['dollarmath']
myst_heading_anchors = 4
highlight_language = 'none'
mathjax3_config = {'chtml': {'scale': 0.9}}
# Docstrings say types with shapes and units.
autodoc_typehints = 'none'
autodoc_member_order = 'bysource'
autodoc_default_options = {'members': True, 'inherited-members': 'BaseException, Env, VectorEnv'}
# Each name in api.md has a page; that of a class has a file name of its own where small and
# capital letters are the same (`fit`, `Fit`). Pages of names that are gone do not stay.
autosummary_filename_map = {f'timo_sim.{name}': f'timo_sim.{name}-class'
                            for name in timo_sim.__all__ if name[0].isupper()}
shutil.rmtree('api', ignore_errors=True)
toc_object_entries_show_parents = 'hide'
default_role = 'py:obj'
numpydoc_show_class_members = False
# All but those that want more sections, parameters of a dataclass beside its attributes, or a
# blank line before the closing quotes.
numpydoc_validation_checks = {'all', 'ES01', 'EX01', 'GL02', 'GL03', 'PR01', 'PR07', 'RT01',
                              'RT03', 'SA01'}

html_theme = 'pydata_sphinx_theme'
html_theme_options = {
    'logo': {'text': f'{project} {release}'}, 'navbar_center': [],
    'navbar_end': ['repository', 'theme-switcher'], 'secondary_sidebar_items': []}
# The web address of the remote `origin`, if it has one.
_origin = re.search(r'^(?:\w+://)?(?:[^/]*@)?([\w.-]+\.\w+)(?::\d+)?[:/](.+?)(?:\.git)?/?$',
                    subprocess.getoutput('git remote get-url origin'))
html_context = {'default_mode': 'auto',
                'repository': _origin and f'https://{_origin[1]}/{_origin[2]}'}
templates_path = ['site']
html_static_path = ['site/static']
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


def _adapt_figures(app, page):
    """Make pictures links to themselves; animations find their icons in the site."""
    for picture in page.findall(image):
        picture['scale'] = 100  # Sphinx links pictures that have a scale
    for part in page.findall(raw):
        part.children = [Text(re.sub('<link [^>]*"https?:[^>]*>', '', part.astext()))]


def _try_it(app, page, text):
    """Put a page with three scenes in the place of its picture, if it can be linked."""
    if page != 'web':
        return
    try:
        names = 'arm', 'paper', 'standing'
        export_web({name: name for name in names}, Path(app.outdir, 'arm.html'), estimate=False)
    except OSError as error:
        print(f'the site has a picture in place of the page to try: {error}')
        return
    frame = ('<iframe src="arm.html" style="width: 100%; height: 1150px; border: 0"></iframe>\n'
             '<p><a href="arm.html">The page alone</a></p>')
    text[0] = re.sub(r'^!\[.*$', f'```{{raw}} html\n{frame}\n```', text[0], flags=re.MULTILINE)


def setup(app):
    app.connect('source-read', _try_it)
    app.connect('include-read', _relative_to_doc)
    app.connect('doctree-read', _adapt_links)
    app.connect('doctree-read', _adapt_figures)
