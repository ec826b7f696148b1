// SPDX-License-Identifier: MIT
#include "common/recording/writer.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cassert>
#include <cerrno>
#include <system_error>
#include <utility>

#include "common/recording/reader.h"

namespace eigencast::recording {
namespace {

/// So many checkpoints make an index block.
constexpr std::size_t kEntriesPerIndex = 16;

std::string short_text(std::string_view text) {
  return std::string(text.substr(0, 255));
}

}  // namespace

class Writer::Impl {
 public:
  Impl(std::string path, int fd) : path_(std::move(path)), fd_(fd) {}
  ~Impl() { ::close(fd_); }
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  Result<void> begin(const Start& start) {
    pending_.assign(kMagic.begin(), kMagic.end());
    ByteWriter(pending_).u32(kVersion);
    Bytes body;
    ByteWriter out(body);
    out.u64(start.started_unix_us);
    for (const std::string& text : {short_text(start.stream), short_text(start.software)}) {
      out.u8(static_cast<std::uint8_t>(text.size()));
      out.text(text);
    }
    append(Type::kStart, 0, body);
    return flush();
  }

  /// Goes on behind what `reader` found whole.
  void resume(const Reader& reader, const std::vector<IndexEntry>& entries) {
    written_ = reader.info().whole_bytes;
    last_us_ = reader.info().duration_us;
    frames_ = reader.info().frames;
    lost_ = reader.info().lost;
    // One new chain over all: what index blocks there are before the tear are left behind, and may be.
    entries_ = entries;
  }

  void append(Type type, TimeUs time_us, ByteView first, ByteView second = {}) {
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
    const auto head = head_of(type, last_us_, first);
    ByteWriter out(pending_);
    out.bytes(head);
    out.bytes(first);
  }

  std::uint64_t end_offset() const { return written_ + pending_.size(); }

  Result<void> flush() {
    if (entries_.size() >= kEntriesPerIndex) append_index();
    return write_out();
  }

  Result<void> sync() {
    if (auto flushed = flush(); !flushed) return flushed;
    if (::fdatasync(fd_) != 0) return give_up(errno);
    return {};
  }

  Result<void> finish() {
    if (!entries_.empty()) append_index();
    Bytes body;
    ByteWriter out(body);
    out.u64(last_index_);
    out.u64(frames_);
    out.u64(lost_);
    append(Type::kEnd, last_us_, body);
    return sync();
  }

  Result<void> cut(std::uint64_t size) {
    if (::ftruncate(fd_, static_cast<off_t>(size)) != 0) return give_up(errno);
    return {};
  }

  std::uint64_t announce_ = 0;  ///< Offset of the last announcement.
  std::vector<IndexEntry> entries_;
  TimeUs last_us_ = 0;
  std::uint64_t frames_ = 0;
  std::uint64_t lost_ = 0;

 private:
  void append_index() {
    Bytes body;
    ByteWriter out(body);
    out.u64(last_index_);
    for (const IndexEntry& entry : entries_) {
      out.u64(static_cast<std::uint64_t>(entry.time_us));
      out.u64(entry.checkpoint);
      out.u64(entry.announce);
    }
    entries_.clear();
    const std::uint64_t here = end_offset();
    append(Type::kIndex, last_us_, body);
    last_index_ = here;
  }

  Result<void> write_out() {
    if (broken_) return fail(ErrorCode::kIo, path_ + ": an earlier write failed");
    std::size_t done = 0;
    while (done < pending_.size()) {
      const ssize_t count =
          ::pwrite(fd_, pending_.data() + done, pending_.size() - done, static_cast<off_t>(written_ + done));
      if (count < 0 && errno == EINTR) continue;
      if (count < 0) return give_up(errno);
      done += static_cast<std::size_t>(count);
    }
    written_ += pending_.size();
    pending_.clear();
    return {};
  }

  Error give_up(int number) {
    broken_ = true;
    pending_.clear();
    // Best effort: a reader finds the border of the last record by itself.
    [[maybe_unused]] const int ignored = ::ftruncate(fd_, static_cast<off_t>(written_));
    const bool full = number == ENOSPC || number == EDQUOT || number == EFBIG;
    return fail(ErrorCode::kIo, path_ + ": " + std::generic_category().message(number) +
                                    (full ? ": free some space, or record elsewhere" : ""));
  }

  std::string path_;
  int fd_;
  Bytes pending_;
  std::uint64_t written_ = 0;
  std::uint64_t last_index_ = 0;
  bool broken_ = false;

  friend class Writer;
};

Writer::Writer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Writer::Writer(Writer&&) noexcept = default;
Writer& Writer::operator=(Writer&&) noexcept = default;
Writer::~Writer() = default;

Result<Writer> Writer::create(const std::string& path, const Start& start) {
  const int fd = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
  if (fd < 0) {
    const int number = errno;
    return fail(number == EEXIST ? ErrorCode::kRefused : ErrorCode::kIo,
                path + ": " + std::generic_category().message(number));
  }
  Writer writer(std::make_unique<Impl>(path, fd));
  if (auto begun = writer.impl_->begin(start); !begun) return begun.error();
  return writer;
}

Result<void> Writer::announce(TimeUs time_us, std::string_view text) {
  impl_->announce_ = impl_->end_offset();
  impl_->append(Type::kAnnounce, time_us, ByteView(reinterpret_cast<const std::uint8_t*>(text.data()), text.size()));
  return {};
}

Result<void> Writer::frame(TimeUs time_us, ByteView message) {
  impl_->append(Type::kFrame, time_us, message);
  ++impl_->frames_;
  return {};
}

Result<void> Writer::checkpoint(TimeUs time_us, ByteView join) {
  assert(impl_->announce_ != 0);
  const std::uint64_t here = impl_->end_offset();
  impl_->append(Type::kCheckpoint, time_us, join);
  impl_->entries_.push_back({impl_->last_us_, here, impl_->announce_});
  return {};
}

Result<void> Writer::object(TimeUs time_us, ByteView id, ByteView bytes) {
  assert(id.size() == kIdBytes);
  impl_->append(Type::kObject, time_us, id, bytes);
  return flush();  // Large ones are not gathered in memory.
}

Result<void> Writer::gap(TimeUs time_us, std::uint64_t frames) {
  Bytes body;
  ByteWriter(body).u64(frames);
  impl_->append(Type::kGap, time_us, body);
  impl_->lost_ += frames;
  return {};
}

Result<void> Writer::flush() {
  return impl_->flush();
}
Result<void> Writer::sync() {
  return impl_->sync();
}
Result<void> Writer::finish() {
  return impl_->finish();
}
std::uint64_t Writer::bytes() const {
  return impl_->end_offset();
}
std::uint64_t Writer::frames() const {
  return impl_->frames_;
}
std::uint64_t Writer::lost() const {
  return impl_->lost_;
}
TimeUs Writer::duration_us() const {
  return impl_->last_us_;
}

Result<Recovered> recover(const std::string& path) {
  auto reader = Reader::open(path);
  if (!reader) return reader.error();
  const Info& info = reader->info();
  Recovered result{info.complete, info.frames, info.torn_bytes};
  if (info.complete) return result;
  const int fd = ::open(path.c_str(), O_WRONLY | O_CLOEXEC);
  if (fd < 0) return fail(ErrorCode::kIo, path + ": " + std::generic_category().message(errno));
  Writer::Impl impl(path, fd);
  impl.resume(*reader, reader->index());
  if (auto cut = impl.cut(info.whole_bytes); !cut) return cut.error();
  if (auto finished = impl.finish(); !finished) return finished.error();
  return result;
}

}  // namespace eigencast::recording
