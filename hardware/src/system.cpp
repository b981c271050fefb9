// Copyright 2026 The timo_sim authors
// SPDX-License-Identifier: Apache-2.0

// The scene as hardware of ros2_control; doc/ros.md is the page about it.

#include <algorithm>
#include <cctype>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <locale>
#include <memory>
#include <mutex>
#include <sstream>
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

constexpr int64_t SECOND = 1000000000;  // [ns]

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
    const char * const home = std::getenv("HOME");
    if (home && record_file_.compare(0, 2, "~/") == 0) {
      record_file_.replace(0, 1, home);
    }
    const auto factor = parameter(given, "real_time_factor");
    if (!factor.empty()) {
      std::istringstream text(factor);
      text.imbue(std::locale::classic());
      if (!(text >> factor_ && text.eof() && factor_ >= 0.0 && factor_ <= 1e6)) {
        throw std::runtime_error(
                "real_time_factor must be a number >= 0 and <= 1e6, got '" + factor + "'");
      }
    }
    auto publish_clock = parameter(given, "publish_clock");
    for (auto & letter : publish_clock) {
      letter = std::tolower(static_cast<unsigned char>(letter));
    }
    if (publish_clock == "true") {
      clock_ = get_node()->create_publisher<rosgraph_msgs::msg::Clock>("/clock", 10);
    } else if (!publish_clock.empty() && publish_clock != "false") {
      throw std::runtime_error(
              "publish_clock must be true or false, got '" + given.at("publish_clock") + "'");
    }
    if (info_.rw_rate < 1) {
      throw std::runtime_error("rw_rate must be >= 1 Hz, got 0");
    }
    wall_period_ = wall(SECOND / info_.rw_rate);
    // The loop of the manager waits for its clock to start, and to go on while it cannot read.
    const auto tick = std::chrono::milliseconds(10);
    idle_ = patience_ = 100 + wall_period_ / tick;
    timer_ = get_node()->create_wall_timer(
      tick, [this] {
        const std::lock_guard<std::mutex> lock(mutex_);
        if (++idle_ > patience_) {
          advance_clock();
          missed_ += commanded_;
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
    active_ = true;
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
      if (active_ && !std::isnan(value)) {  // an inactive arm rests, whoever commands it
        plant_->set(each.input, value);
        const std::lock_guard<std::mutex> lock(mutex_);
        if (!commanded_) {
          commanded_ = true;
          plant_->note_offset(time(periods_));
        }
      }
    }
    return return_type::OK;
  }

  return_type read(const rclcpp::Time &, const rclcpp::Duration &) override
  {
    int64_t missed, period;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (get_clock()->now().nanoseconds() != time(periods_)) {
        throw std::runtime_error(
                "another program sets the clock of the controller manager, or it hears its own: "
                "start it with --ros-args -r controller_manager:/clock:=/clock_unheard");
      }
      idle_ = 0;
      missed = missed_;
      missed_ = 0;
      period = time(periods_ + 1) - time(periods_);
    }
    if (factor_ > 0.0) {  // wait for the wall clock; at most a period is caught up
      std::this_thread::sleep_until(next_);
      next_ = std::max(next_, SteadyClock::now() - wall_period_) + wall(period);
    }
    if (missed) {  // the arm is where the clock is
      RCLCPP_WARN(
        get_logger(), "the loop of the controller manager has not read for %lld periods, in which "
        "the arm goes on under its last commands", static_cast<long long>(missed));
    }
    for (int64_t k = 0; commanded_ && k <= missed; ++k) {
      plant_->step(steps_);
    }
    complain();
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      advance_clock();
    }
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
    active_ = false;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      idle_ = patience_;
      missed_ = 0;
      commanded_ = false;
    }
    if (plant_) {
      plant_->start("");
      complain();
    }
    return CallbackReturn::SUCCESS;
  }

  // Say once that the log has ended early; the run goes on.
  void complain()
  {
    const auto error = plant_->log_error();
    if (error != told_) {
      told_ = error;
      if (!error.empty()) {
        RCLCPP_ERROR(get_logger(), "%s", error.c_str());
      }
    }
  }

  // Sim time after some periods [ns]; the remainder of a division does not add up.
  int64_t time(int64_t periods) const
  {
    const int64_t rate = info_.rw_rate;
    return periods / rate * SECOND + periods % rate * SECOND / rate;
  }

  // Wall time of a sim time [ns].
  std::chrono::nanoseconds wall(int64_t time) const
  {
    return std::chrono::nanoseconds(factor_ > 0.0 ? std::llround(time / factor_) : 0);
  }

  // The clock of the controller manager goes on by a period; it has no other source.
  void advance_clock()
  {
    const int64_t before = time(periods_), now = time(++periods_);
    {
      const std::lock_guard<std::mutex> lock(get_clock()->get_clock_mutex());
      if (rcl_set_ros_time_override(get_clock()->get_clock_handle(), now) != RCL_RET_OK) {
        throw std::runtime_error("the clock of the controller manager cannot be set");
      }
    }
    // For others some 100 times a second of sim time are enough.
    if (clock_ && now / 10000000 != before / 10000000) {
      rosgraph_msgs::msg::Clock message;
      message.clock = rclcpp::Time(now);
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
  int64_t steps_ = 0;  // time steps in a period
  bool active_ = false;
  std::chrono::nanoseconds wall_period_{0};
  SteadyClock::time_point next_;
  std::string told_;  // of the log's error
  std::mutex mutex_;  // of the clock: of what follows until `commanded_`
  int64_t periods_ = 0;  // of the clock since its start
  int64_t idle_ = 0, patience_ = 0;  // ticks of the timer since the last read
  int64_t missed_ = 0;  // periods by which the timer has advanced the clock of a moving arm
  bool commanded_ = false;
  rclcpp::Publisher<rosgraph_msgs::msg::Clock>::SharedPtr clock_;
  rclcpp::TimerBase::SharedPtr timer_;
};

}  // namespace timo_sim_hardware

PLUGINLIB_EXPORT_CLASS(timo_sim_hardware::System, hardware_interface::SystemInterface)
