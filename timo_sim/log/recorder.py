"""A recorder that writes MCAP from a thread of its own."""

from collections import deque
from pathlib import Path
import threading
import time
from typing import NamedTuple

from mcap.writer import CompressionType, Writer
import yaml

from timo_sim.log.schema import schema_text, type_hash

FLUSH_PERIOD = 0.5       # [s] of wall time; half of what a crash may cost
CHUNK_SIZE = 128 * 1024  # [B] so that compressing one does not hold up the other threads
BACKLOG = 100000         # messages that may wait before `write` does

_FOR_EVER = {'sec': 9223372036, 'nsec': 854775807}
# What the node offers on every topic, as rosbag2 writes it (metadata version 9).
QOS = {
    'history': 'keep_last', 'depth': 10, 'reliability': 'reliable', 'durability': 'volatile',
    'deadline': _FOR_EVER, 'lifespan': _FOR_EVER, 'liveliness': 'automatic',
    'liveliness_lease_duration': _FOR_EVER, 'avoid_ros_namespace_conventions': False}


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data):
        return True


class Channel(NamedTuple):
    """A topic of the log."""

    topic: str      # fully qualified name
    type_name: str  # as in 'sensor_msgs/msg/JointState'


class Recorder:
    """
    Write serialised messages and metadata to a new MCAP file.

    Messages are handed over at the cost of one append; a thread serialises chunks, compresses them
    and gives them to the operating system at least every `FLUSH_PERIOD`. If that fails, `error`
    says why, what was written is kept, and later messages are dropped.

    Parameters
    ----------
    path : str or Path
        A file of this name is never overwritten: `_1`, `_2`, ... is appended to the stem.
    channels : list of Channel
    notes : dict of dict
        Metadata records by name, values of str.

    Attributes
    ----------
    path : Path
        The file that is written.
    error : str or None

    Raises
    ------
    OSError
        If the file cannot be made.

    """

    def __init__(self, path, channels, notes):
        self.error = None
        self._channels = channels
        self._counts = [0] * len(channels)
        self._span = [None, 0]
        self._queue = deque()
        self._closing = threading.Event()
        definitions = {name: (schema_text(name), type_hash(name))
                       for name in {channel.type_name for channel in channels}}
        self.path, self._file = _create(Path(path))
        self._writer = Writer(self._file, chunk_size=CHUNK_SIZE, compression=CompressionType.LZ4)
        try:
            self._start(definitions, notes)
        except OSError:
            self._file.close()
            raise
        self._thread = threading.Thread(target=self._run, name='recorder', daemon=True)
        self._thread.start()

    def write(self, index, step, stamp, data):
        """
        Log a message.

        Parameters
        ----------
        index : int
            Of its channel.
        step : int
            Time step, written as the message's sequence number.
        stamp : int
            Sim time, written as log time and publish time [ns].
        data : bytes
            CDR.

        """
        if self.error is not None:
            return
        self._queue.append((index, step, stamp, data))
        while len(self._queue) > BACKLOG and self.error is None:
            time.sleep(0.001)

    def note(self, name, values):
        """Log a metadata record: a name, and a dictionary of str."""
        if self.error is None:
            self._queue.append((name, values))

    def close(self):
        """Write what is waiting, the index and the summary, and close the file."""
        self._closing.set()
        self._thread.join()

    def _start(self, definitions, notes):
        self._writer.start(profile='ros2')
        schemas = {name: self._writer.register_schema(name, 'ros2msg', text.encode())
                   for name, (text, _) in definitions.items()}
        qos = yaml.dump([QOS], Dumper=_Dumper, sort_keys=False)
        for channel in self._channels:
            self._writer.register_channel(channel.topic, 'cdr', schemas[channel.type_name], {
                'offered_qos_profiles': qos,
                'topic_type_hash': definitions[channel.type_name][1]})
        for name, values in notes.items():
            self._writer.add_metadata(name, values)
        self._writer.flush()

    def _run(self):
        try:
            flushed = time.monotonic()
            while not self._closing.wait(0.02):
                self._drain()
                if time.monotonic() - flushed > FLUSH_PERIOD:
                    self._writer.flush()
                    flushed = time.monotonic()
            self._drain()
            self._writer.add_metadata('rosbag2', {'serialized_metadata': self._rosbag2()})
            self._writer.finish()
        except (OSError, ValueError) as error:
            self.error = f'{self.path}: {error}'
            self._queue.clear()
        finally:
            try:
                self._file.close()
            except OSError as error:
                self.error = self.error or f'{self.path}: {error}'

    def _drain(self):
        while self._queue:
            item = self._queue.popleft()
            if len(item) == 2:
                self._writer.add_metadata(*item)
                continue
            index, step, stamp, data = item
            self._writer.add_message(index + 1, stamp, data, stamp, step & 0xffffffff)
            self._counts[index] += 1
            if self._span[0] is None:
                self._span[0] = stamp
            self._span[1] = stamp

    def _rosbag2(self):
        """Return what rosbag2 keeps in its metadata record, version 9."""
        first, last = self._span[0] or 0, self._span[1]
        span = {'duration': {'nanoseconds': last - first},
                'starting_time': {'nanoseconds_since_epoch': first},
                'message_count': sum(self._counts)}
        topics = [
            {'topic_metadata': {
                'name': channel.topic, 'type': channel.type_name, 'serialization_format': 'cdr',
                'offered_qos_profiles': [QOS],
                'type_description_hash': type_hash(channel.type_name)},
             'message_count': count}
            for channel, count in zip(self._channels, self._counts)]
        return yaml.dump({
            'version': 9, 'storage_identifier': 'mcap', **span,
            'topics_with_message_count': topics, 'compression_format': '', 'compression_mode': '',
            'relative_file_paths': [self.path.name],
            'files': [{'path': self.path.name, **span}],
            'custom_data': {}, 'ros_distro': 'jazzy'}, Dumper=_Dumper, sort_keys=False)


def _create(path):
    # Mode 'x' is the file system's own promise that nothing is overwritten.
    path.parent.mkdir(parents=True, exist_ok=True)
    for attempt in range(10000):
        candidate = path.with_stem(f'{path.stem}_{attempt}') if attempt else path
        try:
            return candidate, open(candidate, 'xb')
        except FileExistsError:
            continue
    raise FileExistsError(f'{path} and 9999 numbered names after it exist')
