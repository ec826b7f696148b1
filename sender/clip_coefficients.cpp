// SPDX-License-Identifier: MIT
#include "sender/clip_coefficients.h"

#include <unistd.h>

#include <algorithm>
#include <cassert>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>

#include "common/surface/checks/jumps.h"

namespace eigencast {
namespace {

/// Null, with errno, where none can be made.
std::FILE* temporary_file() {
  std::error_code code;
  std::string name = (std::filesystem::temp_directory_path(code) / "eigencast-coefficients-XXXXXX").string();
  const int descriptor = code ? -1 : ::mkstemp(name.data());
  if (descriptor < 0) return nullptr;
  ::unlink(name.c_str());
  return ::fdopen(descriptor, "w+");
}

}  // namespace

Result<CoefficientStore> CoefficientStore::create(std::size_t frames, std::size_t values,
                                                  std::uint64_t max_bytes_in_memory) {
  const std::uint64_t bytes = std::uint64_t{frames} * values * sizeof(double);
  if (bytes <= max_bytes_in_memory) {
    CoefficientStore store(values, {nullptr, &std::fclose});
    store.memory_.resize(frames * values);
    return store;
  }
  if (bytes > kMaxBytesOnDisk) {
    return fail(ErrorCode::kTooLarge, std::to_string(bytes >> 20) + " MiB of coefficients; at most " +
                                          std::to_string(kMaxBytesOnDisk >> 20) + " are kept");
  }
  File file(temporary_file(), &std::fclose);
  if (!file)
    return fail(ErrorCode::kIo, std::string("no temporary file can be made: ") + std::strerror(errno) +
                                    "; name another folder in TMPDIR");
  return CoefficientStore(values, std::move(file));
}

bool CoefficientStore::seek(std::size_t frame) const {
  return ::fseeko(file_.get(), static_cast<off_t>(frame * values_ * sizeof(double)), SEEK_SET) == 0;
}

Result<void> CoefficientStore::put(std::size_t frame, const std::vector<double>& C) {
  assert(C.size() == values_);
  if (!on_disk()) {
    std::copy(C.begin(), C.end(), memory_.begin() + static_cast<std::ptrdiff_t>(frame * values_));
    return {};
  }
  if (seek(frame) && std::fwrite(C.data(), sizeof(double), values_, file_.get()) == values_ &&
      std::fflush(file_.get()) == 0)
    return {};
  return fail(ErrorCode::kIo, std::string("the temporary file of coefficients cannot be written: ") +
                                  std::strerror(errno) + "; name a folder with more room in TMPDIR");
}

Result<std::vector<double>> CoefficientStore::at(std::size_t frame) const {
  std::vector<double> C(values_);
  if (!on_disk()) {
    std::copy_n(memory_.begin() + static_cast<std::ptrdiff_t>(frame * values_), values_, C.begin());
    return C;
  }
  if (seek(frame) && std::fread(C.data(), sizeof(double), values_, file_.get()) == values_) return C;
  return fail(ErrorCode::kIo, "the temporary file of coefficients cannot be read");
}

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
