// SPDX-License-Identifier: MIT
#pragma once

#include <string>

#include "common/asset/asset.h"
#include "common/asset/format.h"
#include "common/core/hash/sha256.h"
#include "common/core/result.h"

/// A baked asset as files, to be carried to another machine: each object in a file that is named by its hash.
namespace eigencast {

/// Writes the objects, the manifest last; the folder is made. Errors: kIo.
Result<void> write_asset(const EncodedAsset& encoded, const std::string& folder);

struct AssetFromFolder {
  Asset asset;
  EncodedAsset encoded;
};
/// Reads the asset of that manifest, every object verified. Errors: kNotFound (an object, naming it), kIo, kCorrupt, kTooLarge,
/// kIncompatibleVersion, kUnsupported.
Result<AssetFromFolder> read_asset(const std::string& folder, const Sha256& id);

}  // namespace eigencast
