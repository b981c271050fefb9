// Copyright 2026 The timo_sim authors
// SPDX-License-Identifier: Apache-2.0

// The scene as hardware of ros2_control; doc/ros.md is the page about it.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <unordered_map>
#include <vector>

#include "hardware_interface/system_interface.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "rcl/time.h"
#include "rclcpp/rclcpp.hpp"
#include "rosgraph_msgs/msg/clock.hpp"

#include "plant.hpp"

namespace timo_sim_hardware
{

using hardware_interface::CallbackReturn;
using hardware_interface::return_type;
using rclcpp_lifecycle::State;
using SteadyClock = std::chrono::steady_clock;

// The controller manager catches what its methods throw, and prints it.
class System : public hardware_interface::SystemInterface
{
public:
  CallbackReturn on_init(
    const hardware_interface::HardwareComponentInterfaceParams & params) override
  {
    if (hardware_interface::SystemInterface::on_init(params) != CallbackReturn::SUCCESS) {
      return CallbackReturn::ERROR;
    }
    if (get_clock()->get_clock_type() != RCL_ROS_TIME || !get_clock()->ros_time_is_active()) {
      throw std::runtime_error(
              "the controller manager must have use_sim_time: true, since its plant sets the clock");
    }
    const auto & given = info_.hardware_parameters;
    plant_ = std::make_unique<Plant>(parameter(given, "scene_library"));
    record_file_ = parameter(given, "record_file");
    const auto factor = parameter(given, "real_time_factor");
    factor_ = factor.empty() ? 1.0 : std::atof(factor.c_str());
    if (!(factor_ >= 0.0 && factor_ <= 1e6)) {
      throw std::runtime_error("real_time_factor must be >= 0 and <= 1e6, got " + factor);
    }
    if (parameter(given, "publish_clock") == "true") {
      clock_ = get_node()->create_publisher<rosgraph_msgs::msg::Clock>("/clock", 10);
    }
    period_ = 1000000000 / info_.rw_rate;
    wall_period_ = std::chrono::nanoseconds(factor_ > 0.0 ? std::llround(period_ / factor_) : 0);
    // The loop of the manager waits for its clock to start, and to go on while it cannot read.
    const auto tick = std::chrono::milliseconds(10);
    idle_ = patience_ = 100 + wall_period_ / tick;
    timer_ = get_node()->create_wall_timer(
      tick, [this] {
        const std::lock_guard<std::mutex> lock(mutex_);
        if (++idle_ > patience_) {
          advance_clock();
        }
      });
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_configure(const State &) override
  {
    commands_.clear();
    readings_.clear();
    for (const auto * parts : {&info_.joints, &info_.sensors}) {
      for (const auto & part : *parts) {
        for (const auto & each : part.command_interfaces) {
          const auto name = part.name + "/" + each.name;
          commands_.push_back(
            {name, get_command_interface_handle(name),
              plant_->input(parameter(each.parameters, "input"))});
        }
        for (const auto & each : part.state_interfaces) {
          if (each.parameters.count("output")) {  // others keep their initial_value
            readings_.push_back(
              {get_state_interface_handle(part.name + "/" + each.name),
                plant_->reading(each.parameters.at("output"))});
          }
        }
      }
    }
    publish();
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_activate(const State & state) override
  {
    const double exact = 1.0 / (info_.rw_rate * plant_->time_step());
    steps_ = std::llround(exact);
    if (steps_ < 1 || std::abs(exact - steps_) > 1e-9 * exact) {
      throw std::runtime_error(
              "the period of the controller manager, 1/update_rate = " +
              std::to_string(1.0 / info_.rw_rate) + " s, must be a whole multiple of the time step "
              "of the scene, integrator.step = " + std::to_string(plant_->time_step()) + " s");
    }
    for (const auto & each : commands_) {
      set_command(each.handle, std::nan(""), true);
    }
    leave(state);
    plant_->start(record_file_);
    publish();
    if (!record_file_.empty()) {
      RCLCPP_INFO(get_logger(), "log: %s", plant_->log_path().c_str());
    }
    next_ = SteadyClock::now();
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_deactivate(const State & state) override {return leave(state);}
  CallbackReturn on_cleanup(const State & state) override {return leave(state);}
  CallbackReturn on_shutdown(const State & state) override {return leave(state);}
  CallbackReturn on_error(const State & state) override {return leave(state);}

  // An interface that no controller has any more does nothing.
  return_type perform_command_mode_switch(
    const std::vector<std::string> &, const std::vector<std::string> & stopped) override
  {
    for (const auto & each : commands_) {
      if (commanded_ && std::find(stopped.begin(), stopped.end(), each.name) != stopped.end()) {
        set_command(each.handle, 0.0, true);
      }
    }
    return return_type::OK;
  }

  // The motion begins with the first command, so that each of its periods has one.
  return_type write(const rclcpp::Time &, const rclcpp::Duration &) override
  {
    for (const auto & each : commands_) {
      double value = 0.0;
      get_command(each.handle, value, true);
      if (!std::isnan(value)) {
        plant_->set(each.input, value);
        commanded_ = true;
      }
    }
    return return_type::OK;
  }

  return_type read(const rclcpp::Time &, const rclcpp::Duration &) override
  {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (get_clock()->now().nanoseconds() != time_) {
        throw std::runtime_error(
                "another program sets the clock of the controller manager, or it hears its own: "
                "start it with --ros-args -r controller_manager:/clock:=/clock_unheard");
      }
      idle_ = 0;
    }
    if (factor_ > 0.0) {  // wait for the wall clock; at most a period is caught up
      std::this_thread::sleep_until(next_);
      next_ = std::max(next_, SteadyClock::now() - wall_period_) + wall_period_;
    }
    if (commanded_) {
      plant_->step(steps_);
    }
    advance_clock();
    publish();
    return return_type::OK;
  }

private:
  static std::string parameter(
    const std::unordered_map<std::string, std::string> & given, const std::string & name)
  {
    const auto found = given.find(name);
    return found == given.end() ? "" : found->second;
  }

  // Go back to the start, and let the clock go on at once if the loop does not read.
  CallbackReturn leave(const State &)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    idle_ = patience_;
    commanded_ = false;
    if (plant_) {
      plant_->start("");
    }
    return CallbackReturn::SUCCESS;
  }

  // The clock of the controller manager goes on by a period; it has no other source.
  void advance_clock()
  {
    time_ += period_;
    {
      const std::lock_guard<std::mutex> lock(get_clock()->get_clock_mutex());
      if (rcl_set_ros_time_override(get_clock()->get_clock_handle(), time_) != RCL_RET_OK) {
        throw std::runtime_error("the clock of the controller manager cannot be set");
      }
    }
    // For others some 100 times a second of sim time are enough.
    if (clock_ && time_ / 10000000 != (time_ - period_) / 10000000) {
      rosgraph_msgs::msg::Clock message;
      message.clock = rclcpp::Time(time_);
      clock_->publish(message);
    }
  }

  void publish()
  {
    for (const auto & each : readings_) {
      set_state(each.handle, plant_->get(each.reading), true);
    }
  }

  struct Command
  {
    std::string name;
    hardware_interface::CommandInterface::SharedPtr handle;
    int input;
  };
  struct Reading
  {
    hardware_interface::StateInterface::SharedPtr handle;
    Plant::Reading reading;
  };

  std::unique_ptr<Plant> plant_;
  std::vector<Command> commands_;
  std::vector<Reading> readings_;
  std::string record_file_;
  double factor_ = 1.0;  // sim time per wall time; 0: as fast as possible
  int64_t period_ = 0, time_ = 0, steps_ = 0;  // [ns], sim time [ns], time steps in a period
  std::chrono::nanoseconds wall_period_{0};
  SteadyClock::time_point next_;
  std::mutex mutex_;  // of the clock
  int64_t idle_ = 0, patience_ = 0;  // ticks of the timer since the last read
  bool commanded_ = false;
  rclcpp::Publisher<rosgraph_msgs::msg::Clock>::SharedPtr clock_;
  rclcpp::TimerBase::SharedPtr timer_;
};

}  // namespace timo_sim_hardware

PLUGINLIB_EXPORT_CLASS(timo_sim_hardware::System, hardware_interface::SystemInterface)
