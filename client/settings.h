// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "client/level_control.h"
#include "common/core/result.h"
#include "common/motion/playout.h"
#include "view/style.h"

namespace eigencast {

/// What the window remembers.
struct Settings {
  static constexpr std::size_t kMaxRecent = 6;

  int width = 1280, height = 720;
  bool hud = true, panel = false;
  Style style;  ///< Without colouring and range, which belong to a stream.
  std::optional<ResolverKind> resolver;
  std::optional<PlayoutMode> playout;
  std::optional<double> smoothness;  ///< 0..1; nothing: the mode's default.
  std::vector<std::string> recent;   ///< Opened streams and files, newest first, without secrets.

  void opened(const std::string& what);

  /// $XDG_CONFIG_HOME/eigencast/viewer.json; empty if there is no such folder.
  static std::string default_path();
  /// Defaults for what is missing or invalid: another version may have written it. Errors: kIo, kCorrupt (no object).
  static Result<Settings> load(const std::string& path);
  /// Errors: kIo.
  Result<void> save(const std::string& path) const;
};

}  // namespace eigencast
