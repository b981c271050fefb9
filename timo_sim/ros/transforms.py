"""The frames world, carrier, arm and tip as a message on /tf; not logged."""

from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from timo_sim.outputs import TRANSFORMS
from timo_sim.ros.topics import MotionOutlet


def _transform(time, parent, child, x=0.0, y=0.0, z=0.0, w=1.0):
    return TransformStamped(
        header=Header(stamp=time, frame_id=parent), child_frame_id=child,
        transform=Transform(translation=Vector3(x=x, y=y), rotation=Quaternion(z=z, w=w)))


def message(time, *numbers):
    """Return the tree of frames, from the numbers of `outputs.TRANSFORMS`."""
    return TFMessage(transforms=[
        _transform(time, 'world', 'carrier', *numbers[:2]),
        _transform(time, 'carrier', 'arm', 0.0, 0.0, *numbers[2:4]),
        _transform(time, 'arm', 'tip', *numbers[4:])])


class Transforms(MotionOutlet):
    """The outlet of /tf, among those that carry the motion."""

    logged = False

    def __init__(self, node):
        super().__init__(node, TRANSFORMS, TFMessage, message)
