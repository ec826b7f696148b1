// SPDX-License-Identifier: MIT
#include "common/codec/memory_keeper.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace eigencast {
namespace {

constexpr TimeUs kSecond = 1'000'000;
constexpr std::uint64_t kParts = PoseMemory::kParts;
/// A key comes again where at least a third of its bits is saved, and motion where the phase grows, by at most so much.
constexpr double kComesAgain = 1.0 / 3;
constexpr std::uint64_t kLongestAdvance = 8 * kParts;
constexpr double kRemembering = 1.3;  ///< Bits of a remembered pose over those of a key, before any is known.
constexpr TimeUs kSegmentUs = 4 * kSecond;
constexpr std::size_t kShortest = 16;  ///< Poses of a segment.
/// Values of a segment: coding it takes some 6 ms.
constexpr std::size_t kMostValues = 1 << 17;
constexpr std::size_t kFewestPoses = 32;
constexpr TimeUs kBetweenTries = kSecond / 4;
constexpr TimeUs kLongestGap = kSecond / 4;
constexpr double kForgetting = 1.0 / 64;  ///< Of keys on average, a key; of savings, a second.

double bits_of(std::size_t bytes) {
  return static_cast<double>(bytes) * 8;
}

}  // namespace

Result<void> MemoryKeeper::restore(std::vector<CodedSegment> segments) {
  std::uint64_t poses = 0;
  for (const CodedSegment& segment : segments) poses += segment.segment->poses;
  if (auto fits = PoseMemory::check_size(options_.layout, poses); !fits) return fits;
  segments_ = std::move(segments);
  used_bits_.assign(segments_.size(), 0);
  return {};
}

double MemoryKeeper::distance(const Pose& a, const Pose& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.q.size(); ++i) sum += std::pow(static_cast<double>(a.q[i]) - b.q[i], 2);
  return sum;
}

bool MemoryKeeper::add(const Sent& sent) {
  if (sent.half_spacing == 0 || sent.pose.bands != options_.layout.all_bands()) return false;
  if (!first_us_) first_us_ = last_us_ = decided_us_ = sent.capture_us;
  double plain = bits_of(sent.bytes);
  if (sent.phase) {
    if (const auto coded = encode_key(options_.layout, sent.before, sent.pose, sent.half_spacing))
      plain = bits_of(coded->payload.size());
  }
  const auto gap_us = static_cast<double>(std::clamp<TimeUs>(sent.capture_us - last_us_, 1, kLongestGap));
  key_bits_ += (key_bits_ == 0 ? 1 : kForgetting) * (plain - key_bits_);
  gap_us_ += (gap_us_ <= 1 ? 1 : kForgetting) * (gap_us - gap_us_);
  sent_bits_ += bits_of(sent.bytes);
  const double saved = plain - bits_of(sent.bytes);
  saved_bits_ += saved;
  if (sent.phase) {
    std::uint64_t end = 0;
    for (std::size_t i = 0; i < segments_.size(); ++i) {
      end += segments_[i].segment->poses * kParts;
      if (*sent.phase >= end) continue;
      used_bits_[i] += saved;
      break;
    }
  }
  const bool is_covered = sent.phase && saved >= kComesAgain * plain;
  look_back(sent, plain, is_covered);
  last_us_ = sent.capture_us;
  const bool due = sent.capture_us - decided_us_ >= kSecond;
  if (due) {
    decided_us_ = sent.capture_us;
    take_stock();
  }
  if (!sent.may_grow || sent.capture_us - tried_us_ < kBetweenTries) return false;
  if (options_.at_once) {
    const auto run = due ? run_of_new() : std::nullopt;
    return run && grow(*run, sent, false);
  }
  if (recurred_us_ >= kSecond) {
    if (const auto run = run_ahead()) return grow(*run, sent, false);
  }
  const auto run = due && recurred_us_ < kSecond / 2 ? run_of_credit() : std::nullopt;
  return run && grow(*run, sent, true);
}

/// What the poses of the last minute would save.
void MemoryKeeper::look_back(const Sent& sent, double plain_bits, bool is_covered) {
  bool again = false;
  std::uint64_t like = history_first_ + history_.size();
  if (shadow_) {
    ChainState before = sent.before;
    before.phase = phase_;
    const auto coded = shadow_->encode(before, sent.pose, sent.half_spacing);
    phase_ = coded ? coded->phase : std::nullopt;
    const std::uint64_t phase = phase_.value_or(0) + shadow_first_ * kParts;
    if (phase_ && phase / kParts >= history_first_) {
      const double saved = plain_bits - bits_of(coded->payload.size());
      const std::uint64_t advance = phase - last_phase_;
      again = saved >= kComesAgain * plain_bits && advance > 0 && advance <= kLongestAdvance;
      last_phase_ = phase;
      Pose& pose = history_[phase / kParts - history_first_];
      // The credit of all passes goes to the first one.
      const std::uint64_t number = pose.like >= history_first_ ? pose.like : phase / kParts;
      Pose& first = history_[number - history_first_];
      first.credit += std::max(0.0, bits_of(sent.bytes) - bits_of(coded->payload.size()));
      first.covered |= is_covered, pose.covered |= is_covered;
      if (again) like = number;
    }
  }
  note_pose(sent, like, is_covered);
  const TimeUs since_us = std::clamp<TimeUs>(sent.capture_us - last_us_, 0, kLongestGap);
  recurred_us_ = std::clamp<TimeUs>(recurred_us_ + (again ? since_us : -2 * since_us), 0, kSpanUs);
}

void MemoryKeeper::note_pose(const Sent& sent, std::uint64_t like, bool is_covered) {
  if (sent.pose.step != step_) {
    history_first_ += history_.size();
    history_.clear();
    shadow_.reset(), phase_.reset();
    like = history_first_;
    step_ = sent.pose.step;
  }
  // A held pose teaches nothing.
  if (sent.pose.q == sent.before.newer.q || (!history_.empty() && history_.back().q == sent.pose.q)) return;
  history_.push_back({sent.pose.q, sent.capture_us, like, 0, is_covered});
  if (!PoseMemory::check_size(options_.layout, history_.size())) history_.pop_front(), ++history_first_;
}

/// Once a second.
void MemoryKeeper::take_stock() {
  for (double& used : used_bits_) used *= 1 - kForgetting;
  while (!published_.empty() && last_us_ - published_.front().at_us > kSpanUs) published_.pop_front();
  while (!history_.empty() && last_us_ - history_.front().at_us > kSpanUs) history_.pop_front(), ++history_first_;
  if (phase_ && *phase_ >= (history_first_ - shadow_first_) * kParts) {
    *phase_ -= static_cast<std::uint32_t>((history_first_ - shadow_first_) * kParts);
  } else {
    phase_.reset();
  }
  shadow_first_ = history_first_;
  shadow_.reset();
  if (history_.empty()) return;
  auto poses = std::make_shared<MemorySegment>();
  poses->step = step_;
  poses->poses = static_cast<std::uint32_t>(history_.size());
  poses->values.reserve(history_.size() * options_.layout.size());
  for (const Pose& pose : history_) poses->values.insert(poses->values.end(), pose.q.begin(), pose.q.end());
  if (auto memory = PoseMemory(options_.layout).with(std::move(poses))) shadow_.emplace(std::move(*memory));
}

/// The poses that followed the last time, where the memory is about to end, up to where they come again themselves; for
/// as long as twice what has come again so far, or not yet.
std::optional<MemoryKeeper::Run> MemoryKeeper::run_ahead() const {
  if (!phase_ || last_phase_ / kParts < history_first_) return std::nullopt;
  const std::size_t pose = last_phase_ / kParts - history_first_;
  std::size_t first = pose;
  while (first < history_.size() && history_[first].covered) ++first;
  if (first == history_.size() || history_[first].at_us > history_[pose].at_us + kSecond) return std::nullopt;
  Run run = uncovered_from(first, history_[first].at_us + kSegmentUs);
  // Within a quarter of the way to the next one.
  const double near = 1.0 / 16 * distance(history_[pose], history_[std::min(pose + 1, history_.size() - 1)]);
  for (std::size_t i = std::max(pose, run.first) + kShortest; i < run.last; ++i) {
    if (distance(history_[pose], history_[i]) > near) continue;
    run.last = i + 1;
    run.covers = history_.size();
  }
  return history_[run.last - 1].at_us - history_[first].at_us <= 2 * recurred_us_ ? std::optional(run) : std::nullopt;
}

std::optional<MemoryKeeper::Run> MemoryKeeper::run_of_new() const {
  const auto first = std::find_if(history_.begin(), history_.end(), [](const Pose& pose) { return !pose.covered; });
  if (first == history_.end() || last_us_ - first->at_us < kSecond * 3 / 4) return std::nullopt;
  return uncovered_from(static_cast<std::size_t>(first - history_.begin()), last_us_);
}

/// Begins with a pose that the memory has, if there is one, so that phases lead from that on.
MemoryKeeper::Run MemoryKeeper::uncovered_from(std::size_t first, TimeUs until_us) const {
  Run run{first > 0 ? first - 1 : first, first, 0};
  while (run.last < history_.size() && !history_[run.last].covered && history_[run.last].at_us <= until_us) ++run.last;
  return run;
}

/// The run whose credit exceeds its bits by most (Kadane).
std::optional<MemoryKeeper::Run> MemoryKeeper::run_of_credit() const {
  const double cost = cost_bits_ > 0 ? cost_bits_ : kRemembering * key_bits_;
  Run run, best;
  double sum = 0, most = begin_bits_;
  for (std::size_t i = 0; i < history_.size(); ++i) {
    if (sum <= 0) sum = 0, run.first = i;
    sum += history_[i].credit - cost;
    run.last = i + 1;
    if (sum > most) most = sum, best = run;
  }
  return best.last > 0 ? std::optional(best) : std::nullopt;
}

double MemoryKeeper::allowed_bits() const {
  double allowed = HUGE_VAL;
  if (!options_.at_once) {
    const double stake = key_bits_ * static_cast<double>(kStakeUs) / std::max(gap_us_, 1.0);
    allowed = stake + kLoss * sent_bits_ + saved_bits_ - published_bits_;
  }
  if (options_.bitrate > 0) {
    double lately = 0;
    for (const Published& published : published_) lately += last_us_ - published.at_us <= kSpanUs ? published.bits : 0;
    const auto seconds = static_cast<double>(std::min(last_us_ - *first_us_, kSpanUs)) * 1e-6;
    allowed = std::min(allowed, kShareOfBitrate * options_.bitrate * seconds - lately);
  }
  return allowed;
}

bool MemoryKeeper::grow(Run run, const Sent& sent, bool by_credit) {
  const double allowed = allowed_bits();
  if (cost_bits_ == 0) cost_bits_ = kRemembering * key_bits_;
  tried_us_ = last_us_;
  const auto coded = [&](std::size_t poses) {
    std::vector<Key> keys;
    for (std::size_t i = run.first; i < run.first + poses; ++i)
      keys.push_back({options_.layout.all_bands(), step_, history_[i].q, {}});
    return encode_segment(options_.layout, options_.asset, keys, remembered_half_spacing(sent.half_spacing));
  };
  // Once more where the first one shows that poses take more than was thought.
  for (int tries = 0; tries < 2; ++tries) {
    const double affordable = std::max(0.0, allowed - begin_bits_) / std::max(cost_bits_, 1.0);
    auto most = static_cast<double>(std::max(kFewestPoses, kMostValues / options_.layout.size()));
    most = std::min(most, std::floor(affordable));
    // Few long segments: what is neither the whole nor a second can wait.
    const auto wished = static_cast<double>(run.last - run.first);
    if (most < wished && most * gap_us_ < static_cast<double>(kSecond)) return false;
    const auto poses = static_cast<std::size_t>(std::min(most, wished));
    if (poses < kShortest) return false;
    auto first = coded(1), segment = coded(poses);
    if (!first || !segment) return false;
    const auto bits = static_cast<double>(segment->bytes.size() + kSegmentBytes) * 8;
    begin_bits_ = static_cast<double>(first->bytes.size() + kSegmentBytes) * 8;
    cost_bits_ = (bits - begin_bits_) / static_cast<double>(poses - 1);
    double credit = 0;
    for (std::size_t i = run.first; i < run.first + poses; ++i) credit += history_[i].credit;
    if (by_credit && bits > credit) return false;
    if (bits > allowed) continue;
    make_room(poses);
    segments_.push_back(std::move(*segment));
    used_bits_.push_back(0);
    published_bits_ += bits;
    published_.push_back({last_us_, bits});
    for (std::size_t i = 0; i < history_.size(); ++i) {
      history_[i].credit = 0;  // Was against the memory as it was before.
      history_[i].covered |= i >= run.first && i < std::max(run.first + poses, run.covers);
    }
    return true;
  }
  return false;
}

/// Keeps what saved most lately, up to half of what a memory holds, where so many more poses are too many.
void MemoryKeeper::make_room(std::size_t poses) {
  std::uint64_t held = 0;
  for (const CodedSegment& segment : segments_) held += segment.segment->poses;
  if (PoseMemory::check_size(options_.layout, held + poses)) return;
  std::vector<std::size_t> order(segments_.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  const auto worth = [&](std::size_t i) { return used_bits_[i] / segments_[i].segment->poses; };
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return worth(a) > worth(b); });
  held = 0;
  std::vector<std::size_t> kept;
  for (const std::size_t i : order) {
    const std::uint64_t more = held + segments_[i].segment->poses;
    if (!PoseMemory::check_size(options_.layout, 2 * more) || !PoseMemory::check_size(options_.layout, more + poses))
      continue;
    held = more;
    kept.push_back(i);
  }
  std::sort(kept.begin(), kept.end());
  std::vector<CodedSegment> segments;
  std::vector<double> used;
  for (const std::size_t i : kept) segments.push_back(std::move(segments_[i])), used.push_back(used_bits_[i]);
  segments_ = std::move(segments);
  used_bits_ = std::move(used);
  for (Pose& pose : history_) pose.covered = false;  // By a segment that may be left out.
}

}  // namespace eigencast
