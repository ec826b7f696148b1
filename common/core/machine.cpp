// SPDX-License-Identifier: MIT
#include "common/core/machine.h"

#include <algorithm>
#include <fstream>
#include <limits>
#include <string>

namespace eigencast {
namespace {

std::vector<InstructionSet> find_instruction_sets() {
  std::vector<InstructionSet> sets{InstructionSet::kBaseline};
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) sets.push_back(InstructionSet::kAvx2);
  if (sets.back() == InstructionSet::kAvx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl")) {
    sets.push_back(InstructionSet::kAvx512);
  }
  if (sets.back() == InstructionSet::kAvx512 && __builtin_cpu_supports("avx512vnni")) {
    sets.push_back(InstructionSet::kAvx512Vnni);
  }
#endif
  return sets;
}

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

const std::vector<InstructionSet>& instruction_sets() {
  static const std::vector<InstructionSet> sets = find_instruction_sets();
  return sets;
}

const char* name_of(InstructionSet set) {
  constexpr const char* kNames[] = {"baseline", "AVX2", "AVX-512", "AVX-512 VNNI"};
  return kNames[static_cast<int>(set)];
}

double usable_memory() {
  return std::min(available_by_kernel(), left_in_group());
}

}  // namespace eigencast
