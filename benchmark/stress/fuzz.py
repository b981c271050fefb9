# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""
Search for a file that `timo_sim recover`, `info` or `Recording` does not survive.

    python -m benchmark.stress.fuzz

Needs atheris (`pip install atheris`; Python 3.11). What follows on the command line goes to
libFuzzer, for instance `-max_total_time=600`, which is the default; a file that it finds is left
in the working directory. It tries any bytes, also after the beginning of a log, and chunks whose
checksum is made right, so that their contents are read.
"""

import os
from pathlib import Path
import struct
import sys
import tempfile
import zlib

import atheris

from benchmark.command import parser
import timo_sim.simulation.simulator  # noqa: F401  # numba cannot compile what atheris has changed

with atheris.instrument_imports(include=['timo_sim.log', 'mcap']):
    from oracles import hostile_logs
    from oracles.log_readers import outcome

LONGEST = 20000  # [B] of a file
START = hostile_logs.hostile()['header only']


def mended(data):
    """Return a log with the checksum of each uncompressed chunk made right."""
    data, place = bytearray(data), len(hostile_logs.MCAP0_MAGIC)
    while place + 9 <= len(data):
        opcode, length = struct.unpack_from('<BQ', data, place)
        place += 9
        if opcode == 6 and 40 <= length <= len(data) - place:
            head = struct.pack('<I', 0) + struct.pack('<Q', length - 40)
            data[place + 28:place + 40] = head
            inside = data[place + 40:place + length]
            struct.pack_into('<QI', data, place + 16, len(inside), zlib.crc32(inside))
        place += length
    return bytes(data)


def main():
    """Fuzz until the time is over or something is found."""
    _, given = parser(__spec__, __doc__).parse_known_args()
    folder = Path(tempfile.mkdtemp(prefix='fuzz_log_'))
    corpus, path = folder / 'corpus', folder / 'log.mcap'
    corpus.mkdir()
    intact = hostile_logs.record(folder / 'run.mcap', steps=30, chunk=10)
    for number, content in enumerate([intact, intact[:-20], *hostile_logs.hostile().values()]):
        if len(content) <= LONGEST:
            (corpus / str(number)).write_bytes(b'\0' + content)
    os.fsync = lambda number: None  # thousands of logs need not wait for the disk

    def one(data):
        if not data:
            return
        content = data[1:]
        if data[0] & 1:
            content = START + content
        path.write_bytes(mended(content) if data[0] & 2 else content)
        outcome(path)

    limits = ['-max_total_time=600', f'-max_len={LONGEST}', '-rss_limit_mb=1500', '-timeout=20',
              '-print_final_stats=1']
    atheris.Setup([sys.argv[0], *limits, *given, str(corpus)], one)
    atheris.Fuzz()


if __name__ == '__main__':
    main()
