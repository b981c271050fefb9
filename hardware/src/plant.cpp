// Copyright 2026 The timo_sim authors
// SPDX-License-Identifier: Apache-2.0

#include "plant.hpp"

#include <dlfcn.h>

#include <cmath>
#include <cstring>
#include <stdexcept>

namespace timo_sim_hardware
{

namespace
{

// A record of MCAP: opcode and length; of a message then channel, sequence, log and publish time.
constexpr size_t HEAD = 31;

template<typename Number>
void write(unsigned char * place, Number number)  // of a little-endian processor, as CDR and MCAP
{
  std::memcpy(place, &number, sizeof number);
}

}  // namespace

Plant::Plant(const std::string & library)
: path_(library)
{
  // dlopen would search for a name without a slash elsewhere.
  library_ = dlopen((library.find('/') == library.npos ? "./" + library : library).c_str(),
      RTLD_NOW | RTLD_LOCAL);
  if (!library_) {
    throw std::runtime_error(
            "scene_library must be a shared object that `timo_sim urdf --ros2-control` has "
            "written: " + std::string(dlerror()));
  }
  try {
    scene_ = function<const Scene *>("arm_scene");
    reset_ = function<int (*)(arm *)>("arm_reset");
    set_input_ = function<int (*)(arm *, int, double)>("arm_set_input");
    step_ = function<int (*)(arm *, int64_t)>("arm_step");
    get_outputs_ = function<int (*)(arm *, double *)>("arm_get_outputs");
    error_text_ = function<const char * (*)(int)>("arm_error_text");
    input_names_ = names("arm_input_name");
    output_names_ = names("arm_output_name");
    const size_t size = function<size_t (*)()>("arm_size")();
    memory_.resize((size + 7) / 8);
    arm_ = reinterpret_cast<arm *>(memory_.data());
    check(function<int (*)(void *, size_t)>("arm_create")(arm_, size));
  } catch (...) {
    dlclose(library_);
    throw;
  }
  inputs_.resize(input_names_.size());
  outputs_.resize(output_names_.size());
  for (int k = 0; k < scene_->count; ++k) {
    const Message & each = scene_->messages[k];
    std::vector<unsigned char> record(HEAD + each.size);
    record[0] = 5;
    write<uint64_t>(&record[1], record.size() - 9);
    write<uint16_t>(&record[9], each.channel);
    std::memcpy(&record[HEAD], each.data, each.size);
    messages_.push_back(record);
  }
  start("");
}

Plant::~Plant()
{
  log_.reset();
  dlclose(library_);
}

template<typename Function>
Function Plant::function(const char * name) const
{
  void * found = dlsym(library_, name);
  if (!found) {
    throw std::runtime_error(
            "scene_library must be a shared object that `timo_sim urdf --ros2-control` of this "
            "version has written, but " + path_ + " has no " + name);
  }
  return reinterpret_cast<Function>(found);
}

std::vector<std::string> Plant::names(const char * function_name) const
{
  const auto name = function<const char * (*)(int)>(function_name);
  std::vector<std::string> found;
  while (std::strcmp(name(found.size()), "unknown")) {
    found.push_back(name(found.size()));
  }
  return found;
}

int Plant::find(
  const std::vector<std::string> & names, const std::string & name, const char * kind) const
{
  std::string known;
  for (size_t k = 0; k < names.size(); ++k) {
    if (names[k] == name) {
      return k;
    }
    known += (k ? ", " : "") + names[k];
  }
  throw std::runtime_error(
          std::string(kind) + " must be one of the scene's, " + known + "; got '" + name + "'");
}

int Plant::input(const std::string & name) const
{
  return find(input_names_, name, "input");
}

Plant::Reading Plant::reading(const std::string & text) const
{
  for (const auto kind : {Reading::SIN_HALF, Reading::COS_HALF}) {
    const std::string begin = kind == Reading::SIN_HALF ? "sin_half(" : "cos_half(";
    if (text.compare(0, begin.size(), begin) == 0 && text.back() == ')') {
      const auto name = text.substr(begin.size(), text.size() - begin.size() - 1);
      return {find(output_names_, name, "output"), kind};
    }
  }
  return {find(output_names_, text, "output"), Reading::VALUE};
}

void Plant::start(const std::string & log_path)
{
  if (log_) {
    log_->close();
    log_error_ = log_->error();
    log_.reset();
  }
  check(reset_(arm_));
  steps_ = 0;
  inputs_.assign(inputs_.size(), 0.0);
  logged_inputs_ = inputs_;
  check(get_outputs_(arm_, outputs_.data()));
  if (!log_path.empty()) {
    log_ = std::make_unique<Log>(log_path);
    log_error_.clear();
    log_->put(scene_->head, scene_->head_size);
    log(false);
  }
}

void Plant::set(int input, double value)
{
  check(set_input_(arm_, input, value));
  inputs_[input] = value;
}

void Plant::step(int64_t count)
{
  log(true);
  check(step_(arm_, count));
  steps_ += count;
  check(get_outputs_(arm_, outputs_.data()));
  log(false);
}

double Plant::get(Reading reading) const
{
  const double value = outputs_[reading.output];
  return reading.kind == Reading::SIN_HALF ? std::sin(0.5 * value) :
         reading.kind == Reading::COS_HALF ? std::cos(0.5 * value) : value;
}

void Plant::check(int code) const
{
  if (code) {
    throw std::runtime_error(error_text_(code));
  }
}

void Plant::note_offset(int64_t nanoseconds)
{
  const std::string name = "timo_sim.clock", key = "offset_ns";
  const std::string value = std::to_string(nanoseconds);
  std::vector<unsigned char> content;
  const auto add_size = [&content](size_t size) {
      content.resize(content.size() + 4);
      write<uint32_t>(&content[content.size() - 4], size);
    };
  const auto add = [&](const std::string & text) {
      add_size(text.size());
      content.insert(content.end(), text.begin(), text.end());
    };
  add(name);
  add_size(8 + key.size() + value.size());
  add(key);
  add(value);
  unsigned char head[9] = {12};  // a record Metadata of MCAP
  write<uint64_t>(head + 1, content.size());
  content.insert(content.begin(), head, head + 9);
  if (log_) {
    log_->put(content.data(), content.size());
  }
}

void Plant::log(bool commanded)
{
  if (!log_ || (commanded && inputs_ == logged_inputs_)) {
    return;
  }
  const uint64_t time = std::llround(1e9 * scene_->step * steps_);
  const auto & values = commanded ? inputs_ : outputs_;
  for (int k = 0; k < scene_->count; ++k) {
    const Message & each = scene_->messages[k];
    if (each.commanded != commanded) {
      continue;
    }
    bool changed = !commanded;
    unsigned char * const record = messages_[k].data(), * const data = record + HEAD;
    for (int n = 0; n < each.count; ++n) {
      const int number = each.fields[n].number;
      changed = changed || inputs_[number] != logged_inputs_[number];
      write(data + each.fields[n].place, values[number]);
    }
    if (changed) {
      write<uint32_t>(record + 11, steps_);
      write<uint64_t>(record + 15, time);
      write<uint64_t>(record + 23, time);
      if (each.stamp >= 0) {
        write<int32_t>(data + each.stamp, time / 1000000000);
        write<uint32_t>(data + each.stamp + 4, time % 1000000000);
      }
      log_->put(record, messages_[k].size());
    }
  }
  if (commanded) {
    logged_inputs_ = inputs_;
  }
}

}  // namespace timo_sim_hardware
