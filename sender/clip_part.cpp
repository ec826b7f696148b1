// SPDX-License-Identifier: MIT
#include "sender/clip_part.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "common/core/text.h"
#include "common/motion/curve.h"
#include "common/progressive/prefix.h"
#include "common/surface/vector.h"

namespace eigencast {
namespace {

constexpr std::size_t kPosesOfLevel = 8;  ///< That a level is chosen by.
constexpr TimeUs kStep = 1'000'000;       ///< From a pose to the next, as catmull_rom_weights() takes it.

class PartOfClip final : public MotionClip {
 public:
  PartOfClip(std::unique_ptr<MotionClip> clip, double from_s, double rate_hz, std::size_t count)
      : clip_(std::move(clip)), from_s_(from_s), rate_hz_(rate_hz), count_(count), rest_(clip_->rest()) {
    if (clip_->appearance() != nullptr) appearance_ = *clip_->appearance();
  }

  /// Errors: those of the clip and of build_prefix_order.
  Result<void> take_level(double level) {
    std::vector<std::vector<Vec3>> poses;
    for (std::size_t i = 0; i < std::min(kPosesOfLevel, count_); ++i) {
      auto taken = pose(i * count_ / std::min(kPosesOfLevel, count_));
      if (!taken) return taken.error();
      poses.push_back(*std::move(taken));
    }
    const auto prefix = build_prefix_order(clip_->rest(), {}, poses);
    if (!prefix) return prefix.error();
    const auto wanted = static_cast<std::uint32_t>(std::lround(level * static_cast<double>(prefix->order.size())));
    const std::uint32_t N = std::max(wanted, prefix->base_count);
    rows_.assign(prefix->order.begin(), prefix->order.begin() + N);
    rest_.positions = chosen(clip_->rest().positions);
    rest_.faces.assign(prefix->faces.begin(), prefix->faces.begin() + prefix_face_count(prefix->death, N));
    for (Face& face : rest_.faces) {
      for (std::uint32_t& corner : face) corner = prefix_corner(prefix->map, corner, N);
    }
    if (appearance_)
      appearance_ =
          Appearance{chosen(stated_colours(clip_->rest(), *appearance_)), {}, {}, {}, {}, {}, {}, appearance_->missing};
    return {};
  }

  const Surface& rest() const override { return rest_; }
  std::size_t frame_count() const override { return count_; }
  double frame_rate_hz() const override { return rate_hz_; }
  std::string name() const override { return clip_->name(); }
  std::vector<std::string> notes() const override { return clip_->notes(); }
  const Appearance* appearance() const override { return appearance_ ? &*appearance_ : nullptr; }

  Result<std::vector<Vec3>> pose(std::size_t frame) const override {
    const auto last = static_cast<std::int64_t>(clip_->frame_count()) - 1;
    const double at = (from_s_ + static_cast<double>(frame) / rate_hz_) * clip_->frame_rate_hz();
    const auto from = std::min(static_cast<std::int64_t>(at + 1e-6), last);
    const auto part = static_cast<TimeUs>(std::llround((at - static_cast<double>(from)) * double{kStep}));
    std::vector<Vec3> result;
    if (part <= 0 || from == last) {
      if (const auto good = store(result, kept(from)); !good) return good.error();
    } else {
      const auto there = [&](std::int64_t i) { return i >= 0 && i <= last; };
      const CurveWeights w = catmull_rom_weights(there(from - 1) ? std::optional(-kStep) : std::nullopt, 0, kStep,
                                                 there(from + 2) ? std::optional(2 * kStep) : std::nullopt, part);
      const std::array<std::pair<std::int64_t, double>, 4> terms{
          {{from - 1, w.before}, {from, w.from}, {from + 1, w.to}, {from + 2, w.after}}};
      result.resize(clip_->rest().vertex_count());
      for (const auto& [number, weight] : terms) {
        if (weight == 0) continue;
        const auto term = kept(number);
        if (!term) return term.error();
        for (std::size_t i = 0; i < result.size(); ++i) result[i] = result[i] + weight * (*term)[i];
      }
    }
    poses_.erase(poses_.begin(), poses_.lower_bound(from - 1));
    return rows_.empty() ? result : chosen(result);
  }

 private:
  /// A pose of the clip, which may take long to read and is needed by its neighbours.
  Result<std::vector<Vec3>> kept(std::int64_t number) const {
    if (const auto found = poses_.find(number); found != poses_.end()) return found->second;
    auto read = clip_->pose(static_cast<std::size_t>(number));
    if (!read) return read;
    if (poses_.size() > 4) poses_.clear();
    return poses_[number] = *std::move(read);
  }
  template <typename T>
  std::vector<T> chosen(const std::vector<T>& all) const {
    std::vector<T> some;
    for (std::size_t i = 0; i < rows_.size() && !all.empty(); ++i) some.push_back(all[rows_[i]]);
    return some;
  }

  const std::unique_ptr<MotionClip> clip_;
  const double from_s_, rate_hz_;
  const std::size_t count_;
  Surface rest_;
  std::vector<std::uint32_t> rows_;  ///< Of the clip's vertices; empty: all.
  std::optional<Appearance> appearance_;
  mutable std::map<std::int64_t, std::vector<Vec3>> poses_;
};

}  // namespace

Result<std::unique_ptr<MotionClip>> part_of(std::unique_ptr<MotionClip> clip, const ClipPart& part) {
  const double rate_hz = part.rate_hz > 0 ? part.rate_hz : clip->frame_rate_hz();
  const double length_s = static_cast<double>(clip->frame_count()) / clip->frame_rate_hz();
  if (part.from_s >= length_s)
    return fail(ErrorCode::kInvalidArgument,
                formatted("begins %g s into a clip of %g s; name an earlier time", part.from_s, length_s));
  const double duration_s =
      part.duration_s > 0 ? std::min(part.duration_s, length_s - part.from_s) : length_s - part.from_s;
  const auto count = static_cast<std::size_t>(std::max(1.0, std::ceil(duration_s * rate_hz - 1e-6)));
  if (count > kMaxClipFrames)
    return fail(ErrorCode::kTooLarge,
                formatted("%zu poses at %g a second; the most are %zu", count, rate_hz, kMaxClipFrames));
  if (part.level >= 1 && part.from_s == 0 && count == clip->frame_count() && rate_hz == clip->frame_rate_hz())
    return clip;
  auto result = std::make_unique<PartOfClip>(std::move(clip), part.from_s, rate_hz, count);
  if (part.level < 1) {
    if (const auto taken = result->take_level(part.level); !taken) return taken.error();
  }
  return std::unique_ptr<MotionClip>(std::move(result));
}

}  // namespace eigencast
