# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The manipulator of a scene as a URDF, whose links are the frames of `topics.outputs`."""

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from timo_sim.model.bodies import Manipulator, Quadrature
from timo_sim.model.layout import LINKS
from timo_sim.topics.outputs import renamed

_PAPER = Path(__file__).with_name('timo_sim.urdf')
_ALUMINIUM = 2710.0  # [kg/m3]; bodies are drawn with the volume of their mass in aluminium


def urdf_of(body: Manipulator, frames: Mapping[str, str],
            control: ElementTree.Element | None = None) -> str:
    """Return the URDF of a Manipulator with these names of frames, and a <ros2_control> if any."""
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    robot = ElementTree.parse(_PAPER, parser).getroot()
    for path, values in _numbers(body).items():
        next(robot.iterfind(path)).attrib.update({
            name: ' '.join(f'{number:.9g}' for number in numbers)
            for name, numbers in values.items()})
    for key, elements in (('name', robot.findall('link')), ('link', robot.iter('parent')),
                          ('link', robot.iter('child'))):
        for element in elements:
            element.set(key, renamed(element.get(key, ''), frames))
    if control is not None:
        robot.append(control)
    text = ElementTree.tostring(robot, 'unicode')
    return '<?xml version="1.0"?>\n' + text.replace(' />', '/>')


def _numbers(body):
    """Return the numbers of a Manipulator by element of the URDF and attribute."""
    arm, base, tip = body.arm, body.base_mass, body.end_effector_mass
    nodes = Quadrature(arm.breaks, 4)  # exact for sections that vary linearly
    section = arm.at(nodes.nodes)
    lump = nodes.weights * section.mass_per_length
    mass = lump.sum()
    centre = lump @ nodes.nodes / mass
    apart = lump @ (nodes.nodes - centre)**2
    # Parts of the moments of inertia that are due to the section's height and width.
    bending = nodes.weights @ (np.ones_like(lump) * section.inertia_per_length)
    side = 'height' if arm.section.shape in ('round', 'tube') else 'width'
    sideways = lump @ (np.ones_like(lump) * getattr(section, side)**2) / 12.0
    spin, hub = body.shaft_inertia, body.hub_radius
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

    piece = arm.length / LINKS
    middles = arm.at(piece * (np.arange(LINKS) + 0.5))
    links = {}
    for k, (height, width) in enumerate(zip(*(
            np.ones(LINKS) * size for size in (middles.height, getattr(middles, side))))):
        link = f'arm_{k + 1}'
        links[f"joint[@name='{link}']/origin"] = {'xyz': [piece if k else hub, 0.0, 0.0]}
        links[visual(link, 'origin')] = {'xyz': [0.5 * piece, 0.0, 0.0]}
        links[visual(link, 'geometry/box')] = {'size': [piece, height, width]}
    return {
        # The carrier does not turn: any moments of inertia will do that a body can have.
        **inertial('carrier', base, 0.0, *3 * [base * carrier**2 / 6.0]),
        # The shaft turns about z alone: its moments about x and y are made up, as of a ball.
        **inertial('arm', mass, hub + centre, spin + bending + sideways, spin + apart + sideways,
                   spin + apart + bending),
        **inertial('tip', tip, body.end_effector_offset, *3 * [body.end_effector_inertia]),
        "joint[@name='tip']/origin": {'xyz': [hub + arm.length, 0.0, 0.0]},
        visual('carrier', 'origin'): {'xyz': [0.0, 0.0, -motor - 0.5 * carrier]},
        visual('carrier', 'geometry/box'): {'size': 3 * [carrier]},
        visual('carrier', 'geometry/cylinder', 2): {'radius': [motor], 'length': [2.0 * motor]},
        visual('arm', 'origin'): {'xyz': [hub + 0.5 * arm.length, 0.0, 0.0]},
        # Half as thick as the links, which hide it unless they bend.
        visual('arm', 'geometry/box'): {'size': [
            arm.length, *(0.5 * np.max(size) for size in (
                arm.section.height, getattr(arm.section, side)))]},
        **links,
        visual('tip', 'geometry/sphere'): {'radius': [ball]},
    }
