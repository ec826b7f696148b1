// SPDX-License-Identifier: MIT
#include "sender/live.h"

namespace eigencast {

Result<void> find_display() {
  return fail(ErrorCode::kUnsupported, "this build has no window to deform in; --script deforms without one");
}

Result<void> write_thumbnail(const Asset&, std::span<const double>, const std::string&) {
  return fail(ErrorCode::kUnsupported, "this build draws no pictures");
}

Result<std::string> deform_by_hand(const DeformCommand&, deform::Deformer&, deform::ProjectedDeformer&, const Asset&,
                                   Publisher&, Interrupt&) {
  return find_display().error();
}

}  // namespace eigencast
