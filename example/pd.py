"""
PD control of the shaft, in lock step with the node: turns the arm by 45 degrees.

    ros2 run timo_sim sim_node --ros-args -p sync:=wait -p sync_period:=0.002 \
        -p rate.joint_states:=500.0 -p duration:=4.0 -p record_file:=pd.mcap
    python example/pd.py

Each state of the node is answered by one command with the same stamp; the run has the same bits
however busy the machine is. It ends with the node. `timo_sim view pd.mcap` shows it.
"""

import math

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState

GOAL = math.radians(45.0)      # of the shaft, from where it starts [rad]
STIFFNESS, DAMPING = 40.0, 40.0  # [N m/rad], [N m s/rad]
QUIET = 2.0                    # [s] of wall time without a state: the node has ended


def torque(angle, speed, goal):
    """Return the torque on the shaft [N m]."""
    return STIFFNESS * (goal - angle) - DAMPING * speed


class Controller(Node):
    """Answers each joint state with an effort for the shaft."""

    def __init__(self):
        super().__init__('pd')
        self.goal, self.answers = None, 0
        self.publisher = self.create_publisher(JointState, '/timo_sim/joint_command', 10)
        self.create_subscription(JointState, '/joint_states', self.answer, 10)
        self.clock = self.create_timer(QUIET, self.look)
        self.seen = -1

    def answer(self, state):
        """Send the command for a state."""
        place = state.name.index('shaft')
        angle, speed = state.position[place], state.velocity[place]
        if self.goal is None:
            self.goal = angle + GOAL
        command = JointState(name=['shaft'], effort=[torque(angle, speed, self.goal)])
        command.header.stamp = state.header.stamp
        self.publisher.publish(command)
        self.answers += 1

    def look(self):
        """End when the node has ended."""
        if self.answers and self.answers == self.seen:
            raise ExternalShutdownException
        self.seen = self.answers


def main():
    """Control until the node ends."""
    rclpy.init()
    node = Controller()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        print(f'{node.answers} states answered')
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
