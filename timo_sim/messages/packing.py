# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Fast serialisation of messages in which only the time and some numbers change."""

import struct
from typing import NamedTuple

from timo_sim.messages.cdr import Layout, layout, pack


class Number(NamedTuple):
    """
    Stands in a template for a number that changes from message to message.

    A template has the values of a message as `cdr.pack` takes them. Numbers are counted in the
    order of the template, whatever the order of the message, those without a name last; these
    describe the others, as variances do, and are no columns.

    Examples
    --------
    >>> template = {'name': ['shaft'], 'position': [Number('shaft_rad')]}
    >>> serialize = Serializer('sensor_msgs/msg/JointState', template)
    >>> message = serialize((1, 500000000), [0.25])  # at 1.5 s

    """

    column: str = ''  # its name with unit, as in 'shaft_rad'


def columns(template):
    """Return the names of those numbers of a template that have one, a tuple of str."""
    found = []
    _filled(template, lambda number: found.append(number.column))
    return tuple(filter(None, found))


class Form(NamedTuple):
    """A message made from a template, and where its numbers are."""

    data: bytes
    layout: Layout
    places: tuple  # index of each Number among all float64 of the message


def form(type_name, template):
    """Return the Form of a template."""
    marks: list[tuple[bool, float]] = []

    def mark(number):  # with a value that no template holds: 5e-324, 1e-323, ...
        marks.append((not number.column, 5e-324 * (len(marks) + 1)))
        return marks[-1][1]

    data = pack(type_name, _filled(template, mark))
    found = layout(type_name, data)
    doubles = [struct.unpack_from('<d', data, place)[0] for place in found.doubles]
    return Form(data, found, tuple(doubles.index(value) for _, value in sorted(marks)))


def _filled(template, value):
    """Return a template with value(number) for each Number, in the order of the template."""
    if isinstance(template, Number):
        return value(template)
    if isinstance(template, dict):
        return {name: _filled(part, value) for name, part in template.items()}
    if isinstance(template, list):
        return [_filled(part, value) for part in template]
    return template


class Serializer:
    """
    Writes time and numbers straight into a serialised message.

    Everything else is the same in all messages of a topic, so each is a copy of the first with
    other numbers. All times in a message are the same. A type without a time is a ValueError.
    """

    def __init__(self, type_name, template):
        data, found, places = form(type_name, template)
        if not found.stamps:
            raise ValueError(f'{type_name} has no time')
        self._data = bytearray(data)
        # CDR aligns every number to its size, counted from the end of the header of four bytes.
        body = memoryview(self._data)[4:]
        self._words = body[:len(body) // 4 * 4].cast('I')
        self._times = [(place - 4) // 4 for place in found.stamps]
        self._numbers = body[:len(body) // 8 * 8].cast('d')
        self._places = [(found.doubles[place] - 4) // 8 for place in places]
        for place in self._places:  # numbers that no call gives are zero
            self._numbers[place] = 0.0

    def __call__(self, time, numbers):
        """Return the serialised message with a time ([s], [ns]) and numbers in the columns."""
        for place in self._times:
            self._words[place], self._words[place + 1] = time
        view = self._numbers
        for place, number in zip(self._places, numbers):
            view[place] = number
        return bytes(self._data)
