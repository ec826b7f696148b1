// SPDX-License-Identifier: MIT
#include "common/motion/correction.h"

#include <algorithm>

namespace eigencast {

double Correction::remaining(TimeUs now_us) const {
  return std::clamp(1 - static_cast<double>(now_us - since_us_) / kBlendUs, 0.0, 1.0);
}

void Correction::add(std::span<const double> error, TimeUs now_us) {
  const double share = remaining(now_us);
  const bool same_size = error_.size() == error.size();
  if (!same_size) error_.assign(error.size(), 0);
  for (std::size_t i = 0; i < error.size(); ++i) error_[i] = error_[i] * share + error[i];
  since_us_ = now_us;
}

void Correction::apply(std::span<double> pose, TimeUs now_us) const {
  const double share = remaining(now_us);
  if (share == 0 || pose.size() != error_.size()) return;
  for (std::size_t i = 0; i < pose.size(); ++i) pose[i] += share * error_[i];
}

}  // namespace eigencast
