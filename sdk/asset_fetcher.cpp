// SPDX-License-Identifier: MIT
#include "sdk/asset_fetcher.h"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <thread>

#include "common/net/backoff.h"
#include "common/net/guarded_run.h"
#include "common/net/http.h"
#include "sdk/asset_cache.h"
#include "sdk/broker_text.h"

namespace eigencast {

namespace {

using std::chrono::milliseconds;

constexpr std::size_t kReadyObjects = 2;
constexpr milliseconds kFirstRetry{300};
constexpr milliseconds kLongestRetry{5000};

}  // namespace

class AssetFetcher::Impl {
 public:
  Impl(BrokerUrl url, std::string cache_dir, std::function<void()> wake, LogSink log)
      : url_(std::move(url)), cache_(std::move(cache_dir)), wake_(std::move(wake)), log_(std::move(log)) {
    thread_ = std::thread([this] { guarded_run([this] { run(); }, [this](const std::string& what) { rest(what); }); });
  }

  ~Impl() {
    {
      const std::lock_guard lock(mutex_);
      stopping_ = true;
      if (http_) http_->cancel();
    }
    changed_.notify_all();
    thread_.join();
  }

  void ask(std::vector<Object> objects) {
    {
      const std::lock_guard lock(mutex_);
      ++job_;
      wanted_.assign(objects.begin(), objects.end());
      ready_.clear();
      stats_.trouble.clear();
      if (http_) http_->cancel();
    }
    changed_.notify_all();
  }

  std::optional<Bytes> take() {
    std::optional<Bytes> bytes;
    {
      const std::lock_guard lock(mutex_);
      if (ready_.empty()) return std::nullopt;
      bytes = std::move(ready_.front());
      ready_.pop_front();
    }
    changed_.notify_all();
    return bytes;
  }

  Stats stats() const {
    const std::lock_guard lock(mutex_);
    return stats_;
  }

 private:
  void run() {
    std::unique_lock lock(mutex_);
    while (true) {
      changed_.wait(lock, [&] { return stopping_ || (!wanted_.empty() && ready_.size() < kReadyObjects); });
      if (stopping_) return;
      const std::uint64_t job = job_;
      const Object object = wanted_.front();
      lock.unlock();
      std::optional<Bytes> bytes = cache_.load(object.id);
      const std::uint64_t cached = bytes ? bytes->size() : 0;
      if (!bytes) bytes = download(job, object);
      lock.lock();
      if (stopping_) return;
      if (job != job_ || !bytes) continue;
      stats_.cached_bytes += cached;
      stats_.trouble.clear();
      wanted_.pop_front();
      ready_.push_back(std::move(*bytes));
      lock.unlock();
      wake_();
      lock.lock();
    }
  }

  /// An exception ended run(): says so and waits before it may start anew.
  void rest(const std::string& what) {
    std::unique_lock lock(mutex_);
    stats_.trouble = what + try_again_in(kLongestRetry);
    const std::uint64_t job = job_;
    changed_.wait_for(lock, kLongestRetry, [&] { return stopping_ || job != job_; });
  }

  /// Tries until it has the object; nothing when the job changed.
  std::optional<Bytes> download(std::uint64_t job, const Object& object) {
    Bytes body;
    for (int failures = 0;;) {
      const std::size_t before = body.size();
      auto got = try_download(job, object, body);
      if (got) {
        if (auto stored = cache_.store(object.id, body); !stored)
          log(log_, LogLevel::kWarning, "not kept in the cache: " + stored.error().message);
        return body;
      }
      if (got.error().code == ErrorCode::kCancelled) return std::nullopt;
      failures =
          body.size() > before ? 1 : failures + 1;  // Progress: what was wrong was the connection, not the object.
      const milliseconds wait = retry_delay(failures, kFirstRetry, kLongestRetry, 0.5);
      const std::string text = got.error().message + try_again_in(wait);
      log(log_, LogLevel::kWarning, text);
      std::unique_lock lock(mutex_);
      stats_.trouble = text;
      lock.unlock();
      wake_();
      lock.lock();
      if (changed_.wait_for(lock, wait, [&] { return stopping_ || job != job_; })) return std::nullopt;
    }
  }

  Result<void> try_download(std::uint64_t job, const Object& object, Bytes& body) {
    std::shared_ptr<HttpConnection> http;
    {
      // Under the lock, so that ask() and the destructor either see the connection or are seen here.
      const std::lock_guard lock(mutex_);
      if (stopping_ || job != job_) return fail(ErrorCode::kCancelled, "no longer wanted");
      if (!http_ || http_job_ != job) {
        http_ = std::make_shared<HttpConnection>(url_);
        http_job_ = job;
      }
      http = http_;
    }
    std::uint64_t counted = body.size();
    const std::string name = "asset object " + object.id.hex().substr(0, 12);
    auto answer = http->get_rest("/v1/assets/" + object.id.hex(), object.max_bytes, body, [&](std::uint64_t size) {
      const std::lock_guard lock(mutex_);
      stats_.downloaded_bytes += size > counted ? size - counted : size;
      counted = size;
    });
    if (!answer) return in_context(name, answer.error());
    if (answer->status != 200 && answer->status != 206) {
      body.clear();
      return fail(answer->status == 404 ? ErrorCode::kNotFound : ErrorCode::kRefused,
                  name + ": the broker answered " + std::to_string(answer->status));
    }
    if (sha256(body) != object.id) {
      body.clear();
      return fail(ErrorCode::kCorrupt, name + " does not have the hash it is named by");
    }
    return {};
  }

  const BrokerUrl url_;
  const AssetCache cache_;
  const std::function<void()> wake_;
  const LogSink log_;

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  // GUARDED_BY(mutex_), all that follows.
  std::uint64_t job_ = 0;
  std::deque<Object> wanted_;
  std::deque<Bytes> ready_;  ///< At most kReadyObjects.
  std::shared_ptr<HttpConnection> http_;
  std::uint64_t http_job_ = 0;
  Stats stats_;
  bool stopping_ = false;

  std::thread thread_;
};

AssetFetcher::AssetFetcher(BrokerUrl url, std::string cache_dir, std::function<void()> wake, LogSink log)
    : impl_(std::make_unique<Impl>(std::move(url), std::move(cache_dir), std::move(wake), std::move(log))) {}
AssetFetcher::~AssetFetcher() = default;
void AssetFetcher::ask(std::vector<Object> objects) {
  impl_->ask(std::move(objects));
}
std::optional<Bytes> AssetFetcher::take() {
  return impl_->take();
}
AssetFetcher::Stats AssetFetcher::stats() const {
  return impl_->stats();
}

}  // namespace eigencast
