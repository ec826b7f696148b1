// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>

#include "broker/storage/recorder.h"
#include "common/recording/writer.h"

namespace eigencast::broker {

inline constexpr std::string_view kRecordingSuffix = ".ecrec";
/// Of what is kept: a file, longer where the memory that each needs would be most of it, and shorter for fast streams.
inline constexpr TimeUs kPieceUs = 60'000'000, kLongestPieceUs = 600'000'000;
inline constexpr std::uint64_t kMaxPieceBytes = 16 << 20;
inline constexpr std::size_t kHolderDigits = 16;  ///< Of the hash of its holder, in its name.

/// What a file takes of the quotas: many small ones cost a folder, and this memory, too.
constexpr std::uint64_t file_cost(std::uint64_t bytes) {
  return std::max(charge_of(bytes), std::uint64_t{64} << 10);
}

/// Now, by the system's clock, since 1970.
inline std::uint64_t unix_now_us() {
  return static_cast<std::uint64_t>(
      std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::system_clock::now().time_since_epoch())
          .count());
}

struct Recorder::Session {
  std::string stream;
  bool automatic = false;  ///< Started by a pattern: ends with the sender.

  // GUARDED_BY(Recorder::mutex_).
  std::string payer;       ///< Of the turns and the queue.
  bool begun = false;      ///< The thread has it, or will.
  bool announced = false;  ///< The present surface, too.
  bool wants_checkpoint = true;
  std::uint32_t memory = 0;  ///< The generation that the file has.
  TimeUs checkpoint_us = 0;
  std::uint64_t keys = 0;          ///< Since then.
  TimeUs begun_us = 0;             ///< Arrival of its first key, where it is one of several files.
  bool follows = false;            ///< What the file before it ended with.
  bool goes_on = false;            ///< The file after it does so.
  std::uint64_t object_bytes = 0;  ///< Of the file.
  std::uint64_t dropped = 0;       ///< Since the last enqueued key.
  bool failed = false;
  TimeUs resume_us = 0;  ///< Not 0: the disk failed, and until then nothing is tried.
  RecordingInfo info;

  // Belong to the thread.
  std::optional<recording::Writer> writer;
  KeptPtr kept;
  CoefficientLayout layout;
  std::string asset;
  std::string holder;        ///< Pays for what is written from now on. Hashed, where that is kept.
  std::set<Sha256> objects;  ///< In the file.
  TimeUs start_us = 0;
  TimeUs start_unix_us = 0;
  std::uint64_t written = 0;  ///< Bytes already counted in the totals.
  std::uint64_t charged = 0;  ///< The same, as the quotas count.
};

struct Recorder::Item {
  enum class Kind { kAnnounce, kKey, kEnd } kind = Kind::kKey;
  SessionPtr session{};
  TimeUs arrival_us = 0;      ///< kAnnounce: of the first key, or 0.
  Bytes frame{};              ///< kKey. Empty: the checkpoint bridges it.
  KeyRecord state{};          ///< kKey, for a checkpoint: without payload. Without `after`: none is due.
  std::uint64_t dropped = 0;  ///< Keys dropped before this one.
  struct Surface {
    control::Announce announced;
    GenerationPtr memory;  ///< Null: none.
    CoefficientLayout layout;
    std::string holder;
  };
  std::unique_ptr<const Surface> begins{};  ///< kAnnounce
};

}  // namespace eigencast::broker
