// SPDX-License-Identifier: MIT
#include "sender/order_check.h"

#include <algorithm>
#include <utility>

namespace eigencast {
namespace {

constexpr std::uint64_t kFirstPoses = 30;
constexpr TimeUs kPauseUs = 200'000;
constexpr double kCheckUs = 0.1;  // of a vertex or a face, at most

Error other_order(const std::string& where) {
  return fail(ErrorCode::kInvalidArgument,
              where +
                  ": the mesh's faces join vertices that are not neighbours there; mesh and poses are of different "
                  "files, or of different orders of vertices: export them together, with the order of vertices kept");
}

}  // namespace

Result<void> accept_order(const Result<void>& order, bool any_order) {
  if (order || any_order) return {};
  return fail(order.error().code, order.error().message + " (--any-order takes them as they are)");
}

std::vector<std::size_t> sample_frames(std::size_t frame_count, std::size_t most) {
  std::vector<std::size_t> frames(std::min(most, frame_count));
  for (std::size_t i = 0; i < frames.size(); ++i) frames[i] = (i + 1) * frame_count / frames.size() - 1;
  return frames;
}

Result<std::string> check_frames(const Surface& mesh, const MotionClip& clip, const std::vector<std::size_t>& frames,
                                 bool any_order) {
  const VertexOrder order(mesh);
  std::string first;
  std::size_t misfits = 0, certain = 0;
  for (const std::size_t frame : frames) {
    const auto pose = clip.pose(frame);
    if (!pose) return pose.error();
    if (pose->size() != mesh.vertex_count()) continue;  // The projection reports it.
    const Misfit misfit = order.check(*pose);
    if (misfit.kind == Misfit::Kind::kNone) continue;
    if (misfits++ == 0) first = "frame " + std::to_string(frame) + ": " + misfit.text();
    certain += misfit.certain ? 1 : 0;
  }
  if (misfits > 1)
    first +=
        " (and " + std::to_string(misfits - 1) + " more of the " + std::to_string(frames.size()) + " frames checked)";
  if (2 * certain <= frames.size()) return first;
  const auto accepted = accept_order(
      other_order(std::to_string(certain) + " of the " + std::to_string(frames.size()) + " frames checked"), any_order);
  return accepted ? Result<std::string>(first) : accepted.error();
}

TimeUs pause_between_checks(std::uint64_t checked, std::size_t size) {
  const auto check_us = static_cast<TimeUs>(kCheckUs * static_cast<double>(size));
  return checked < kFirstPoses ? 5 * check_us : std::max(kPauseUs, 50 * check_us);
}

Result<std::optional<std::string>> ArrivalCheck::check(std::span<const float> positions, std::uint64_t number,
                                                       TimeUs now_us) {
  if (now_us < next_us_) return std::optional<std::string>();
  next_us_ = now_us + pause_between_checks(checked_ + 1, size_);
  std::vector<Vec3> pose(positions.size() / 3);
  for (std::size_t i = 0; i < positions.size(); ++i) pose[i / 3][i % 3] = double{positions[i]};
  const Misfit misfit = order_.check(pose);
  misfits_ += misfit.kind != Misfit::Kind::kNone ? 1 : 0;
  if (checked_++ == 0 && misfit.certain) {
    const auto accepted = accept_order(other_order("the first pose"), any_order_);
    if (!accepted) return accepted.error();
  }
  if (std::exchange(before_, misfit.kind) == misfit.kind || misfit.kind == Misfit::Kind::kNone)
    return std::optional<std::string>();
  return std::optional("pose " + std::to_string(number) + ": " + misfit.text());
}

}  // namespace eigencast
