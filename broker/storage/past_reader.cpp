// SPDX-License-Identifier: MIT
#include "broker/storage/past_reader.h"

#include <algorithm>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <utility>

#include "common/wire/limits.h"

namespace eigencast::broker {
namespace {

using recording::Record;
using recording::Type;

constexpr std::size_t kRecordBytes = 512;  // What a key takes besides its payload and numbers.

std::string_view text_of(const Record& record) {
  return {reinterpret_cast<const char*>(record.body.data()), record.body.size()};
}

double thread_us() {
  timespec time{};
  ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) * 1e6 + static_cast<double>(time.tv_nsec) / 1e3;
}

}  // namespace

template <typename Work>
Result<Passage> PastReader::timed(Work work) {
  const double before_us = thread_us();
  auto passage = work();
  took_us_ = thread_us() - before_us;
  return passage;
}

Result<Passage> PastReader::seek(const control::Seek& wanted, TimeUs origin_us) {
  return timed([&] { return find(wanted, origin_us); });
}

Result<Passage> PastReader::find(const control::Seek& wanted, TimeUs origin_us) {
  const auto pieces = kept_.pieces(stream_);
  if (pieces.empty())
    return fail(ErrorCode::kNotFound, "nothing of '" + stream_ + "' is kept that could be seen again");
  Passage passage;
  const Recorder::Piece& last = pieces.back();
  const TimeUs live_us = last.growing ? kept_.unix_from_steady(steady_now_us()) : last.to_us;
  passage.ends = wanted.speed >= 1 ? wanted.at_us > live_us - kLiveUs : !last.growing && wanted.at_us > live_us;
  if (passage.ends) return passage;
  auto piece = std::upper_bound(pieces.begin(), pieces.end(), wanted.at_us,
                                [](TimeUs at_us, const Recorder::Piece& one) { return at_us < one.from_us; });
  if (piece != pieces.begin()) --piece;
  // In a gap: what comes after it.
  const auto after = std::next(piece);
  if (after != pieces.end() && wanted.at_us > piece->to_us && after->from_us - piece->to_us > kSeamUs) piece = after;

  decoder_.reset();
  ahead_.reset();
  newest_us_.reset();
  ended_ = false;
  anew_ = true;
  speed_ = wanted.speed;
  origin_us_ = origin_us;
  if (auto entered = enter(*piece); !entered) return entered.error();
  if (auto found = reader_->seek(std::max<TimeUs>(0, wanted.at_us - from_us_)); !found) return found.error();
  for (;;) {
    auto record = next();
    if (!record) return record.error();
    if (!*record) break;
    const TimeUs time_us = time_of(**record);
    if (newest_us_ && (*newest_us_ > wanted.at_us || (time_us > wanted.at_us && !wanted.next))) {
      ahead_ = std::move(*record);
      break;
    }
    const auto decoded = decode(**record);
    if (!decoded) return decoded.error();
    if (*decoded) newest_us_ = time_us;
  }
  if (!newest_us_) return fail(ErrorCode::kNotFound, "nothing of '" + stream_ + "' is kept there yet");
  add_newest(passage);
  return passage;
}

Result<Passage> PastReader::go_on(TimeUs until_us) {
  return timed([&]() -> Result<Passage> {
    Passage passage;
    std::size_t bytes = 0;
    if (newest_us_) add_newest(passage);
    while (bytes < kMaxPassageBytes) {
      auto record = next();
      if (!record) return record.error();
      if (!*record) break;
      const bool anew = begins_anew(**record);
      const TimeUs at_us = time_of(**record);
      if ((anew && !passage.poses.empty()) || (!anew && !anew_ && at_us > until_us)) {
        ahead_ = std::move(*record);
        break;
      }
      const auto decoded = decode(**record);
      if (!decoded) return decoded.error();
      if (!*decoded) continue;
      newest_us_ = at_us;
      if (anew_ && !passage.poses.empty()) return passage;  // It begins the next passage.
      add_newest(passage);
      bytes += kRecordBytes + memory_of(*passage.poses.back().key);
    }
    passage.ends = ended_;
    return passage;
  });
}

Result<void> PastReader::enter(const Recorder::Piece& piece) {
  from_us_ = piece.from_us;
  if (piece.file == file_ && reader_) {
    std::error_code gone;
    const auto size = std::filesystem::file_size(file_, gone);
    if (!gone) (void)reader_->extend(size);
    return {};
  }
  file_.clear();
  auto opened = recording::Reader::open(piece.file);
  if (!opened) return opened.error();
  reader_.emplace(std::move(*opened));
  file_ = piece.file;
  return {};
}

Result<std::optional<Record>> PastReader::next() {
  if (ahead_) return std::exchange(ahead_, std::nullopt);
  for (;;) {
    auto record = reader_->next();
    if (!record || *record) return record;
    const auto pieces = kept_.pieces(stream_);
    const auto own = std::find_if(pieces.begin(), pieces.end(), [&](const auto& one) { return one.file == file_; });
    std::error_code gone;
    const auto size = std::filesystem::file_size(file_, gone);
    if (!gone && reader_->extend(size)) continue;
    if (own != pieces.end() && own->growing) return std::optional<Record>();
    const auto after =
        std::find_if(pieces.begin(), pieces.end(), [&](const auto& one) { return one.from_us > from_us_; });
    if (after == pieces.end()) {
      ended_ = true;
      return std::optional<Record>();
    }
    const TimeUs end_us = own != pieces.end() ? own->to_us : from_us_ + reader_->info().duration_us;
    if (auto entered = enter(*after); !entered) return entered.error();
    gap_ = after->from_us - end_us > kSeamUs;
  }
}

bool PastReader::begins_anew(const Record& record) const {
  return record.type == Type::kAnnounce && (!decoder_ || gap_ || announced_ != text_of(record));
}

Result<bool> PastReader::decode(const Record& record) {
  if (record.type == Type::kAnnounce) {
    if (auto begun = begin(record); !begun) return begun.error();
  } else if (record.type == Type::kMemory) {
    if (auto loaded = load_memory(record.body); !loaded) return loaded.error();
  }
  const bool is_join = record.type == Type::kCheckpoint;
  if (!decoder_ || (!is_join && record.type != Type::kFrame)) return false;
  const auto frame = parse_frame(record.body);
  if (!frame) return frame.error();
  const KeyRecordPtr before = decoder_->snapshot().newest;
  if (is_join && before && frame->envelope.sequence == before->sequence) return false;
  if (decoder_->take_frame(*frame, time_of(record))) return true;
  if (!is_join) return false;  // What was left out before it: a checkpoint follows.
  // Its numbers or times went back.
  const control::Announce announced = decoder_->announcement();
  const GenerationPtr memory = decoder_->memory();
  decoder_ = std::make_unique<Stream>(stream_, 1, Stream::Settings{});
  anew_ = true;
  if (auto begun = decoder_->announce(announced, 1); !begun) return begun.error();
  if (memory) decoder_->set_memory(memory);
  if (auto taken = decoder_->take_frame(*frame, time_of(record)); !taken) return taken.error();
  return true;
}

Result<void> PastReader::begin(const Record& announce) {
  if (!begins_anew(announce)) {  // For another memory, which comes next, or none.
    decoder_->set_memory(nullptr);
    return {};
  }
  const auto message = control_from_text(text_of(announce));
  const auto* read = message ? std::get_if<control::Announce>(&*message) : nullptr;
  if (read == nullptr) return fail(ErrorCode::kCorrupt, "an announcement in " + file_ + " is damaged");
  control::Announce announced = *read;
  announced.continues = false;
  announced.resume.clear();
  decoder_ = std::make_unique<Stream>(stream_, 1, Stream::Settings{});
  announced_ = text_of(announce);
  gap_ = false;
  anew_ = true;
  return decoder_->announce(announced, 1);
}

Result<void> PastReader::load_memory(ByteView ids) {
  if (!decoder_) return {};
  const auto asset = Sha256::from_hex(decoder_->asset());
  if (!asset) return fail(ErrorCode::kCorrupt, "an announcement in " + file_ + " names no asset");
  Generation memory{++generation_, generation_, PoseMemory(decoder_->layout()), {}};
  std::map<std::string, std::uint64_t> offsets;
  auto known = std::exchange(segments_, {});
  for (; ids.size() >= recording::kIdBytes; ids = ids.subspan(recording::kIdBytes)) {
    Sha256 id;
    std::copy_n(ids.begin(), recording::kIdBytes, id.digest.begin());
    auto& segment = segments_[id.hex()] = known[id.hex()];
    if (!segment && offsets.empty()) {  // Once: there may be as many objects as segments.
      const auto objects = reader_->object_offsets();
      if (!objects) return objects.error();
      for (const std::uint64_t offset : *objects) {
        const auto object = reader_->object_at(offset);
        if (!object) return object.error();
        Sha256 held;
        std::copy_n(object->body.begin(), recording::kIdBytes, held.digest.begin());
        offsets[held.hex()] = offset;
      }
    }
    if (const auto found = offsets.find(id.hex()); !segment && found != offsets.end()) {
      const auto object = reader_->object_at(found->second);
      if (!object) return object.error();
      auto decoded =
          decode_segment(decoder_->layout(), asset->digest, ByteView(object->body).subspan(recording::kIdBytes));
      if (!decoded) return decoded.error();
      auto paid = charge_(*std::move(decoded));
      if (!paid) return paid.error();
      segment = *std::move(paid);
    }
    if (!segment) return fail(ErrorCode::kCorrupt, file_ + " lacks a part of its memory");
    memory.segments.push_back({id.hex(), segment, generation_});
    if (auto grown = memory.poses.add(segment); !grown) return grown;
  }
  decoder_->set_memory(std::make_shared<const Generation>(std::move(memory)));
  return {};
}

void PastReader::add_newest(Passage& passage) {
  const TimeUs at_us = *std::exchange(newest_us_, std::nullopt);
  KeyRecord key = *decoder_->plain();
  const double pace = speed_ > 0 ? 1 / speed_ : 1;
  const auto slowed = [&](TimeUs us) {
    constexpr double kMax = 1LL << 56;  // As bounded_time(), before it is a whole number.
    return static_cast<TimeUs>(std::llround(std::clamp(static_cast<double>(us) * pace, -kMax, kMax)));
  };
  ChainState after = *key.after;
  if (std::exchange(anew_, false)) {
    first_capture_us_ = key.capture_us;
    if (last_) origin_us_ = std::max(origin_us_, last_->capture_us + 1);
    last_.reset();
    key.before.reset();
    key.capture_us = origin_us_;
    after.age_us = std::min(slowed(after.age_us), origin_us_);
    control::Announce announced = decoder_->announcement();
    announced.utc_us = bounded_time(bounded_time(announced.utc_us) + bounded_time(first_capture_us_ - origin_us_));
    if (speed_ > 0) announced.key_rate_hz = std::min(announced.key_rate_hz * speed_, 10'000.0);
    const auto velocity_us = std::clamp<TimeUs>(slowed(announced.format.velocity_us), 1, limits::kMaxVelocityUs);
    announced.format.velocity_us = static_cast<std::uint32_t>(velocity_us);
    passage.begins = Passage::Beginning{std::move(announced), {at_us, origin_us_, speed_}};
  } else {
    key.capture_us = std::max(last_->capture_us + 1, origin_us_ + slowed(key.capture_us - first_capture_us_));
    after.age_us = key.capture_us - last_->capture_us;
    key.before = key.before && key.sequence == last_->sequence + 1 ? last_->after : nullptr;
  }
  key.arrival_us = 0;  // It does not come from the network now.
  key.after = std::make_shared<const ChainState>(std::move(after));
  last_ = std::make_shared<const KeyRecord>(std::move(key));
  passage.poses.push_back({at_us, last_});
}

}  // namespace eigencast::broker
