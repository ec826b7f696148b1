// SPDX-License-Identifier: MIT
#include "sdk/broker_publisher.h"

#include <mutex>

#include "common/codec/recaller.h"

namespace eigencast {

namespace {

ErrorCode code_named(std::string_view name) {
  for (int code = 0; code < static_cast<int>(ErrorCode::kInternal); ++code) {
    if (name_of(static_cast<ErrorCode>(code)) == name) return static_cast<ErrorCode>(code);
  }
  return ErrorCode::kInternal;
}

}  // namespace

Result<void> BrokerPublisher::remember(std::vector<CodedSegment> segments) {
  const std::lock_guard lock(mutex_);
  now_->memory.decide_by_caller();
  return remember_now(std::move(segments));
}

Publisher::MemoryState BrokerPublisher::memory() const {
  const std::lock_guard lock(mutex_);
  return now_->memory.state();
}

void BrokerPublisher::keep(const Key& pose, const KeyWriter::Coded& coded, std::size_t bytes) {
  const bool due = now_->memory.add({*now_->writer.state(), pose, bytes, coded.next.phase, now_->writer.half_spacing(),
                                     coded.capture_us, now_->memory.may_grow()},
                                    steady_now_us());
  stats_.saved_bytes = saved_before_ + now_->memory.saved_bytes();
  if (now_->memory.state().generation != 0) stats_.memory_bytes = memory_before_ + now_->memory.bytes();
  if (!due) return;
  if (auto asked = remember_now(now_->memory.segments_to_keep()); !asked) refuse_memory(asked.error());
}

Result<void> BrokerPublisher::remember_now(std::vector<CodedSegment> segments) {
  if (auto wanted = now_->memory.want(std::move(segments)); !wanted) return wanted;
  if (phase_ == Phase::kLive) upload_memory();
  return {};
}

void BrokerPublisher::forget_memory() {
  if (segment_uploader_) segment_uploader_->cancel();
  now_->writer.code_by({}, {}, false);
  now_->memory.forget();
}

void BrokerPublisher::upload_memory() {
  auto objects = std::make_shared<EncodedAsset>();
  objects->chunks = now_->memory.missing();
  if (!segment_uploader_) {
    AssetUploader::Events upload;
    upload.on_progress = [](std::uint64_t, std::uint64_t) {};
    upload.on_done = [this](const Result<void>& done) {
      on_memory_uploaded(done);
      return std::optional<milliseconds>();
    };
    upload.on_exception = [this](const std::string& what) { on_memory_uploaded(fail(ErrorCode::kInternal, what)); };
    segment_uploader_ = std::make_unique<AssetUploader>(objects, std::move(upload));
  }
  segment_uploader_->use(std::move(objects));
  segment_uploader_->begin(at_, milliseconds(0));
}

void BrokerPublisher::on_memory_uploaded(const Result<void>& done) {
  const std::lock_guard lock(mutex_);
  if (phase_ != Phase::kLive || !now_->memory.state().pending) return;
  if (!done) return refuse_memory(done.error());
  if (socket_->send_text(text_from_control(now_->memory.message(url_.stream))) != SendStatus::kSent)
    return refuse_memory(fail(ErrorCode::kDisconnected, "the broker takes no messages now"));
  if (now_->memory.asked()) now_->writer.code_by({}, {}, false);
}

void BrokerPublisher::refuse_memory(const Error& why) {
  now_->memory.refuse(why, steady_now_us());
  log(log_, why.code == ErrorCode::kUnsupported ? LogLevel::kInfo : LogLevel::kWarning,
      "memory not used: " + why.message);
}

void BrokerPublisher::on_message(const control::Remembered& m) {
  const std::lock_guard lock(mutex_);
  if (phase_ != Phase::kLive || !now_->memory.awaits(m.generation)) return;
  if (!m.code.empty()) return refuse_memory({code_named(m.code), m.message});
  const auto poses = now_->memory.hold();
  if (!poses) return;
  log(log_, LogLevel::kInfo, "keys are predicted from a memory of " + std::to_string(poses->pose_count()) + " poses");
  const auto recaller = std::make_shared<Recaller>(*poses);
  const auto coder = [recaller](const ChainState& state, const Key& key, std::uint8_t half_spacing) {
    return recaller->encode(state, key, half_spacing);
  };
  now_->writer.code_by(coder, *poses, true);
}

}  // namespace eigencast
