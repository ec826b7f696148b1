// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "client/options.h"
#include "view/pose_source.h"

namespace eigencast {

/// What a user who types, pastes or drops a text means by it.
struct Wanted {
  enum class Kind { kNothing, kStream, kClip, kScene };
  Kind kind = Kind::kNothing;
  std::string what;  ///< A stream's URL, a clip's "file:INPUT", a scene's path.
};
/// URLs of any scheme but file are streams, of which ws, wss, http and https can be opened; files that end in .json
/// scenes; other paths, globs and the names of built-in shapes clips. Spaces and quotes around it are dropped.
Wanted wanted_from(const std::string& text);

/// Whom to say one is to the broker of a stream that is opened later: what was said to that broker (scheme, host and
/// port) before, and to no other; a token in the URL itself stands before it. streams, credentials: of the command
/// line, one each.
Credentials credentials_for(const std::string& stream, std::span<const std::string> streams,
                            std::span<const Credentials> credentials);

/// Opens a stream of a broker, or a clip (see clip_source.h): null credentials are those of credentials_for(), then
/// those of the contexts. in_background: a clip is baked while its source says how far it is; else this returns when it
/// is baked. `stop`: when set, baking ends. Errors: as subscribe_to and BakedClip::open.
using OpenSource = std::function<Result<std::unique_ptr<PoseSource>>(const std::string& stream)>;
Result<std::unique_ptr<PoseSource>> open_source(const std::string& stream, const Credentials* credentials,
                                                const ClientOptions& options, bool in_background,
                                                const std::atomic<bool>& stop, const LogSink& log);

}  // namespace eigencast
