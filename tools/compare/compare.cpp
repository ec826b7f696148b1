// SPDX-License-Identifier: MIT
#include "tools/compare/compare.h"

#include <array>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>

#include "common/core/files.h"
#include "common/core/text.h"
#include "common/surface/vector.h"

namespace eigencast {
namespace {

using nlohmann::json;

/// The last two are kept, because poses come in order.
class ClipFrames {
 public:
  explicit ClipFrames(const MotionClip& clip) : clip_(clip) {}

  Result<const std::vector<Vec3>*> frame(std::size_t index) {
    for (const Kept& kept : kept_) {
      if (kept.index == index) return &kept.positions;
    }
    Result<std::vector<Vec3>> pose = clip_.pose(index);
    if (!pose) return pose.error();
    std::swap(kept_[0], kept_[1]);
    kept_[1] = {index, std::move(*pose)};
    return &kept_[1].positions;
  }

  Result<std::vector<Vec3>> between(std::size_t first, std::size_t second, double u) {
    const auto a = frame(first);
    if (!a) return a.error();
    std::vector<Vec3> mixed = **a;
    const auto b = frame(second);
    if (!b) return b.error();
    for (std::size_t i = 0; i < mixed.size(); ++i) mixed[i] = mixed[i] + u * ((**b)[i] - mixed[i]);
    return mixed;
  }

 private:
  struct Kept {
    std::optional<std::size_t> index;
    std::vector<Vec3> positions;
  };
  const MotionClip& clip_;
  std::array<Kept, 2> kept_;
};

/// The same frame twice for a key.
struct Span {
  std::size_t first, second;
  double u;
};

std::optional<Span> span_of(const RecordedPose& pose, const SentFrames& sent) {
  if (pose.is_key()) {
    const auto at = sent.find(pose.capture_us);
    if (at == sent.end()) return std::nullopt;
    return Span{at->second, at->second, 0};
  }
  const auto after = sent.upper_bound(pose.capture_us);
  if (after == sent.begin() || after == sent.end()) return std::nullopt;
  return Span{std::prev(after)->second, after->second, static_cast<double>(pose.at) / pose.of};
}

template <typename Line>
Result<void> for_each_line(const std::string& path, Line&& read_line) {
  std::ifstream in(path);
  if (!in) return fail(ErrorCode::kNotFound, path + ": no such file, or it may not be read");
  std::string text;
  for (std::size_t number = 1; std::getline(in, text); ++number) {
    const json line = json::parse(text, nullptr, false);
    try {
      if (line.is_discarded()) return fail(ErrorCode::kCorrupt, path + ":" + std::to_string(number) + ": not JSON");
      read_line(line);
    } catch (const json::exception& error) {
      return fail(ErrorCode::kCorrupt, path + ":" + std::to_string(number) + ": " + error.what());
    }
  }
  return {};
}

}  // namespace

Result<Comparison> compare_with_truth(const MotionClip& clip, const Asset& asset, const SentFrames& sent,
                                      const std::vector<RecordedPose>& received) {
  if (clip.rest().vertex_count() != asset.vertex_count) {
    return fail(ErrorCode::kInvalidArgument, "the asset has " + std::to_string(asset.vertex_count) +
                                                 " vertices, the clip " + std::to_string(clip.rest().vertex_count()) +
                                                 ": they do not belong together");
  }
  Comparison result;
  SurfaceErrorSum keys(asset.diagonal()), interpolated(asset.diagonal());
  SourceRebuilder rebuilder(asset);
  ClipFrames truth(clip);
  for (const RecordedPose& pose : received) {
    if (pose.coefficients.size() != std::size_t{asset.rank} * pose.channels || pose.channels < 3) {
      return fail(ErrorCode::kInvalidArgument, "pose " + std::to_string(pose.sequence) + " has " +
                                                   std::to_string(pose.coefficients.size()) +
                                                   " numbers, the asset needs " + std::to_string(asset.rank) + " x 3");
    }
    const std::optional<Span> span = span_of(pose, sent);
    if (!span) {
      ++result.unmatched;
      continue;
    }
    const Result<std::vector<Vec3>> expected = truth.between(span->first, span->second, span->u);
    if (!expected) return expected.error();
    (pose.is_key() ? keys : interpolated).add(*expected, rebuilder.rebuild(pose.coefficients, pose.channels));
  }
  result.keys = keys.result();
  result.interpolated = interpolated.result();
  if (result.keys.poses + result.interpolated.poses == 0) {
    return fail(ErrorCode::kInvalidArgument,
                "none of the " + std::to_string(received.size()) +
                    " recorded poses has the capture time of a frame that was sent; are both records of one run?");
  }
  return result;
}

Result<SentFrames> read_sent_frames(const std::string& path) {
  SentFrames frames;
  const Result<void> read = for_each_line(path, [&](const json& line) {
    frames[line.at("capture_us").get<TimeUs>()] = line.at("frame").get<std::size_t>();
  });
  if (!read) return read.error();
  return frames;
}

Result<std::vector<RecordedPose>> read_recorded_poses(const std::string& path) {
  std::vector<RecordedPose> poses;
  const Result<void> read = for_each_line(path, [&](const json& line) {
    poses.push_back({.sequence = line.at("sequence"),
                     .at = line.at("at"),
                     .of = line.at("of"),
                     .capture_us = line.at("capture_us"),
                     .channels = line.at("channels"),
                     .coefficients = line.at("coefficients")});
  });
  if (!read) return read.error();
  return poses;
}

Result<void> add_to_report(const Comparison& comparison, const std::string& report_path) {
  json report = json::object();
  if (std::ifstream in(report_path); in) {
    report = json::parse(in, nullptr, false);
    if (!report.is_object())
      return fail(ErrorCode::kCorrupt, report_path + ": is not a JSON object; give another file");
  }
  report["reconstruction"] = {{"keys", json_from(comparison.keys)},
                              {"interpolated", json_from(comparison.interpolated)},
                              {"unmatched", comparison.unmatched}};
  return write_file_atomically(report_path, report.dump(2) + "\n");
}

std::string text_from_comparison(const Comparison& comparison) {
  std::string text;
  const auto add = [&text](const char* what, const SurfaceError& error) {
    text += formatted("%-18s %5zu poses   KG %.3f %%   rms %.2e   max %.2e of the diagonal\n", what, error.poses,
                      error.kg_percent, error.rms, error.max);
  };
  add("keys", comparison.keys);
  add("interpolated", comparison.interpolated);
  if (comparison.unmatched > 0) text += std::to_string(comparison.unmatched) + " poses match no frame that was sent\n";
  return text;
}

}  // namespace eigencast
