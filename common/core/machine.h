// SPDX-License-Identifier: MIT
#pragma once

#include <vector>

namespace eigencast {

/// What the processor can do beyond what every build asks of it; each contains those before.
enum class InstructionSet {
  kBaseline,    ///< SSE2 on x86-64, NEON on 64-bit ARM.
  kAvx2,        ///< With fused multiply-add.
  kAvx512,      ///< F, BW, DQ and VL.
  kAvx512Vnni,  ///< With VNNI: products of 16-bit integers summed in one instruction.
};

/// Those that this processor and operating system run, best last. Thread-safe.
const std::vector<InstructionSet>& instruction_sets();

const char* name_of(InstructionSet set);

/// Bytes that this process can still take without making the machine swap: what the kernel says is available, and no
/// more than its control group has left. Infinity where nothing says.
double usable_memory();

}  // namespace eigencast
