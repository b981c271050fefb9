# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Scenes in files: ROS parameter files, and those that are installed with the package, by name."""

from pathlib import Path

import yaml

from timo_sim.scene.parameter import did_you_mean, ParameterError
from timo_sim.scene.parameters import PARAMETERS

_DEEPEST = max(name.count('.') for name in PARAMETERS)
# Beside the package in a clone; below the prefix of PREFIX/lib/python3.x/site-packages elsewhere.
_ABOVE = [*Path(__file__).resolve().parents[2:]]
_FOLDERS = [_ABOVE[0] / 'config', *(prefix / 'share/timo_sim/config' for prefix in _ABOVE[3:4])]


def scene_file(source):
    """Return the path of a scene's file, or raise FileNotFoundError with the known names."""
    path = Path(source)
    if path.is_file() or path.suffix or path.name != str(source):
        return path
    known = {entry.stem: entry for folder in _FOLDERS for entry in sorted(folder.glob('*.yaml'))
             if 'ros__parameters' in entry.read_text(encoding='utf-8')}
    if path.name not in known:
        raise FileNotFoundError(f'{source} is neither a file nor one of the scenes '
                                f'{", ".join(known)}{did_you_mean(source, known)}')
    return known[path.name]


def read_parameter_file(path):
    """
    Return the values for the node `timo_sim` in a ROS parameter file, unchecked, by dotted name.

    The file is given by its path or, where it is an installed scene, its name.
    """
    path = scene_file(path)
    content = read_yaml(path)
    values = {}
    sections = content.items() if isinstance(content, dict) else ()
    for node, section in sections:
        if str(node).rpartition('/')[2] in ('**', 'timo_sim') and isinstance(section, dict):
            values.update(flatten(section.get('ros__parameters') or {}))
    if not values:
        raise ParameterError(f'{path} must have parameters under timo_sim: ros__parameters:')
    return values


def read_yaml(path):
    """Return what a YAML file says, or raise ParameterError."""
    try:
        return yaml.safe_load(Path(path).read_text(encoding='utf-8'))
    except (yaml.YAMLError, RecursionError, ValueError, LookupError, AttributeError) as error:
        # PyYAML raises nearly anything for a tag on a value that does not suit it.
        reason = ' '.join(str(error).split())
        raise ParameterError(f'{path} is not a YAML file: {reason}') from None


def flatten(values, prefix=''):
    """Return values by dotted name, of values by nested or dotted name."""
    flat = {}
    for name, value in values.items():
        # No name is deeper; what YAML aliases can make of few lines must not be walked through.
        if isinstance(value, dict) and prefix.count('.') <= _DEEPEST:
            flat.update(flatten(value, f'{prefix}{name}.'))
        else:
            flat[f'{prefix}{name}'] = value
    return flat
