"""The log of a replay: the same topics and bytes as the node writes; needs rclpy's messages."""

from timo_sim.commands import COMMANDS
from timo_sim.log.notes import Peak, start_note, START, SUMMARY
from timo_sim.log.recorder import Channel, Recorder
from timo_sim.outputs import outputs
from timo_sim.parameters import changed
from timo_sim.ros.topics import MESSAGES, Serializer


class NewLog:
    """
    What a Replay tells, written as the node would.

    Parameters
    ----------
    path : str or Path
        A file of this name is never overwritten, see Recorder.
    recording : Recording
        What is replayed.
    scene : Scene
    values : dict
        Parameters of the node, the scene's among them.

    """

    def __init__(self, path, recording, scene, values):
        node = recording.name
        namespace = node.rpartition('/')[0]
        channels = [Channel(node + command.name[1:], command.type_name) for command in COMMANDS]
        self._topics, self._peak = {}, Peak()
        for output in outputs(scene.values['model.modes']):
            name = output.name
            topic = (name if name.startswith('/') else
                     node + name[1:] if name.startswith('~') else f'{namespace}/{name}')
            serialize = Serializer(MESSAGES[name][1], len(output.columns))
            delay = round(1e9 * scene.values[output.delay]) if output.delay else 0
            self._topics[name] = len(channels), serialize, delay
            channels.append(Channel(topic, output.type_name))
        self._recorder = Recorder(path, channels, {
            START: {**start_note(node, values, changed(values), scene),
                    'replay_of': recording.index.name}})

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
