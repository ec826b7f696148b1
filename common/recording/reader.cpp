// SPDX-License-Identifier: MIT
#include "common/recording/reader.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <utility>

#include "common/core/clock.h"

namespace eigencast::recording {
namespace {

constexpr TimeUs kMaxTimeUs = (TimeUs{1} << 62) - 1;

std::string text_of(ByteView bytes) {
  return {bytes.begin(), bytes.end()};
}

}  // namespace

Reader::Reader(std::unique_ptr<std::istream> in, std::uint64_t size) : in_(std::move(in)), size_(size) {}

Result<Reader> Reader::open(const std::string& path) {
  std::error_code error;
  const std::uint64_t size = std::filesystem::file_size(path, error);
  if (error) {
    const bool missing = error == std::errc::no_such_file_or_directory;
    return fail(missing ? ErrorCode::kNotFound : ErrorCode::kIo, path + ": " + error.message());
  }
  auto file = std::make_unique<std::ifstream>(path, std::ios::binary);
  if (!*file) return fail(ErrorCode::kIo, path + ": cannot be read: check its permissions");
  auto reader = over_stream(std::move(file), size);
  if (!reader) return in_context(path, reader.error());
  return reader;
}

Result<Reader> Reader::over(Bytes bytes) {
  const std::uint64_t size = bytes.size();
  return over_stream(std::make_unique<std::istringstream>(text_of(bytes)), size);
}

Result<Reader> Reader::over_stream(std::unique_ptr<std::istream> in, std::uint64_t size) {
  Reader reader(std::move(in), size);
  if (auto begun = reader.begin(); !begun) return begun.error();
  return reader;
}

Result<void> Reader::begin() {
  Bytes header;
  if (!read_at(0, kHeaderBytes, header) || !std::equal(kMagic.begin(), kMagic.end(), header.begin())) {
    return fail(ErrorCode::kCorrupt, "this is not a recording: it does not begin with ECRECOR");
  }
  const std::uint32_t version = ByteReader(ByteView(header).subspan(kMagic.size())).u32();
  if (version != kVersion) {
    return fail(ErrorCode::kIncompatibleVersion, "recording version " + std::to_string(version) +
                                                     ", and this program reads version " + std::to_string(kVersion));
  }
  const auto start = record_at(kHeaderBytes);
  if (!start || start->type != Type::kStart) {
    return fail(ErrorCode::kCorrupt,
                "the recording has no beginning: its recorder was cut off before it had written any");
  }
  ByteReader in(start->body);
  info_.start.started_unix_us = in.u64();
  info_.start.stream = text_of(in.bytes(in.u8()));
  info_.start.software = text_of(in.bytes(in.u8()));
  if (in.failed()) return fail(ErrorCode::kCorrupt, "the first record of the recording is damaged");
  at_ = first_ = kHeaderBytes + kHeadBytes + start->body.size();
  if (!load_end()) scan(first_);
  return {};
}

bool Reader::load_end() {
  if (size_ < first_ + kEndBytes) return false;
  const auto end = record_at(size_ - kEndBytes);
  if (!end || end->type != Type::kEnd || end->body.size() != kEndBytes - kHeadBytes) return false;
  ByteReader in(end->body);
  const std::uint64_t last_index = in.u64();
  info_.frames = in.u64();
  info_.dropped = in.u64();
  info_.duration_us = end->time_us;
  if (!load_index(last_index)) {
    info_.frames = info_.dropped = 0;
    index_.clear();
    return false;
  }
  info_.complete = true;
  info_.whole_bytes = size_;
  return true;
}

bool Reader::load_index(std::uint64_t offset) {
  // Each block names an earlier one, so that this ends.
  for (std::uint64_t before = size_; offset != 0;) {
    if (offset >= before || offset < first_) return false;
    before = offset;
    const auto block = record_at(offset);
    if (!block || block->type != Type::kIndex || block->body.size() % kIndexEntryBytes != 8) return false;
    ByteReader in(block->body);
    offset = in.u64();
    while (in.remaining() > 0) {
      const auto time_us = static_cast<TimeUs>(in.u64());
      const std::uint64_t checkpoint = in.u64();
      const std::uint64_t announce = in.u64();
      if (time_us < 0 || announce >= checkpoint || checkpoint >= size_) return false;
      index_.push_back({time_us, checkpoint, announce});
    }
  }
  std::sort(index_.begin(), index_.end(),
            [](const IndexEntry& a, const IndexEntry& b) { return a.checkpoint < b.checkpoint; });
  return std::is_sorted(index_.begin(), index_.end(),
                        [](const IndexEntry& a, const IndexEntry& b) { return a.time_us < b.time_us; });
}

bool Reader::extend(std::uint64_t size) {
  const std::uint64_t before = info_.whole_bytes;
  if (info_.complete || size <= before) return false;
  size_ = size;
  scan(before);
  return info_.whole_bytes > before;
}

void Reader::scan(std::uint64_t offset) {
  while (const auto record = record_at(offset)) {
    if (record->time_us < info_.duration_us) break;
    info_.duration_us = record->time_us;
    if (record->type == Type::kFrame) ++info_.frames;
    if (record->type == Type::kAnnounce) announce_ = offset;
    if (record->type == Type::kCheckpoint && announce_ != 0) index_.push_back({record->time_us, offset, announce_});
    if (record->type == Type::kGap) info_.dropped += ByteReader(record->body).u64();
    offset += kHeadBytes + record->body.size();
  }
  info_.whole_bytes = offset;
  info_.torn_bytes = size_ - offset;
}

bool Reader::read_at(std::uint64_t offset, std::size_t count, Bytes& out) {
  if (offset > size_ || count > size_ - offset) return false;
  out.resize(count);
  in_->clear();
  in_->seekg(static_cast<std::streamoff>(offset));
  in_->read(reinterpret_cast<char*>(out.data()), static_cast<std::streamsize>(count));
  return static_cast<std::size_t>(in_->gcount()) == count;
}

std::optional<Reader::Head> Reader::head_at(std::uint64_t offset) {
  Bytes bytes;
  if (!read_at(offset, kHeadBytes, bytes)) return std::nullopt;
  ByteReader in(bytes);
  Head head;
  head.length = in.u32();
  head.type = in.u8();
  head.time_us = static_cast<TimeUs>(in.u64());
  head.crc = in.u32();
  if (head.length > kMaxBodyBytes || head.length > size_ - offset - kHeadBytes) return std::nullopt;
  if (head.time_us < 0 || head.time_us > kMaxTimeUs) return std::nullopt;
  return head;
}

std::optional<Record> Reader::record_at(std::uint64_t offset) {
  const auto head = head_at(offset);
  if (!head) return std::nullopt;
  Record record{static_cast<Type>(head->type), head->time_us, {}};
  if (!read_at(offset + kHeadBytes, head->length, record.body)) return std::nullopt;
  const auto expected = head_of(record.type, record.time_us, record.body);
  if (ByteReader(ByteView(expected).subspan(kHeadBytes - 4)).u32() != head->crc) return std::nullopt;
  return record;
}

Result<std::optional<Record>> Reader::next() {
  if (!pending_.empty()) {
    std::optional<Record> next = std::move(pending_.front());
    pending_.pop_front();
    return next;
  }
  while (at_ < info_.whole_bytes) {
    auto record = record_at(at_);
    if (!record) return fail(ErrorCode::kCorrupt, "the record at byte " + std::to_string(at_) + " is damaged");
    at_ += kHeadBytes + record->body.size();
    const Type type = record->type;
    if (type == Type::kAnnounce || type == Type::kFrame || type == Type::kCheckpoint || type == Type::kObject ||
        type == Type::kGap || type == Type::kMemory)
      return std::optional(std::move(*record));
  }
  return std::optional<Record>();
}

Result<void> Reader::seek(TimeUs time_us) {
  pending_.clear();
  at_ = first_;
  const auto after = std::upper_bound(index_.begin(), index_.end(), time_us,
                                      [](TimeUs time, const IndexEntry& entry) { return time < entry.time_us; });
  if (after == index_.begin()) return {};
  const IndexEntry& entry = *std::prev(after);
  auto announce = record_at(entry.announce);
  if (!announce || announce->type != Type::kAnnounce) {
    return fail(ErrorCode::kCorrupt,
                "the index names an announcement at byte " + std::to_string(entry.announce) + ", and there is none");
  }
  auto memory = record_at(entry.announce + kHeadBytes + announce->body.size());
  pending_.push_back(std::move(*announce));
  if (memory && memory->type == Type::kMemory) pending_.push_back(std::move(*memory));
  at_ = entry.checkpoint;
  return {};
}

Result<std::vector<std::uint64_t>> Reader::object_offsets() {
  std::vector<std::uint64_t> found;
  for (std::uint64_t offset = first_; offset < info_.whole_bytes;) {
    const auto head = head_at(offset);
    if (!head) return fail(ErrorCode::kCorrupt, "the record at byte " + std::to_string(offset) + " is damaged");
    if (static_cast<Type>(head->type) == Type::kObject) found.push_back(offset);
    offset += kHeadBytes + head->length;
  }
  return found;
}

Result<Record> Reader::object_at(std::uint64_t offset) {
  auto record = record_at(offset);
  if (!record || record->type != Type::kObject || record->body.size() < kIdBytes) {
    return fail(ErrorCode::kCorrupt, "the asset object at byte " + std::to_string(offset) + " is damaged");
  }
  return std::move(*record);
}

}  // namespace eigencast::recording
