# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Describe a log by its summary and indexes: a gigabyte takes less than a second."""

from collections import defaultdict
from itertools import accumulate
import json
from pathlib import Path

import numpy as np

from timo_sim.log.read import LogFile
from timo_sim.log.write import ENVIRONMENT

_NANOSECONDS = 1000000000
_MOST_CHUNKS = 40      # chunks that are read for the peak if the node has not noted it
_MOST_COUNTERS, _IN_A_LINE = 20, 4


def info(file: Path | str) -> list[str]:
    """Return lines that describe a log of this package, or another MCAP file."""
    log = LogFile(file)
    notes = log.notes()
    kind = 'log of ' + notes.facts.get('node', '/timo_sim') if notes.facts else 'plain bag'
    lines = [f'{log.name}: {kind}, {log.path.stat().st_size / 1e6:.3g} MB']
    if notes.facts:
        lines += _about_run(log, notes)
    lines += _about_topics(log)
    # Texts of the file may hold anything, such as control sequences of a terminal.
    return [''.join(char if char.isprintable() else ' ' for char in line[:200]) for line in lines]


def _about_run(log, notes):
    facts, summary, resets, changes = notes
    yield from _entry('changed', _changed(facts) or ['nothing: the arm of the paper at rest'])
    yield from _entry('made with', [', '.join(
        f'{name} {facts[name][:40]}' for name in ENVIRONMENT if name in facts)])
    end = log.statistics.message_end_time / _NANOSECONDS
    yield from _entry('sim time', [f'0 to {end:.9g} s'])
    steps = ', '.join(str(step) for step, _ in resets[:8]) + (', ...' if len(resets) > 8 else '')
    yield from _entry('resets', [f'at steps {steps}' if resets else 'none'])
    if changes:
        yield from _entry('set later', [
            f'at step {step}: {name} = {json.dumps(value)}'[:90]
            for step, _, values in changes for name, value in values.items()][:20])
    counted = [f'{name[:40]} {value[:20]}' for name, value in summary.items()
               if not name.startswith('peak')][:_MOST_COUNTERS]
    yield from _entry('counted', [
        ', '.join(counted[first:first + _IN_A_LINE])
        for first in range(0, len(counted), _IN_A_LINE)
    ] or ['not known: the node did not write its summary'])
    yield from _entry('peak tip', [_peak(log, summary)])


def _changed(facts):
    try:
        changed = json.loads(facts['changed'])
        return [f'{name} = {json.dumps(value)}'[:90] for name, value in changed.items()]
    except (KeyError, AttributeError, ValueError, RecursionError):
        return ['not known: the log does not contain it']


def _entry(title, lines):
    for number, line in enumerate(lines):
        yield f'  {title if not number else "":<10}{line}'


def _peak(log, summary):
    try:
        largest = float(summary['peak_tip_deflection_m'])
        time, about = float(summary['peak_tip_deflection_at_s']), ''
    except (KeyError, ValueError):
        from timo_sim.log.tables import Recording  # here, because its import is slow
        series = Recording(log.path).read('~/tip_deflection', most_chunks=_MOST_CHUNKS).get(
            '~/tip_deflection')
        if series is None or not len(series.ns):
            return 'not in the log'
        across = np.abs(series.values[:, 1])
        place = int(np.argmax(across))
        largest, time = across[place], series.ns[place] / _NANOSECONDS
        chunks = len(log.chunks)
        about = '' if chunks <= _MOST_CHUNKS else (
            f'at least, from some of {chunks} chunks: ')
    return f'{about}{largest:.6g} m transverse, at {time:.6g} s'


def _about_topics(log):
    counts = log.statistics.channel_message_counts
    times = _times(log)
    ordered = sorted(log.chunks, key=lambda chunk: chunk.message_start_time)
    ends = accumulate((chunk.message_end_time for chunk in ordered), max)
    pauses = [after.message_start_time - end for end, after in zip(ends, ordered[1:])]
    if max(pauses, default=0) > _NANOSECONDS:
        yield f'  no messages at all for {max(pauses) / _NANOSECONDS:.6g} s'
    width, silent = max([len(channel.topic) for channel in log.channels.values()], default=5), []
    width = min(width, 60)
    yield f'  {"topic":<{width}}  {"messages":>9}  {"rate":>10}  largest gap'
    for number, channel in sorted(log.channels.items(), key=lambda item: item[1].topic):
        count = counts.get(number, 0)
        if not count:
            silent.append(channel.topic)
            continue
        first, last, gap = times.get(number, (0, 0, 0))
        rate = f'{(count - 1) * _NANOSECONDS / (last - first):.6g} Hz' if last > first else '-'
        gap = f'{gap / _NANOSECONDS:.6g} s' if gap else '-'
        yield f'  {channel.topic[:width]:<{width}}  {count:>9}  {rate:>10}  {gap}'
    if silent:
        yield f'  without messages: {", ".join(silent)}'


def _times(log):
    """Return first and last time and the largest gap between messages of each channel [ns]."""
    parts = defaultdict(list)
    for chunk in log.chunks:
        for channel, times in log.times(chunk).items():
            parts[channel].append(times)
    found = {}
    for channel, each in parts.items():
        times = np.sort(np.concatenate(each))
        if len(times):
            found[channel] = (int(times[0]), int(times[-1]),
                              int(np.diff(times, prepend=times[0]).max()))
    return found
