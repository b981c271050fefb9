"""Message definitions and type hashes of installed ROS message packages."""

from functools import cache
import json
import os
from pathlib import Path
import re
import sys

_BUILT_IN = {'bool', 'byte', 'char', 'float32', 'float64', 'int8', 'uint8', 'int16', 'uint16',
             'int32', 'uint32', 'int64', 'uint64', 'string', 'wstring'}
_FIELD = re.compile(r'^\s*([A-Za-z][\w/]*)[^\s#]*\s+\w+')


def _share(type_name, suffix):
    # The wheels of ROS 2 set no AMENT_PREFIX_PATH; their share/ is that of the environment.
    package, _, name = type_name.split('/')
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    for prefix in filter(None, prefixes):
        path = Path(prefix) / 'share' / package / 'msg' / (name + suffix)
        if path.exists():
            return path.read_text(encoding='utf-8')
    raise FileNotFoundError(f'{package}/msg/{name}{suffix} is in no share/ of {prefixes}')


@cache
def schema_text(type_name):
    """
    Return a message definition with all that it depends on, in the `ros2msg` encoding.

    Parameters
    ----------
    type_name : str
        As in 'sensor_msgs/msg/JointState'.

    Returns
    -------
    str

    Raises
    ------
    FileNotFoundError
        If the message package is not installed.

    """
    texts, waiting = {}, [type_name]
    while waiting:
        current = waiting.pop(0)
        if current in texts:
            continue
        texts[current] = _share(current, '.msg')
        for line in texts[current].splitlines():
            field = _FIELD.match(line)
            if field and field.group(1) not in _BUILT_IN:
                package, _, name = field.group(1).rpartition('/')
                package = package.removesuffix('/msg') or current.split('/')[0]
                waiting.append(f'{package}/msg/{name}')
    parts = [texts.pop(type_name)]
    for name, text in texts.items():
        package, _, message = name.split('/')
        parts.append(f'{"=" * 80}\nMSG: {package}/{message}\n{text}')
    return '\n'.join(parts)


@cache
def type_hash(type_name):
    """Return the REP-2011 hash of a message type, 'RIHS01_...'."""
    hashes = json.loads(_share(type_name, '.json'))['type_hashes']
    return next(entry['hash_string'] for entry in hashes if entry['type_name'] == type_name)
