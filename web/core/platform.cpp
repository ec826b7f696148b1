// SPDX-License-Identifier: MIT
//
// What common/ asks of a system, where that is a browser: one thread, one instruction set, no pages of memory.
#include <cstddef>
#include <functional>
#include <new>

#include "common/core/machine.h"
#include "common/core/worker_team.h"
#include "common/reconstruction/kernel.h"
#include "common/reconstruction/lines.h"

namespace eigencast {

const std::vector<InstructionSet>& instruction_sets() {
  static const std::vector<InstructionSet> sets{InstructionSet::kBaseline};
  return sets;
}

void* allocate_lines(std::size_t bytes) {
  return ::operator new (bytes, std::align_val_t{kernel::kAlignment});
}
void free_lines(void* at, std::size_t) {
  ::operator delete (at, std::align_val_t{kernel::kAlignment});
}

struct WorkerTeam::State {};
WorkerTeam::WorkerTeam(unsigned) {}
WorkerTeam::~WorkerTeam() = default;
unsigned WorkerTeam::threads() const {
  return 1;
}
void WorkerTeam::run(std::size_t count, const std::function<void(std::size_t)>& task) {
  for (std::size_t i = 0; i < count; ++i) task(i);
}

WorkerTeam& worker_team() {
  static WorkerTeam team;
  return team;
}

}  // namespace eigencast
