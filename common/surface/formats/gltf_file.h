// SPDX-License-Identifier: MIT
#pragma once

// tinygltf without the parts that decode and write images; this is the one place that includes it.
#define TINYGLTF_NO_STB_IMAGE
#define TINYGLTF_NO_STB_IMAGE_WRITE
#include <tiny_gltf.h>

#include <string>
#include <string_view>
#include <vector>

#include "common/core/result.h"

/// Private to common/surface.
namespace eigencast {

inline Error corrupt_gltf(const std::string& what) {
  return fail(ErrorCode::kCorrupt, what);
}

/// Element `index`; null where there is none.
template <typename T>
const T* element(const std::vector<T>& all, int index) {
  return index >= 0 && static_cast<std::size_t>(index) < all.size() ? &all[static_cast<std::size_t>(index)] : nullptr;
}

/// Checks a file, then lets tinygltf parse it: tinygltf trusts chunk lengths and recurses as deep as JSON nests. Images
/// are kept encoded; those in a buffer view stay there. No index in the result has been checked. Errors: kCorrupt,
/// kUnsupported (an extension that must be understood), kTooLarge.
///   folder  only files below it are read, none if it is empty
Result<tinygltf::Model> gltf_model_from_bytes(std::string_view bytes, const std::string& folder);

}  // namespace eigencast
