# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The project itself: linters, layers, metadata, builds, and what README.md and doc/ promise."""

import ast
from decimal import Decimal
from graphlib import TopologicalSorter
from html import unescape
import importlib.util
from pathlib import Path
from posixpath import dirname, join, normpath
import re
import subprocess
import sys
import tomllib
from types import SimpleNamespace

import pytest
import timo_sim
from timo_sim import extras
from timo_sim.compiled.machine import COMPILING
from timo_sim.topics.cdr import DEFINITIONS
import yaml

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = [folder for folder in ('timo_sim', 'test', 'bringup', 'hardware', 'benchmark', 'doc',
                                 'example', 'setup.py') if (ROOT / folder).exists()]
_SPEC = importlib.util.spec_from_file_location('tables', ROOT / 'doc' / 'tables.py')
tables = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(tables)
PAGES = {str(page.relative_to(ROOT)): page.read_text() for page in tables.PAGES}


def python(*arguments, **options):
    """Run Python; return what it prints."""
    result = subprocess.run([sys.executable, *arguments], capture_output=True, text=True,
                            **{'cwd': ROOT, **options})
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def test_linters():
    started = [subprocess.Popen([sys.executable, '-m', *command], cwd=ROOT, text=True,
                                stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
               for command in (['ruff', 'check', '--no-cache'], ['mypy', 'timo_sim', 'benchmark'])]
    told = [process.communicate()[0] for process in started]
    assert not any(process.returncode for process in started), '\n'.join(told)


def test_messages_of_the_program_are_found_and_have_no_full_stop():
    spec = importlib.util.spec_from_file_location('messages', ROOT / 'doc' / 'messages.py')
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    found = [text for path in sorted((ROOT / 'timo_sim').rglob('*.py'))
             for _, text in script.messages(path)]
    for text in ('{self.name} must be {self.rule}, got {short(value)}',  # raised
                 'a callback failed: {error}', 'an alias, which ROS does not take'):  # called
        assert text in found
    assert not [text for text in found if text.endswith('.') and not text.endswith('...')]


def test_licences_and_cited_equations():
    header = '# Copyright 2026 The timo_sim authors\n# SPDX-License-Identifier: Apache-2.0\n'
    assert not [path for folder in FOLDERS for path in (ROOT / folder).rglob('*.py')
                if not path.read_text().startswith(header)]
    numbers = re.findall(r'\\tag\{(T\d+)\}', PAGES['doc/theory.md'])
    assert numbers == [f'T{n + 1}' for n in range(len(numbers))]
    cited = {*re.findall(r'\((T\d+)\)', '\n'.join(map(Path.read_text, MODULES.values())))}
    assert cited and cited <= {*numbers}


# From the ground up, as doc/design.md lists them: a folder may import from those before it.
LAYERS = ['version', 'extras', 'compiled', 'model', 'steps', 'topics', 'scene',
          'simulation', 'log', 'view', 'runs', 'fitting', 'control', 'export', 'gym', 'ros', 'cli',
          '__main__', '__init__']
MODULES = {'.'.join(path.relative_to(ROOT).with_suffix('').parts).removesuffix('.__init__'): path
           for path in (ROOT / 'timo_sim').rglob('*.py')}


def named_modules(path):
    """Yield the modules that a file imports anywhere, or names in a string for a later import."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f'{path} has a relative import'
            for alias in node.names:
                inside = f'{node.module}.{alias.name}'
                yield inside if inside in MODULES else node.module
        elif isinstance(node, ast.Call) and 'import' in ast.unparse(node.func):
            yield from (each.value for each in node.args[:1]
                        if isinstance(each, ast.Constant) and each.value not in MODULES)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found = re.fullmatch(r'(timo_sim(?:\.\w+)+)(?::\w+)?', node.value)
            if found and found[1] in MODULES:
                yield found[1]


def layer(module):
    """Return the layer of a module."""
    return module.split('.')[1] if '.' in module else '__init__'


def test_imports_point_down():
    """No cycle among modules or innermost folders; ROS in `ros`, no files in the model, ..."""
    names = {name: {*named_modules(path)} for name, path in MODULES.items()}
    imports = {name: found & MODULES.keys() - {name} for name, found in names.items()}
    folder = {name: name if path.parent.name == 'timo_sim' else path.parent
              for name, path in MODULES.items()}
    folders = {}
    for name, modules in imports.items():
        folders.setdefault(folder[name], set()).update(
            folder[module] for module in modules if folder[module] != folder[name])
    for graph in imports, folders:
        TopologicalSorter(graph).prepare()  # raises CycleError
    assert not [(name, module) for name, modules in imports.items() for module in modules
                if LAYERS.index(layer(module)) > LAYERS.index(layer(name))]

    outside = {name: {module.split('.')[0] for module in found} for name, found in names.items()}

    def importing(*packages):
        return {layer(name) for name, modules in outside.items() if modules & {*packages}}

    assert importing('rclpy', 'std_msgs', 'sensor_msgs', 'geometry_msgs') == {'ros'}
    # A log notes their versions; an export writes LLVM's code of its interface.
    assert importing('numba', 'llvmlite') == {'compiled', 'export', 'log'}
    assert importing('rerun') == {'view'}
    assert not {'model', 'steps', 'topics'} & importing('pathlib', 'yaml', 'mcap', 'os')


def test_more_than_five_fields_are_given_by_name():
    made = [node for path in MODULES.values() for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Call)
            and re.fullmatch(r'(\w+\.)*_?[A-Z]\w*', ast.unparse(node.func))]
    assert len(made) > 500
    assert not [ast.unparse(call) for call in made if len(call.args) > 5]


def test_what_is_private_to_rclpy_is_used_in_one_module():
    private = re.compile(r'rclpy\.(_|experimental)|\._parameter_overrides|take_message|'
                         r'\.handle\b')
    found = {path.name for path in (ROOT / 'timo_sim/ros').glob('*.py')
             if private.search(path.read_text())}
    assert found == {'private.py'}


def test_what_is_not_needed_is_imported_late():
    python('-c', """
import sys, timo_sim
def without(names):
    assert not {*names.split()} & {*sys.modules}, {*names.split()} & {*sys.modules}
without('numpy numba rclpy')
import timo_sim.cli
without('numpy yaml tqdm pyarrow')
import timo_sim.scene.parameters
without('numba')
timo_sim.simulate(timo_sim.load_scene({}), 0.01)
without('rclpy mcap rerun matplotlib pyarrow distributed scipy.integrate')
timo_sim.simulate_many(timo_sim.load_scene({}), [{}], 0.01, workers=1)
without('pyarrow distributed')
""")
    python('-c', 'import sys, timo_sim; timo_sim.simulate; assert "click" not in sys.modules')


PROJECT = tomllib.loads((ROOT / 'pyproject.toml').read_text())['project']
EXTRAS = PROJECT['optional-dependencies']
# Distributions by module, where the names differ.
DISTRIBUTIONS = {'cupy': 'cupy-cuda12x', 'llvmlite': 'numba', 'PIL': 'pillow',
                 'rerun': 'rerun-sdk', 'rerun_cli': 'rerun-sdk', 'yaml': 'pyyaml'}
# ROS packages that the node uses where they are installed.
OPTIONAL_ROS = {'simulation_interfaces'}


def requirements(lines):
    """Return the requirements by lower-case name, without extras of timo_sim itself."""
    from packaging.requirements import Requirement
    parsed = [Requirement(line) for line in lines]
    return {each.name.lower(): each for each in parsed if each.name != 'timo_sim'}


def listed(name):
    """Return the lines of a file of requirements that are no comments."""
    lines = (ROOT / name).read_text().splitlines()
    return [line for line in lines if line and not line.startswith('#')]


ROSDEP = yaml.safe_load((ROOT / 'test/data/rosdep_keys.yaml').read_text())


@pytest.fixture(scope='module')
def packages():
    """Return for each of the packages, by name, its package.xml and the keys it needs to run."""
    from catkin_pkg.package import parse_package
    parsed = [parse_package(str(ROOT / folder)) for folder in ('', 'bringup', 'hardware')]
    return {package.name: (package, {depend.name for depend in package.exec_depends})
            for package in parsed}


def test_metadata_agree(packages):
    """Of package.xml, pyproject.toml, setup.py, CHANGELOG.md and the lists of versions."""
    assert {name: package.get_build_type() for name, (package, _) in packages.items()} == {
        PROJECT['name']: 'ament_python', 'timo_sim_bringup': 'ament_python',
        'timo_sim_hardware': 'ament_cmake'}
    for name, (package, _) in packages.items():
        package.validate()
        assert package.licenses == ['Apache-2.0'] and package.version == timo_sim.__version__
        # rosdep installs every dependency with apt.
        assert not {depend.name for kind in ('build', 'build_export', 'buildtool', 'exec', 'test')
                    for depend in getattr(package, f'{kind}_depends')
                    } - {*ROSDEP['apt'], *ROSDEP['ros'], *packages}
    version = f"version='{timo_sim.__version__}'"
    assert version in (ROOT / 'bringup/setup.py').read_text()
    assert f'## {timo_sim.__version__}' in (ROOT / 'CHANGELOG.md').read_text()
    # package.xml and the pip list make up the dependencies.
    keys = {key.removeprefix('python3-') for key in packages['timo_sim'][1] & {*ROSDEP['apt']}}
    from_apt = {DISTRIBUTIONS.get(key, key) for key in keys}
    without_key = listed('requirements-pip.txt')
    assert {*without_key} <= {*PROJECT['dependencies']}
    assert from_apt.isdisjoint(requirements(without_key))
    assert from_apt | {*requirements(without_key)} == {*requirements(PROJECT['dependencies'])}
    assert {*requirements(without_key)} <= {*ROSDEP['none']}
    assert 'requirements-pip.txt' in PAGES['doc/ros.md']
    # Every version that is asked for is pinned and allowed.
    optional = [line for extra in ('cluster', 'control', 'pandas', 'plot', 'rl', 'sweep')
                for line in EXTRAS[extra]]
    lowest, pinned = (requirements(listed(f'constraints{name}.txt')) for name in ('-lowest', ''))
    bounded = requirements(PROJECT['dependencies'] + optional)
    assert {*lowest} == {*bounded}
    for name, requirement in bounded.items():
        for constraints in (lowest, pinned):
            version = str(constraints[name].specifier).removeprefix('==')
            assert requirement.specifier.contains(version), (name, version)


def test_imports_are_declared(packages):
    declared = {*requirements(PROJECT['dependencies'])}
    for extra in ['cuda', *re.findall(r'\w+', EXTRAS['all'][0].partition('[')[2])]:
        declared |= {*requirements(EXTRAS[extra])}
    imported = {module.split('.')[0]: path for path in MODULES.values()
                for module in named_modules(path)}
    ros = imported.keys() & {*ROSDEP['ros']}
    assert not {module: path for module, path in imported.items()
                if module not in {*sys.stdlib_module_names, 'timo_sim', *ros}
                and DISTRIBUTIONS.get(module, module) not in declared}
    # A node without a screen pulls in what it imports and the types of its topics, and no more.
    types = {name.split('/')[0] for name in DEFINITIONS}
    assert packages['timo_sim'][1] & {*ROSDEP['ros']} == (ros | types) - OPTIONAL_ROS
    for folder in 'bringup', 'hardware':
        files = [*(ROOT / folder / 'launch').iterdir()]
        modules = {name.split('.')[0] for path in files for name in named_modules(path)}
        started = {name for path in files
                   for name in re.findall(r"package='(\w+)'", path.read_text())}
        assert files and started | modules - {*sys.stdlib_module_names} <= packages[
            f'timo_sim_{folder}'][1]


def test_tests_that_are_left_out_are_named_and_the_workflow_leaves_out_none(monkeypatch):
    import conftest
    monkeypatch.setattr(conftest, 'collect_ignore', ['ros/test_transforms.py', 'tools'])
    reporter = SimpleNamespace(stats={}, config=SimpleNamespace(args=[]))
    conftest.pytest_terminal_summary(reporter)
    assert {text: len(each) for text, each in reporter.stats.items()} == {
        'left out for want of tf2_msgs, ros2cli': 2, 'left to make browser': 1}
    ros = (ROOT / '.github/workflows/test.yml').read_text().partition('container: ros:')[2]
    assert f"python -c 'import {', '.join(sorted({*conftest.NEED.values()}))}'" in ros


def test_what_is_missing_is_named_with_the_command_that_installs_it(tmp_path):
    """Also in Python; extras that are named have the package among their requirements."""
    code = """
import sys
from timo_sim import extras
class Missing:
    def find_spec(self, name, *_):
        if name in extras._EXTRAS:
            raise ModuleNotFoundError(name=name)
sys.meta_path.insert(0, Missing())
import timo_sim
RECORD = {'time': {'column': 't'}, 'columns': {'s': 'shaft'}}
run = timo_sim.simulate('paper', 0.1)
for use in (lambda: run.plot(), lambda: run.view(), lambda: run.to_pandas(),
            lambda: run.save('run.parquet'), lambda: timo_sim.linearize('paper').to_control(),
            lambda: timo_sim.read_record('in.parquet', RECORD),
            lambda: __import__('timo_sim.gym'), lambda: timo_sim.Batch('paper', device='cuda'),
            lambda: timo_sim.simulate_many('paper', [{}], 0.1, scheduler='tcp://localhost:1')):
    try:
        use()
    except ModuleNotFoundError as error:
        print(error)
"""
    (tmp_path / 'in.parquet').touch()
    assert python('-W', 'ignore', '-c', code, cwd=tmp_path).splitlines() == [
        f'{package} is missing: in a clone of timo_sim, {sys.executable} -m pip install '
        f"-e '.[{extra}]'" for package, extra in (
            ('matplotlib', 'plot'), ('rerun', 'view'), ('pandas', 'pandas'),
            ('pyarrow', 'sweep'), ('control', 'control'), ('pyarrow', 'sweep'),
            ('gymnasium', 'rl'), ('cupy', 'cuda'), ('distributed', 'cluster'))]
    assert [*tmp_path.iterdir()] == [tmp_path / 'in.parquet']
    for package, extra in extras._EXTRAS.items():
        name = DISTRIBUTIONS.get(package, package).replace('_', '-')
        assert any(name in line for line in EXTRAS[extra]), package


def test_the_first_run_of_a_usual_scene_compiles_nothing(installed, tmp_path):
    """Nor does the finer one: no store is made."""
    for scene, modes, store in ('paper', 5, False), ('arm', 3, False), ('paper', 6, True):
        subprocess.run(
            [sys.executable, '-m', 'timo_sim', 'simulate', scene, '--set', f'model.modes={modes}',
             '--duration', '0.1', '-o', 'run.mcap'], cwd=tmp_path, check=True, capture_output=True,
            env={**installed[1], 'NUMBA_CACHE_DIR': str(tmp_path / 'store')})
        assert (tmp_path / 'store').exists() == store


def test_colcon_builds_and_the_installed_node_runs(installed, tmp_path):
    import rclpy  # noqa: F401  # without which there is no node
    prefix, environment = installed
    share = prefix / 'share' / 'timo_sim'
    for name, folder in ('timo_sim', '.'), ('timo_sim_bringup', 'bringup'):
        assert (prefix / 'share/ament_index/resource_index/packages' / name).exists()
        for path in (path for pattern in ('package.xml', 'config/*', 'example/*.*', 'launch/*')
                     for path in (ROOT / folder).glob(pattern)):
            place = prefix / 'share' / name / path.relative_to(ROOT / folder)
            assert place.read_text() == path.read_text()
    assert any(prefix.rglob('compiled/prebuilt/*.bc'))
    assert {path.name for path in (prefix / 'lib/timo_sim').iterdir()} == {*PROJECT['scripts']}
    # The programs that `ros2 run timo_sim` starts, and a scene by its name.
    for command, words in (
            (['sim_node', '--ros-args', '--params-file', share / 'config/paper.yaml', '-p',
              'duration:=0.5', '-p', 'record_file:=run.mcap'], 'simulated 0.5 s'),
            (['timo_sim', 'info', 'run.mcap'], 'sim time  0 to 0.5 s'),
            (['timo_sim', 'simulate', 'spin_up', '--duration', '0.1'], 'no warnings')):
        told = subprocess.run(
            [sys.executable, prefix / 'lib/timo_sim' / command[0], *command[1:]], cwd=tmp_path,
            env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        assert told.returncode == 0 and words in told.stdout, told.stdout


def _anchor(heading):
    return re.sub(r'[^\w\- ]', '', heading.lstrip('# ').lower()).replace(' ', '-')


def test_pages_have_the_tables_of_the_code_and_links_that_lead_somewhere():
    """`make pages` writes the tables anew; parts that are `made` are measured."""
    wrong = []
    for name, text in PAGES.items():
        begun = sum(text.count(f'<!-- {kind}: ') for kind in ('table', 'made'))
        if begun != text.count('<!-- end -->') or tables.filled(text) != text:
            wrong.append(f'{name}: a table, `make pages` writes it')
        for target in re.findall(r'\]\(([^)\s]+)\)', text):
            path, _, place = target.partition('#')
            page = (ROOT / name).parent / path if path else ROOT / name
            if not target.startswith(('http://', 'https://')) and not (
                    page.exists() and (not place or place in {
                        _anchor(line) for line in page.read_text().splitlines()
                        if line.startswith('#')})):
                wrong.append(f'{name}: {target}')
    assert not wrong
    # README.md is short, but for rows of tables, and names every page, as the site's contents do.
    lines = PAGES['README.md'].splitlines()
    pages = {name.removeprefix('doc/').removesuffix('.md') for name in PAGES}
    pages -= {'index', 'api', 'README', 'contributing', 'changelog'}
    assert len(lines) <= 120
    assert all(len(line) <= 120 for line in lines if not line.startswith(('|', '![')))
    assert {*re.findall(r'\(doc/([\w/]+)\.md\)', PAGES['README.md'])} >= pages
    assert {*re.findall(r'^(?:.*<)?([\w/]+)>?$', PAGES['doc/index.md'], re.MULTILINE)} >= {
        *pages, 'api'}


_NUMBER = re.compile(r'-?\d+(?:\.\d+)?(?:e[-+]\d+)?')


@pytest.mark.parametrize('page', [
    'README.md', 'doc/python.md', 'doc/control.md', 'doc/observer.md', 'doc/ros.md',
    'doc/tutorial/python.md', 'doc/tutorial/control.md'])
def test_its_python_runs(page, tmp_path, monkeypatch, capsys):
    """Run all blocks of a page in turn; a block `text` is the output of the one before."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(ROOT / 'example')
    text, scope = PAGES[page], {}
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


def test_a_notebook_shows_what_is_compiled_as_a_line(tmp_path, monkeypatch):
    """Notebooks show what goes to stderr as an error."""
    client = pytest.importorskip('nbclient')
    from nbformat.v4 import new_code_cell, new_notebook
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path))
    cell = new_code_cell("import timo_sim\nrun = timo_sim.simulate({'model.modes': 7}, 0.01)")
    client.NotebookClient(new_notebook(cells=[cell])).execute()
    assert [(each.name, each.text) for each in cell.outputs] == [
        ('stdout', f'timo_sim: {COMPILING}\n')]


def test_the_site(tmp_path):
    """`make docs` builds it; a warning, such as a broken link, is an error."""
    pytest.importorskip('sphinx')
    python('-m', 'sphinx', '-EqW', '--keep-going', 'doc', str(tmp_path))
    site = {str(path.relative_to(tmp_path)): unescape(path.read_text())
            for path in tmp_path.rglob('*.html') if '_static' not in path.parts}
    sources = {str(path.relative_to(ROOT / 'doc').with_suffix('.html')): path.read_text()
               for kind in ('*.md', '*.ipynb') for path in (ROOT / 'doc').rglob(kind)}
    # Every page is one click from every other, and links between pages are links.
    for page, source in sources.items():
        linked = {normpath(join(dirname(page), href))
                  for href in re.findall(r'href="([^"#]+)', site[page])}
        assert sources.keys() - {'index.html', page} <= linked, page
        for name, place in re.findall(r'\]\(([\w/.]+)\.md(#[\w-]+)?\)', source):
            there = re.sub(r'\.\./README$', 'index', name) + '.html' + place
            assert f'<a class="reference internal" href="{there}"><span class="std' in site[page]
        assert f'timo_sim {timo_sim.__version__}</p>' in site[page]
        assert re.search('href="(https://[^"#]+|[^"#]*#help-citing-licence)">Repo', site[page])
        # Pictures open.
        assert not re.search(r'(?<!">)<img alt', site[page])
    for name in {*timo_sim.__all__} - {'__version__'}:
        there, = re.findall(rf'href="(api/[^"]*)#timo_sim.{name}"', site['api.html'])
        assert f'id="timo_sim.{name}"' in site[there]
    assert 'ndarray, shape (n,)' in site['api/timo_sim.Run-class.html']
    assert r'\tag{T1}' in site['theory.html']
    # The notebook has its outputs, none of which looks like an error.
    shown = site['tutorial/arm.html']
    assert 'mode 5:' in shown and 'anim-controls' in shown and 'stderr' not in shown
    # Nothing is loaded from the network: MathJax is part of the site.
    assert not re.findall(r'<(?:script|link|img)[^>]*(?:src|href)="(https?:[^"]*)',
                          '\n'.join(site.values()))


def test_no_module_makes_two_simulators_and_a_simulator_makes_none():
    made = {}
    for path in sorted((ROOT / 'timo_sim').rglob('*.py')):
        tree = ast.parse(path.read_text(encoding='utf-8'))
        calls = (node.func for node in ast.walk(tree) if isinstance(node, ast.Call))
        made[path.name] = sum(getattr(each, 'id', '') == 'Simulator' for each in calls)
    assert max(made.values()) == made['finer.py'] == 1 and not made['simulator.py']
