// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/core/files.h"
#include "common/recording/format.h"

namespace eigencast::recording {

/// What recover() found.
struct Recovered {
  bool was_complete = false;  ///< The file had its end: nothing was changed.
  std::uint64_t frames = 0;
  std::uint64_t cut_bytes = 0;  ///< Counts a record that was never whole.
};

/// Makes a recording whole that a crash left without its end: cuts a torn tail off, adds index and end.
/// Errors: kCorrupt (no recording), kIo.
Result<Recovered> recover(const std::string& path);

/// Writes a recording, append-only. What was flushed survives the end of the process, what was synced that of the
/// machine; a file that ends anywhere can be read up to its last whole record.
///
/// Times are microseconds since the start of the recording and never go back (an earlier one is taken as the last).
/// Every call may fail with kIo (the message names the file and the cause, for example a full disk): the file then ends
/// at a record's border, and the writer takes nothing more. Not thread-safe.
class Writer {
 public:
  /// Makes a new file; one that is there already is left alone. Errors: kRefused (it is there), kIo.
  static Result<Writer> create(const std::string& path, const Start& start);

  /// memory  the ids of the segments that frames from here on are predicted from; object() came before with each
  Result<void> announce(TimeUs time_us, std::string_view text, ByteView memory = {});
  Result<void> frame(TimeUs time_us, ByteView message);
  /// A join frame. REQUIRES: announce() came before.
  Result<void> checkpoint(TimeUs time_us, ByteView join);
  Result<void> object(TimeUs time_us, ByteView id, ByteView bytes);
  /// So many frames are missing here.
  Result<void> gap(TimeUs time_us, std::uint64_t frames);

  /// Hands all to the system, with an index block now and then.
  Result<void> flush();
  /// flush(), and onto the disk.
  Result<void> sync();
  /// Index, end, sync, or flush alone. Nothing may follow.
  Result<void> finish(bool syncs = true);
  std::uint64_t bytes() const { return written_ + pending_.size(); }
  std::uint64_t frames() const { return frames_; }
  TimeUs duration_us() const { return last_us_; }

 private:
  friend Result<Recovered> recover(const std::string& path);
  Writer(std::string path, FileHandle file) : path_(std::move(path)), file_(std::move(file)) {}
  void append(Type type, TimeUs time_us, ByteView first, ByteView second = {});
  void append_index();
  Result<void> write_out();
  Error give_up(int number);

  std::string path_;
  FileHandle file_;
  Bytes pending_;
  std::uint64_t written_ = 0;
  std::uint64_t announce_ = 0;    ///< Offset of the last announcement.
  std::uint64_t last_index_ = 0;  ///< Offset of the last index block; 0: none.
  std::vector<IndexEntry> entries_;
  TimeUs last_us_ = 0;
  std::uint64_t frames_ = 0, dropped_ = 0;
  bool broken_ = false;
};

}  // namespace eigencast::recording
