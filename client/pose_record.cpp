// SPDX-License-Identifier: MIT
#include "client/pose_record.h"

#include <array>
#include <nlohmann/json.hpp>
#include <string_view>

#include "client/hud_text.h"

namespace eigencast {
namespace {

using nlohmann::json;

std::string_view name_of(FrameKind kind) {
  constexpr std::array<std::string_view, 6> kNames{"unknown", "key", "join", "synthetic", "step", "estimate"};
  const auto number = static_cast<std::size_t>(kind);
  return kNames[number < kNames.size() ? number : 0];
}

Result<void> open_file(const std::string& path, std::ofstream& file) {
  if (path.empty()) return {};
  file.open(path, std::ios::trunc);
  return file ? Result<void>() : fail(ErrorCode::kIo, path + ": cannot be written; is its folder there?");
}

}  // namespace

Result<void> PoseRecord::open(const std::string& received, const std::string& shown) {
  if (Result<void> opened = open_file(received, received_); !opened) return opened;
  return open_file(shown, shown_);
}

void PoseRecord::received(std::size_t source, std::span<const ReceivedPose> poses) {
  if (!received_.is_open() || poses.empty()) return;
  for (const ReceivedPose& pose : poses) {
    const Envelope& e = pose.envelope;
    const json line{{"stream", source},
                    {"kind", name_of(e.kind)},
                    {"sequence", e.sequence},
                    {"at", e.step.at},
                    {"of", e.step.of},
                    {"epoch", e.epoch},
                    {"bands", e.bands.bits},
                    {"ahead", (e.flags & Envelope::kAhead) != 0},
                    {"capture_us", e.capture_us},
                    {"arrival_us", pose.arrival_us},
                    {"channels", pose.channels},
                    {"coefficients", std::span(pose.coefficients)}};
    received_ << line.dump() << '\n';
  }
  received_.flush();
}

void PoseRecord::shown(const Scene& scene, TimeUs drawn_us) {
  if (!shown_.is_open()) return;
  for (std::size_t i = 0; i < scene.instances().size(); ++i) {
    const SurfaceView& view = scene.instances()[i].view;
    if (!view.shown_capture_us()) continue;
    const json line{{"surface", i},
                    {"drawn_us", drawn_us},
                    {"capture_us", *view.shown_capture_us()},
                    {"shown", name_of(view.shown())},
                    {"settling", view.settling()},
                    {"vertices", view.geometry().vertex_count()},
                    {"coefficients", view.coefficients()}};
    shown_ << line.dump() << '\n';
  }
}

}  // namespace eigencast
