// SPDX-License-Identifier: MIT
#include "sender/progress_line.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace eigencast {

std::string ProgressLine::text(double fraction, std::string_view stage, TimeUs elapsed_us) {
  const double done = std::clamp(fraction, 0.0, 1.0);
  constexpr int kWidth = 30;
  const int filled = static_cast<int>(done * kWidth);
  std::string line(stage);
  if (line.size() < 24) line.resize(24, ' ');
  line += " [" + std::string(static_cast<std::size_t>(filled), '#') +
          std::string(static_cast<std::size_t>(kWidth - filled), '.') + "] ";
  char rest[48];
  std::snprintf(rest, sizeof rest, "%3.0f %%", done * 100);
  line += rest;
  if (done > 0.02 && done < 1 && elapsed_us > 1'000'000) {
    std::snprintf(rest, sizeof rest, "  %.0f s left",
                  std::ceil(static_cast<double>(elapsed_us) * 1e-6 * (1 - done) / done));
    line += rest;
  }
  return line;
}

void ProgressLine::show(double fraction, std::string_view stage, TimeUs now_us) {
  if (!enabled_ || !on_terminal_) return;
  if (start_us_ < 0) start_us_ = now_us;
  const bool new_stage = stage != stage_;
  stage_ = stage;
  if (!new_stage && now_us - shown_us_ < 100'000 && fraction < 1) return;
  shown_us_ = now_us;
  std::fprintf(stderr, "\r\033[K%s", text(fraction, stage, now_us - start_us_).c_str());
  open_ = true;
  std::fflush(stderr);
}

void ProgressLine::finish() {
  if (open_) std::fputs("\r\033[K", stderr);
  open_ = false;
}

}  // namespace eigencast
