// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "client/options.h"

namespace eigencast {

inline constexpr const char* kLocalBroker = "ws://127.0.0.1:7490";

/// Options as the command line has them.
struct RawOptions {
  std::string reconstruct = "auto", scene, resolver, quality, size = "1280x720", colour = "auto",
              colour_map = "viridis", colour_range, normals = "authored", rate, scheme, playout = "latest", context,
              film;
  Credentials credentials;
  int k = 3, bands = 8;
  double crease_deg = 40, delay_ms = 0, smooth = 1, ahead_ms = 200, fps = 60, seconds = 0;
};

/// The streams, files or scene of the words, with credentials; or the broker that is listed or has the welcome.
Result<void> find_streams(const RawOptions& raw, ClientOptions& options);
/// Options win over the URL.
Result<std::optional<Profile>> profile_from(const CommandLine& line, const std::string& url, const RawOptions& raw);
std::size_t files_in(const std::vector<std::string>& streams);
/// Fails for an option that would do nothing where it stands.
Result<void> check_uses(const CommandLine& line, const RawOptions& raw, const ClientOptions& options);

}  // namespace eigencast
