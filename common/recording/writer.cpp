// SPDX-License-Identifier: MIT
#include "common/recording/writer.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cassert>
#include <cerrno>
#include <system_error>

#include "common/recording/reader.h"

namespace eigencast::recording {
namespace {

constexpr std::size_t kEntriesPerIndex = 65'536;  // One block for all of most recordings: readers fetch it at once.

}  // namespace

Result<Writer> Writer::create(const std::string& path, const Start& start) {
  FileHandle file(::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644));
  if (file.get() < 0) {
    const int number = errno;
    return fail(number == EEXIST ? ErrorCode::kRefused : ErrorCode::kIo,
                path + ": " + std::generic_category().message(number));
  }
  Writer writer(path, std::move(file));
  ByteWriter header(writer.pending_);
  header.bytes(kMagic);
  header.u32(kVersion);
  Bytes body;
  ByteWriter out(body);
  out.u64(start.started_unix_us);
  for (const std::string& text : {start.stream.substr(0, 255), start.software.substr(0, 255)}) {
    out.u8(static_cast<std::uint8_t>(text.size()));
    out.text(text);
  }
  writer.append(Type::kStart, 0, body);
  if (auto written = writer.flush(); !written) {
    ::unlink(path.c_str());  // No recording, and nothing to repair.
    return written.error();
  }
  return writer;
}

Result<void> Writer::announce(TimeUs time_us, std::string_view text, ByteView memory) {
  announce_ = bytes();
  append(Type::kAnnounce, time_us, ByteView(reinterpret_cast<const std::uint8_t*>(text.data()), text.size()));
  if (!memory.empty()) append(Type::kMemory, time_us, memory);
  return {};
}

Result<void> Writer::frame(TimeUs time_us, ByteView message) {
  append(Type::kFrame, time_us, message);
  ++frames_;
  return {};
}

Result<void> Writer::checkpoint(TimeUs time_us, ByteView join) {
  assert(announce_ != 0);
  const std::uint64_t here = bytes();
  append(Type::kCheckpoint, time_us, join);
  entries_.push_back({last_us_, here, announce_});
  return {};
}

Result<void> Writer::object(TimeUs time_us, ByteView id, ByteView bytes) {
  assert(id.size() == kIdBytes);
  append(Type::kObject, time_us, id, bytes);
  return flush();  // Large ones are not gathered in memory.
}

Result<void> Writer::gap(TimeUs time_us, std::uint64_t frames) {
  Bytes body;
  ByteWriter(body).u64(frames);
  append(Type::kGap, time_us, body);
  dropped_ += frames;
  return {};
}

Result<void> Writer::flush() {
  if (entries_.size() >= kEntriesPerIndex) append_index();
  return write_out();
}

Result<void> Writer::sync() {
  if (auto flushed = flush(); !flushed) return flushed;
  if (::fdatasync(file_.get()) != 0) return give_up(errno);
  return {};
}

Result<void> Writer::finish(bool syncs) {
  if (!entries_.empty()) append_index();
  Bytes body;
  ByteWriter out(body);
  for (const std::uint64_t value : {last_index_, frames_, dropped_}) out.u64(value);
  append(Type::kEnd, last_us_, body);
  return syncs ? sync() : flush();
}

void Writer::append(Type type, TimeUs time_us, ByteView first, ByteView second) {
  last_us_ = std::max(last_us_, time_us);
  Bytes body;
  if (!second.empty()) {
    body.reserve(first.size() + second.size());
    ByteWriter out(body);
    out.bytes(first);
    out.bytes(second);
    first = body;
  }
  assert(first.size() <= kMaxBodyBytes);
  ByteWriter out(pending_);
  out.bytes(head_of(type, last_us_, first));
  out.bytes(first);
}

void Writer::append_index() {
  Bytes body;
  ByteWriter out(body);
  out.u64(last_index_);
  for (const IndexEntry& entry : entries_) {
    out.u64(static_cast<std::uint64_t>(entry.time_us));
    out.u64(entry.checkpoint);
    out.u64(entry.announce);
  }
  entries_.clear();
  const std::uint64_t here = bytes();
  append(Type::kIndex, last_us_, body);
  last_index_ = here;
}

Result<void> Writer::write_out() {
  if (broken_) return fail(ErrorCode::kIo, path_ + ": an earlier write failed");
  std::size_t done = 0;
  while (done < pending_.size()) {
    const ssize_t count =
        ::pwrite(file_.get(), pending_.data() + done, pending_.size() - done, static_cast<off_t>(written_ + done));
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return give_up(errno);
    done += static_cast<std::size_t>(count);
  }
  written_ += pending_.size();
  pending_.clear();
  return {};
}

Error Writer::give_up(int number) {
  broken_ = true;
  pending_.clear();
  // Best effort: a reader finds the border of the last record by itself.
  [[maybe_unused]] const int ignored = ::ftruncate(file_.get(), static_cast<off_t>(written_));
  const bool full = number == ENOSPC || number == EDQUOT || number == EFBIG;
  return fail(ErrorCode::kIo, path_ + ": " + std::generic_category().message(number) +
                                  (full ? ": free some space, or record elsewhere" : ""));
}

Result<Recovered> recover(const std::string& path) {
  auto reader = Reader::open(path);
  if (!reader) return reader.error();
  const Info& info = reader->info();
  Recovered result{info.complete, info.frames, info.torn_bytes};
  if (info.complete) return result;
  FileHandle file(::open(path.c_str(), O_WRONLY | O_CLOEXEC));
  if (file.get() < 0) return fail(ErrorCode::kIo, path + ": " + std::generic_category().message(errno));
  Writer writer(path, std::move(file));
  writer.written_ = info.whole_bytes;
  writer.last_us_ = info.duration_us;
  writer.frames_ = info.frames;
  writer.dropped_ = info.dropped;
  // One new chain over all: what index blocks there are before the tear are left behind, and may be.
  writer.entries_ = reader->index();
  if (::ftruncate(writer.file_.get(), static_cast<off_t>(info.whole_bytes)) != 0) return writer.give_up(errno);
  if (auto finished = writer.finish(); !finished) return finished.error();
  return result;
}

}  // namespace eigencast::recording
