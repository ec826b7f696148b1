// SPDX-License-Identifier: MIT
#pragma once

namespace eigencast {

/// Bytes that this process can still take without making the machine swap: what the kernel says is available, and no
/// more than its control group has left. Infinity where nothing says.
double usable_memory();

}  // namespace eigencast
