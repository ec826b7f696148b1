// SPDX-License-Identifier: MIT
#include "sender/source.h"

#include <algorithm>
#include <filesystem>

#include "common/surface/read.h"
#include "common/surface/shapes.h"

namespace eigencast {
namespace {

bool is_builtin(const std::string& input) {
  const std::vector<std::string> names = builtin_names();
  std::error_code ignored;
  return std::find(names.begin(), names.end(), input) != names.end() && !std::filesystem::exists(input, ignored);
}

std::string joined(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
  return text;
}

}  // namespace

Result<std::unique_ptr<MotionClip>> open_source(const SourceOptions& options) {
  if (is_builtin(options.input)) return builtin_clip(options.input);
  auto clip = open_clip(options.input, options.rest, options.faces);
  if (!clip && clip.error().code == ErrorCode::kNotFound && options.input.find('/') == std::string::npos) {
    return fail(ErrorCode::kNotFound, clip.error().message + "; the built-in shapes are " + joined(builtin_names()));
  }
  return clip;
}

Result<Source> bake_source(const SourceOptions& options, const BakeProgress& progress) {
  auto clip = open_source(options);
  if (!clip) return clip.error();
  const BakeOptions bake_options{options.basis, options.rank, options.name.empty() ? (*clip)->name() : options.name};
  auto baked = bake((*clip)->rest(), bake_options, options.cache_dir, progress);
  if (!baked) return in_context(options.input, baked.error());
  return Source{std::move(*clip), std::move(*baked)};
}

}  // namespace eigencast
