// Copyright 2026 The timo_sim authors
// SPDX-License-Identifier: Apache-2.0

// What hardware/src/system.cpp uses of hardware_interface, for tests where it is not installed.

#pragma once

#include <atomic>
#include <map>
#include <memory>
#include <string>
#include <unordered_map>
#include <vector>

#include "rclcpp/rclcpp.hpp"

namespace hardware_interface
{

enum class CallbackReturn {SUCCESS, FAILURE, ERROR};
enum class return_type {OK, ERROR};

struct Handle
{
  using SharedPtr = std::shared_ptr<Handle>;
  std::atomic<double> value{0.0};
};
using CommandInterface = Handle;
using StateInterface = Handle;

struct InterfaceInfo
{
  std::string name;
  std::unordered_map<std::string, std::string> parameters;
};

struct ComponentInfo
{
  std::string name;
  std::vector<InterfaceInfo> command_interfaces, state_interfaces;
};

struct HardwareInfo
{
  std::unordered_map<std::string, std::string> hardware_parameters;
  unsigned int rw_rate;
  std::vector<ComponentInfo> joints, sensors;
};

struct HardwareComponentInterfaceParams {HardwareInfo hardware_info;};

class SystemInterface
{
public:
  using State = rclcpp_lifecycle::State;
  virtual ~SystemInterface() = default;
  virtual CallbackReturn on_init(const HardwareComponentInterfaceParams & params)
  {
    info_ = params.hardware_info;
    return CallbackReturn::SUCCESS;
  }
  virtual CallbackReturn on_configure(const State &) = 0;
  virtual CallbackReturn on_activate(const State &) = 0;
  virtual CallbackReturn on_deactivate(const State &) = 0;
  virtual CallbackReturn on_cleanup(const State &) = 0;
  virtual CallbackReturn on_shutdown(const State &) = 0;
  virtual CallbackReturn on_error(const State &) = 0;
  virtual return_type perform_command_mode_switch(
    const std::vector<std::string> &, const std::vector<std::string> &) = 0;
  virtual return_type read(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  virtual return_type write(const rclcpp::Time &, const rclcpp::Duration &) = 0;

  Handle::SharedPtr get_command_interface_handle(const std::string & name) {return handle(name);}
  Handle::SharedPtr get_state_interface_handle(const std::string & name) {return handle(name);}
  bool set_command(const Handle::SharedPtr & handle, double value, bool)
  {
    handle->value = value;
    return true;
  }
  bool get_command(const Handle::SharedPtr & handle, double & value, bool)
  {
    value = handle->value;
    return true;
  }
  bool set_state(const Handle::SharedPtr & handle, double value, bool)
  {
    handle->value = value;
    return true;
  }
  std::shared_ptr<rclcpp::Clock> get_clock() const {return clock_;}
  std::shared_ptr<rclcpp::Node> get_node() const {return node_;}
  rclcpp::Logger get_logger() const {return {};}

protected:
  HardwareInfo info_;

private:
  Handle::SharedPtr handle(const std::string & name)
  {
    auto & found = handles_[name];
    return found = found ? found : std::make_shared<Handle>();
  }

  std::map<std::string, Handle::SharedPtr> handles_;
  std::shared_ptr<rclcpp::Clock> clock_ = std::make_shared<rclcpp::Clock>();
  std::shared_ptr<rclcpp::Node> node_ = std::make_shared<rclcpp::Node>();
};

}  // namespace hardware_interface
