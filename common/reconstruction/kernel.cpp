// SPDX-License-Identifier: MIT
#include "common/reconstruction/kernel.h"

namespace eigencast::kernel {

extern const Functions baseline_functions;
#if defined(__x86_64__)
extern const Functions avx2_functions;
extern const Functions avx512_functions;
extern const Functions avx512vnni_functions;
#endif

const Functions& functions(InstructionSet set) {
#if defined(__x86_64__)
  if (set == InstructionSet::kAvx512Vnni) return avx512vnni_functions;
  if (set == InstructionSet::kAvx512) return avx512_functions;
  if (set == InstructionSet::kAvx2) return avx2_functions;
#endif
  static_cast<void>(set);
  return baseline_functions;
}

}  // namespace eigencast::kernel
