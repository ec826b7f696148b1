// SPDX-License-Identifier: MIT
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "client/level_control.h"
#include "common/core/result.h"
#include "common/motion/playout.h"
#include "view/style.h"

namespace eigencast {

/// What the window remembers from one time to the next.
struct Settings {
  static constexpr std::size_t kMaxRecent = 6;

  int width = 1280, height = 720;
  bool hud = true, panel = false;
  Style style;  ///< But for colouring and range, which belong to a stream.
  std::optional<ResolverKind> resolver;
  std::optional<PlayoutMode> playout;
  std::optional<double> smoothness;  ///< 0..1, of that mode; nothing: its default.
  std::vector<std::string> recent;   ///< What was opened, newest first; nothing secret.

  /// Puts it first.
  void opened(const std::string& what);

  /// $XDG_CONFIG_HOME/eigencast/viewer.json; empty where no such folder is known.
  static std::string default_path();
  /// Members that are missing, or make no sense, are as at first: a newer or an older version may have written them.
  /// Errors: kIo, kCorrupt (no JSON object); no such file is none.
  static Result<Settings> load(const std::string& path);
  /// Errors: kIo.
  Result<void> save(const std::string& path) const;
};

}  // namespace eigencast
