// SPDX-License-Identifier: MIT
#include "sdk/surfaces.h"

#include <utility>
#include <vector>

#include "common/asset/asset_limits.h"

namespace eigencast {

Surfaces::Surfaces(std::string cache_dir, std::function<void()> wake, LogSink log, MemoryBudget& memory)
    : log_(log), memory_(memory), fetcher_(std::move(cache_dir), std::move(wake), std::move(log)) {}

bool Surfaces::announce(const control::StreamInfo& info) {
  if (info.state == control::StreamInfo::State::kWaiting || info.asset.empty()) return false;
  if (latest() && latest()->goes_on_as(info.asset)) {
    adopt(*latest(), info);
    return false;
  }
  if (shown_ && shown_->goes_on_as(info.asset)) {  // Back to what is shown before its successor could be.
    pending_.reset();
  } else {  // Also where this very surface could not be shown before: what was wrong may have been put right.
    pending_ = std::make_unique<Slot>();
    pending_->asset = info.asset;
  }
  adopt(*latest(), info);
  ask();
  return true;
}

void Surfaces::adopt(Slot& slot, const control::StreamInfo& info) {
  slot.epoch = info.epoch;
  slot.format = info.format;
  check_format_of(slot);
}

bool Surfaces::check_format_of(Slot& slot) {
  if (!slot.reader) return true;
  const std::uint32_t rank = slot.reader->asset().rank;
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
  Slot& slot = *latest();
  if (!slot.damage.empty()) return;
  std::vector<AssetFetcher::Object> objects;
  if (!slot.reader) {
    const auto id = Sha256::from_hex(slot.asset);
    if (!id) return damage(slot, fail(ErrorCode::kCorrupt, "\"" + slot.asset + "\" is not an asset's id"));
    objects.push_back({*id, asset_limits::kMaxManifestBytes});
  } else {
    const auto& chunks = slot.reader->chunks();
    for (std::size_t i = slot.next_chunk; i < chunks.size(); ++i) objects.push_back({chunks[i].id, chunks[i].bytes});
  }
  fetcher_.ask(std::move(objects));
}

void Surfaces::damage(Slot& slot, const Error& why) {
  slot.damage = "the stream's surface cannot be shown: " + why.message;
  log(log_, LogLevel::kError, slot.damage);
  fetcher_.ask({});
}

bool Surfaces::add_object() {
  Slot* slot = latest();
  if (!slot || !slot->damage.empty() || slot->finished()) return false;
  const auto bytes = fetcher_.take();
  if (!bytes) return false;
  if (!slot->reader) {
    read_manifest(*slot, *bytes);
  } else if (auto added = slot->reader->add_chunk(slot->next_chunk, *bytes); !added) {
    damage(*slot, added.error());
  } else {
    ++slot->next_chunk;
    if (pending_) shown_ = std::move(pending_);
  }
  return true;
}

void Surfaces::read_manifest(Slot& slot, ByteView bytes) {
  auto reader = AssetReader::from_manifest(*Sha256::from_hex(slot.asset), bytes);
  if (!reader) return damage(slot, reader.error());
  auto memory = memory_.take(reader->memory_bytes(), "it");
  if (!memory) return damage(slot, memory.error());
  slot.memory = std::move(*memory);
  slot.total_bytes = bytes.size();
  for (const auto& chunk : reader->chunks()) slot.total_bytes += chunk.bytes;
  slot.reader = std::move(*reader);
  if (check_format_of(slot)) ask();
}

Surfaces::Progress Surfaces::progress() const {
  if (pending_) return Progress::kNotDrawable;
  if (!shown_) return Progress::kNone;
  return shown_->finished() ? Progress::kFinished : Progress::kDrawable;
}

}  // namespace eigencast
