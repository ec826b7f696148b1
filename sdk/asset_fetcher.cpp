// SPDX-License-Identifier: MIT
#include "sdk/asset_fetcher.h"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <limits>
#include <list>
#include <mutex>
#include <thread>

#include "common/net/backoff.h"
#include "common/net/guarded_run.h"
#include "common/net/http.h"
#include "sdk/broker.h"

namespace eigencast {

namespace {

using std::chrono::milliseconds;

constexpr std::size_t kReadyObjects = 2;
constexpr milliseconds kFirstRetry{300};
constexpr milliseconds kLongestRetry{5000};

}  // namespace

class AssetFetcher::Worker {
 public:
  explicit Worker(const BrokerUrl& url) : url_(url) {
    thread_ = std::thread([this] { guarded_run([this] { run(); }, [this](const std::string& what) { rest(what); }); });
  }

  /// REQUIRES: no fetchers.
  ~Worker() {
    std::unique_lock lock(mutex_);
    stopping_ = true;
    lock.unlock();
    changed_.notify_all();
    thread_.join();
  }

 private:
  friend AssetFetcher;

  /// REQUIRES: mutex_ is held.
  void cancel(AssetFetcher& fetcher) {
    ++fetcher.order_;
    if (current_ == &fetcher && http_) std::exchange(http_, nullptr)->cancel();
  }

  void run() {
    std::unique_lock lock(mutex_);
    while (!stopping_) {
      current_ = next();
      if (current_ == nullptr) {
        wait(lock);
        continue;
      }
      if (!http_) http_ = std::make_shared<HttpConnection>(url_);
      const bool has_news = serve(*current_, lock, http_);
      if (has_news) {
        lock.unlock();
        current_->wake_();
        lock.lock();
      }
      current_ = nullptr;
      changed_.notify_all();
    }
  }

  /// The one whose turn it is, which goes to the end of the queue.
  AssetFetcher* next() {
    const TimeUs now = steady_now_us();
    const auto at = std::find_if(fetchers_.begin(), fetchers_.end(), [&](const AssetFetcher* fetcher) {
      return fetcher->is_waiting() && fetcher->next_try_us_ <= now;
    });
    if (at == fetchers_.end()) return nullptr;
    fetchers_.splice(fetchers_.end(), fetchers_, at);
    return fetchers_.back();
  }

  void wait(std::unique_lock<std::mutex>& lock) {
    TimeUs until = std::numeric_limits<TimeUs>::max();
    for (const AssetFetcher* fetcher : fetchers_) {
      if (fetcher->is_waiting()) until = std::min(until, fetcher->next_try_us_);
    }
    const TimeUs now = steady_now_us();
    if (until == std::numeric_limits<TimeUs>::max()) return changed_.wait(lock);
    if (until > now) changed_.wait_for(lock, std::chrono::microseconds(until - now));
  }

  /// Tries to get the first object that the fetcher wants, unlocked meanwhile. True: take() or stats() has news.
  bool serve(AssetFetcher& fetcher, std::unique_lock<std::mutex>& lock, std::shared_ptr<HttpConnection> http) {
    const std::uint64_t order = fetcher.order_;
    const Object object = fetcher.wanted_.front();
    lock.unlock();
    if (std::exchange(fetcher.body_order_, order) != order) fetcher.body_.clear();
    const std::size_t before = fetcher.body_.size();
    std::optional<Bytes> bytes = fetcher.cache_.load(object.id);
    const std::uint64_t cached = bytes ? bytes->size() : 0;
    const Result<void> got = bytes ? Result<void>() : download(fetcher, object, *http);
    if (!bytes && got) {
      bytes = std::exchange(fetcher.body_, {});
      if (auto stored = fetcher.cache_.store(object.id, *bytes); !stored)
        log(fetcher.log_, LogLevel::kWarning, "not kept in the cache: " + stored.error().message);
    }
    lock.lock();
    if (order != fetcher.order_) return false;
    if (bytes) {
      fetcher.stats_.cached_bytes += cached;
      fetcher.stats_.trouble.clear();
      fetcher.failures_ = 0;
      fetcher.wanted_.pop_front();
      fetcher.ready_.push_back(std::move(*bytes));
      return true;
    }
    // Progress: what was wrong was the connection, not the object.
    fetcher.failures_ = fetcher.body_.size() > before ? 1 : fetcher.failures_ + 1;
    const milliseconds wait = retry_delay(fetcher.failures_, kFirstRetry, kLongestRetry, 0.5);
    fetcher.next_try_us_ = steady_now_us() + TimeUs{wait.count()} * 1000;
    fetcher.stats_.trouble = got.error().message + try_again_in(wait);
    const std::string text = fetcher.stats_.trouble;
    lock.unlock();
    log(fetcher.log_, LogLevel::kWarning, text);
    lock.lock();
    return true;
  }

  Result<void> download(AssetFetcher& fetcher, const Object& object, HttpConnection& http) {
    std::uint64_t counted = fetcher.body_.size();
    const std::string name = "asset object " + object.id.hex().substr(0, 12);
    auto answer =
        http.get_rest("/v1/assets/" + object.id.hex(), object.max_bytes, fetcher.body_, [&](std::uint64_t size) {
          const std::lock_guard lock(mutex_);
          fetcher.stats_.downloaded_bytes += size > counted ? size - counted : size;
          counted = size;
        });
    if (!answer) return in_context(name, answer.error());
    if (answer->status != 200 && answer->status != 206) {
      fetcher.body_.clear();
      return fail(answer->status == 404 ? ErrorCode::kNotFound : ErrorCode::kRefused,
                  name + ": the broker answered " + std::to_string(answer->status));
    }
    if (sha256(fetcher.body_) != object.id) {
      fetcher.body_.clear();
      return fail(ErrorCode::kCorrupt, name + " does not have the hash it is named by");
    }
    return {};
  }

  void rest(const std::string& what) {
    const std::lock_guard lock(mutex_);
    if (current_ != nullptr) {
      current_->stats_.trouble = what + try_again_in(kLongestRetry);
      current_->next_try_us_ = steady_now_us() + TimeUs{kLongestRetry.count()} * 1000;
      current_ = nullptr;
    }
    changed_.notify_all();
  }

  const BrokerUrl url_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  // GUARDED_BY(mutex_):
  std::list<AssetFetcher*> fetchers_;  ///< Those whose turn comes first are first.
  AssetFetcher* current_ = nullptr;    ///< Is being served.
  std::shared_ptr<HttpConnection> http_;
  bool stopping_ = false;

  std::thread thread_;
};

AssetFetcher::AssetFetcher(std::string cache_dir, std::function<void()> wake, LogSink log)
    : cache_(std::move(cache_dir)), wake_(std::move(wake)), log_(std::move(log)) {}

void AssetFetcher::use(const BrokerUrl& broker) {
  static SharedByBroker<Worker> workers;
  auto worker = workers.get(broker, [](Worker&) { return true; });
  if (worker == worker_) return;
  const std::uint64_t order = order_;
  detach();
  worker_ = std::move(worker);
  const std::lock_guard lock(worker_->mutex_);
  order_ = order;  // What has come of an object is kept.
  failures_ = 0;
  next_try_us_ = 0;
  worker_->fetchers_.push_back(this);
  worker_->changed_.notify_all();
}

/// Afterwards no thread of a worker uses this.
void AssetFetcher::detach() {
  if (!worker_) return;
  std::unique_lock lock(worker_->mutex_);
  worker_->fetchers_.remove(this);
  worker_->cancel(*this);
  worker_->changed_.wait(lock, [&] { return worker_->current_ != this; });
}

bool AssetFetcher::is_waiting() const {
  return !wanted_.empty() && ready_.size() < kReadyObjects;
}

void AssetFetcher::ask(std::vector<Object> objects) {
  const std::lock_guard lock(worker_->mutex_);
  wanted_.assign(objects.begin(), objects.end());
  ready_.clear();
  stats_.trouble.clear();
  failures_ = 0;
  next_try_us_ = 0;
  worker_->cancel(*this);
  worker_->changed_.notify_all();
}

std::optional<Bytes> AssetFetcher::take() {
  if (!worker_) return std::nullopt;
  const std::lock_guard lock(worker_->mutex_);
  if (ready_.empty()) return std::nullopt;
  Bytes bytes = std::move(ready_.front());
  ready_.pop_front();
  worker_->changed_.notify_all();
  return bytes;
}

AssetFetcher::Stats AssetFetcher::stats() const {
  if (!worker_) return {};
  const std::lock_guard lock(worker_->mutex_);
  return stats_;
}

}  // namespace eigencast
