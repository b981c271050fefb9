// Copyright 2026 The timo_sim authors
// SPDX-License-Identifier: Apache-2.0

#pragma once

#include <atomic>
#include <cstdint>

enum { RCL_RET_OK, RCL_ROS_TIME };

struct rcl_clock_t {std::atomic<int64_t> time{0};};

inline int rcl_set_ros_time_override(rcl_clock_t * clock, int64_t time)
{
  clock->time = time;
  return RCL_RET_OK;
}
