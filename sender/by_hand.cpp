// SPDX-License-Identifier: MIT

#include <nlohmann/json.hpp>

#include "sender/live.h"
#include "sender/studio/studio.h"
#include "sender/studio/thumbnail.h"

namespace eigencast {
namespace {

nlohmann::json json_from(const Histogram& us) {
  return {{"count", us.count()}, {"p50", us.percentile(50)}, {"p99", us.percentile(99)}, {"max", us.max()}};
}

}  // namespace

Result<void> write_thumbnail(const Asset& asset, std::span<const double> C, const std::string& path) {
  return studio::write_thumbnail(asset, C, path);
}

Result<void> find_display() {
  return studio::find_display();
}

Result<std::string> deform_by_hand(const DeformCommand& command, deform::Deformer& deformer,
                                   deform::ProjectedDeformer& projected, const Asset& asset, Publisher& publisher,
                                   Interrupt& interrupt) {
  studio::Options options;
  options.title = "Eigencast - " + (asset.name.empty() ? "deform" : asset.name);
  options.view = command.view;
  options.width = command.width;
  options.height = command.height;
  options.rate_hz = command.rate_hz;
  options.duration_s = command.duration_s;
  for (const TargetOptions& other : command.watch) {
    options.watch.push_back(
        {.url = other.url, .profile = {}, .cache_dir = command.source.cache_dir, .credentials = other.credentials});
  }
  const auto report = studio::run(
      options, deformer, projected, asset, publisher, [&interrupt] { return interrupt.requested(); }, to_log());
  if (!report) return report.error();
  const Publisher::Stats stats = publisher.stats();
  const studio::PaintingReport& painting = report->painting;
  const nlohmann::json json{{"frames_sent", stats.frames_sent},
                            {"frames_dropped", stats.frames_dropped},
                            {"bytes", stats.payload_bytes},
                            {"frames_recalled", stats.frames_recalled},
                            {"memory_bytes", stats.memory_bytes},
                            {"saved_bytes", stats.saved_bytes},
                            {"handles", deformer.handles().size()},
                            {"poses_by_hand", report->poses},
                            {"poses_held_back", report->held_back},
                            {"rms_over_diagonal", report->rms},
                            {"max_over_diagonal", report->max},
                            {"input_to_coefficients_us", json_from(report->input_to_coefficients_us)},
                            {"input_to_sent_us", json_from(report->input_to_sent_us)},
                            {"input_to_pose_us", json_from(report->input_to_pose_us)},
                            {"input_to_drawn_us", json_from(painting.input_to_drawn_us)},
                            {"pictures", painting.pictures},
                            {"others_poses", painting.others_poses},
                            {"graphics", painting.device}};
  return json.dump(2);
}

}  // namespace eigencast
