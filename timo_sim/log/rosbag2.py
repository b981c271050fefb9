# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""What rosbag2 keeps in a log besides the messages: QoS, and its own metadata record."""

import os

import yaml

_FOR_EVER = {'sec': 9223372036, 'nsec': 854775807}
# What the node offers on every topic, as rosbag2 writes it (metadata version 9).
_QOS = {
    'history': 'keep_last', 'depth': 10, 'reliability': 'reliable', 'durability': 'volatile',
    'deadline': _FOR_EVER, 'lifespan': _FOR_EVER, 'liveliness': 'automatic',
    'liveliness_lease_duration': _FOR_EVER, 'avoid_ros_namespace_conventions': False}


class _Dumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    def ignore_aliases(self, data):
        return True


def yaml_text(value):
    """Return a value as YAML without aliases."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False)


_QOS_TEXT = yaml_text([_QOS])


def printable(path):
    """Return a path as text that can be printed anywhere: on Linux file names are bytes."""
    return os.fsencode(path).decode(errors='replace')


def channel_metadata(type_hash):
    """Return the metadata of a channel: what the node offers, and the hash of its type."""
    return {'offered_qos_profiles': _QOS_TEXT, 'topic_type_hash': type_hash}


def information(schemas, channels, statistics, name):
    """Return what rosbag2, metadata version 9, says of a bag from its records and file name."""
    start, end = statistics.message_start_time, statistics.message_end_time
    span = {'duration': {'nanoseconds': end - start},
            'starting_time': {'nanoseconds_since_epoch': start},
            'message_count': statistics.message_count}
    types = {schema.id: schema.name for schema in schemas}
    topics = [
        {'topic_metadata': {
            'name': channel.topic, 'type': types[channel.schema_id],
            'serialization_format': channel.message_encoding,
            # A text that is not ours is left alone: it may come from a hostile file.
            'offered_qos_profiles':
                [_QOS] if channel.metadata.get('offered_qos_profiles') == _QOS_TEXT else [],
            'type_description_hash': channel.metadata.get('topic_type_hash', '')},
         'message_count': statistics.channel_message_counts.get(channel.id, 0)}
        for channel in channels]
    return {
        'version': 9, 'storage_identifier': 'mcap', **span,
        'topics_with_message_count': topics, 'compression_format': '', 'compression_mode': '',
        'relative_file_paths': [printable(name)], 'files': [{'path': printable(name), **span}],
        'custom_data': {}, 'ros_distro': 'jazzy'}
