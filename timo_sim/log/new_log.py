# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""A log of a run that no node has made: the same topics and bytes as the node writes."""

from timo_sim.log.notes import Peak, start_note, START, SUMMARY
from timo_sim.log.recorder import Channel, Recorder
from timo_sim.messages.commands import COMMANDS
from timo_sim.messages.outputs import outputs
from timo_sim.messages.packing import Serializer
from timo_sim.scene.parameters import changed

NODE = '/timo_sim'


class NewLog:
    """
    A log that is written output by output, as the node would.

    Parameters
    ----------
    path : str or Path
        A file of this name is never overwritten, see Recorder.
    scene : Scene
    values : dict
        Parameters of the node, the scene's among them.
    node : str, optional
        Its fully qualified name.
    **notes : str
        More to be known of the run at its start.

    """

    def __init__(self, path, scene, values, node=NODE, **notes):
        namespace = node.rpartition('/')[0]
        channels = [Channel(node + command.name[1:], command.type_name) for command in COMMANDS]
        self._topics, self._peak = {}, Peak()
        for output in outputs(scene.modal_count):
            name = output.name
            topic = (name if name.startswith('/') else
                     node + name[1:] if name.startswith('~') else f'{namespace}/{name}')
            delay = round(1e9 * scene.values[output.delay]) if output.delay else 0
            self._topics[name] = (
                len(channels), Serializer(output.type_name, output.template), delay)
            channels.append(Channel(topic, output.type_name))
        self._recorder = Recorder(path, channels, {
            START: {**start_note(node, values, changed(values), scene), **notes}})

    @property
    def path(self):
        """The file."""
        return self._recorder.path

    def command(self, index, step, nanoseconds, data):
        """Log a command."""
        self._recorder.write(index, step, nanoseconds, data)

    def output(self, name, snapshot, numbers):
        """Log a message."""
        index, serialize, delay = self._topics[name]
        self._recorder.write(index, snapshot.step, snapshot.nanoseconds + delay,
                             serialize(snapshot.time, numbers))
        if name == '~/tip_deflection':
            self._peak.see(numbers, snapshot.nanoseconds)

    def note(self, name, values):
        """Log a metadata record."""
        self._recorder.note(name, values)

    def close(self):
        """Complete the file; raise OSError if it is not."""
        self._recorder.note(SUMMARY, self._peak.note())
        self._recorder.close()
        if self._recorder.error:
            raise OSError(self._recorder.error)
