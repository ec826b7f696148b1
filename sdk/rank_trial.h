// SPDX-License-Identifier: MIT
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "common/core/result.h"
#include "common/spectral/basis.h"
#include "common/spectral/known_motion.h"
#include "common/surface/surface.h"

namespace eigencast {

/// What a basis is to be good for. Errors are root mean square distances of vertices, basis and coding together, over
/// the diagonal of the rest box.
struct BakeWish {
  /// The fewest bits at 1 / quality times the error of 200 columns, ten groups of products, that are coded to within
  /// 1e-3. Above 0.
  double quality = 1;
  double target_error = 0;  ///< The fewest bits at this error, instead. 0: not asked for.
  double kbit_per_s = 0;    ///< The least error at this rate, headers counted, instead. 0: not asked for.
};

/// One way to stream a surface: its basis, its coding, and what they gave on sample poses.
struct TrialPoint {
  int rank = 0, products = 0;
  double coding = 0;      ///< What quantising may move vertices by (rms), over the diagonal.
  double error = 0;       ///< Basis and coding together, over the diagonal.
  double kbit_per_s = 0;  ///< With envelopes and WebSocket headers.
  bool operator==(const TrialPoint&) const = default;
};

/// Bits or error times e^(rank / 2000): viewers multiply for a column and the asset grows by it, so that a hundred
/// more have to save five percent.
double priced(double value, int rank);

/// What was tried on sample poses, and what was chosen of it.
struct RankTrial {
  /// The first: what quality 1 is measured by. A bake's last: what is chosen, with the basis as the asset rounds it.
  std::vector<TrialPoint> points;
  bool is_made = false;  ///< The poses are deformations of the rest pose, since none were given.
  bool is_rate = false;  ///< A rate was wished for, not an error.
  double asked = 0;      ///< The error or rate wished for.
  TrialPoint chosen = {};

  double held(const TrialPoint& point) const { return is_rate ? point.kbit_per_s : point.error; }
  bool is_met() const { return held(chosen) <= asked; }
};

/// Chooses the point of the fewest bits (or of the least error), priced by its rank, that meets the wish; of several
/// equal ones that of the least error (or of the fewest bits). Without one, the point that misses by least. No other
/// point is better in both, priced bits (error) and error (bits). REQUIRES: at least one point.
RankTrial choose(std::vector<TrialPoint> points, const BakeWish& wish, bool is_made = false);

/// The points that no other beats in both, bits priced by the rank and error: ascending bits, descending error.
std::vector<TrialPoint> front_of(std::vector<TrialPoint> points);

/// What was chosen of how many, and by how much the wish is missed: a line.
std::string text_of(const RankTrial& trial);

/// Bytes of a key's message on the wire: payload, envelope of an even stream, WebSocket header of a server.
std::size_t key_message_bytes(std::size_t payload);

inline constexpr std::size_t kMaxJudges = 16'384;  ///< Vertices that bases are judged by.

/// Poses that bases are judged by, at all of the vertices or, of many, at some: so many that a trial takes a few
/// seconds of one processor, however large the surface and long the clip.
struct SamplePoses {
  std::vector<std::uint32_t> vertices;  ///< At most kMaxJudges, evenly spread over their numbers.
  Eigen::MatrixXd positions;            ///< N x 3 T, T <= 128
  std::vector<std::size_t> run_ends;    ///< Poses of a run follow each other at rate_hz; the last end is T.
  double rate_hz = 30;
  bool is_made = false;  ///< Of deformations of the rest pose.

  std::size_t count() const { return static_cast<std::size_t>(positions.cols()) / 3; }
};

/// Up to eight runs of 16 poses from all over the motion. Poses that cannot be read, or are not finite, end a run: who
/// plays them reports that. Without two poses in a row: what might happen to the rest pose, parts of which turn about
/// joints as limbs do. Errors: kInvalidArgument (poses of another surface).
Result<SamplePoses> sample_poses(const Surface& rest, const KnownMotion* motion);

/// Codes the poses on prefixes of the offers, coarsely to finely, comes closer to the wish on each, and chooses.
///   laplacian  of the surface of which the offers are bases; diagonal, origin  of its box, and its centre of mass
/// Uses the process's threads. Errors: kNumerical (the poses leave the codec's range).
Result<RankTrial> try_ranks(std::span<const OfferedBasis> offers, const Laplacian& laplacian, double diagonal,
                            const Vec3& origin, const SamplePoses& poses, const BakeWish& wish);

}  // namespace eigencast
