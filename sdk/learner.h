// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/asset/asset.h"
#include "common/asset/format/columns.h"
#include "common/core/result.h"
#include "common/reconstruction/reconstruct.h"
#include "common/spectral/snapshots.h"

namespace eigencast {

/// What a stream learnt that its basis misses.
struct LearntColumns {
  ColumnValues columns;  ///< Of unit norm by the asset's masses. Rounding moves vertices alike in all of them.
  std::vector<double> amplitudes;  ///< k, descending: rms over the poses of a coefficient's norm over x, y, z.
};

/// What columns would have brought on poses that they were not learnt from: on the second half of those seen, with
/// columns of the first half. Errors are rms, area-weighted, model units.
struct LearningTrial {
  double basis_error = 0;       ///< What the basis leaves out of those poses, and
  double learnt_error = 0;      ///< with columns.
  double coding_error = 0;      ///< Of quantising, without columns.
  double kbit_per_s = 0;        ///< Without columns, headers counted, and
  double equal_kbit_per_s = 0;  ///< with columns, at the same error of basis and coding together.
  double coarser = 1;           ///< How much coarser coding with columns may be for no more bits than without, and
  double equal_error = 0;       ///< the error of basis and coding together that this leaves.

  /// Seconds that columns of so many bytes take to save these; nothing: they do not pay.
  std::optional<double> payback_s(std::uint64_t bytes) const;
  static constexpr double kStayS = 300;  ///< What a live stream is expected to go on for.
  /// Whether a stream that may go on for kStayS should learn them: coarse coding hides what a basis misses.
  bool pays(std::uint64_t bytes) const;
};

/// Learns from the poses of a stream as they come. Without clocks, and of bounded memory: 24 bytes a vertex for each of
/// at most kMaxPoses poses, fewer of large surfaces. Not thread-safe.
class Learner {
 public:
  static constexpr std::size_t kMaxPoses = 60;
  static constexpr std::uint32_t kMaxColumns = 20;  ///< More bring next to nothing.
  static constexpr std::size_t kMaxBytes = std::size_t{128} << 20;

  /// REQUIRES: the asset is complete.
  explicit Learner(std::shared_ptr<const Asset> asset);

  /// positions: n x 3, in the source's order and space.  C: r x 3, what the Projector made of them. May throw
  /// std::bad_alloc.
  void add(std::span<const float> positions, std::span<const double> C);
  std::size_t poses() const { return snapshots_.count(); }

  /// The columns that capture most of what was missed: of those that move vertices more than coding does.
  ///   eps  as of quantiser_for_error, of the stream
  LearntColumns columns(double eps) const;
  /// Nothing where there are too few poses.
  ///   rate_hz  of the poses that were added
  std::optional<LearningTrial> trial(double eps, double rate_hz) const;

 private:
  std::shared_ptr<const Asset> asset_;
  Reconstructor reconstructor_;
  std::vector<double> weights_;
  Snapshots snapshots_;
  std::vector<std::vector<double>> coefficients_;  ///< C of the snapshots' poses.
  std::vector<float> rebuilt_;
  std::vector<double> residual_;
};

/// The asset with columns that it was given. Errors: as with_columns().
Result<Asset> learnt_asset(const Asset& asset, const EncodedColumns& columns);

}  // namespace eigencast
