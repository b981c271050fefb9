# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Write new logs, MCAP files, in a thread of their own."""

from collections import deque
from contextlib import suppress
import errno
import os
from pathlib import Path
import threading
import time
from typing import NamedTuple

from mcap.records import Channel as ChannelRecord
from mcap.records import Schema

from timo_sim.log.notes import Peak, start_note, START, SUMMARY
from timo_sim.log.records import hold
from timo_sim.log.writer import channel_metadata, Chunk, DEPTH, Writer
from timo_sim.messages.commands import COMMANDS
from timo_sim.messages.definitions import schema_text, TYPE_HASHES
from timo_sim.messages.outputs import in_frames, outputs
from timo_sim.messages.packing import Serializer
from timo_sim.scene.values import changed, frame_names

FLUSH_PERIOD = 0.5       # [s] of wall time; a crash loses at most twice this
CHUNK_SIZE = 512 * 1024  # [B] so that a day has few; none waits longer than `FLUSH_PERIOD`
BACKLOG = 20             # chunks that may wait for the disk before `write` waits, too
NOTABLE, PATIENCE = 0.5, 60.0  # [s] that `write` waits before a warning, before it gives up


class Channel(NamedTuple):
    """A topic of the log."""

    topic: str      # fully qualified name
    type_name: str  # as in 'sensor_msgs/msg/JointState'
    name: str = ''  # before remapping, as in '~/tip_pose'
    depth: int = DEPTH
    reliability: str = 'reliable'  # or 'best_effort'


class Recorder:
    """
    Write serialised messages and metadata to a new MCAP file.

    `write` only appends to a chunk; a thread compresses chunks, for the most part without holding
    up other threads, and gives them to the operating system at least every `FLUSH_PERIOD`. If that
    fails or takes longer than `PATIENCE`, or another program deletes, cuts or writes to the file,
    `error` says so, what was written is kept, and later messages are dropped.

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
        Why the log has ended early.
    warning : str or None
        That the file has been moved or the disk is slow; the log goes on.

    Raises
    ------
    OSError
        If the file cannot be made.

    """

    def __init__(self, path, channels, notes):
        self.error = self.warning = None
        self._lock = threading.Lock()  # of the chunk that grows
        self._chunk = Chunk()
        self._queue = deque()  # (method of the Writer, arguments) of what is to be written
        self._ready = threading.Event()
        self._closing = False
        types = list(dict.fromkeys(channel.type_name for channel in channels))
        records = [*(Schema(id=number, name=name, encoding='ros2msg',
                            data=schema_text(name).encode())
                     for number, name in enumerate(types, start=1)),
                   *(ChannelRecord(id=number, topic=topic, message_encoding='cdr',
                                   schema_id=types.index(name) + 1,
                                   metadata=channel_metadata(TYPE_HASHES[name], *qos))
                     for number, (topic, name, _, *qos) in enumerate(channels, start=1))]
        self.path, self._file = create(Path(path))
        try:
            self._writer = Writer(self._file, 'ros2')
            for record in records:
                self._writer.add_record(record)
            for name, values in notes.items():
                self._writer.add_metadata(name, values)
            self._file.flush()
        except OSError:
            with suppress(OSError):
                self._file.close()
            self.path.unlink()  # this process made it, and it is not a log
            raise
        self._thread = threading.Thread(target=self._run, name='recorder', daemon=True)
        self._thread.start()

    def write(self, index, step, stamp, data):
        """
        Log a message, CDR, of the channel with this index.

        The time step becomes its sequence number; the stamp, sim time [ns], becomes its log and
        publish time.
        """
        if self.error is not None:
            return
        with self._lock:
            self._chunk.add(index + 1, step & 0xffffffff, stamp, data)
            if len(self._chunk.data) < CHUNK_SIZE:
                return
        self._pass_on()
        self._ready.set()
        begun = time.monotonic()
        while len(self._queue) > BACKLOG and self.error is None:
            time.sleep(0.001)
            if time.monotonic() - begun > NOTABLE:
                self.warning = f'the simulation has waited for the disk of {self.path}'
            if time.monotonic() - begun > PATIENCE:
                self.error = f'{self.path}: the disk has taken nothing for {PATIENCE:g} s'

    def note(self, name, values):
        """Log a metadata record: a name, and a dictionary of str."""
        if self.error is None:
            self._pass_on()
            self._queue.append((self._writer.add_metadata, name, values))

    def close(self):
        """Write what is waiting, the index and the summary, and close the file."""
        self._closing = True
        self._ready.set()
        size = None
        while self._thread.is_alive() and self._writer.size != size:  # while it makes progress
            size = self._writer.size
            self._thread.join(PATIENCE)
        if self._thread.is_alive():
            self.error = self.error or f'{self.path}: the disk does not take the end of the log'

    def _pass_on(self):
        """Queue the chunk that grows, to be written as it is."""
        with self._lock:
            if self._chunk.data:
                self._queue.append((self._writer.add_chunk, self._chunk))
                self._chunk = Chunk()

    def _run(self):
        try:
            while not self._closing:
                if not self._ready.wait(FLUSH_PERIOD):
                    self._pass_on()
                self._ready.clear()
                self._drain()
            self._pass_on()
            self._drain()
            self._writer.finish(self.path.name)
            sync(self._file)
            self._look()
        except Exception as error:  # of any type, because `write` must not wait for this thread
            self.error = f'{self.path}: {error}'
            self._queue.clear()
        finally:
            try:
                self._file.close()
            except OSError as error:
                self.error = self.error or f'{self.path}: {error}'

    def _drain(self):
        self._look()
        while self._queue:
            write, *items = self._queue.popleft()
            write(*items)
        self._file.flush()

    def _look(self):
        """Raise OSError if another program changed or deleted the file: `write` gives no error."""
        ours = os.fstat(self._file.fileno())
        if ours.st_size != self._writer.size:
            raise OSError(f'it has {ours.st_size} bytes, {self._writer.size} were written: '
                          'another program has cut it or written to it')
        with suppress(OSError):
            if os.path.samestat(ours, os.stat(self.path)):
                return
        if not ours.st_nlink:
            raise OSError('it was deleted')
        self.warning = f'{self.path} was moved; the log goes on where it is now'


class NewLog(Recorder):
    """
    A log of a run made without a node: the same topics and bytes as the node writes.

    Parameters
    ----------
    path : str or Path
    scene : Scene
    values : dict
        Parameters of the node, the scene's among them.
    node : str, optional
        Fully qualified name of the node that topics are named after.
    **notes : str
        Further metadata for the start of the run.

    """

    def __init__(self, path, scene, values, node='/timo_sim', **notes):
        namespace = node.rpartition('/')[0]
        channels = [Channel(node + command.name[1:], command.type_name) for command in COMMANDS]
        self._topics, self._peak, frames = {}, Peak(), frame_names(values)
        for output in outputs(scene.modal_count):
            name = output.name
            topic = (name if name.startswith('/') else
                     node + name[1:] if name.startswith('~') else f'{namespace}/{name}')
            delay = round(1e9 * scene.values[output.delay]) if output.delay else 0
            self._topics[name] = (
                len(channels), Serializer(output.type_name, in_frames(output.template, frames)),
                delay, output)
            channels.append(Channel(topic, output.type_name))
        super().__init__(path, channels, {
            START: {**start_note(node, values, changed(values), scene), **notes}})

    def output(self, name, snapshot, numbers):
        """Log a message of an output; commands are logged by `write`."""
        index, serialize, delay, output = self._topics[name]
        self.write(index, snapshot.step, snapshot.nanoseconds + delay,
                   serialize(snapshot.time, output.content(snapshot, numbers)))
        if name == '~/tip_deflection':
            self._peak.see(numbers, snapshot.nanoseconds)

    def close(self):
        """Complete the file; raise OSError if that fails, or the log has ended early."""
        self.note(SUMMARY, self._peak.note())
        super().close()
        if self.error:
            raise OSError(self.error)


def create(path):
    """Make a new file, numbered if it exists, and its folders; return its path and stream."""
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if path.exists() and not path.is_file():
        raise OSError(f'{path} must be a regular file or none yet, not a device or FIFO')
    path.parent.mkdir(parents=True, exist_ok=True)
    # With mode 'x' the file system guarantees that nothing is overwritten.
    for attempt in range(10000):
        candidate = path.with_stem(f'{path.stem}_{attempt}') if attempt else path
        try:
            # O_APPEND: if another program cuts the file or adds to it, its size shows that.
            stream = open(candidate, 'xb', opener=lambda name, flags: os.open(
                name, flags | os.O_APPEND, 0o666))
        except FileExistsError:
            continue
        hold(stream)
        return candidate, stream
    raise FileExistsError(f'{path} and 9999 numbered names after it exist')


def sync(stream):
    """Wait until all that was written is on the disk: a closed log survives a power cut."""
    stream.flush()
    os.fsync(stream.fileno())
