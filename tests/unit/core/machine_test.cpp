// SPDX-License-Identifier: MIT
#include "common/core/machine.h"

#include <gtest/gtest.h>
#include <unistd.h>

namespace eigencast {
namespace {

TEST(UsableMemory, IsAtMostWhatTheMachineHas) {
  const double machine = static_cast<double>(sysconf(_SC_PHYS_PAGES)) * static_cast<double>(sysconf(_SC_PAGESIZE));
  EXPECT_GT(usable_memory(), 1e7);
  EXPECT_LE(usable_memory(), machine);
}

}  // namespace
}  // namespace eigencast
