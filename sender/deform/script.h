// SPDX-License-Identifier: MIT
#pragma once

#include <string_view>
#include <vector>

#include "common/core/result.h"
#include "sender/deform/moves.h"

namespace eigencast::deform {

/// Between keys a cubic with the slopes of Fritsch and Carlson, "Monotone Piecewise Cubic Interpolation", 1980: smooth,
/// and never beyond what two neighbouring keys say. Constant before the first and after the last.
struct Track {
  std::vector<double> times;   ///< Growing, one or more.
  std::vector<double> values;  ///< times.size() x width
  std::size_t width = 1;
  std::vector<double> at(double time_s) const;
};

struct Move {
  enum class Kind { kTwist, kBend, kRotate, kTranslate, kScale, kPosition };
  Kind kind = Kind::kTranslate;
  Frame frame;
  std::vector<std::uint32_t> handles;  ///< Which; all of them are listed too.
  Vec3 centre{};                       ///< A rotation or a scale keeps it.
  Track track;                         ///< Radians; or three components; or three for each handle (kPosition).
};

/// Moves done one after the other to the handles at rest.
class Script {
 public:
  /// Reads JSON as docs/deform.md says. Errors: kCorrupt: where, and why.
  static Result<Script> from_json(std::string_view text, std::span<const Vec3> handles);
  /// "twist" (180 degrees), "bend" (180 degrees) or "both" (90 degrees each), of the bar in Figure 2 of Zhang et al.
  /// 2013, as far as its angles are known; there and back in 4 s. Errors: kNotFound.
  static Result<Script> builtin(std::string_view name, std::span<const Vec3> handles);

  double duration_s() const { return duration_s_; }
  bool loops() const { return loops_; }
  /// A script that loops takes it modulo its duration.
  std::vector<Vec3> handles_at(double time_s) const;

 private:
  std::vector<Vec3> rest_;
  Box box_;
  std::vector<Move> moves_;
  double duration_s_ = 0;
  bool loops_ = false;
  friend class ScriptParser;
};

}  // namespace eigencast::deform
