// SPDX-License-Identifier: MIT
#include "sdk/uploader.h"

#include <algorithm>
#include <iterator>

namespace eigencast {
namespace {

std::string target_of(const AssetObject& object) {
  return "/v1/assets/" + object.id.hex();
}

Error unexpected(const std::string& doing, const HttpResponse& answer) {
  const std::string said(answer.body.begin(),
                         answer.body.begin() + std::min<std::ptrdiff_t>(std::ssize(answer.body), 300));
  return fail(ErrorCode::kRefused,
              doing + ": the broker answered " + std::to_string(answer.status) + (said.empty() ? "" : ", " + said));
}

}  // namespace

Result<void> Uploader::upload(const Progress& progress) {
  const auto there = is_there(encoded_.manifest);
  if (!there) return there.error();
  if (*there) return {};
  if (encoded_.manifest.bytes.empty()) {
    return fail(ErrorCode::kRefused, "the broker does not have asset " + encoded_.manifest.id.hex() +
                                         ", and it is not at hand here: give its objects, or put it there first");
  }
  std::uint64_t done = 0;
  const std::uint64_t total = encoded_.total_bytes();
  for (const AssetObject& chunk : encoded_.chunks) {
    progress(done, total);
    if (auto put = put_missing(chunk); !put) return put;
    done += chunk.bytes.size();
  }
  progress(done, total);
  return put_missing(encoded_.manifest);
}

Result<bool> Uploader::is_there(const AssetObject& object) {
  auto answer = http_.head(target_of(object));
  if (!answer) return answer.error();
  if (answer->status == 200) return true;
  if (answer->status == 404) return false;
  return unexpected("asking for asset " + object.id.hex(), *answer);
}

Result<void> Uploader::put_missing(const AssetObject& object) {
  const auto there = is_there(object);
  if (!there) return there.error();
  if (*there) return {};
  auto answer = http_.put(target_of(object), object.bytes);
  if (!answer) return answer.error();
  if (answer->status >= 200 && answer->status < 300) return {};
  return unexpected("uploading asset object " + object.id.hex(), *answer);
}

}  // namespace eigencast
