// Copyright 2026 The timo_sim authors
// SPDX-License-Identifier: Apache-2.0

// What hardware/src/system.cpp uses of rclcpp, for tests where ROS in C++ is not installed.

#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "rcl/time.h"

#define RCLCPP_INFO(logger, ...) ((void)(logger), std::printf(__VA_ARGS__), std::puts(""))
#define RCLCPP_WARN RCLCPP_INFO
#define RCLCPP_ERROR RCLCPP_INFO

namespace rclcpp
{

struct Logger {};
struct Duration {};

struct Time
{
  explicit Time(int64_t nanoseconds)
  : count(nanoseconds) {}
  int64_t nanoseconds() const {return count;}
  int64_t count;
};

class Clock
{
public:
  Time now() const {return Time(handle_.time);}
  int get_clock_type() const {return RCL_ROS_TIME;}
  bool ros_time_is_active() const {return true;}
  std::mutex & get_clock_mutex() {return mutex_;}
  rcl_clock_t * get_clock_handle() {return &handle_;}

private:
  std::mutex mutex_;
  rcl_clock_t handle_;
};

template<typename Message>
struct Publisher
{
  using SharedPtr = std::shared_ptr<Publisher>;
  void publish(const Message &) {++count;}
  std::atomic<int> count{0};
};

// Calls in a thread of its own, as an executor of several threads does.
class TimerBase
{
public:
  using SharedPtr = std::shared_ptr<TimerBase>;
  TimerBase(std::chrono::milliseconds period, std::function<void()> callback)
  : thread_([this, period, callback] {
        while (!ends_) {
          std::this_thread::sleep_for(period);
          callback();
        }
      }) {}
  ~TimerBase()
  {
    ends_ = true;
    thread_.join();
  }

private:
  std::atomic<bool> ends_{false};
  std::thread thread_;
};

struct Node
{
  template<typename Message>
  typename Publisher<Message>::SharedPtr create_publisher(const std::string &, int)
  {
    std::puts("publishes /clock");
    return std::make_shared<Publisher<Message>>();
  }
  template<typename Callback>
  TimerBase::SharedPtr create_wall_timer(std::chrono::milliseconds period, Callback callback)
  {
    return std::make_shared<TimerBase>(period, callback);
  }
};

}  // namespace rclcpp

namespace rclcpp_lifecycle
{
struct State {};
}
