// SPDX-License-Identifier: MIT
#pragma once

#include <deque>
#include <istream>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/core/result.h"
#include "common/recording/format.h"

namespace eigencast::recording {

struct Info {
  Start start;
  TimeUs duration_us = 0;
  std::uint64_t frames = 0;
  std::uint64_t dropped = 0;      ///< Frames that the recorder had to leave out.
  bool complete = false;          ///< It has its end. If not, the recorder was cut off, or still writes.
  std::uint64_t whole_bytes = 0;  ///< Up to the end of the last whole record.
  std::uint64_t torn_bytes = 0;   ///< After it: never whole, or damaged.
};

struct Record {
  Type type = Type::kFrame;
  TimeUs time_us = 0;  ///< Since the start of the recording.
  Bytes body;
};

/// Reads a recording: in order, or from any time on. A torn tail is not an error: what is whole is read.
///
/// Safe on hostile input: every length is checked against what is there before anything is allocated. Not thread-safe.
class Reader {
 public:
  /// A file without its end is read through once. Errors: kNotFound, kIo, kCorrupt (not a recording),
  /// kIncompatibleVersion.
  static Result<Reader> open(const std::string& path);
  static Result<Reader> over(Bytes bytes);

  /// Looks on, where the file is still being written and has so many bytes now. Whether there are more whole records.
  bool extend(std::uint64_t size);

  const Info& info() const { return info_; }
  const std::vector<IndexEntry>& index() const { return index_; }

  /// The next announcement, memory, frame, checkpoint, object or gap; nothing at the end.
  /// Errors: kCorrupt (a record before the end is damaged).
  Result<std::optional<Record>> next();

  /// Goes to the last checkpoint at or before `time_us`: next() gives its announcement with its memory, then it, then
  /// what followed. Before the first checkpoint: to the beginning. Errors: kCorrupt.
  Result<void> seek(TimeUs time_us);

  /// Whether the recording holds objects of assets; reads the heads of all records. They come by next() from the
  /// beginning. Errors: kCorrupt.
  Result<std::vector<std::uint64_t>> object_offsets();
  /// The object record at an offset that object_offsets() gave. Errors: kCorrupt.
  Result<Record> object_at(std::uint64_t offset);

 private:
  struct Head {
    std::uint32_t length = 0;
    std::uint8_t type = 0;
    TimeUs time_us = 0;
    std::uint32_t crc = 0;
  };
  Reader(std::unique_ptr<std::istream> in, std::uint64_t size);
  static Result<Reader> over_stream(std::unique_ptr<std::istream> in, std::uint64_t size);
  Result<void> begin();
  bool load_end();
  bool load_index(std::uint64_t offset);
  void scan(std::uint64_t offset);
  bool read_at(std::uint64_t offset, std::size_t count, Bytes& out);
  std::optional<Head> head_at(std::uint64_t offset);
  /// The whole record at `offset`, whose head fits into the file and whose sum is right; nothing otherwise.
  std::optional<Record> record_at(std::uint64_t offset);

  std::unique_ptr<std::istream> in_;
  std::uint64_t size_ = 0;
  std::uint64_t at_ = kHeaderBytes;
  std::uint64_t first_ = kHeaderBytes;  ///< The record behind "start".
  std::uint64_t announce_ = 0;          ///< The last that scan() found.
  Info info_;
  std::vector<IndexEntry> index_;
  std::deque<Record> pending_;
};

}  // namespace eigencast::recording
