"""The packed messages are those that rclpy makes."""

from builtin_interfaces.msg import Time
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64

from timo_sim.ros.topics import Serializer, TOPICS


@pytest.mark.parametrize('topic', TOPICS, ids=lambda topic: topic.name)
def test_packed_is_what_rclpy_serializes(topic):
    pack = Serializer(topic.message, topic.size)
    for sec, nanosec in ((0, 0), (1, 999999999), (2**31 - 1, 1)):
        numbers = np.random.default_rng(sec).normal(size=topic.size).tolist()
        message = topic.message(Time(sec=sec, nanosec=nanosec), *numbers)
        assert isinstance(message, topic.message_type)
        assert pack((sec, nanosec), numbers) == serialize_message(message)


def test_a_message_that_does_not_begin_with_the_time_is_refused():
    with pytest.raises(ValueError, match='begin with the time'):
        Serializer(lambda time, number: Float64(data=number), 1)
