// SPDX-License-Identifier: MIT
#include "common/command_line/progress.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "common/core/text.h"

namespace eigencast {

std::string ProgressLine::text(double fraction, std::string_view stage, TimeUs elapsed_us) {
  const double done = std::clamp(fraction, 0.0, 1.0);
  std::string bar(30, '.');
  std::fill_n(bar.begin(), static_cast<int>(done * 30), '#');
  std::string line = formatted("%-24s [%s] %3.0f %%", std::string(stage).c_str(), bar.c_str(), done * 100);
  if (done > 0.02 && done < 1 && elapsed_us > 1'000'000)
    line += formatted("  %.0f s left", std::ceil(static_cast<double>(elapsed_us) * 1e-6 * (1 - done) / done));
  return line;
}

bool ProgressLine::operator()(double fraction, std::string_view stage) {
  const bool go_on = !stops_();
  if (!shown_) return go_on;
  const TimeUs now_us = steady_now_us();
  if (start_us_ < 0) start_us_ = now_us;
  const bool new_stage = stage != stage_;
  stage_ = stage;
  if (!new_stage && now_us - shown_us_ < 100'000 && fraction < 1) return go_on;
  shown_us_ = now_us;
  std::fprintf(stderr, "\r\033[K%s", text(fraction, stage, now_us - start_us_).c_str());
  open_ = true;
  std::fflush(stderr);
  return go_on;
}

void ProgressLine::finish() {
  if (open_) std::fputs("\r\033[K", stderr);
  open_ = false;
}

}  // namespace eigencast
