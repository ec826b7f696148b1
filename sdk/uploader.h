// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "common/asset/format/encode.h"
#include "common/core/result.h"
#include "common/net/http.h"

namespace eigencast {

/// Puts the objects of an asset on a broker that lacks some of them: the manifest last, so that none there ever names a
/// chunk that is missing. HttpConnection::cancel() ends it from any thread.
class Uploader {
 public:
  using Progress = std::function<void(std::uint64_t done, std::uint64_t total)>;

  Uploader(HttpConnection& http, const EncodedAsset& encoded) : http_(http), encoded_(encoded) {}

  /// Errors: kRefused (the broker's answer; or the objects are not at hand), kCancelled, and those of HttpConnection.
  Result<void> upload(const Progress& progress);

 private:
  Result<bool> is_there(const AssetObject& object);
  Result<void> put_missing(const AssetObject& object);

  HttpConnection& http_;
  const EncodedAsset& encoded_;
};

}  // namespace eigencast
