// SPDX-License-Identifier: MIT
#include "broker/storage/history.h"

#include <filesystem>
#include <string>

#include "broker/storage/past_reader.h"
#include "common/wire/limits.h"

namespace eigencast::broker {
namespace {

constexpr double kLookUs = 0.3;  ///< At a file that is kept.

}  // namespace

History::History(const Recorder::Settings& settings, AssetStore& assets, const LogSink& log) {
  std::error_code ignored;
  if (settings.streams.empty()) {
    std::filesystem::remove_all(settings.folder, ignored);
  } else {
    kept = std::make_unique<Recorder>(settings, assets, log);
  }
}

control::History History::of(std::string_view stream, TimeUs now_us, double* work_us) const {
  control::History history{std::string(stream)};
  if (!kept) return history;
  history.now_us = kept->unix_from_steady(now_us);
  const auto pieces = kept->pieces(stream);
  if (work_us != nullptr) *work_us += kLookUs * static_cast<double>(pieces.size());
  for (const Recorder::Piece& piece : pieces) {
    const bool live = piece.growing && &piece == &pieces.back();
    const TimeUs to_us = live ? std::max(history.now_us, piece.to_us) : piece.to_us;
    if (!history.spans.empty() && piece.from_us - history.spans.back().to_us <= PastReader::kSeamUs) {
      history.spans.back().to_us = to_us;
    } else {
      history.spans.push_back({piece.from_us, to_us});
    }
  }
  if (history.spans.size() > limits::kMaxSpans)
    history.spans.erase(history.spans.begin(), history.spans.end() - std::ptrdiff_t{limits::kMaxSpans});
  return history;
}

}  // namespace eigencast::broker
