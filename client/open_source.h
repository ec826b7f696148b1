// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <span>
#include <string>

#include "client/options.h"
#include "view/pose_source.h"

namespace eigencast {

/// What a typed, pasted or dropped text means.
struct Wanted {
  enum class Kind { kNothing, kStream, kClip, kScene };
  Kind kind = Kind::kNothing;
  std::string what;  ///< A stream's URL, a clip's "file:INPUT", a scene's path.
};
/// URLs of any scheme but file are streams (of which ws, wss, http and https can be opened), files that end in .json
/// are scenes, other paths, globs and names of built-in shapes are clips. Drops spaces and quotes around the text.
Wanted wanted_from(const std::string& text);

/// The credentials for a stream that is opened later: those that the command line gave for the same broker (scheme,
/// host and port). A token in the URL replaces theirs. streams, credentials: of the command line, one each.
Credentials credentials_for(const std::string& stream, std::span<const std::string> streams,
                            std::span<const Credentials> credentials);

/// Opens a stream of a broker, or a clip (see clip_source.h). Null credentials: those of credentials_for(), then those
/// of the contexts. in_background: the source bakes a clip and reports progress; else the call does. `stop` ends
/// baking. Errors: as subscribe_to and BakedClip::open.
using OpenSource = std::function<Result<std::unique_ptr<PoseSource>>(const std::string& stream)>;
Result<std::unique_ptr<PoseSource>> open_source(const std::string& stream, const Credentials* credentials,
                                                const ClientOptions& options, bool in_background,
                                                const std::atomic<bool>& stop, const LogSink& log);

}  // namespace eigencast
