// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "common/asset/format/encode.h"
#include "common/core/result.h"
#include "common/net/http.h"
#include "common/net/url.h"

namespace eigencast {

/// Uploads a publisher's asset, or its chunks alone where it has no manifest, to a broker each time that begin() is
/// called. Its events are called on a thread of its own, with no lock held. Thread-safe.
class AssetUploader {
 public:
  struct Events {
    std::function<void(std::uint64_t sent, std::uint64_t total)> on_progress;
    /// Not called where begin() or cancel() came first. Says after how long to try again; nothing: not before begin().
    std::function<std::optional<std::chrono::milliseconds>(const Result<void>& done)> on_done;
    /// Memory ran out, or one of the above threw: nothing happens before begin().
    std::function<void(const std::string& what)> on_exception;
  };

  AssetUploader(std::shared_ptr<const EncodedAsset> encoded, Events events);
  ~AssetUploader() { stop(); }
  AssetUploader(const AssetUploader&) = delete;
  AssetUploader& operator=(const AssetUploader&) = delete;

  void begin(const BrokerUrl& url, std::chrono::milliseconds after);
  /// Uploads another asset from the next begin() on.
  void use(std::shared_ptr<const EncodedAsset> encoded);
  void cancel();
  void stop();

 private:
  void run();

  const Events events_;

  std::mutex mutex_;
  std::condition_variable changed_;
  // GUARDED_BY(mutex_), all that follows.
  std::shared_ptr<const EncodedAsset> encoded_;
  BrokerUrl url_;
  std::optional<std::chrono::steady_clock::time_point> due_;  ///< When to upload next.
  std::uint64_t orders_ = 0;                                  ///< Calls of begin() and cancel().
  std::shared_ptr<HttpConnection> http_;                      ///< While uploading.
  bool stopping_ = false;

  std::thread thread_;
};

}  // namespace eigencast
