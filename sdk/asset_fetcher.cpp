// SPDX-License-Identifier: MIT
#include "sdk/asset_fetcher.h"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <limits>
#include <list>
#include <mutex>
#include <thread>

#include "common/core/clock.h"
#include "common/net/backoff.h"
#include "common/net/guarded_run.h"
#include "common/net/http.h"
#include "sdk/asset_cache.h"
#include "sdk/broker_text.h"
#include "sdk/shared_by_broker.h"

namespace eigencast {

namespace {

using std::chrono::milliseconds;

constexpr std::size_t kReadyObjects = 2;
constexpr milliseconds kFirstRetry{300};
constexpr milliseconds kLongestRetry{5000};

}  // namespace

struct AssetFetcher::Job {
  Job(std::string cache_dir, std::function<void()> on_news, LogSink sink)
      : cache(std::move(cache_dir)), wake(std::move(on_news)), log(std::move(sink)) {}
  bool is_waiting() const { return !wanted.empty() && ready.size() < kReadyObjects; }

  const AssetCache cache;
  const std::function<void()> wake;
  const LogSink log;

  // GUARDED_BY(Worker::mutex_), all that follows.
  std::uint64_t order = 0;  ///< Grows with each ask().
  std::deque<Object> wanted;
  std::deque<Bytes> ready;  ///< At most kReadyObjects.
  Stats stats;
  int failures = 0;
  TimeUs next_try_us = 0;

  /// Of the first object wanted. Belongs to the worker's thread.
  Bytes body;
  std::uint64_t body_order = 0;
};

class AssetFetcher::Worker {
 public:
  explicit Worker(const BrokerUrl& url) : url_(url) {
    thread_ = std::thread([this] { guarded_run([this] { run(); }, [this](const std::string& what) { rest(what); }); });
  }

  /// REQUIRES: no jobs.
  ~Worker() {
    {
      const std::lock_guard lock(mutex_);
      stopping_ = true;
    }
    changed_.notify_all();
    thread_.join();
  }

  void add(Job& job) {
    const std::lock_guard lock(mutex_);
    jobs_.push_back(&job);
  }

  void remove(Job& job) {
    std::unique_lock lock(mutex_);
    jobs_.remove(&job);
    cancel(job);
    changed_.wait(lock, [&] { return current_ != &job; });
  }

  void ask(Job& job, std::vector<Object> objects) {
    {
      const std::lock_guard lock(mutex_);
      job.wanted.assign(objects.begin(), objects.end());
      job.ready.clear();
      job.stats.trouble.clear();
      job.failures = 0;
      job.next_try_us = 0;
      cancel(job);
    }
    changed_.notify_all();
  }

  std::optional<Bytes> take(Job& job) {
    std::optional<Bytes> bytes;
    {
      const std::lock_guard lock(mutex_);
      if (job.ready.empty()) return std::nullopt;
      bytes = std::move(job.ready.front());
      job.ready.pop_front();
    }
    changed_.notify_all();
    return bytes;
  }

  Stats stats(const Job& job) const {
    const std::lock_guard lock(mutex_);
    return job.stats;
  }

 private:
  /// REQUIRES: mutex_ is held.
  void cancel(Job& job) {
    ++job.order;
    if (current_ == &job && http_) std::exchange(http_, nullptr)->cancel();
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
        current_->wake();
        lock.lock();
      }
      current_ = nullptr;
      changed_.notify_all();
    }
  }

  /// The job whose turn it is, which goes to the end of the queue.
  Job* next() {
    const TimeUs now = steady_now_us();
    const auto at = std::find_if(jobs_.begin(), jobs_.end(),
                                 [&](const Job* job) { return job->is_waiting() && job->next_try_us <= now; });
    if (at == jobs_.end()) return nullptr;
    jobs_.splice(jobs_.end(), jobs_, at);
    return jobs_.back();
  }

  void wait(std::unique_lock<std::mutex>& lock) {
    TimeUs until = std::numeric_limits<TimeUs>::max();
    for (const Job* job : jobs_) {
      if (job->is_waiting()) until = std::min(until, job->next_try_us);
    }
    const TimeUs now = steady_now_us();
    if (until == std::numeric_limits<TimeUs>::max()) return changed_.wait(lock);
    if (until > now) changed_.wait_for(lock, std::chrono::microseconds(until - now));
  }

  /// Tries to get the first object that the job wants; releases the lock meanwhile. True: take() or stats() has news.
  bool serve(Job& job, std::unique_lock<std::mutex>& lock, std::shared_ptr<HttpConnection> http) {
    const std::uint64_t order = job.order;
    const Object object = job.wanted.front();
    lock.unlock();
    if (std::exchange(job.body_order, order) != order) job.body.clear();
    const std::size_t before = job.body.size();
    std::optional<Bytes> bytes = job.cache.load(object.id);
    const std::uint64_t cached = bytes ? bytes->size() : 0;
    const Result<void> got = bytes ? Result<void>() : download(job, object, *http);
    if (!bytes && got) {
      bytes = std::exchange(job.body, {});
      if (auto stored = job.cache.store(object.id, *bytes); !stored)
        log(job.log, LogLevel::kWarning, "not kept in the cache: " + stored.error().message);
    }
    lock.lock();
    if (order != job.order) return false;
    if (bytes) {
      job.stats.cached_bytes += cached;
      job.stats.trouble.clear();
      job.failures = 0;
      job.wanted.pop_front();
      job.ready.push_back(std::move(*bytes));
      return true;
    }
    // Progress: what was wrong was the connection, not the object.
    job.failures = job.body.size() > before ? 1 : job.failures + 1;
    const milliseconds wait = retry_delay(job.failures, kFirstRetry, kLongestRetry, 0.5);
    job.next_try_us = steady_now_us() + TimeUs{wait.count()} * 1000;
    job.stats.trouble = got.error().message + try_again_in(wait);
    const std::string text = job.stats.trouble;
    lock.unlock();
    log(job.log, LogLevel::kWarning, text);
    lock.lock();
    return true;
  }

  Result<void> download(Job& job, const Object& object, HttpConnection& http) {
    std::uint64_t counted = job.body.size();
    const std::string name = "asset object " + object.id.hex().substr(0, 12);
    auto answer = http.get_rest("/v1/assets/" + object.id.hex(), object.max_bytes, job.body, [&](std::uint64_t size) {
      const std::lock_guard lock(mutex_);
      job.stats.downloaded_bytes += size > counted ? size - counted : size;
      counted = size;
    });
    if (!answer) return in_context(name, answer.error());
    if (answer->status != 200 && answer->status != 206) {
      job.body.clear();
      return fail(answer->status == 404 ? ErrorCode::kNotFound : ErrorCode::kRefused,
                  name + ": the broker answered " + std::to_string(answer->status));
    }
    if (sha256(job.body) != object.id) {
      job.body.clear();
      return fail(ErrorCode::kCorrupt, name + " does not have the hash it is named by");
    }
    return {};
  }

  void rest(const std::string& what) {
    {
      const std::lock_guard lock(mutex_);
      if (current_ != nullptr) {
        current_->stats.trouble = what + try_again_in(kLongestRetry);
        current_->next_try_us = steady_now_us() + TimeUs{kLongestRetry.count()} * 1000;
        current_ = nullptr;
      }
    }
    changed_.notify_all();
  }

  const BrokerUrl url_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  // GUARDED_BY(mutex_):
  std::list<Job*> jobs_;    ///< Those whose turn comes first stand first.
  Job* current_ = nullptr;  ///< Is being served.
  std::shared_ptr<HttpConnection> http_;
  bool stopping_ = false;

  std::thread thread_;
};

AssetFetcher::AssetFetcher(const BrokerUrl& url, std::string cache_dir, std::function<void()> wake, LogSink log)
    : job_(std::make_unique<Job>(std::move(cache_dir), std::move(wake), std::move(log))) {
  static SharedByBroker<Worker> workers;
  worker_ = workers.get(url, [](Worker&) { return true; });
  worker_->add(*job_);
}
AssetFetcher::~AssetFetcher() {
  worker_->remove(*job_);
}
void AssetFetcher::ask(std::vector<Object> objects) {
  worker_->ask(*job_, std::move(objects));
}
std::optional<Bytes> AssetFetcher::take() {
  return worker_->take(*job_);
}
AssetFetcher::Stats AssetFetcher::stats() const {
  return worker_->stats(*job_);
}

}  // namespace eigencast
