# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""A scene as hardware of ros2_control, for the plugin in the folder `hardware/`."""

from __future__ import annotations

from collections.abc import Mapping
import math
from pathlib import Path
from string import Template
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

from timo_sim.export.c import link, write_c
from timo_sim.export.constants import interface_of
from timo_sim.log.read import LogFile
from timo_sim.log.new_log import NewLog
from timo_sim.scene.files import check_target, whole_file
from timo_sim.scene.parameters import fixed_axes, frame_names
from timo_sim.scene.scene import Scene
from timo_sim.topics.cdr import form, Number
from timo_sim.topics.commands import JOINTS
from timo_sim.topics.outputs import gravity_along_z, in_frames


def write_hardware(scene: Scene, values: Mapping[str, Any],
                   library: Path | str) -> ElementTree.Element:
    """
    Write a scene as a shared object for `timo_sim_hardware`; return its `<ros2_control>` element.

    `values` are all parameters of a node, of which names of frames, `record`, `record_file`,
    `real_time_factor` and `publish_clock` are used. The object has the functions of `export_c` and
    the beginning of a log, of which hardware/src/plant.hpp describes the layout. Raises
    ParameterError if the scene cannot be exported; OSError without a C compiler.
    """
    library = Path(library).resolve()
    check_target(library)
    with TemporaryDirectory() as folder:
        write_c(scene, folder, derivatives=False)
        Path(folder, 'scene.c').write_text(_scene_in_c(scene, values, folder))
        content = link(folder, ['scene.c', 'arm.o'], 'arm_*')
    library.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(library) as path:
        path.write_bytes(content)
    block = ElementTree.Element('ros2_control', name='timo_sim_hardware', type='system')
    hardware = ElementTree.SubElement(block, 'hardware')
    ElementTree.SubElement(hardware, 'plugin').text = 'timo_sim_hardware/System'
    _add(hardware, scene_library=library, real_time_factor=values['real_time_factor'],
         publish_clock=str(values['publish_clock']).lower(),
         record_file=(values['record_file'] or 'timo_sim.mcap') if values['record'] else '')
    for joint, force in zip(JOINTS, ('force', 'force', 'torque')):
        element = ElementTree.SubElement(block, 'joint', name=joint)
        for kind, name in _commands(scene).get(joint, {}).items():
            _add(ElementTree.SubElement(element, 'command_interface', name=kind), input=name)
        _add_states(element, {'position': joint, 'velocity': f'{joint}_velocity',
                              'effort': f'{joint}_{force}'})
    for name, states in _sensors(scene).items():
        _add_states(ElementTree.SubElement(block, 'sensor', name=name), states)
    ElementTree.indent(block, level=1)
    block.tail = '\n'
    return block


def _commands(scene):
    """Return the inputs of a scene by joint and command interface."""
    held, dc = fixed_axes(scene.values), scene.values['motor.dc.resistance'] > 0.0
    free = {'x': 'force_x', 'y': 'force_y'}
    found = {f'carrier_{axis}': {'effort': name} for axis, name in free.items()
             if held not in (axis, 'both')}
    if scene.values['motor.shaft'] == 'free':
        found['shaft'] = {'voltage': 'voltage'} if dc else {'effort': 'torque'}
    return found


def _sensors(scene):
    """Return outputs and constants by sensor and state interface, named as for broadcasters."""
    of_tip, of_imu = ({
        'orientation.x': 0.0, 'orientation.y': 0.0, 'orientation.z': f'sin_half({place}_rotation)',
        'orientation.w': f'cos_half({place}_rotation)'} for place in ('tip', 'imu'))
    return {
        'root': {'strain': 'root_strain'}, 'encoder': {'position': 'encoder'},
        **({'rotor': {'position': 'rotor'}} if scene.manipulator.gear else {}),
        'tip': {'axial': 'tip_axial', 'transverse': 'tip_transverse', 'rotation': 'tip_rotation'},
        'tip_pose': {'position.x': 'tip_x', 'position.y': 'tip_y', 'position.z': 0.0, **of_tip},
        'tip_imu': {
            **of_imu, 'angular_velocity.x': 0.0, 'angular_velocity.y': 0.0,
            'angular_velocity.z': 'tip_turning', 'linear_acceleration.x': 'tip_acceleration_x',
            'linear_acceleration.y': 'tip_acceleration_y',
            'linear_acceleration.z': gravity_along_z(math.hypot(*scene.values['gravity']))}}


def _add_states(parent, states):
    for name, source in states.items():
        element = ElementTree.SubElement(parent, 'state_interface', name=name)
        _add(element, **{'output' if isinstance(source, str) else 'initial_value': source})


def _add(parent, **parameters):
    for name, value in parameters.items():
        ElementTree.SubElement(parent, 'param', name=name).text = str(value)


def _scene_in_c(scene, values, folder):
    """Return the C source of what the shared object has besides the functions of `export_c`."""
    log = NewLog(Path(folder, 'head.mcap'), scene, values, saved_by='timo_sim_hardware')
    head = log.path.read_bytes()
    log.close()
    channels = {each.topic: each.id for each in LogFile(log.path).summary.channels.values()}
    interface, modes = interface_of(scene, False), range(1, scene.modal_count + 1)
    inputs, results = ([each.title for each in group]
                       for group in (interface.inputs, interface.outputs))
    torque = [name for name in _commands(scene).get('shaft', {}).values() if name == 'torque']
    efforts = [Number('force_x'), Number('force_y'),
               Number('torque') if torque else math.nan]  # NaN leaves the shaft as it is
    shown = {'joint_states': [*JOINTS, *(f'{name}_velocity' for name in JOINTS),
                              'carrier_x_force', 'carrier_y_force', 'shaft_torque'],
             '~/tip_deflection': ['tip_axial', 'tip_transverse'],
             '~/modal_state': [f'mode_{n}{end}' for end in ('', '_rate') for n in modes]}
    # Name, type, template, what its numbers are, whether they are inputs.
    logged = [('~/joint_command', 'sensor_msgs/msg/JointState',
               {'name': [*JOINTS], 'effort': efforts}, ['force_x', 'force_y', *torque], True)]
    if 'voltage' in inputs:
        logged.append(('~/motor_voltage', 'std_msgs/msg/Float64', {'data': Number('voltage')},
                       ['voltage'], True))
    logged += [(each.name, each.type_name, in_frames(each.template, frame_names(values)),
                shown[each.name], False)
               for each in scene.outputs if each.name in shown]
    data, fields, messages = b'', [], []
    for name, type_name, template, titles, commanded in logged:
        message, layout, places = form(type_name, template)
        channel = channels[name.replace('~', '/timo_sim') if '~' in name else f'/{name}']
        stamp, = layout.stamps or [-1]
        messages.append(f'{{{channel}, {commanded:d}, {len(message)}, {stamp}, '
                        f'data + {len(data)}, {len(places)}, fields + {len(fields)}}}')
        numbers = inputs if commanded else results
        fields += [f'{{{layout.doubles[place]}, {numbers.index(title)}}}'
                   for place, title in zip(places, titles, strict=True)]
        data += message
    source = Template(Path(__file__).with_name('scene.c').read_text(encoding='utf-8'))
    return source.substitute(
        fields=', '.join(fields), head=','.join(map(str, head)), data=','.join(map(str, data)),
        messages=', '.join(messages), step=repr(scene.step), count=len(messages))
