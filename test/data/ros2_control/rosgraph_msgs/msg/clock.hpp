// Copyright 2026 The timo_sim authors
// SPDX-License-Identifier: Apache-2.0

#pragma once

#include "rclcpp/rclcpp.hpp"

namespace rosgraph_msgs::msg
{
struct Clock {rclcpp::Time clock{0};};
}
