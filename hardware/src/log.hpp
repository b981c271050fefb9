// Copyright 2026 The timo_sim authors
// SPDX-License-Identifier: Apache-2.0

#pragma once

#include <condition_variable>
#include <cstdio>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

namespace timo_sim_hardware
{

// A new file that a thread writes: who adds to it never waits for the disk. If the disk takes
// nothing any more, `error` says so and what is added later is dropped.
class Log
{
public:
  // The path is numbered if it exists. Throws std::runtime_error if there can be no such file.
  explicit Log(const std::string & path);
  Log(const Log &) = delete;
  Log & operator=(const Log &) = delete;
  ~Log() {close();}

  void put(const void * data, size_t size);
  void close();  // when all that waits is written
  std::string error() const;
  std::string path() const {return path_;}

private:
  void run();
  void fail(const std::string & reason);

  std::string path_, error_;
  FILE * file_;
  mutable std::mutex mutex_;  // of what follows, and of the error
  std::condition_variable closed_;
  std::vector<unsigned char> waiting_;
  bool closing_ = false;
  std::thread thread_;
};

}  // namespace timo_sim_hardware
