// SPDX-License-Identifier: MIT
#include "sdk/recorded_stream.h"

#include <algorithm>
#include <string_view>
#include <utility>

namespace eigencast {

using recording::Record;
using recording::Type;

Result<RecordedStream> RecordedStream::open(const std::string& path) {
  auto reader = recording::Reader::open(path);
  if (!reader) return reader.error();
  const auto offsets = reader->object_offsets();
  if (!offsets) return offsets.error();
  std::map<Sha256, std::uint64_t> objects;
  for (const std::uint64_t offset : *offsets) {
    const auto object = reader->object_at(offset);
    if (!object) return object.error();
    objects.emplace(sha256(ByteView(object->body).subspan(recording::kIdBytes)), offset);
  }
  return RecordedStream(*std::move(reader), std::move(objects));
}

Result<void> RecordedStream::seek(TimeUs time_us) {
  newest_.reset();
  return reader_.seek(time_us);
}

Result<std::optional<RecordedStream::Event>> RecordedStream::next() {
  for (;;) {
    const auto record = reader_.next();
    if (!record) return record.error();
    if (!*record) return std::optional<Event>();
    const auto& [type, time_us, body] = **record;
    const auto event = [time_us = time_us](auto what) { return std::optional(Event{time_us, std::move(what)}); };
    if (type == Type::kAnnounce) {
      auto announce = begin(body);
      return announce ? Result(event(*std::move(announce))) : announce.error();
    }
    if (type == Type::kMemory) {
      auto memory = remember(body);
      return memory ? Result(event(*std::move(memory))) : memory.error();
    }
    if (type != Type::kFrame && type != Type::kCheckpoint) continue;
    auto made = pose(body);
    if (!made) return made.error();
    if (*made) return event(**std::move(made));
  }
}

Result<control::Announce> RecordedStream::begin(const Bytes& text) {
  auto message = control_from_text(std::string_view(reinterpret_cast<const char*>(text.data()), text.size()));
  if (!message) return in_context("the recorded announcement", message.error());
  auto* announce = std::get_if<control::Announce>(&*message);
  if (announce == nullptr) return fail(ErrorCode::kCorrupt, "the recorded announcement is none");
  if (const auto usable = check_format(announce->format); !usable) return usable.error();
  asset_ = Sha256::from_hex(announce->asset);
  if (!asset_) return fail(ErrorCode::kCorrupt, "the recorded announcement names no surface");
  control::StreamInfo info;
  info.state = control::StreamInfo::State::kLive;
  info.epoch = ++epoch_;
  info.format = announce->format;
  envelopes_.begin(0, 0, epoch_);
  decoder_.set_stream(info);
  return std::move(*announce);
}

Result<RecordedStream::Memory> RecordedStream::remember(ByteView ids) {
  if (!asset_ || decoder_.layout().is_float() || ids.size() % recording::kIdBytes != 0)
    return fail(ErrorCode::kCorrupt, "a memory without an announcement that it fits");
  Memory memory;
  decoder_.set_memory(std::nullopt);
  for (; !ids.empty(); ids = ids.subspan(recording::kIdBytes)) {
    Sha256 id;
    std::copy_n(ids.begin(), recording::kIdBytes, id.digest.begin());
    auto coded = object(id);
    if (!coded) return fail(ErrorCode::kCorrupt, "a segment of a memory: " + coded.error().message);
    auto segment = decode_segment(decoder_.layout(), asset_->digest, *coded);
    if (!segment) return segment.error();
    if (const auto grown = decoder_.remember(*segment); !grown) return grown.error();
    memory.push_back({*std::move(coded), *std::move(segment)});
  }
  return memory;
}

Result<std::optional<RecordedPose>> RecordedStream::pose(ByteView bytes) {
  const auto parsed = parse_frame(bytes);
  if (!parsed) return parsed.error();
  const auto frame = envelopes_.read(*parsed);
  if (!frame) return std::optional<RecordedPose>();  // behind a gap: the checkpoint that bridges it comes
  const auto key = decoder_.decode(*frame);
  if (!key) return key.error();
  const ChainClock at{frame->envelope.sequence, frame->envelope.capture_us};
  if (*key == nullptr || (newest_ && newest_->sequence == at.sequence && newest_->capture_us == at.capture_us))
    return std::optional<RecordedPose>();  // none, or a checkpoint of what is there
  newest_ = at;
  RecordedPose pose{**key, {}, decoder_.phase(), at.capture_us};
  if (frame->envelope.kind == FrameKind::kKey) pose.coded.assign(frame->payload.begin(), frame->payload.end());
  return std::optional(std::move(pose));
}

Result<Bytes> RecordedStream::object(const Sha256& id) {
  const auto found = objects_.find(id);
  if (found == objects_.end()) return fail(ErrorCode::kNotFound, "the recording does not hold object " + id.hex());
  const auto record = reader_.object_at(found->second);
  if (!record) return record.error();
  return Bytes(record->body.begin() + recording::kIdBytes, record->body.end());
}

}  // namespace eigencast
