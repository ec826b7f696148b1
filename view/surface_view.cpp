// SPDX-License-Identifier: MIT
#include "view/surface_view.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <utility>

#include "sdk/surfaces.h"
#include "view/creases.h"

namespace eigencast {
namespace {

/// From a cube's centre to its corners, edges and sides.
constexpr auto kOutlineDirections = [] {
  std::array<glm::vec3, 26> directions{};
  std::size_t count = 0;
  for (int i = 0; i < 27; ++i) {
    if (i != 13) directions[count++] = glm::vec3(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1);
  }
  return directions;
}();

/// Takes the points that lie farther along a direction than those of the outline.
void widen(std::vector<glm::vec3>& outline, std::span<const float> points) {
  for (std::size_t i = 0; i + 2 < points.size(); i += 3) {
    const glm::vec3 point(points[i], points[i + 1], points[i + 2]);
    for (std::size_t k = 0; k < kOutlineDirections.size(); ++k) {
      if (glm::dot(kOutlineDirections[k], point - outline[k]) > 0) outline[k] = point;
    }
  }
}

/// Leading rows up to the last that is not zero.
std::uint32_t rank_in_use(std::span<const double> coefficients, std::uint32_t channels) {
  std::size_t used = coefficients.size();
  while (used > 0 && coefficients[used - 1] == 0) --used;
  return static_cast<std::uint32_t>((used + channels - 1) / channels);
}

/// But for what interpolation rounds.
bool are_alike(std::span<const double> a, std::span<const double> b) {
  constexpr double kRounding = 1e-12;
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](double x, double y) { return std::abs(x - y) <= kRounding * std::abs(y); });
}

Shown shown_from(FrameKind kind) {
  if (kind == FrameKind::kEstimate) return Shown::kEstimated;
  return kind == FrameKind::kStep ? Shown::kInterpolated : Shown::kLive;
}

}  // namespace

void BandFade::apply(BandMask bands, TimeUs now_us, std::span<const std::uint32_t> band_ends,
                     std::span<const double> shown, Coefficients& wanted) {
  const BandMask changed = shown_bands_.value_or(bands) ^ bands;
  shown_bands_ = bands;
  if (!changed.empty()) {
    fading_ |= changed;
    started_us_ = now_us;
    from_.assign(shown.begin(), shown.end());
  }
  if (fading_.empty()) return;
  if (now_us - started_us_ >= kFadeUs || from_.size() != wanted.size() || band_ends.empty()) {
    fading_ = {};
    return;
  }
  const double share = static_cast<double>(std::max<TimeUs>(0, now_us - started_us_)) / kFadeUs;
  const std::size_t channels = wanted.size() / band_ends.back();
  std::vector<double>& values = wanted.edit();
  for (std::size_t band = 0; band < band_ends.size(); ++band) {
    if (!fading_.has(band)) continue;
    const auto [first, end] = band_range(band_ends, band, channels);
    for (std::size_t i = first; i < end; ++i) values[i] = from_[i] + share * (values[i] - from_[i]);
  }
}

SurfaceView::SurfaceView(const SceneOptions& options)
    : playout_(options.playout),
      wanted_playout_(options.playout),
      lod_(options.lod),
      shading_(options.shading),
      morphs_(options.morph) {
  static std::atomic<std::uint64_t> made{0};
  geometry_.maker = ++made;
}

void SurfaceView::set_playout(const PlayoutSettings& settings) {
  wanted_playout_ = settings;
  playout_.set(is_exact_ ? PlayoutSettings{} : settings);
}

void SurfaceView::receive(const PoseSource& source, const std::vector<ReceivedPose>& poses) {
  if (std::exchange(is_exact_, source.timeline() != nullptr) != is_exact_) set_playout(wanted_playout_);
  follow_epoch(source);
  const Asset* asset = source.asset();
  for (const ReceivedPose& pose : poses) {
    newest_arrival_ = pose.arrival_us;
    if (asset != nullptr && pose.envelope.epoch == epoch_) {
      add_pose(pose, *asset);
    } else {
      ++poses_unusable_;
    }
  }
}

void SurfaceView::follow_epoch(const PoseSource& source) {
  const Asset* asset = source.asset();
  if (asset == nullptr) return;
  const auto& info = source.info();
  const std::string id = info && info->epoch == source.epoch() ? info->asset : std::string();
  if (!has_asset_ || epoch_ != source.epoch()) {
    // A sender that comes back with the same surface: keep what is shown until its first pose.
    const bool same = has_asset_ && !id.empty() && id == asset_id_;
    const ChangeOver* change = source.change();
    const bool goes_on = has_asset_ && change != nullptr && change->from_epoch == epoch_;
    has_asset_ = true;
    epoch_ = source.epoch();
    asset_id_ = id;
    if (goes_on && change_over(*change, *asset)) return;
    if (!same) reconstructor_ = std::make_shared<Reconstructor>();
    playout_.reset();
    shown_time_.reset();
    if (!same) show_rest(*asset);
  } else if (!id.empty()) {
    asset_id_ = id;
  }
}

/// What is shown, and what is to be, as poses of the new asset. Vertices, faces and rest pose are those of before.
bool SurfaceView::change_over(const ChangeOver& change, const Asset& asset) {
  const auto carried = [&](const Coefficients& C, std::uint32_t channels) {
    return change.transfer.apply({C.begin(), C.end()}, channels);
  };
  auto C = carried(coefficients_, channels_);
  if (C.empty()) return false;
  coefficients_ = std::move(C);
  playout_.replace_poses([&](const Coefficients& pose) {
    return Coefficients(carried(pose, static_cast<std::uint32_t>(pose.size() / change.transfer.from_rank())));
  });
  reconstructor_ = change.reconstructor;
  fade_.reset();
  stream_bands_ = {};
  forget_rebuilt();
  triangles_.forget();
  ++level_version_;
  update_barycentre(asset);
  facts_rows_ = asset.rows_ready;
  return true;
}

void SurfaceView::show_rest(const Asset& asset) {
  fade_.reset();
  stream_bands_ = {};
  has_pose_ = false;
  shown_ = Shown::kHeld;
  coefficients_ = asset.rest;
  channels_ = 3;
  forget_rebuilt();
  triangles_.forget();
  ++level_version_;
  facts_rows_ = 0;
}

void SurfaceView::forget_rebuilt() {
  geometry_.positions.clear();
  geometry_.unmorphed.clear();
  geometry_.gpu.reset();
}

void SurfaceView::add_pose(const ReceivedPose& pose, const Asset& asset) {
  if (!pose.envelope.bands.empty()) {
    stream_bands_ = pose.envelope.bands;
    bands_received_ = static_cast<std::uint32_t>(std::popcount(stream_bands_.bits));
  }
  if (pose.channels < 3 || pose.coefficients.size() != std::size_t{asset.rank} * pose.channels) {
    ++poses_unusable_;
    return;
  }
  const Envelope& e = pose.envelope;
  playout_.add({e.capture_us, pose.coefficients, stream_bands_, shown_from(e.kind)}, pose.arrival_us);
  if (pose.next) playout_.add_next({pose.next->capture_us, pose.next->coefficients, pose.next->bands});
}

bool SurfaceView::choose_pose(const PoseSource& source, TimeUs now_us) {
  if (paused_ && has_pose_ && !is_exact_) return false;
  const std::uint32_t rank = source.asset()->rank;
  const auto& info = source.info();
  std::span<const std::uint32_t> band_ends;
  if (info && !info->format.band_ends.empty() && info->format.band_ends.back() == rank)
    band_ends = info->format.band_ends;
  playout_.set_band_ends(band_ends);
  std::optional<PlayoutPose> pose = playout_.at(now_us);
  if (!pose) return false;
  shown_ = pose->shown;
  const bool is_new = shown_time_ != pose->time_us;
  // Once more after settling, so that no error remains.
  if (!is_new && !fade_.fading() && !pose->settling && !settling_) return false;
  settling_ = pose->settling;
  ++times_shown_[static_cast<std::size_t>(shown_)];
  fade_.apply(pose->bands, now_us, band_ends, coefficients_, pose->coefficients);
  channels_ = static_cast<std::uint32_t>(pose->coefficients.size() / rank);
  shown_time_ = pose->time_us;
  if (is_new) ++poses_shown_;
  if (has_pose_ && are_alike(pose->coefficients, coefficients_)) return false;
  coefficients_ = std::move(pose->coefficients);
  has_pose_ = true;
  ++moves_;
  return true;
}

bool SurfaceView::prepare(const PoseSource& source, TimeUs now_us) {
  const Asset* asset = source.asset();
  if (asset == nullptr || !has_asset_ || epoch_ != source.epoch()) return false;
  std::uint32_t N = lod_.vertices(*asset);
  if (N == 0) return false;
  if (max_vertices_) N = std::max(std::min(N, *max_vertices_), asset->base_count);
  const bool new_pose = choose_pose(source, now_us);
  const std::uint32_t had = geometry_.vertex_count();
  const bool new_level = change_level(*asset, N, now_us);
  if (!new_pose && !new_level && !reshades_) return false;
  if (asset->rows_ready > reconstructor_->tiles().rows()) reconstructor_->update(*asset);
  update_facts(source);
  const auto parted = geometry_.corners;
  if (std::exchange(reshades_, false)) part_normals(*asset);
  follow_corners();
  level_changed_ |= new_level;
  if (new_level) ++level_version_;
  const bool all = new_pose || has_detail_ != reconstructor_->has_detail() || parted != geometry_.corners;
  has_detail_ = reconstructor_->has_detail();
  first_to_rebuild_ = all ? 0 : std::min(had, morph_.drawn());
  rank_to_rebuild_ = std::min(asset->rank, std::max(1U, rank_in_use(coefficients_, channels_)));
  return true;
}

bool SurfaceView::change_level(const Asset& asset, std::uint32_t N, TimeUs now_us) {
  const bool jump = !morphs_ || geometry_.vertex_count() == 0 || morph_.drawn() > asset.rows_ready;
  const std::uint32_t before = geometry_.vertex_count();
  if (jump) morph_.jump(N);
  const bool moved = morph_.advance(N, now_us, pace(asset, N)) || morph_.drawn() != before;
  const bool new_faces = triangles_.update(asset, geometry_.triangles);
  reshades_ |= new_faces;
  triangles_.set_level(morph_.drawn(), geometry_.triangles);
  return moved || new_faces;
}

/// A vertex moves by an edge of the coarsest level at most.
MorphPace SurfaceView::pace(const Asset& asset, std::uint32_t N) const {
  const std::uint32_t coarsest = std::max(1U, std::min(N, morph_.whole()));
  return asset.area > 0 ? MorphPace::of(px_per_unit_ * std::sqrt(asset.area / coarsest)) : MorphPace();
}

RebuildJob SurfaceView::job(const Asset& asset) {
  return {&asset,           reconstructor_, coefficients_,     channels_,
          rank_to_rebuild_, &morph_,        first_to_rebuild_, level_changed_ || geometry_.level_version == 0,
          &geometry_};
}

void SurfaceView::finish(const Asset& asset) {
  geometry_.is_point_cloud = asset.is_point_cloud();
  geometry_.point_spacing = static_cast<float>(std::sqrt(std::max(asset.area, 0.0) / morph_.effective()));
  ++geometry_.pose_version;
  level_changed_ = false;
}

std::span<const float> SurfaceView::positions(std::vector<float>& room) const {
  if (!geometry_.gpu) return geometry_.positions;
  room.resize(3 * std::size_t{morph_.drawn()});
  reconstructor_->rebuild(coefficients_, channels_, rank_to_rebuild_, morph_.drawn(), room);
  morph_.blend(triangles_.map(), room);
  return room;
}

std::span<const float> SurfaceView::whole_positions(std::vector<float>& room) const {
  const std::uint32_t N = reconstructor_->tiles().rows();
  room.resize(3 * std::size_t{N});
  reconstructor_->rebuild(coefficients_, channels_, rank_to_rebuild_, N, room);
  return room;
}

glm::vec3 SurfaceView::point(const std::array<std::uint32_t, 3>& rows, const glm::vec3& weights,
                             std::vector<float>& room) const {
  glm::vec3 sum{0};
  for (int i = 0; i < 3; ++i) {
    const std::uint32_t row = rows[static_cast<std::size_t>(i)];
    if (weights[i] == 0) continue;
    if (room.size() < 3 * (std::size_t{row} + 1)) room.resize(3 * (std::size_t{row} + 1));
    const PoseToRebuild pose{coefficients_, channels_, std::span(room).first(3 * (std::size_t{row} + 1))};
    reconstructor_->rebuild({&pose, 1}, rank_to_rebuild_, row + 1, row);
    sum += weights[i] * glm::vec3(room[3 * row], room[3 * row + 1], room[3 * row + 2]);
  }
  return sum;
}

glm::vec3 SurfaceView::barycentre() const {
  glm::dvec3 sum{0};
  const std::size_t rank = std::min(barycentre_weights_.size(), coefficients_.size() / channels_);
  for (std::size_t k = 0; k < rank; ++k) {
    const double* row = coefficients_.begin() + k * channels_;
    sum += barycentre_weights_[k] * glm::dvec3(row[0], row[1], row[2]);
  }
  return glm::vec3(sum);
}

void SurfaceView::include_motion(const PoseSource& source) {
  constexpr std::size_t kMaxPoses = 24, kMaxPoints = 2000;
  const std::span<const std::vector<double>> poses = source.motion();
  const Asset& asset = *source.asset();
  std::vector<float> points(3 * std::min<std::size_t>(asset.rows_ready, kMaxPoints));
  const std::size_t count = std::min(poses.size(), kMaxPoses);
  for (std::size_t i = 0; i < count; ++i) {
    const std::vector<double>& pose = poses[i * poses.size() / count];
    reconstructor_->rebuild(pose, static_cast<std::uint32_t>(pose.size() / asset.rank), asset.rank,
                            static_cast<std::uint32_t>(points.size() / 3), points);
    widen(facts_.outline, points);
  }
}

std::vector<float> SurfaceView::rest_positions(const Asset& asset) const {
  std::vector<float> rest(std::size_t{asset.rows_ready} * 3);
  reconstructor_->rebuild(asset.rest, 3, asset.rank, asset.rows_ready, rest);
  return rest;
}

void SurfaceView::part_normals(const Asset& asset) {
  const bool had = geometry_.corners != nullptr;
  geometry_.corners.reset();
  const float angle = shading_.crease_deg / 57.2957795F;
  const bool authored = shading_.normals == Normals::kAuthored, few = triangles_.faces().size() <= kMaxCreasedFaces,
             wanted = few && (authored || shading_.normals == Normals::kCrease);
  std::vector<Parting> partings(wanted ? triangles_.map().size() : 0);
  bool any = false;
  for (std::size_t v = 0; v < partings.size(); ++v) {
    const std::uint8_t own = authored && v < asset.normals.size() ? asset.normals[v] : 0;
    const bool creased = own == 0 && v < creases_.size() && creases_[v] >= angle;
    partings[v] = own == 2 ? Parting::kKnown : creased ? Parting::kByAngle : Parting::kNone;
    any |= partings[v] != Parting::kNone;
  }
  if (any) {
    const std::vector<float> rest = rest_positions(asset);
    auto corners =
        std::make_shared<CornerNormals>(CornerNormals::Whole{asset.vertex_count, asset.base_count, triangles_.map(),
                                                             triangles_.faces(), triangles_.death(), rest},
                                        partings, std::cos(double{angle}));
    if (!corners->empty()) geometry_.corners = std::move(corners);
  }
  if (had || geometry_.corners) triangles_.mark_all();
}

/// Those of the blocks that have changed.
void SurfaceView::follow_corners() {
  if (geometry_.topology_version != triangles_.version()) {
    geometry_.topology_version = triangles_.version();
    geometry_.triangle_blocks = triangles_.block_versions();
  }
  if (!geometry_.corners) {
    geometry_.corner_triangles.clear();
    geometry_.extra_normals.clear();
    return;
  }
  const std::uint64_t had = std::exchange(corner_version_, triangles_.version());
  const std::vector<std::uint32_t>& triangles = geometry_.triangles;
  geometry_.corner_triangles.resize(triangles.size());
  for (std::size_t block = 0; block < geometry_.triangle_blocks.size(); ++block) {
    if (geometry_.triangle_blocks[block] <= had) continue;
    const std::size_t begin = block * LevelTriangles::kBlock,
                      end = std::min(begin + LevelTriangles::kBlock, triangles.size());
    for (std::size_t corner = begin; corner < end; ++corner)
      geometry_.corner_triangles[corner] = geometry_.corners->at(corner, triangles[corner]);
  }
}

void SurfaceView::update_facts(const PoseSource& source) {
  const Asset& asset = *source.asset();
  if (facts_rows_ == asset.rows_ready) return;
  facts_rows_ = asset.rows_ready;
  // The rest pose as rebuilt here: exact in every basis and for every part that has arrived.
  const std::vector<float> rest = rest_positions(asset);
  facts_.low = facts_.high = {rest[0], rest[1], rest[2]};
  facts_.outline.assign(kOutlineDirections.size(), facts_.low);
  for (std::size_t i = 0; i < rest.size(); i += 3) {
    const glm::vec3 point(rest[i], rest[i + 1], rest[i + 2]);
    facts_.low = glm::min(facts_.low, point);
    facts_.high = glm::max(facts_.high, point);
  }
  widen(facts_.outline, rest);
  include_motion(source);
  creases_.clear();
  geometry_.is_solid = false;
  if (asset.complete() && asset.faces.size() <= kMaxCreasedFaces)
    creases_ = crease_angles(asset.faces, rest, &geometry_.is_solid);
  facts_.up_axis = asset.up_axis;
  ++facts_.version;
  update_barycentre(asset);
}

/// Mass times basis, over the mass; in the harmonic basis only the constant column.
void SurfaceView::update_barycentre(const Asset& asset) {
  barycentre_weights_.assign(asset.rank, 0);
  double mass = 0;
  for (std::size_t i = 0; i < asset.rows_ready; ++i) {
    const double m = asset.mass[i];
    mass += m;
    for (std::size_t k = 0; k < asset.rank; ++k) barycentre_weights_[k] += m * static_cast<double>(asset.entry(i, k));
  }
  for (double& weight : barycentre_weights_) weight /= mass > 0 ? mass : 1;
}

}  // namespace eigencast
