// SPDX-License-Identifier: MIT
#include "sdk/surfaces.h"

#include <chrono>
#include <exception>
#include <system_error>
#include <utility>
#include <vector>

#include "common/asset/asset_limits.h"

namespace eigencast {
namespace {

/// Beyond it, some ten seconds of a core, a viewer takes what comes next without poses that are carried over.
constexpr std::uint64_t kMostProducts = std::uint64_t{1} << 33;

}  // namespace

Surfaces::Surfaces(std::string cache_dir, std::function<void()> wake, LogSink log, MemoryBudget& memory)
    : log_(log), memory_(memory), fetcher_(std::move(cache_dir), std::move(wake), std::move(log)) {}

bool Surfaces::announce(const control::StreamInfo& info) {
  if (info.state == control::StreamInfo::State::kWaiting || info.asset.empty()) return false;
  to_come_ = info.next ? info.next->asset : std::string();
  if (latest() && latest()->goes_on_as(info.asset)) {
    if (latest()->epoch != info.epoch) change_.reset();
    adopt(*latest(), info);
    prepare();
    return false;
  }
  const bool has_come = next_ && next_->goes_on_as(info.asset) && next_->finished() && !pending_ && shown_;
  change_.reset();
  if (has_come) {
    take_change();
    if (next_->change && next_->change->from_epoch == shown_->epoch) change_ = std::move(next_->change);
    shown_ = std::move(next_);
    adopt(*shown_, info);
    prepare();
    return true;
  }
  if (shown_ && shown_->goes_on_as(info.asset)) {  // Back to what is shown before its successor could be.
    pending_.reset();
  } else {  // Also where this very surface could not be shown before: what was wrong may have been put right.
    // Some of it may be here already.
    pending_ = next_ && next_->goes_on_as(info.asset) ? std::move(next_) : std::make_shared<Slot>();
    pending_->asset = info.asset;
  }
  next_.reset();
  adopt(*latest(), info);
  if (pending_ && pending_->next_chunk > 0) shown_ = std::move(pending_);
  ask();
  return true;
}

/// After the surface that is shown: it is not to wait.
void Surfaces::prepare() {
  if (next_ && next_->asset == to_come_) return;
  told_prepared_ = false;
  const bool asked = next_ && working() == next_.get();
  next_.reset();
  if (!to_come_.empty() && shown_ && !pending_ && to_come_ != shown_->asset) {
    next_ = std::make_shared<Slot>();
    next_->asset = to_come_;
    next_->format.rows = 0;
  }
  if (asked || (next_ && working() == next_.get())) ask();
}

Surfaces::Slot* Surfaces::working() {
  Slot* slot = latest();
  const bool done = slot == nullptr || slot->finished() || !slot->damage.empty();
  return done && next_ ? next_.get() : slot;
}

std::string Surfaces::take_prepared() {
  if (!next_ || !next_->finished() || told_prepared_) return {};
  take_change();
  if (changing_) return {};
  if (!std::exchange(next_->changes, true)) begin_change();
  if (changing_) return {};
  told_prepared_ = true;
  return next_->asset;
}

/// On a thread of its own, one at a time: what is shown goes on meanwhile, and what is given up is not waited for.
void Surfaces::begin_change() {
  const Asset &from = shown_->reader->asset(), &to = next_->reader->asset();
  const Transfer::Cost cost = Transfer::cost(from, to);
  if (cost.products > kMostProducts) return;
  auto memory = memory_.take(cost.bytes, "the change to another basis");
  if (!memory) return log(log_, LogLevel::kWarning, memory.error().message);
  const auto work = [shown = shown_, next = next_, epoch = shown_->epoch,
                     held = std::move(*memory)]() -> std::optional<ChangeOver> {
    try {
      auto transfer = Transfer::between(shown->reader->asset(), next->reader->asset());
      if (!transfer) return std::nullopt;
      auto reconstructor = std::make_shared<Reconstructor>();
      reconstructor->update(next->reader->asset());
      return ChangeOver{epoch, std::move(*transfer), std::move(reconstructor)};
    } catch (const std::exception&) {  // No memory.
      return std::nullopt;
    }
  };
  try {
    making_ = std::async(std::launch::async, work);
    changing_ = next_;
  } catch (const std::system_error&) {
    log(log_, LogLevel::kWarning, "no thread is left: the surface changes without the poses of before");
  }
}

void Surfaces::take_change() {
  if (!changing_ || making_.wait_for(std::chrono::seconds(0)) != std::future_status::ready) return;
  changing_->change = making_.get();
  changing_.reset();
}

void Surfaces::adopt(Slot& slot, const control::StreamInfo& info) {
  slot.epoch = info.epoch;
  slot.format = info.format;
  check_format_of(slot);
}

bool Surfaces::check_format_of(Slot& slot) {
  if (!slot.reader || slot.lacks_columns) return true;
  const std::uint32_t rank = slot.reader->asset().rank;
  if (&slot == next_.get()) return true;  // Its poses are not announced yet.
  if (rank != slot.format.rows) {
    damage(slot,
           fail(ErrorCode::kCorrupt, "its basis has " + std::to_string(rank) + " columns, the stream's poses have " +
                                         std::to_string(slot.format.rows)));
  } else if (slot.format.channels < 3) {
    damage(slot, fail(ErrorCode::kUnsupported, "its poses have fewer than three channels"));
  }
  return slot.damage.empty();
}

void Surfaces::ask() {
  Slot* const wanted = working();
  if (wanted == nullptr) return fetcher_.ask({});
  Slot& slot = *wanted;
  if (!slot.damage.empty()) return;
  std::vector<AssetFetcher::Object> objects;
  if (!slot.reader) {
    const auto id = Sha256::from_hex(slot.asset);
    if (!id) return damage(slot, fail(ErrorCode::kCorrupt, "\"" + slot.asset + "\" is not an asset's id"));
    objects.push_back({*id, asset_limits::kMaxManifestBytes});
  } else {
    const auto columns = slot.reader->columns();
    if (slot.lacks_columns) objects.push_back({columns->id, columns->bytes});
    const auto& chunks = slot.reader->chunks();
    for (std::size_t i = slot.next_chunk; i < chunks.size() && !slot.has_chunks; ++i)
      objects.push_back({chunks[i].id, chunks[i].bytes});
  }
  fetcher_.ask(std::move(objects));
}

void Surfaces::damage(Slot& slot, const Error& why) {
  slot.damage = std::string(&slot == next_.get() ? "the stream's next surface" : "the stream's surface") +
                " cannot be shown: " + why.message;
  log(log_, LogLevel::kError, slot.damage);
  fetcher_.ask({});
}

bool Surfaces::add_object() {
  Slot* slot = working();
  if (!slot || !slot->damage.empty() || slot->finished()) return false;
  const auto bytes = fetcher_.take();
  if (!bytes) return false;
  if (!slot->reader) {
    read_manifest(*slot, *bytes);
  } else if (auto added = slot->add(*bytes); !added) {
    damage(*slot, added.error());
  } else if (check_format_of(*slot) && slot->next_chunk > 0) {
    if (slot == pending_.get()) {
      shown_ = std::move(pending_);
      prepare();
    }
  }
  if (slot->finished() && working() != slot) ask();
  return true;
}

Result<void> Surfaces::Slot::add(ByteView bytes) {
  if (!lacks_columns) {
    auto added = reader->add_chunk(next_chunk, bytes);
    if (added) ++next_chunk;
    return added;
  }
  lacks_columns = false;
  const auto from = std::exchange(has_chunks, nullptr);
  if (!from) return reader->add_columns(bytes);
  auto added = reader->add_columns_to(*from->reader, bytes);
  if (added) next_chunk = reader->chunks().size();
  return added;
}

void Surfaces::read_manifest(Slot& slot, ByteView bytes) {
  auto reader = AssetReader::from_manifest(*Sha256::from_hex(slot.asset), bytes);
  if (!reader) return damage(slot, reader.error());
  const auto columns = reader->columns();
  slot.lacks_columns = columns && reader->asset().rank != slot.format.rows;
  auto memory = memory_.take(reader->memory_bytes(), "it");
  if (!memory) return damage(slot, memory.error());
  slot.memory = std::move(*memory);
  slot.total_bytes = bytes.size();
  if (slot.lacks_columns) slot.total_bytes += columns->bytes;
  if (slot.lacks_columns && shown_ && reader->has_chunks_of(*shown_->reader)) slot.has_chunks = shown_;
  for (const auto& chunk : reader->chunks()) slot.total_bytes += slot.has_chunks ? 0 : chunk.bytes;
  slot.reader = std::move(*reader);
  if (check_format_of(slot)) ask();
}

Surfaces::Progress Surfaces::progress() const {
  if (pending_) return Progress::kNotDrawable;
  if (!shown_) return Progress::kNone;
  return shown_->finished() ? Progress::kFinished : Progress::kDrawable;
}

}  // namespace eigencast
