// SPDX-License-Identifier: MIT
#include "sender/by_hand.h"

namespace eigencast {

Result<std::string> deform_by_hand(const DeformCommand&, deform::Deformer&, deform::ProjectedDeformer&, const Asset&,
                                   Publisher&, Interrupt&) {
  return fail(ErrorCode::kUnsupported, "this build has no window to deform in; --script deforms without one");
}

}  // namespace eigencast
