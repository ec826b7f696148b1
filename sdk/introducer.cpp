// SPDX-License-Identifier: MIT
#include "sdk/introducer.h"

#include <utility>

#include "common/net/guarded_run.h"
#include "sdk/uploader.h"

namespace eigencast {

Introducer::Introducer(BrokerUrl url, std::shared_ptr<const EncodedAsset> encoded, Events events)
    : url_(std::move(url)), encoded_(std::move(encoded)), events_(std::move(events)) {
  thread_ = std::thread([this] { guarded_run([this] { run(); }, events_.on_exception); });
}

void Introducer::begin(std::chrono::milliseconds after) {
  {
    const std::lock_guard lock(mutex_);
    due_ = std::chrono::steady_clock::now() + after;
    ++orders_;
  }
  changed_.notify_all();
}

void Introducer::cancel() {
  const std::lock_guard lock(mutex_);
  due_.reset();
  ++orders_;
  if (http_) http_->cancel();
}

void Introducer::stop() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
    if (http_) http_->cancel();
  }
  changed_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void Introducer::run() {
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
    lock.unlock();
    const auto done = Uploader(*http, *encoded_).upload(events_.on_progress);
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
