// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "sdk/publisher.h"
#include "sender/commands.h"
#include "sender/deform/projected.h"

namespace eigencast {

/// Whether there is a display for deform_by_hand(). Errors: kUnsupported.
Result<void> find_display();

/// deform without a script: a window, until it is closed or the duration is over. Gives the report as JSON. Errors:
/// kUnsupported (no display, or a build without windows).
Result<std::string> deform_by_hand(const DeformCommand& command, deform::Deformer& deformer,
                                   deform::ProjectedDeformer& projected, const Asset& asset, Publisher& publisher,
                                   Interrupt& interrupt);

}  // namespace eigencast
