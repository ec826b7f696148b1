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

struct Wanted {
  enum class Kind { kNothing, kStream, kClip, kScene };
  Kind kind = Kind::kNothing;
  std::string what;  ///< A stream's URL, a clip's "file:INPUT", a scene's path.
};
/// Reads a typed, pasted or dropped text, without spaces and quotes around it: URLs of any scheme but file are streams,
/// files that end in .json scenes, other paths, globs and built-in shapes clips.
Wanted wanted_from(const std::string& text);

/// A word of the command line: as wanted_from(), but what is no path that exists, and has no *, names a stream.
Wanted wanted_from_word(const std::string& word);

/// For a stream that is opened later: those of the command line for the same broker (scheme, host and port), one for
/// each of `streams`. A token in the URL replaces theirs.
Credentials credentials_for(const std::string& stream, std::span<const std::string> streams,
                            std::span<const Credentials> credentials);

/// Opens a stream of a broker, or a clip. Null credentials: those of credentials_for(), then those of the contexts.
/// in_background: the source bakes the clip, else this call; `stop` ends it. Errors: as subscribe_to, BakedClip::open.
using OpenSource = std::function<Result<std::unique_ptr<PoseSource>>(const std::string& stream)>;
Result<std::unique_ptr<PoseSource>> open_source(const std::string& stream, const Credentials* credentials,
                                                const ClientOptions& options, bool in_background,
                                                const std::atomic<bool>& stop, const LogSink& log);

}  // namespace eigencast
