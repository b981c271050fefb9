# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""The YAML that rosbag2 writes: metadata of a bag, and the QoS of topics."""

import os
from typing import Any

from mcap.summary import Summary
import yaml

from timo_sim.log.notes import printable

DEPTH = 10  # of a topic's queue [messages]


class _Dumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    def ignore_aliases(self, data):
        return True


def yaml_text(value: Any) -> str:
    """Return a value as YAML without aliases."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False)


def offered_qos(durability: str) -> str:
    """Return the QoS of a topic, as rosbag2 writes it (metadata version 9)."""
    for_ever = {'sec': 9223372036, 'nsec': 854775807}
    return yaml_text([{
        'history': 'keep_last', 'depth': DEPTH, 'reliability': 'reliable',
        'durability': durability, 'deadline': for_ever, 'lifespan': for_ever,
        'liveliness': 'automatic', 'liveliness_lease_duration': for_ever,
        'avoid_ros_namespace_conventions': False}])


def _qos_of(channel):
    """Return the QoS of a channel; none if it has numbers, as of Humble, or cannot be read."""
    text = channel.metadata.get('offered_qos_profiles', '')
    try:
        return yaml.safe_load(text) if 'history: keep' in text and '&' not in text else []
    except (yaml.YAMLError, RecursionError, ValueError):
        return []


def information(summary: Summary, name: str) -> dict[str, Any]:
    """Return rosbag2's metadata (version 9) of a bag with this summary and file name."""
    statistics = summary.statistics
    assert statistics is not None
    start, end = statistics.message_start_time, statistics.message_end_time
    span = {'duration': {'nanoseconds': end - start},
            'starting_time': {'nanoseconds_since_epoch': start},
            'message_count': statistics.message_count}
    types = {schema.id: schema.name for schema in summary.schemas.values()}
    topics = [
        {'topic_metadata': {
            'name': channel.topic, 'type': types.get(channel.schema_id, ''),
            'serialization_format': channel.message_encoding,
            'offered_qos_profiles': _qos_of(channel),
            'type_description_hash': channel.metadata.get('topic_type_hash', '')},
         'message_count': statistics.channel_message_counts.get(channel.id, 0)}
        for channel in summary.channels.values()]
    return {
        'version': 9, 'storage_identifier': 'mcap', **span,
        'topics_with_message_count': topics, 'compression_format': '', 'compression_mode': '',
        'relative_file_paths': [printable(name)], 'files': [{'path': printable(name), **span}],
        'custom_data': {}, 'ros_distro': os.environ.get('ROS_DISTRO', 'jazzy')}
