"""The packed messages are those that rclpy makes."""

from builtin_interfaces.msg import Time
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Float64

from timo_sim.log.cdr import layout
from timo_sim.outputs import outputs
from timo_sim.ros.topics import MESSAGES, Serializer, type_name

EMPTY_LISTS = {'~/modal_state': 1, '~/root_strain': 2, '~/encoder': 2}


@pytest.mark.parametrize('output', outputs(4), ids=lambda output: output.name)
def test_packed_is_what_rclpy_serializes(output):
    message_type, build = MESSAGES[output.name]
    assert type_name(message_type) == output.type_name
    size = len(output.columns)
    pack = Serializer(build, size)
    for sec, nanosec in ((0, 0), (1, 999999999), (2**31 - 1, 1)):
        numbers = np.random.default_rng(sec).normal(size=size).tolist()
        message = build(Time(sec=sec, nanosec=nanosec), *numbers)
        assert isinstance(message, message_type)
        packed, expected = pack((sec, nanosec), numbers), serialize_message(message)
        # Between fields, and four bytes for an empty list, rclpy leaves what was in memory.
        meant = layout(output.type_name, expected).meant()
        assert [packed[place] for place in meant] == [expected[place] for place in meant]
        assert not any(packed[place] for place in set(range(len(packed))) - set(meant))
        assert len(expected) - len(packed) == 4 * EMPTY_LISTS.get(output.name, 0)
        assert deserialize_message(packed, message_type) == message


def test_a_message_without_a_time_is_refused():
    with pytest.raises(ValueError, match='has no time'):
        Serializer(lambda time, number: Float64(data=number), 1)
