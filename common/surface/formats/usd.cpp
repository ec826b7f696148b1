// SPDX-License-Identifier: MIT
#include "common/surface/formats/usd.h"

#include <algorithm>
#include <cmath>
#include <span>

#include "common/surface/appearance.h"
#include "common/surface/formats/new_file.h"

namespace eigencast {
namespace {

/// "[(x, y, z), ...]"
template <typename Triple>
std::string tuples(std::span<const Triple> all) {
  std::string text = "[";
  for (const Triple& each : all) {
    text += text.size() > 1 ? ", (" : "(";
    for (std::size_t c = 0; c < 3; ++c) {
      if (c > 0) text += ", ";
      append_number(text, static_cast<float>(each[c]));
    }
    text += ')';
  }
  return text + ']';
}

std::string mesh_of(const Surface& rest) {
  std::string counts = "[", indices = "[";
  for (std::size_t f = 0; f < rest.faces.size(); ++f) {
    counts += f > 0 ? ", 3" : "3";
    for (const std::uint32_t corner : rest.faces[f]) {
      if (indices.size() > 1) indices += ", ";
      append_number(indices, corner);
    }
  }
  return "        int[] faceVertexCounts = " + counts + "]\n        int[] faceVertexIndices = " + indices +
         "]\n        uniform token subdivisionScheme = \"none\"\n        uniform token orientation = \"rightHanded\"\n";
}

/// Discs that about touch, on a surface of the box's size.
std::string widths_of(const Surface& rest) {
  const double diagonal = bounding_box(rest.positions).diagonal();
  std::string text = "        float[] widths = [";
  append_number(text, static_cast<float>(2 * diagonal / std::sqrt(static_cast<double>(rest.vertex_count()))));
  return text + "] (\n            interpolation = \"constant\"\n        )\n";
}

std::string colours_of(const MotionClip& clip) {
  if (clip.appearance() == nullptr) return "";
  std::vector<std::array<float, 3>> linear;
  for (const auto& sRGB : stated_colours(clip.rest(), *clip.appearance())) {
    auto& colour = linear.emplace_back();
    for (std::size_t c = 0; c < 3; ++c) colour[c] = linear_from_srgb(static_cast<float>(sRGB[c]) / 255);
  }
  if (linear.empty()) return "";
  return "        color3f[] primvars:displayColor = " + tuples(std::span<const std::array<float, 3>>(linear)) +
         " (\n            interpolation = \"vertex\"\n        )\n";
}

}  // namespace

Result<void> write_usd(const MotionClip& clip, const std::string& path,
                       const std::function<bool(double fraction)>& progress) {
  const Surface& rest = clip.rest();
  NewFile file(path);
  std::string head = "#usda 1.0\n(\n    defaultPrim = \"surface\"\n    upAxis = \"Y\"\n    startTimeCode = 0\n";
  head += "    endTimeCode = " + std::to_string(clip.frame_count() - 1) + "\n    timeCodesPerSecond = ";
  append_number(head, clip.frame_rate_hz());
  head += "\n    framesPerSecond = ";
  append_number(head, clip.frame_rate_hz());
  head += "\n)\n\ndef Xform \"surface\"\n{\n";
  head += rest.is_point_cloud() ? "    def Points \"points\"\n    {\n" : "    def Mesh \"mesh\"\n    {\n";
  head += rest.is_point_cloud() ? widths_of(rest) : mesh_of(rest);
  head += colours_of(clip) + "        point3f[] points = " + tuples(std::span<const Vec3>(rest.positions)) +
          "\n        point3f[] points.timeSamples = {\n";
  if (const auto written = file.write(head); !written) return written;
  std::string extents = "        }\n        float3[] extent.timeSamples = {\n";
  for (std::size_t frame = 0; frame < clip.frame_count(); ++frame) {
    if (progress && !progress(static_cast<double>(frame) / static_cast<double>(clip.frame_count())))
      return fail(ErrorCode::kCancelled, "stopped at frame " + std::to_string(frame));
    const auto pose = clip.pose(frame);
    if (!pose) return pose.error();
    const std::string key = "            " + std::to_string(frame) + ": ";
    const auto written = file.write(key + tuples(std::span<const Vec3>(*pose)) + ",\n");
    if (!written) return written;
    const Box box = bounding_box(*pose);
    extents += key + tuples(std::span<const Vec3>(std::array{box.low, box.high})) + ",\n";
  }
  if (const auto written = file.write(extents + "        }\n    }\n}\n"); !written) return written;
  return file.finish();
}

}  // namespace eigencast
