// SPDX-License-Identifier: MIT
#include "sender/clip_coefficients.h"

#include "common/surface/checks/jumps.h"

namespace eigencast {

Result<std::vector<double>> ClipCoefficients::project(const std::vector<Vec3>& pose, std::size_t frame) const {
  // Vec3 is three doubles without padding.
  static_assert(sizeof(Vec3) == 3 * sizeof(double));
  auto C = projector_->coefficients_from_positions(std::span<const double>(pose.front().data(), 3 * pose.size()));
  if (!C) return in_context("frame " + std::to_string(frame), C.error());
  if (!velocities_) return C;
  const auto moving = clip_->velocity(frame);
  if (!moving) return moving.error();
  auto V = projector_->coefficients_from_vectors(std::span<const double>(moving->front().data(), 3 * moving->size()));
  if (!V) return in_context("velocities of frame " + std::to_string(frame), V.error());
  C->insert(C->end(), V->begin(), V->end());
  return C;
}

Result<ClipCoefficients> ClipCoefficients::create(const MotionClip& clip, const Projector& projector,
                                                  const BakeProgress& progress, bool velocities) {
  ClipCoefficients all(clip, projector, velocities);
  JumpFinder jumps(clip.rest());
  for (std::size_t frame = 0; frame < clip.frame_count(); ++frame) {
    if (progress && !progress(static_cast<double>(frame) / static_cast<double>(clip.frame_count()), "reading frames")) {
      return fail(ErrorCode::kCancelled, "stopped at frame " + std::to_string(frame));
    }
    const auto pose = clip.pose(frame);
    if (!pose) return pose.error();
    jumps.add(*pose);
    const auto C = all.project(*pose, frame);
    if (!C) return C.error();
    if (frame == 0) {
      auto store = CoefficientStore::create(clip.frame_count(), C->size());
      if (store) {
        all.store_.emplace(std::move(*store));
      } else if (store.error().code != ErrorCode::kTooLarge) {
        return store.error();
      }
    }
    if (!all.store_) continue;
    if (const auto put = all.store_->put(frame, *C); !put) return put.error();
  }
  all.findings_ = jumps.findings();
  all.order_ = jumps.order();
  return all;
}

Result<std::vector<double>> ClipCoefficients::at(std::size_t frame) const {
  if (store_) return store_->at(frame);
  const auto pose = clip_->pose(frame);
  if (!pose) return pose.error();
  return project(*pose, frame);
}

}  // namespace eigencast
