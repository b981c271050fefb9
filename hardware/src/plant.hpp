// Copyright 2026 The timo_sim authors
// SPDX-License-Identifier: Apache-2.0

// A scene that `timo_sim urdf --ros2-control` has exported: a shared object, its names and its log.
// This file and plant.cpp know nothing of ROS.

#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "log.hpp"

namespace timo_sim_hardware
{

// What the shared object has besides the functions of arm.h, see timo_sim/export/ros2_control.py.
extern "C" {
struct Field {int place; int number;};  // in a message [bytes], of an output or an input

struct Message
{
  int channel, commanded, size, stamp;  // commanded: of inputs; stamp: its place, or -1
  const unsigned char * data;
  int count;
  const Field * fields;
};

struct Scene
{
  double step;  // [s]
  const unsigned char * head;  // of the log: all records before its messages
  int64_t head_size;
  int count;
  const Message * messages;
};
}

// One arm. Methods throw std::runtime_error with the reason.
class Plant
{
public:
  explicit Plant(const std::string & library);
  Plant(const Plant &) = delete;
  Plant & operator=(const Plant &) = delete;
  ~Plant();

  double time_step() const {return scene_->step;}

  // Number of an input of this name.
  int input(const std::string & name) const;

  // A value to read: NAME of an output, or sin_half(NAME) or cos_half(NAME), as in quaternions.
  struct Reading {int output; enum {VALUE, SIN_HALF, COS_HALF} kind;};
  Reading reading(const std::string & text) const;

  // Return to the start of the scene, with inputs 0; later steps go to the log of this path, which
  // is numbered if it exists; none if it is empty.
  void start(const std::string & log_path);
  void set(int input, double value);
  void step(int64_t count);
  double get(Reading reading) const;
  int64_t steps() const {return steps_;}
  std::string log_path() const {return log_ ? log_->path() : "";}
  // Why the log, or the last one if there is none now, has ended early; empty if it has not.
  std::string log_error() const {return log_ ? log_->error() : log_error_;}
  // Note in the log how far a clock is ahead of its times.
  void note_offset(int64_t nanoseconds);

private:
  template<typename Function>
  Function function(const char * name) const;
  std::vector<std::string> names(const char * function_name) const;
  int find(
    const std::vector<std::string> & names, const std::string & name, const char * kind) const;
  void check(int code) const;
  void log(bool commanded);

  struct arm;
  std::string path_, log_error_;
  void * library_;
  const Scene * scene_;
  int (* reset_)(arm *);
  int (* set_input_)(arm *, int, double);
  int (* step_)(arm *, int64_t);
  int (* get_outputs_)(arm *, double *);
  const char * (*error_text_)(int);
  std::vector<std::string> input_names_, output_names_;
  std::vector<double> memory_, inputs_, logged_inputs_, outputs_;
  std::vector<std::vector<unsigned char>> messages_;  // records, whose numbers are filled in
  arm * arm_;
  int64_t steps_ = 0;
  std::unique_ptr<Log> log_;
};

}  // namespace timo_sim_hardware
