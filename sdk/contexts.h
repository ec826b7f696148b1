// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <vector>

#include "common/core/result.h"
#include "common/net/url.h"

namespace eigencast {

/// A broker under a name, so that its URL, token and authorities need not be typed.
struct Context {
  std::string name;
  std::string url;  ///< http://host[:port], or of one stream.
  Credentials credentials = {};
};

/// The named contexts of a user, in a file that only they can read. Not thread-safe.
class Contexts {
 public:
  /// $XDG_CONFIG_HOME/eigencast/contexts.json, by default ~/.config/...; empty where neither is known.
  static std::string default_path();
  /// No such file: no contexts. Errors: kIo, kCorrupt (naming the file), kTooLarge.
  static Result<Contexts> load(const std::string& path);
  Result<void> save(const std::string& path) const;  ///< Errors: kIo.

  const std::vector<Context>& all() const { return all_; }
  const std::string& current() const { return current_; }
  const Context* find(const std::string& name) const;  ///< Empty: the current one; null: none such.

  /// Adds or replaces; the first becomes the current one. Errors: kInvalidArgument (name or URL).
  Result<void> add(Context context);
  /// Errors: kNotFound, listing those there are.
  Result<void> use(const std::string& name);
  Result<void> remove(const std::string& name);

 private:
  Error unknown(const std::string& name) const;
  std::vector<Context> all_;
  std::string current_;
};

struct Target {
  std::string url;
  Credentials credentials;
};

/// What a user means by a URL or name, credentials and a context's name, any of which may be empty:
///   a URL    unchanged; a context's credentials go only to its own host and port. Where none is named, those of any
///            context whose broker this is
///   a name   that stream at the context's broker; without a context host/stream is a URL
///   nothing  the context's URL
/// Errors: kInvalidArgument (neither a URL nor a context), kNotFound (no such context).
Result<Target> resolve_target(const std::string& to, const Credentials& given, const std::string& context,
                              const Contexts& contexts);

/// For a further stream of a program whose credentials were given for `home`'s broker: another broker gets only those
/// that the contexts hold for it; the same authorities count.
Result<Target> resolve_beside(const Target& home, const std::string& to, const Credentials& given,
                              const std::string& context, const Contexts& contexts);

}  // namespace eigencast
