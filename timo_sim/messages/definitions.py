# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Definitions and type hashes of the messages that are logged, as in the packages of ROS 2."""

from functools import cache
import re
from typing import Any, NamedTuple

# Lines of the .msg files, without comments; sorted by package.
DEFINITIONS = {
    'builtin_interfaces/msg/Time': ('int32 sec', 'uint32 nanosec'),
    'diagnostic_msgs/msg/DiagnosticArray': (
        'std_msgs/Header header', 'DiagnosticStatus[] status'),
    'diagnostic_msgs/msg/DiagnosticStatus': (
        'byte OK=0', 'byte WARN=1', 'byte ERROR=2', 'byte STALE=3', 'byte level', 'string name',
        'string message', 'string hardware_id', 'KeyValue[] values'),
    'diagnostic_msgs/msg/KeyValue': ('string key', 'string value'),
    'geometry_msgs/msg/Point': ('float64 x', 'float64 y', 'float64 z'),
    'geometry_msgs/msg/Pose': ('Point position', 'Quaternion orientation'),
    'geometry_msgs/msg/PoseStamped': ('std_msgs/Header header', 'Pose pose'),
    'geometry_msgs/msg/Quaternion': ('float64 x 0', 'float64 y 0', 'float64 z 0', 'float64 w 1'),
    'geometry_msgs/msg/Transform': ('Vector3 translation', 'Quaternion rotation'),
    'geometry_msgs/msg/TransformStamped': (
        'std_msgs/Header header', 'string child_frame_id', 'Transform transform'),
    'geometry_msgs/msg/Vector3': ('float64 x', 'float64 y', 'float64 z'),
    'geometry_msgs/msg/Vector3Stamped': ('std_msgs/Header header', 'Vector3 vector'),
    'geometry_msgs/msg/Wrench': ('Vector3 force', 'Vector3 torque'),
    'geometry_msgs/msg/WrenchStamped': ('std_msgs/Header header', 'Wrench wrench'),
    'rosgraph_msgs/msg/Clock': ('builtin_interfaces/Time clock',),
    'sensor_msgs/msg/Imu': (
        'std_msgs/Header header',
        'geometry_msgs/Quaternion orientation', 'float64[9] orientation_covariance',
        'geometry_msgs/Vector3 angular_velocity', 'float64[9] angular_velocity_covariance',
        'geometry_msgs/Vector3 linear_acceleration', 'float64[9] linear_acceleration_covariance'),
    'sensor_msgs/msg/JointState': (
        'std_msgs/Header header', 'string[] name', 'float64[] position', 'float64[] velocity',
        'float64[] effort'),
    'std_msgs/msg/Float64': ('float64 data',),
    'std_msgs/msg/Float64MultiArray': ('MultiArrayLayout layout', 'float64[] data'),
    'std_msgs/msg/Header': ('builtin_interfaces/Time stamp', 'string frame_id'),
    'std_msgs/msg/MultiArrayDimension': ('string label', 'uint32 size', 'uint32 stride'),
    'std_msgs/msg/MultiArrayLayout': ('MultiArrayDimension[] dim', 'uint32 data_offset'),
    'tf2_msgs/msg/TFMessage': ('geometry_msgs/TransformStamped[] transforms',),
}

# REP-2011 hashes of the types that topics have; a log states them beside each topic.
TYPE_HASHES = {
    'diagnostic_msgs/msg/DiagnosticArray':
        'RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e',
    'geometry_msgs/msg/PoseStamped':
        'RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8',
    'geometry_msgs/msg/Vector3Stamped':
        'RIHS01_d4829622288cbb443886e7ea94ea5671a3b1be6bab4ad04224432a65f7d7887a',
    'geometry_msgs/msg/WrenchStamped':
        'RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77',
    'rosgraph_msgs/msg/Clock':
        'RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564',
    'sensor_msgs/msg/Imu':
        'RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b',
    'sensor_msgs/msg/JointState':
        'RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e',
    'std_msgs/msg/Float64':
        'RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a',
    'std_msgs/msg/Float64MultiArray':
        'RIHS01_1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f',
    'tf2_msgs/msg/TFMessage':
        'RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087',
}

_FIELD = re.compile(r'([\w/]+)(\[\d*\])? (\w+)(?: (\S+))?')


class Field(NamedTuple):
    """A field of a message."""

    name: str
    type_name: str        # 'float64', 'string', ... or as in 'geometry_msgs/msg/Point'
    length: int | None    # of an array; 0 for a sequence of any length, None for a single value
    default: Any          # what a new message holds: 0, '', {} or an array of these


@cache
def fields(type_name):
    """Return the fields of a message type of DEFINITIONS in order, a tuple of Field."""
    # A line with '=' defines a constant, which is in no message.
    return tuple(_field(type_name.split('/')[0], line) for line in DEFINITIONS[type_name]
                 if '=' not in line)


def _field(package, line):
    kind, array, name, default = _FIELD.findall(line)[0]
    value: Any
    if kind[0].isupper():
        kind = f'{package}/{kind}'  # of the same package
    if '/' in kind:
        kind, value = kind.replace('/', '/msg/'), {}
    else:
        value = '' if kind == 'string' else int(default or 0)
    if not array:
        return Field(name, kind, None, value)
    length = int(array[1:-1] or 0)
    return Field(name, kind, length, length * (value,))


@cache
def schema_text(type_name):
    """Return a definition with all that it depends on, in the `ros2msg` encoding of MCAP."""
    names = [type_name]
    for name in names:  # grows by what is found
        for field in fields(name):
            if field.type_name in DEFINITIONS and field.type_name not in names:
                names.append(field.type_name)
    lines = [*DEFINITIONS[type_name]]
    for name in names[1:]:
        lines += ['=' * 80, 'MSG: ' + name.replace('/msg/', '/'), *DEFINITIONS[name]]
    return '\n'.join(lines) + '\n'
