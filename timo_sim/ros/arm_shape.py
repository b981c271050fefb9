# Copyright 2026 The timo_sim authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Publishes the centre line of the arm as a marker for RViz, on ~/arm_shape; not logged."""

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
import numpy as np
from rclpy.node import Node
from rclpy.serialization import serialize_message
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from timo_sim.model.formulation import Formulation
from timo_sim.ros.topics import Outlet
from timo_sim.simulation.snapshot import Snapshot


class ArmShape(Outlet):
    """The outlet of the centre line of a Formulation; `frame` is the name of the world frame."""

    logged = False
    name, rate = '~/arm_shape', 'rate.arm_shape'

    def __init__(self, node: Node, model: Formulation, frame: str) -> None:
        super().__init__(node, self.name, 'visualization_msgs/msg/Marker')
        self._model, self._frame, self.every = model, frame, 1
        self._thickness = float(np.max(model.manipulator.arm.section.height))

    def publish(self, snapshot: Snapshot, again: bool = False) -> None:
        """Send the shape that the arm has in a snapshot; `again` as in `Outlet.send`."""
        line = self._model.shape(snapshot.motion[np.newaxis])[0]
        sec, nanosec = snapshot.time
        self.send(serialize_message(Marker(
            header=Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=self._frame),
            ns='arm', type=Marker.LINE_STRIP, action=Marker.ADD,
            pose=Pose(orientation=Quaternion(w=1.0)), scale=Vector3(x=self._thickness),
            color=ColorRGBA(r=0.34, g=0.71, b=0.91, a=1.0),
            points=[Point(x=x, y=y) for x, y in line.tolist()])),
            snapshot.step, snapshot.nanoseconds, again)
