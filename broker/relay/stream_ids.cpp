// SPDX-License-Identifier: MIT
#include "broker/relay/stream_ids.h"

#include <algorithm>
#include <utility>

namespace eigencast::broker {

void StreamShare::announce() {
  const std::lock_guard lock(mutex);
  announced = true;
  charge.reset();
}

void StreamShare::begin_preparing(const std::string& asset) {
  const std::lock_guard lock(mutex);
  to_prepare = asset;
  prepared_by.clear();
}

void StreamShare::note_prepared(const std::string& asset, const std::string& holder, std::int64_t viewers) {
  const std::lock_guard lock(mutex);
  if (asset == to_prepare && (prepared_by[holder] += viewers) <= 0) prepared_by.erase(holder);
}

bool StreamShare::is_prepared() {
  const std::lock_guard lock(mutex);
  const auto viewers = watchers.all();
  const auto ready = std::count_if(viewers.begin(), viewers.end(), [&](const auto& holder) {
    const auto found = prepared_by.find(holder.first);
    return found != prepared_by.end() && 10 * found->second >= 9 * holder.second;
  });
  return 10 * ready >= 9 * std::ssize(viewers);
}

Result<std::shared_ptr<void>> StreamShare::take_place(const std::string& holder, std::uint32_t max) {
  const std::lock_guard lock(mutex);
  if (watchers.fits(holder, 1, max)) return watchers.hold(holder, 1);
  return fail(ErrorCode::kTooLarge, "this stream has " + std::to_string(watchers.used()) + " watchers, and of the " +
                                        std::to_string(max) + " that limits.max_subscribers_per_stream allows too " +
                                        "few are free for one that holds more: try again later");
}

std::shared_ptr<StreamShare> StreamIds::new_share() {
  const std::lock_guard lock(slots_->mutex);
  auto& [mutex, last_tags, free] = *slots_;
  if (free.empty()) {
    if (last_tags.size() == max_ids_) return nullptr;
    last_tags.push_back(0);
    free.insert(static_cast<std::uint32_t>(last_tags.size()));
  }
  const std::uint32_t id = free.extract(free.begin()).value();
  return {new StreamShare(id, last_tags[id - 1]), [slots = slots_](StreamShare* share) {
            const std::lock_guard slots_lock(slots->mutex);
            slots->last_tags[share->id - 1] = share->tag;
            slots->free.insert(share->id);
            delete share;
          }};
}

Result<std::shared_ptr<void>> StreamIds::pay(const Charge& charge, const std::string& holder) {
  if (!waiting_.fits(holder, 1, max_waiting_)) {
    return fail(ErrorCode::kTooLarge, std::to_string(waiting_.used()) +
                                          " streams are watched that nobody sends, and of limits.max_waiting_streams " +
                                          "too few are free for one that watches more: try again later");
  }
  const auto paid = charge();
  if (!paid) return paid;
  return std::shared_ptr<void>(paid->get(), [paid = *paid, counted = waiting_.hold(holder, 1)](void*) {});
}

Result<std::shared_ptr<StreamShare>> StreamIds::of(std::string_view name, const Charge& charge,
                                                   const std::string& holder) {
  const std::lock_guard lock(mutex_);
  const auto found = shares_.find(name);
  auto share = found == shares_.end() ? nullptr : found->second.lock();
  const bool is_new = !share;
  if (is_new && !(share = new_share()))
    return fail(ErrorCode::kTooLarge, "all " + std::to_string(max_ids_) + " stream ids are in use: stop a stream");
  const std::lock_guard share_lock(share->mutex);
  if (charge && !share->announced && !share->charge) {
    if (auto stored = store(share->charge, pay(charge, holder)); !stored) return stored.error();
  }
  if (!is_new) return share;
  if (shares_.size() >= sweep_at_) {
    std::erase_if(shares_, [](const auto& item) { return item.second.expired(); });
    sweep_at_ = 2 * shares_.size() + 64;
  }
  shares_.insert_or_assign(std::string(name), share);
  return share;
}

}  // namespace eigencast::broker
