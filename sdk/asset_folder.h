// SPDX-License-Identifier: MIT
#pragma once

#include <functional>
#include <string>

#include "common/asset/asset.h"
#include "common/asset/format/encode.h"
#include "common/core/bytes.h"
#include "common/core/hash/sha256.h"
#include "common/core/result.h"

/// A baked asset as files, each object in one that is named by its hash.
namespace eigencast {

/// Writes the objects, the manifest last, and beside it the asset's coding error, if it has one (ID.coding: a number as
/// text); the folder is made. Errors: kIo.
Result<void> write_asset(const EncodedAsset& encoded, double coding_error, const std::string& folder);

/// Not verified. Errors: kNotFound, kIo, kTooLarge.
Result<Bytes> read_object(const std::string& folder, const Sha256& id);

struct WholeAsset {
  Asset asset;
  EncodedAsset encoded;
};
/// Every object verified; a coding error that is not one is left out. Errors: those of read_object; kCorrupt,
/// kTooLarge, kIncompatibleVersion, kUnsupported.
Result<WholeAsset> read_asset(const std::string& folder, const Sha256& id);
/// Assembles the asset from objects that lie elsewhere. Errors: as read_asset, with those of `object_of`.
Result<WholeAsset> assemble_asset(const Sha256& id, const std::function<Result<Bytes>(const Sha256& id)>& object_of);

}  // namespace eigencast
