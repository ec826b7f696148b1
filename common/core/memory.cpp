// SPDX-License-Identifier: MIT
#include "common/core/memory.h"

#include <algorithm>
#include <fstream>
#include <limits>
#include <string>

namespace eigencast {
namespace {

constexpr double kUnknown = std::numeric_limits<double>::infinity();

double available_by_kernel() {
  std::ifstream file("/proc/meminfo");
  std::string key, unit;
  for (double kibibytes = 0; file >> key >> kibibytes; std::getline(file, unit)) {
    if (key == "MemAvailable:") return kibibytes * 1024;
  }
  return kUnknown;
}

/// A file of one number; "max" and what is not there are unknown.
double number_in(const std::string& path) {
  std::ifstream file(path);
  double value = 0;
  return file >> value ? value : kUnknown;
}

double left_in_group() {
  std::ifstream file("/proc/self/cgroup");
  double least = kUnknown;
  for (std::string line; std::getline(file, line);) {
    if (line.rfind("0::", 0) != 0) continue;
    for (std::string group = line.substr(3);; group.resize(group.find_last_of('/'))) {
      const std::string folder = "/sys/fs/cgroup" + group + "/";
      const double left = number_in(folder + "memory.max") - number_in(folder + "memory.current");
      if (left >= 0) least = std::min(least, left);
      if (group.find('/') == std::string::npos) break;
    }
  }
  return least;
}

}  // namespace

double usable_memory() {
  return std::min(available_by_kernel(), left_in_group());
}

}  // namespace eigencast
