# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""The subcommand `urdf`, which writes a scene's bodies into the paper's URDF, timo_sim.urdf."""

import click

from timo_sim.cli.commands import main, parsed

_ALUMINIUM = 2710.0  # [kg/m3]; bodies are drawn with the volume of their mass in aluminium


@main.command()
@click.argument('scene')
@click.option('--set', 'settings', multiple=True, metavar='NAME=VALUE',
              help='A parameter that differs from the scene, such as frame_prefix=left/.')
def urdf(scene, settings):
    r"""
    Print the URDF of SCENE, a parameter file or the name of an installed scene.

    \b
        timo_sim urdf my_scene.yaml > my_scene.urdf

    Lengths, masses, centres of mass and moments of inertia are those of the scene with a straight
    arm; the link arm includes the inertia of the shaft. Links have the names of the frames.
    """
    from timo_sim.scene.files import read_parameter_file
    from timo_sim.scene.values import frame_names
    from timo_sim.scene.scene import load_scene
    changes = parsed(settings)
    body = load_scene(scene, changes).manipulator
    click.echo(_filled(body, frame_names({**read_parameter_file(scene), **changes})))


def _filled(body, frames):
    """Return the URDF of a Manipulator with these names of frames."""
    from xml.etree import ElementTree
    from timo_sim.scene.files import shared
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    robot = ElementTree.parse(shared('urdf/timo_sim.urdf'), parser).getroot()
    for path, values in _values(body).items():
        next(robot.iterfind(path)).attrib.update({
            name: ' '.join(f'{number:.9g}' for number in numbers)
            for name, numbers in values.items()})
    names = {**frames, 'carrier_rail': frames['carrier'] + '_rail'}
    for key, elements in (('name', robot.findall('link')), ('link', robot.iter('parent')),
                          ('link', robot.iter('child'))):
        for element in elements:
            element.set(key, names[element.get(key)])
    text = ElementTree.tostring(robot, 'unicode')
    return '<?xml version="1.0"?>\n' + text.replace(' />', '/>')


def _values(body):
    """Return the numbers of a Manipulator by element of the URDF and attribute."""
    import numpy as np
    from timo_sim.physics.arm.quadrature import Quadrature
    arm, base, tip = body.arm, body.base_mass, body.end_effector_mass
    nodes = Quadrature(arm.breaks, 4)  # exact for sections that vary linearly
    section = arm.at(nodes.nodes)
    lump = nodes.weights * section.mass_per_length
    mass = lump.sum()
    centre = lump @ nodes.nodes / mass
    apart = lump @ (nodes.nodes - centre)**2
    # Parts of the moments of inertia that are due to the section's height and width.
    bending, sideways = (lump @ (np.ones_like(lump) * size**2) / 12.0
                         for size in (section.height, section.width))
    spin = body.shaft_inertia
    carrier = np.cbrt(body.carrier_mass / _ALUMINIUM)
    motor = np.cbrt(body.motor_mass / _ALUMINIUM / (2.0 * np.pi))  # as high as it is wide
    ball = np.cbrt(tip / _ALUMINIUM / (4.0 / 3.0 * np.pi))

    def inertia(xx, yy, zz):
        return {'ixx': [xx], 'iyy': [yy], 'izz': [zz]}

    def inertial(link, mass, x, *moments):
        path = f"link[@name='{link}']/inertial/"
        return {f'{path}mass': {'value': [mass]}, f'{path}origin': {'xyz': [x, 0.0, 0.0]},
                f'{path}inertia': inertia(*moments)}

    def visual(link, shape, number=1):
        return f"link[@name='{link}']/visual[{number}]/{shape}"

    return {
        # The carrier does not turn: any moments of inertia will do that a body can have.
        **inertial('carrier', base, 0.0, *3 * [base * carrier**2 / 6.0]),
        # The shaft turns about z alone: its moments about x and y are made up, as of a ball.
        **inertial('arm', mass, centre, spin + bending + sideways, spin + apart + sideways,
                   spin + apart + bending),
        **inertial('tip', tip, 0.0, *3 * [body.end_effector_inertia]),
        "joint[@name='tip']/origin": {'xyz': [arm.length, 0.0, 0.0]},
        visual('carrier', 'origin'): {'xyz': [0.0, 0.0, -motor - 0.5 * carrier]},
        visual('carrier', 'geometry/box'): {'size': 3 * [carrier]},
        visual('carrier', 'geometry/cylinder', 2): {'radius': [motor], 'length': [2.0 * motor]},
        visual('arm', 'origin'): {'xyz': [0.5 * arm.length, 0.0, 0.0]},
        visual('arm', 'geometry/box'): {
            'size': [arm.length, np.max(arm.section.height), np.max(arm.section.width)]},
        visual('tip', 'geometry/sphere'): {'radius': [ball]},
    }
