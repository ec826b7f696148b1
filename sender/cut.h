// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "common/core/bytes.h"
#include "common/core/clock.h"
#include "common/core/hash/sha256.h"
#include "common/core/result.h"

namespace eigencast {

struct CutFacts {
  TimeUs duration_us = 0;
  std::uint64_t frames = 0, bytes = 0;
};

/// Copies a range of recordings, one after the other, into a new one, without coding anything again: it begins at the
/// last checkpoint at or before from_s (up to a second earlier), and holds the objects of all.
///   duration_s  0: to the end
///   rate_hz     about so many poses a second stay, and are coded again, each behind the one before and as coarsely as
///               its sender did; 0: all, as they are coded
///   missing     gives objects of surfaces that the recordings do not hold; null: they stay out
/// The file gets its name when it is whole. Errors: those of recording::Reader and Writer; kInvalidArgument (the range
/// holds no pose, or `to` is there already).
Result<CutFacts> cut_recordings(const std::vector<std::string>& files, double from_s, double duration_s, double rate_hz,
                                const std::string& to, const std::function<Result<Bytes>(const Sha256&)>& missing = {});

}  // namespace eigencast
