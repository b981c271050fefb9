// Copyright 2026 The timo_sim authors
// SPDX-License-Identifier: Apache-2.0

#include "log.hpp"


#include <cerrno>
#include <chrono>
#include <cstring>
#include <stdexcept>

namespace timo_sim_hardware
{

namespace
{

constexpr size_t MOST_WAITING = 64 << 20;  // [bytes], minutes of a log in real time
constexpr std::chrono::milliseconds PERIOD(50);  // of writing; a crash loses as much

}  // namespace

Log::Log(const std::string & path)
: path_(path)
{
  const size_t dot = path.rfind(".mcap") == path.npos ? path.size() : path.rfind(".mcap");
  for (int number = 1; !(file_ = std::fopen(path_.c_str(), "wbx")) && errno == EEXIST; ++number) {
    path_ = path.substr(0, dot) + "_" + std::to_string(number) + path.substr(dot);
  }
  if (!file_) {
    throw std::runtime_error("record_file " + path + ": " + std::strerror(errno));
  }
  thread_ = std::thread([this] {run();});
}

void Log::put(const void * data, size_t size)
{
  const std::lock_guard<std::mutex> lock(mutex_);
  if (error_.empty() && waiting_.size() + size > MOST_WAITING) {
    fail("the disk is too slow");
  }
  if (error_.empty()) {
    const auto begin = static_cast<const unsigned char *>(data);
    waiting_.insert(waiting_.end(), begin, begin + size);
  }
}

void Log::close()
{
  if (thread_.joinable()) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      closing_ = true;
    }
    closed_.notify_one();
    thread_.join();
  }
}

std::string Log::error() const
{
  const std::lock_guard<std::mutex> lock(mutex_);
  return error_;
}

void Log::fail(const std::string & reason)
{
  error_ = "log " + path_ + " ends early: " + reason;
  waiting_.clear();
}

void Log::run()
{
  std::vector<unsigned char> taken;
  for (bool last = false; !last; ) {
    {
      std::unique_lock<std::mutex> lock(mutex_);
      last = closed_.wait_for(lock, PERIOD, [this] {return closing_;});
      taken.swap(waiting_);
    }
    const bool written = taken.empty() || (
      std::fwrite(taken.data(), 1, taken.size(), file_) == taken.size() &&
      std::fflush(file_) == 0);
    const int code = errno;
    taken.clear();
    if (!written) {
      const std::lock_guard<std::mutex> lock(mutex_);
      fail(std::strerror(code));
      break;
    }
  }
  std::fclose(file_);
}

}  // namespace timo_sim_hardware
