/*
 * Do what the lines of the standard input say with the hardware of ros2_control, as a controller
 * manager would: p NAME VALUE (a parameter of the hardware), init RATE, configure, activate,
 * deactivate, command VALUE, loop COUNT, stall PERIODS (read nothing until the clock has gone on by
 * as many), foreign (set the clock), room BYTES (that a file may have), times (print clock and arm),
 * angle (print that of the shaft).
 */
#include <csignal>
#include <iostream>
#include <sys/resource.h>

#include "log.cpp"
#include "plant.cpp"
#include "system.cpp"

using timo_sim_hardware::System;

int main()
{
  static_assert(!std::is_copy_assignable_v<timo_sim_hardware::Plant>);
  static_assert(!std::is_copy_constructible_v<timo_sim_hardware::Plant>);
  std::signal(SIGXFSZ, SIG_IGN);
  hardware_interface::HardwareInfo info{};
  info.joints = {{"shaft", {{"effort", {{"input", "torque"}}}}, {{"position", {{"output", "encoder"}}}}}};
  info.sensors = {{"arm", {}, {{"time", {{"output", "time"}}}}}};
  System system;
  const rclcpp_lifecycle::State state;
  const rclcpp::Time now(0);
  const rclcpp::Duration period;
  for (std::string what; std::cin >> what; ) {
    try {
      if (what == "p") {
        std::string name;
        std::cin >> name;
        std::getline(std::cin >> std::ws, info.hardware_parameters[name]);
      } else if (what == "init") {
        std::cin >> info.rw_rate;
        system.on_init({info});
      } else if (what == "configure") {
        system.on_configure(state);
      } else if (what == "activate") {
        system.on_activate(state);
      } else if (what == "deactivate") {
        system.on_deactivate(state);
      } else if (what == "command") {
        double value;
        std::cin >> value;
        system.get_command_interface_handle("shaft/effort")->value = value;
      } else if (what == "stop") {
        system.perform_command_mode_switch({}, {"shaft/effort"});
      } else if (what == "loop") {
        int count;
        std::cin >> count;
        while (count--) {
          system.read(now, period);
          system.write(now, period);
        }
      } else if (what == "stall") {
        int64_t count;
        std::cin >> count;
        const int64_t end = system.get_clock()->now().nanoseconds() +
          1000000000 / info.rw_rate * count;
        while (system.get_clock()->now().nanoseconds() < end) {
          std::this_thread::sleep_for(std::chrono::milliseconds(1));
        }
      } else if (what == "foreign") {
        rcl_set_ros_time_override(system.get_clock()->get_clock_handle(), 5);
      } else if (what == "room") {
        rlimit room;
        getrlimit(RLIMIT_FSIZE, &room);
        std::cin >> room.rlim_cur;
        setrlimit(RLIMIT_FSIZE, &room);
      } else if (what == "angle") {
        std::printf("%a\n", system.get_state_interface_handle("shaft/position")->value.load());
      } else if (what == "times") {
        std::printf("%lld %.9f\n", static_cast<long long>(system.get_clock()->now().nanoseconds()),
          system.get_state_interface_handle("arm/time")->value.load());
      }
    } catch (const std::exception & error) {
      std::printf("error: %s\n", error.what());
    }
  }
}
