// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "sdk/publisher.h"
#include "sender/commands.h"
#include "sender/deform/projected.h"

namespace eigencast {

/// Errors: kUnsupported (no display, or a build without windows).
Result<void> find_display();

/// Until the window is closed or the duration is over. Gives the report as JSON. Errors: as find_display().
Result<std::string> deform_by_hand(const DeformCommand& command, deform::Deformer& deformer,
                                   deform::ProjectedDeformer& projected, const Asset& asset, Publisher& publisher,
                                   Interrupt& interrupt);

}  // namespace eigencast
