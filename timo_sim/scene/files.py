# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Read scenes from YAML files, ROS parameter files or values alone, given by path or name."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
import errno
import os
from pathlib import Path
import re
import stat
import tempfile
from typing import Any

import yaml

from timo_sim.scene.parameters import did_you_mean, ParameterError, PARAMETERS, short, stated

_MAX_DEPTH = max(name.count('.') for name in PARAMETERS)
_DEEPEST = 100  # lists and mappings of a file in each other
# In a clone, config/ is beside the package. Once installed, it is in PREFIX/share/timo_sim, and
# the package is in PREFIX/lib/python3.x/site-packages.
_PARENTS = [*Path(__file__).resolve().parents[2:]]
_FOLDERS = [_PARENTS[0] / 'config',
            *(prefix / 'share/timo_sim/config' for prefix in _PARENTS[3:4])]
_GROUPS = {name.partition('.')[0] for name in PARAMETERS}
_A_SCENE = ('a scene is YAML, such as "arm: {length: 0.8}"; timo_sim new my_arm.yaml writes one '
            'to begin with')


@contextmanager
def whole_file(path: Path | str, new: bool = False) -> Iterator[Path]:
    """
    Yield a path to write to; what is there at the end becomes the file or folder `path`.

    If writing fails or is interrupted, an older file stays as it was, and no part of the new one
    is left. With `new`, an older file is a FileExistsError.
    """
    if new:
        check_new(path)
    path = Path(os.path.realpath(path))  # the target of a symbolic link
    if not new and path.exists() and not path.is_file():  # such as /dev/null
        yield path
        return
    try:
        folder = tempfile.TemporaryDirectory(prefix='.timo_sim_', dir=path.parent)
    except OSError as error:
        raise type(error)(error.errno, error.strerror, str(path)) from None
    with folder as name:
        part = Path(name, path.name)
        yield part
        if new:
            check_new(path)
        part.replace(path)


def check_new(path: Path | str) -> None:
    """Raise FileExistsError if there is something at a path, OSError as `check_folder`."""
    if Path(path).exists():
        raise FileExistsError(f'{path} exists: remove it or choose another name')
    check_folder(path)


def check_folder(path: Path | str) -> None:
    """Raise OSError if there is no folder for a file to be written, or no right to write there."""
    target = Path(os.path.realpath(path))  # of a symbolic link
    if target.exists() and not target.is_file():  # such as /dev/null
        return
    if not target.parent.is_dir():
        raise FileNotFoundError(f'{path} cannot be written: its folder does not exist')
    _check_right(target.parent, path)


def _check_right(folder, path):
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))


def check_target(path: Path) -> None:
    """Raise OSError if a file cannot be written: `path` is none, or its folder cannot be made."""
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if path.exists() and not path.is_file():
        raise OSError(f'{path} must be a regular file or none yet, not a device or FIFO')
    parent = next(each for each in path.absolute().parents if each.exists())
    if not parent.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(parent))
    _check_right(parent, path)


def is_of_rclpy(name: str) -> bool:
    """Return whether a parameter is rclpy's own, by its name."""
    return name in ('use_sim_time', 'start_type_description_service')


def scene_file(source: Path | str) -> Path:
    """Return the path of a scene's file, or raise FileNotFoundError with the known names."""
    path = Path(source)
    if path.is_file() or path.suffix or path.name != str(source):
        return path
    known = installed_scenes()
    if path.name not in known:
        raise FileNotFoundError(f'{source} is neither a file nor one of the scenes '
                                f'{", ".join(known)}{did_you_mean(source, known)}')
    return known[path.name]


def installed_scenes() -> dict[str, Path]:
    """Return the paths of the installed scenes by name."""
    # A scene has a section /**, for a node of any name; other files in config/ have none.
    return {entry.stem: entry for folder in _FOLDERS for entry in sorted(folder.glob('*.yaml'))
            if '\n/**:\n' in entry.read_text(encoding='utf-8')}


def read_parameter_file(path: Path | str) -> dict[str, Any]:
    """
    Return the values for the node `/timo_sim` in a scene's file, unchecked, by dotted name.

    It is a ROS parameter file, or has the values alone, such as `arm: {length: 0.8}`. `path` may
    also be the name of an installed scene. Sections match the node as in ROS: names
    and namespaces, with * for one of them and ** for any number. Parameters of rclpy itself are
    left out. Raises ParameterError if the file is not valid or has no values for the node.
    """
    path = scene_file(path)
    try:
        content = read_yaml(path)
    except ParameterError as error:
        raise ParameterError(f'{error}; {_A_SCENE}') from None
    if not isinstance(content, Mapping):
        raise ParameterError(f'{path} is not a scene: {_A_SCENE}')
    if content and not _has_sections(content):
        values = flatten(content)
        if not {name.partition('.')[0] for name in values} & _GROUPS:
            raise ParameterError(f'{path} is not a scene, it has {short(", ".join(values), str)}: '
                                 + _A_SCENE)
    else:
        sections, values = _sections(content, path), {}
        for node, section in sections.items():
            if is_for(node, '/timo_sim'):
                values.update(section)
        if not values:
            others = f'; it has those of {short(", ".join(sections), str)}' if sections else ''
            raise ParameterError(
                f'{path} must have parameters under timo_sim: ros__parameters:{others}')
    return {name: value for name, value in values.items() if not is_of_rclpy(name)}


def read_sections(path: Path | str) -> dict[str, dict[str, Any]]:
    """
    Return the sections of a ROS parameter file: unchecked values by dotted name, by node.

    Raises ParameterError if it is not YAML, or has duplicate names, aliases, merge keys.
    """
    content = read_yaml(path)
    if isinstance(content, Mapping) and content and not _has_sections(content):
        raise ParameterError(f'{path} must have its values under "/**: {{ros__parameters: ...}}" '
                             'for the node')
    return _sections({} if content is None else content, path)


def _has_sections(content):
    # Parameter files nest namespaces and nodes, none of which is a parameter.
    return isinstance(content, Mapping) and (
        'ros__parameters' in content or any(map(_has_sections, content.values())))


def _sections(content, path):
    found, waiting = {}, [('', content)]
    while waiting:
        node, inside = waiting.pop(0)
        try:
            if node in found:
                raise ParameterError(f'{node} is given twice')
            inside = dict(_mapping(inside))
            if 'ros__parameters' in inside:
                found[node] = flatten(inside.pop('ros__parameters') or {})
        except ParameterError as error:
            raise ParameterError(f'{error} ({path})') from None
        waiting[:0] = [(f'{node}/{str(name).strip("/")}'.rstrip('/'), part)
                       for name, part in inside.items()]
    return found


def is_for(section: str, node: str) -> bool:
    """Return whether a section of a ROS parameter file is for a node, by its full name."""
    wild = {'*': r'/\w+', '**': r'(/\w+)*'}
    pattern = ''.join(wild.get(name, '/' + re.escape(name)) for name in section.split('/')[1:])
    return bool(re.fullmatch(pattern, node))


# Numbers as C and ROS read them: in YAML 1.1, which PyYAML has, 1e-3 is a text and 1:30 is 90.
_NUMBERS = [('tag:yaml.org,2002:int', re.compile(r'[-+]?([1-9]\d*|0[0-7]*|0x[\da-fA-F]+)$')),
            ('tag:yaml.org,2002:float', re.compile(
                r'[-+]?((\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|\.(inf|Inf|INF|nan|NaN|NAN))$'))]


class _Loader(getattr(yaml, 'CSafeLoader', yaml.SafeLoader)):  # type: ignore[misc]
    """A loader by libyaml, as ROS has one, that accepts only what ROS reads alike."""

    yaml_implicit_resolvers = {**yaml.SafeLoader.yaml_implicit_resolvers,
                               **dict.fromkeys('+-.0123456789', _NUMBERS)}

    def flatten_mapping(self, node: Any) -> None:
        """Refuse duplicate names, and merge keys, which ROS reads as ordinary names."""
        seen = set()
        for name, _ in node.value:
            if name.tag == 'tag:yaml.org,2002:merge':
                _refuse('a merge key, which ROS does not take', name)
            if str(name.value) in seen:
                _refuse(f'{short(name.value, str)} is given twice', name)
            seen.add(str(name.value))


def _check_events(content):
    """Refuse octal numbers, aliases, unknown to ROS, and nesting beyond the loader's stack."""
    depth = 0
    for event in yaml.parse(content, _Loader):
        if isinstance(event, yaml.AliasEvent):
            _refuse('an alias, which ROS does not take', event)
        if isinstance(event, yaml.ScalarEvent) and event.implicit[0] and (
                re.fullmatch('[-+]?0[0-7]+', event.value)):
            _refuse(f'write {int(event.value)} or {int(event.value, 8)} for {event.value}, which '
                    'ROS reads as octal', event)
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            _refuse(f'more than {_DEEPEST} lists and mappings in each other', event)


def _refuse(words, place):
    raise yaml.constructor.ConstructorError(None, None, words, place.start_mark)


def read_yaml(path: Path | str) -> Any:
    """Return the content of a YAML file, or raise ParameterError."""
    path = Path(path)
    if not stat.S_ISREG(mode := path.stat().st_mode) and not stat.S_ISDIR(mode):
        # A pipe might never end; a folder is refused by the system.
        raise ParameterError(f'{path} is not a file')
    return parse_yaml(path.read_bytes(), path)


def parse_yaml(content: bytes | str, source: Path | str) -> Any:
    """Return the content of YAML text or bytes, or raise ParameterError that names the source."""
    try:
        _check_events(content)
        return yaml.load(content, _Loader)
    except (yaml.YAMLError, RecursionError, ValueError, LookupError, AttributeError) as error:
        # PyYAML raises errors of many types for a tag that does not suit its value.
        reason = ' '.join(str(error).split())
        raise ParameterError(f'{source} is not a YAML file: {reason}') from None


def scene_text(values: Mapping[str, Any]) -> str:
    """Return the YAML of a scene with these values, all of the manipulator and its start."""
    nested: dict[str, Any] = {}
    for name, value in stated(values).items():
        place = nested
        *groups, last = name.split('.')
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = [*value] if isinstance(value, tuple) else value
    return yaml.safe_dump({'/**': {'ros__parameters': nested}}, sort_keys=False)


def flatten(values: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    """Return nested or dotted values as one dictionary by dotted name, or raise ParameterError."""
    flat = {}
    for name, value in _mapping(values).items():
        name = f'{prefix}{name}'
        # No parameter has more dots, so that the recursion is bounded.
        nested = isinstance(value, Mapping) and prefix.count('.') <= _MAX_DEPTH
        for each, inner in (flatten(value, f'{name}.') if nested else {name: value}).items():
            if each in flat:
                raise ParameterError(f'{short(each, str)} is given twice')
            flat[each] = inner
    return flat


def _mapping(values):
    if not isinstance(values, Mapping):
        raise ParameterError(f'values must be given by name, got {short(values)}')
    return values
