// SPDX-License-Identifier: MIT
#pragma once

#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "broker/relay/stream.h"
#include "broker/storage/recorder.h"
#include "common/recording/reader.h"

namespace eigencast::broker {

/// A part of a stream's past, ready for feeds: its keys need no memory, and their capture times go at the speed that
/// was asked for.
struct Passage {
  struct Pose {
    TimeUs at_us = 0;  ///< Microseconds since 1970.
    KeyRecordPtr key;
  };
  struct Beginning {
    control::Announce announced;
    control::StreamInfo::Rewind rewind;
  };
  std::optional<Beginning> begins;  ///< Its first key builds on nothing before it.
  std::deque<Pose> poses;
  bool ends = false;  ///< Nothing more is kept behind these.
};

/// Reads what a Recorder keeps of one stream, also while it is written: from any time on, decoded. Blocks on the disk.
/// Belongs to one thread at a time. The recorder outlives it.
class PastReader {
 public:
  static constexpr std::size_t kMaxPassageBytes = 2 << 20;  ///< Of the keys of one, but for the last.
  static constexpr TimeUs kLiveUs = 1'000'000;              ///< So close to now the present is shown instead.

  static constexpr TimeUs kSeamUs = 1'000'000;  ///< From one file to the next, where that is no gap.

  /// charge  of the memory that keys need
  PastReader(const Recorder& kept, std::string stream, PosesCharge charge)
      : kept_(kept), stream_(std::move(stream)), charge_(std::move(charge)) {}

  /// The pose that was asked for alone; or, where it is of the present, nothing and `ends`. Capture times go on from
  /// `origin_us`. Errors: kNotFound (nothing is kept), kTooLarge (by `charge`), kCorrupt, kIo.
  Result<Passage> seek(const control::Seek& wanted, TimeUs origin_us);
  /// What follows up to a time, or a part of it; beyond a gap its first pose. Errors: as seek().
  Result<Passage> go_on(TimeUs until_us);
  double took_us() const { return took_us_; }  ///< Computing that the last of these took, also where it failed.

 private:
  template <typename Work>
  Result<Passage> timed(Work work);
  Result<Passage> find(const control::Seek& wanted, TimeUs origin_us);
  Result<void> enter(const Recorder::Piece& piece);
  /// Nothing: there is none yet, or none at all (ended_).
  Result<std::optional<recording::Record>> next();
  bool begins_anew(const recording::Record& record) const;
  /// Whether it was a new key.
  Result<bool> decode(const recording::Record& record);
  Result<void> begin(const recording::Record& announce);
  Result<void> load_memory(ByteView ids);
  TimeUs time_of(const recording::Record& record) const { return from_us_ + record.time_us; }
  /// The newest key, with the epoch that begins with it, if one does.
  void add_newest(Passage& passage);

  const Recorder& kept_;
  const std::string stream_;
  const PosesCharge charge_;
  double speed_ = 1;
  std::string file_;
  TimeUs from_us_ = 0;
  std::optional<recording::Reader> reader_;
  std::optional<recording::Record> ahead_;  ///< Read, and not used yet.
  std::optional<TimeUs> newest_us_;         ///< Of the decoder's newest key, if it was not handed out.
  bool ended_ = false;
  bool gap_ = false;                 ///< The file that was entered follows one.
  std::unique_ptr<Stream> decoder_;  ///< Null: nothing is decoded yet.
  std::string announced_;            ///< That the decoder follows.
  std::uint32_t generation_ = 0;
  std::map<std::string, std::shared_ptr<const MemorySegment>> segments_;  ///< Of the memory.
  double took_us_ = 0;
  bool anew_ = true;                                                      ///< The next key begins an epoch.
  KeyRecordPtr last_;                                                     ///< As it was handed out.
  TimeUs first_capture_us_ = 0, origin_us_ = 0;                           ///< Where times of capture went.
};

}  // namespace eigencast::broker
