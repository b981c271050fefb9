# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""Describe a log by its summary alone: a gigabyte takes less than a second."""

import json
from pathlib import Path

from timo_sim.log.notes import ENVIRONMENT, plain
from timo_sim.log.read import LogFile
from timo_sim.topics.cdr import NANOSECONDS


def info(file: Path | str) -> list[str]:
    """Return lines that describe a log of this package, or another MCAP file."""
    log = LogFile(file)
    notes = log.notes()
    kind = 'log of ' + notes.facts.get('node', '/timo_sim') if notes.facts else 'plain bag'
    lines = [f'{log.name}: {kind}, {log.path.stat().st_size / 1e6:.3g} MB']
    if notes.facts:
        lines += _about_run(log, notes)
    lines += _about_topics(log.summary)
    return [plain(line[:200]) for line in lines]


def _about_run(log, notes):
    facts, summary, resets, changes = notes
    end = log.summary.statistics.message_end_time
    steps = ', '.join(map(str, resets[:8])) + ', ...' * (len(resets) > 8)
    later = [f'at step {step}: {name} = {json.dumps(value)}'
             for step, _, values in changes for name, value in values.items()]
    for title, lines in {
            'changed': _changed(facts) or ['nothing: the arm of the paper at rest'],
            'made with': [', '.join(f'{name} {facts[name]}' for name in ENVIRONMENT
                                    if name in facts)],
            'sim time': [f'0 to {end / NANOSECONDS:.9g} s'],
            'resets': [f'{len(resets)}, at steps {steps}' if resets else 'none'],
            'set later': later[:20] + [f'and {len(later) - 20} more'] * (len(later) > 20),
            'counted': [f'{name} {value}' for name, value in summary.items()]
            or ['not known: the node did not write its summary']}.items():
        for line in lines:
            yield f'  {title:<10}{line}'
            title = ''


def _changed(facts):
    try:
        changed = json.loads(facts['changed'])
        return [f'{name} = {json.dumps(value)}' for name, value in changed.items()]
    except (KeyError, AttributeError, ValueError, RecursionError):
        return ['not known: the log does not contain it']


def _about_topics(summary):
    statistics = summary.statistics
    span = (statistics.message_end_time - statistics.message_start_time) / NANOSECONDS
    width = min(max([len(each.topic) for each in summary.channels.values()], default=5), 60)
    yield f'  {"topic":<{width}}  {"messages":>9}  mean rate'
    for number, channel in sorted(summary.channels.items(), key=lambda item: item[1].topic):
        count = statistics.channel_message_counts.get(number, 0)
        rate = f'{(count - 1) / span:.6g} Hz' if span > 0.0 and count > 1 else '-'
        yield f'  {channel.topic[:width]:<{width}}  {count:>9}  {rate}'
