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

/// The name that an asset is published under: without the path, which says more of this machine than viewers should learn.
std::string public_name(const std::string& clip_name) {
  const std::filesystem::path path(clip_name);
  const std::string stem = path.stem().string();
  // A clip's file is often called as a thousand others, and a glob says nothing: their folder tells more.
  const bool generic = stem == "vertices" || stem.find_first_of("*?[") != std::string::npos || stem.empty();
  const std::string folder = path.parent_path().filename().string();
  return generic && !folder.empty() ? folder : stem;
}

}  // namespace

Result<std::unique_ptr<MotionClip>> open_source(const SourceOptions& options) {
  // Neither a path, nor a glob, nor a file's name: a built-in shape is meant, and its error lists those that there are.
  std::error_code ignored;
  const bool is_word = options.input.find_first_of("/*?[.") == std::string::npos;
  if (is_builtin(options.input) || (is_word && !std::filesystem::exists(options.input, ignored)))
    return builtin_clip(options.input);
  return open_clip(options.input, {options.rest, options.faces, options.animation, options.sample_rate_hz});
}

Result<Source> bake_source(const SourceOptions& options, const BakeProgress& progress) {
  auto clip = open_source(options);
  if (!clip) return clip.error();
  const BakeOptions bake_options{options.basis, options.rank,
                                 options.name.empty() ? public_name((*clip)->name()) : options.name,
                                 options.asset_error};
  auto baked = bake((*clip)->rest(), bake_options, options.cache_dir, progress);
  if (!baked) return in_context(options.input, baked.error());
  return Source{std::move(*clip), std::move(*baked)};
}

}  // namespace eigencast
