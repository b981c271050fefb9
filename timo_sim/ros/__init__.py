# Copyright 2026 The timo_sim authors
# SPDX-License-Identifier: Apache-2.0

"""
The simulator as a ROS 2 node: subscriptions, publishers, services, clock and log, wired together.

This package may import everything below it; nothing else imports rclpy.
"""
