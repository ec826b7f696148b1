// SPDX-License-Identifier: MIT
#include "sdk/asset_uploader.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "common/net/guarded_run.h"

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

Result<bool> is_there(HttpConnection& http, const AssetObject& object) {
  auto answer = http.head(target_of(object));
  if (!answer) return answer.error();
  if (answer->status == 200) return true;
  if (answer->status == 404) return false;
  return unexpected("asking for asset " + object.id.hex(), *answer);
}

Result<void> put_missing(HttpConnection& http, const AssetObject& object) {
  const auto there = is_there(http, object);
  if (!there) return there.error();
  if (*there) return {};
  auto answer = http.put(target_of(object), object.bytes);
  if (!answer) return answer.error();
  if (answer->status >= 200 && answer->status < 300) return {};
  return unexpected("uploading asset object " + object.id.hex(), *answer);
}

/// The manifest last, so that none there ever names a chunk that is missing. HttpConnection::cancel() ends it.
/// Errors: kRefused (the broker's answer; or the objects are not at hand), kCancelled, and those of HttpConnection.
template <typename Progress>
Result<void> upload(HttpConnection& http, const EncodedAsset& encoded, const Progress& progress) {
  const bool has_manifest = encoded.manifest.id != Sha256{};
  const auto there = has_manifest ? is_there(http, encoded.manifest) : false;
  if (!there) return there.error();
  if (*there) return {};
  if (has_manifest && encoded.manifest.bytes.empty()) {
    return fail(ErrorCode::kRefused, "the broker does not have asset " + encoded.manifest.id.hex() +
                                         ", and it is not at hand here: give its objects, or put it there first");
  }
  std::uint64_t done = 0;
  const std::uint64_t total = encoded.total_bytes();
  for (const auto* parts : {&encoded.chunks, &encoded.sections}) {
    for (const AssetObject& part : *parts) {
      progress(done, total);
      if (auto put = put_missing(http, part); !put) return put;
      done += part.bytes.size();
    }
  }
  progress(done, total);
  return has_manifest ? put_missing(http, encoded.manifest) : Result<void>();
}

}  // namespace

AssetUploader::AssetUploader(std::shared_ptr<const EncodedAsset> encoded, Events events)
    : events_(std::move(events)), encoded_(std::move(encoded)) {
  thread_ = std::thread([this] { guarded_run([this] { run(); }, events_.on_exception); });
}

void AssetUploader::begin(const BrokerUrl& url, std::chrono::milliseconds after) {
  const std::lock_guard lock(mutex_);
  url_ = url;
  due_ = std::chrono::steady_clock::now() + after;
  ++orders_;
  changed_.notify_all();
}

void AssetUploader::use(std::shared_ptr<const EncodedAsset> encoded) {
  const std::lock_guard lock(mutex_);
  encoded_ = std::move(encoded);
}

void AssetUploader::cancel() {
  const std::lock_guard lock(mutex_);
  due_.reset();
  ++orders_;
  if (http_) http_->cancel();
}

void AssetUploader::stop() {
  std::unique_lock lock(mutex_);
  stopping_ = true;
  if (http_) http_->cancel();
  lock.unlock();
  changed_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void AssetUploader::run() {
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [&] { return stopping_ || due_; });
    while (!stopping_ && due_ && *due_ > std::chrono::steady_clock::now()) {
      const auto until = *due_;
      changed_.wait_until(lock, until);
    }
    if (stopping_) return;
    if (!due_) continue;
    due_.reset();
    const std::uint64_t order = orders_;
    const auto http = http_ = std::make_shared<HttpConnection>(url_);
    const auto encoded = encoded_;
    lock.unlock();
    const auto done = upload(*http, *encoded, events_.on_progress);
    lock.lock();
    http_.reset();
    if (stopping_) return;
    if (order != orders_) continue;
    lock.unlock();
    const auto again = events_.on_done(done);
    lock.lock();
    if (again && order == orders_) due_ = std::chrono::steady_clock::now() + *again;
  }
}

}  // namespace eigencast
