// SPDX-License-Identifier: MIT
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>

#include "view/surface_view.h"

namespace eigencast::testing {

/// A sphere of 10*4^s + 2 vertices as a complete asset of rank 6: columns 1, x, y, z, xy, y^2 - 1/3 (not orthonormal,
/// which receivers do not need). Rows are in the order of subdivision, so that every prefix from 12 on is a mesh.
inline Asset sphere_asset(int subdivisions, bool as_points = false) {
  using V = std::array<double, 3>;
  std::vector<V> v;
  const double g = 1.618033988749895;
  for (const double s : {-1.0, 1.0}) {
    for (const double t : {-g, g}) v.insert(v.end(), {V{0, s, t}, V{s, t, 0}, V{t, 0, s}});
  }
  std::vector<std::array<std::uint32_t, 3>> faces;
  for (std::uint32_t a = 0; a < 12; ++a) {
    for (std::uint32_t b = a + 1; b < 12; ++b) {
      for (std::uint32_t c = b + 1; c < 12; ++c) {
        const auto near = [&](std::uint32_t i, std::uint32_t j) {
          double d = 0;
          for (int k = 0; k < 3; ++k) d += (v[i][k] - v[j][k]) * (v[i][k] - v[j][k]);
          return d < 4.1;
        };
        if (!near(a, b) || !near(b, c) || !near(a, c)) continue;
        const auto det = v[a][0] * (v[b][1] * v[c][2] - v[b][2] * v[c][1]) -
                         v[a][1] * (v[b][0] * v[c][2] - v[b][2] * v[c][0]) +
                         v[a][2] * (v[b][0] * v[c][1] - v[b][1] * v[c][0]);
        if (det > 0)
          faces.push_back({a, b, c});
        else
          faces.push_back({a, c, b});
      }
    }
  }
  Asset asset;
  for (std::uint32_t i = 0; i < 12; ++i) asset.map.push_back(i);
  for (int level = 0; level < subdivisions; ++level) {
    std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> middle;
    const auto between = [&](std::uint32_t a, std::uint32_t b) {
      const auto [at, fresh] = middle.try_emplace(std::minmax(a, b), static_cast<std::uint32_t>(v.size()));
      if (fresh) {
        V m{v[a][0] + v[b][0], v[a][1] + v[b][1], v[a][2] + v[b][2]};
        const double scale = std::sqrt((1 + g * g) / (m[0] * m[0] + m[1] * m[1] + m[2] * m[2]));
        for (double& value : m) value *= scale;
        v.push_back(m);
        asset.map.push_back(std::min(a, b));
      }
      return at->second;
    };
    std::vector<std::array<std::uint32_t, 3>> finer;
    for (const auto& [a, b, c] : faces) {
      const std::uint32_t ab = between(a, b), bc = between(b, c), ca = between(c, a);
      finer.insert(finer.end(), {{a, ab, ca}, {ab, b, bc}, {ca, bc, c}, {ab, bc, ca}});
    }
    faces = std::move(finer);
  }
  asset.vertex_count = asset.rows_ready = static_cast<std::uint32_t>(v.size());
  asset.rank = 6;
  asset.base_count = 12;
  asset.band_ends = {4, 6};
  asset.area = 12.566370614359172;
  for (std::uint32_t i = 0; i < asset.vertex_count; ++i) {
    const double length = std::sqrt(v[i][0] * v[i][0] + v[i][1] * v[i][1] + v[i][2] * v[i][2]);
    const double x = v[i][0] / length, y = v[i][1] / length, z = v[i][2] / length;
    for (const double value : {1.0, x, y, z, x * y, y * y - 1.0 / 3}) asset.floats.push_back(static_cast<float>(value));
    asset.mass.push_back(static_cast<float>(asset.area / asset.vertex_count));
    asset.source_vertex.push_back(i);
  }
  asset.rest.assign(18, 0);
  asset.rest[3] = asset.rest[7] = asset.rest[11] = 1;
  asset.box_low = {-1, -1, -1};
  asset.box_high = {1, 1, 1};
  asset.name = "sphere";
  if (as_points) return asset;
  std::vector<std::pair<std::uint32_t, std::array<std::uint32_t, 3>>> dying;
  for (const auto& face : faces) {
    auto corner = face;
    std::uint32_t death = 0;
    while (true) {
      auto highest = std::max_element(corner.begin(), corner.end());
      if (*highest < 12) break;
      death = *highest;
      *highest = asset.map[*highest];
      if (corner[0] == corner[1] || corner[1] == corner[2] || corner[0] == corner[2]) break;
      death = 0;
    }
    dying.emplace_back(death, face);
  }
  std::stable_sort(dying.begin(), dying.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  for (const auto& [death, face] : dying) {
    asset.faces.push_back(face);
    asset.death.push_back(death);
  }
  asset.face_total = asset.faces_ready = static_cast<std::uint32_t>(asset.faces.size());
  return asset;
}

/// The sphere made `stretch` times as tall and moved to x = `shift`, as a received key.
inline ReceivedPose sphere_pose(const Asset& asset, std::uint64_t sequence, TimeUs time_us, double stretch,
                                double shift = 0, std::uint32_t epoch = 1) {
  ReceivedPose pose;
  pose.envelope.kind = FrameKind::kKey;
  pose.envelope.bands = 3;
  pose.envelope.epoch = epoch;
  pose.envelope.sequence = sequence;
  pose.envelope.capture_us = pose.arrival_us = pose.decoded_us = time_us;
  pose.coefficients = asset.rest;
  pose.coefficients.edit()[0] = shift;
  pose.coefficients.edit()[7] = stretch;
  return pose;
}

/// Rebuilds on the processor what has changed; true if anything has.
inline bool advance(SurfaceView& view, const PoseSource& source, TimeUs now_us) {
  if (!view.prepare(source, now_us)) return false;
  const RebuildJob job = view.job(*source.asset());
  CpuRebuilder().rebuild({&job, 1});
  view.finish(*source.asset());
  return true;
}

/// A source that a test fills by hand: each poll() returns the next batch.
class FakeSource : public PoseSource {
 public:
  explicit FakeSource(Asset asset) : asset_(std::move(asset)) {
    stats_.state = Subscriber::State::kLive;
    info_.emplace();
    info_->stream = "demo";
    info_->format = {asset_.rank, 3, asset_.band_ends, "quantised"};
  }
  std::vector<ReceivedPose> poll(std::chrono::milliseconds) override {
    if (on_poll) on_poll();
    if (batches.empty()) return {};
    std::vector<ReceivedPose> batch = std::move(batches.front());
    batches.pop_front();
    stats_.keys += batch.size();
    return batch;
  }
  const Asset* asset() const override { return has_asset ? &asset_ : nullptr; }
  std::uint32_t epoch() const override { return has_asset ? epoch_ : 0; }
  const std::optional<control::StreamInfo>& info() const override { return info_; }
  Subscriber::Stats stats() const override { return stats_; }

  std::deque<std::vector<ReceivedPose>> batches;
  std::function<void()> on_poll;
  bool has_asset = true;
  Asset asset_;
  std::uint32_t epoch_ = 1;
  Subscriber::Stats stats_;
  std::optional<control::StreamInfo> info_;
};

}  // namespace eigencast::testing
