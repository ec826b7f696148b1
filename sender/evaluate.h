// SPDX-License-Identifier: MIT
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "common/asset/asset.h"
#include "common/codec/key.h"
#include "common/core/histogram.h"
#include "common/surface/motion_clip.h"
#include "sdk/bake.h"
#include "sdk/learner.h"
#include "sender/surface_error.h"

namespace eigencast {

/// The clip played again, and coded with a memory of its first pass (PoseMemory).
struct AgainOptions {
  double warp = 1;      ///< Speed of the passes after the first, > 0.
  double noise = 0;     ///< Differs at each pose: rms over the surface, of the diagonal.
  unsigned passes = 2;  ///< Counts the first one; at least 2.
};

/// The clip played in a loop, live: with a memory that MemoryKeeper decides on as it goes.
struct LoopOptions {
  double seconds = 60;
  double rate_hz = 30;
};

/// A stream that learns columns from its first poses. What follows is judged: the rest of the clip and, with
/// AgainOptions, its passes after the first.
struct LearnOptions {
  double seconds = 4;
  double rate_hz = 30;
  const EncodedAsset* encoded = nullptr;  ///< The asset's. Must outlive the evaluation.
};

struct EvaluateOptions {
  CodecKind codec = CodecKind::kQuantised;
  double eps = 0;  ///< Vertex error of quantising, model units (see quantiser_for_error); not of float codecs.
  std::vector<double> levels = {1};     ///< Fractions of the vertices that are drawn.
  bool any_order = false;               ///< As of SourceOptions.
  std::optional<AgainOptions> again{};  ///< Of quantised keys only; likewise:
  std::optional<LoopOptions> loop{};
  std::optional<LearnOptions> learn{};
};

/// What viewers see of a surface that was moving and now rests, while its pose is sent on.
struct StillPose {
  std::size_t settles_after = 0;  ///< Resting poses that still differ from the one before.
  double moves = 0;               ///< Largest rms movement between two poses in the second half of the rest, over
                                  ///< the diagonal.
};

/// Keys of a clip, one after the other.
struct CodedKeys {
  std::uint64_t frames = 0;         ///< Counts neither the first of a stream, which is a join frame, nor its bytes.
  std::uint64_t recalled = 0;       ///< Frames that a memory predicts.
  std::uint64_t payload_bytes = 0;  ///< Without, and
  std::uint64_t wire_bytes = 0;     ///< with envelopes and WebSocket headers.
  double quantising_rms = 0;  ///< Area-weighted rms distance of what is received from what was projected, model units.
  Histogram encode_ns, decode_ns;

  double payload_kbit_per_s(double rate_hz) const;
  double wire_kbit_per_s(double rate_hz) const;
};

/// The passes after the first, thrice: as without a memory, with one, and with one at the error of `plain`.
struct AgainEvaluation {
  AgainOptions options;
  CodedKeys plain, recalled, equal;
  double equal_eps = 0;            ///< Of `equal`, model units.
  std::uint32_t poses = 0;         ///< That the memory holds.
  std::uint64_t memory_bytes = 0;  ///< Side information: what every viewer fetches once.
  std::uint64_t first_use = 0;     ///< Frames from the start of the stream to the first that the memory predicts.

  /// Seconds that the memory takes to save its own bytes; nothing: it never does.
  std::optional<double> payback_s(double rate_hz) const;
  /// Of all passes, the first one and the memory's bytes counted.
  double in_all_kbit_per_s(const CodedKeys& first, double rate_hz) const;
};

/// Against the same without a memory.
struct LoopEvaluation {
  LoopOptions options;
  CodedKeys plain, live;
  Histogram keep_ns;                   ///< MemoryKeeper::add, for each key.
  SurfaceError error;                  ///< Of `live`: basis and codec.
  std::uint32_t poses = 0, roots = 0;  ///< That the memory holds at the end; how often it began anew.
  std::uint64_t memory_bytes = 0;      ///< Side information, requests and messages, and a join for each root.
  std::optional<double> first_use_s;   ///< From the start of the stream to the first key that the memory predicts.
  std::optional<double> paid_back_s;   ///< Likewise, to where all bits are fewer than without, for good.
  std::vector<double> plain_kbit_per_s, kbit_per_s;  ///< By second, headers and memory counted.

  double in_all_kbit_per_s() const;
};

/// Keys, and what viewers see of them.
struct JudgedKeys {
  CodedKeys keys;
  SurfaceError error;
  double eps = 0;  ///< That they were coded with, model units.
};

/// The same poses, without and with columns.
struct LearningGain {
  JudgedKeys plain, learnt;
  JudgedKeys other;  ///< Of a clip's rest: with columns, at as many bits as without. Again: without columns and memory.
};

struct LearnEvaluation {
  LearnOptions options;
  std::size_t poses = 0;               ///< Of the clip, that it learns from.
  std::uint32_t columns = 0;           ///< k; 0: none is worth coding, and all below is as without.
  std::uint64_t bytes = 0;             ///< Side information: manifest and section, which every viewer fetches once.
  std::optional<LearningTrial> trial;  ///< What a sender decides by. Nothing where the poses are too few.
  bool pays = false;                   ///< It decides to learn; the others are judged all the same.
  double learn_ms = 0;                 ///< From the last pose to the columns.
  Histogram add_ns;                    ///< Learner::add, for each pose.
  std::optional<LearningGain> rest;    ///< The clip's other poses.
  std::optional<LearningGain> again;   ///< The passes after the first, with a memory of it.
};

struct Evaluation {
  SurfaceError truncation;           ///< Basis alone.
  SurfaceError total;                ///< Basis and codec: what every receiver at full detail sees.
  std::vector<LevelError> levels;    ///< The same at the levels asked for.
  std::vector<double> rms_by_frame;  ///< Lists that of `total`.
  StillPose still;
  CodedKeys keys;
  std::uint64_t join_bytes = 0;  ///< Counts the join frame at the end.
  std::optional<AgainEvaluation> again;
  std::optional<LoopEvaluation> loop;
  std::optional<LearnEvaluation> learn;
  std::vector<std::string> findings;  ///< Frames that do not follow from the others, a line each; see JumpFinder.
};

nlohmann::json json_from(const RankTrial& trial);

/// The vertex error (model units) that quantising all coefficients of a pose with steps of `step` leaves, where one
/// step of one coefficient moves the surface by step x diagonal (rms): eps = (step diagonal / 2) sqrt(r), by Parseval.
double eps_from_step(const Asset& asset, double step);

/// Errors: the clip's; kInvalidArgument (another order of vertices); kInternal (the decoder differs); kCancelled.
Result<Evaluation> evaluate(const MotionClip& clip, const Asset& asset, const EvaluateOptions& options,
                            const BakeProgress& progress = {});

struct EvaluatedRow {
  std::string basis, detail;
  std::uint32_t rank = 0;
  double diagonal = 0;
  std::uint64_t asset_bytes = 0;
  double eps = 0;  ///< As asked for, model units.
  std::optional<RankTrial> trial;
  Evaluation evaluation;
};

struct EvaluatedClip {
  std::string input, codec;
  double rate_hz = 30;
  bool sweep = false;  ///< State each row's trial.
  std::vector<EvaluatedRow> rows;
};

std::string table_of(const EvaluatedClip& clip);
std::string report_of(const EvaluatedClip& clip);

}  // namespace eigencast
