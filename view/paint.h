// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "view/pose_source.h"
#include "view/surface_view.h"
#include "view/texture_image.h"
#include "view/texture_levels.h"
#include "view/truth.h"

namespace eigencast {

/// What the colours of the surfaces say; kOwn: the vertices' own, as their file has them; kTextured: the image.
enum class Colouring { kClay, kOwn, kTextured, kNormals, kMovement, kSpeed, kChannel, kError };
inline constexpr int kColourings = 8;

/// "clay", "own", "textured", "normals", "movement", "speed", "channel", "error": as --colour takes them.
std::string_view name_of(Colouring colouring);
std::optional<Colouring> colouring_from_name(std::string_view name);

/// The colours of one surface's vertices, as the renderer takes them.
struct SurfacePaint {
  enum class Kind { kClay, kScalar, kColour, kNormal, kTexture };
  Kind kind = Kind::kClay;
  std::vector<float> values;  ///< N of kScalar, N x 3 (linear RGB) of kColour, and of kTexture for points and edges.
  std::shared_ptr<const TextureLevels> levels;  ///< Of kTexture: where the corners lie,
  std::shared_ptr<const Picture> image;         ///< in what.
  bool times_values = false;                    ///< Of kTexture: the image counts times values.
  std::uint64_t version = 0;                    ///< Grows when kind or values have changed.
};

/// Makes the colours of one surface, anew only where the surface or what is asked for has changed.
///
/// Not thread-safe.
class SurfacePainter {
 public:
  struct Wish {
    Colouring colouring = Colouring::kClay;
    std::uint32_t channel = 3;  ///< Of kChannel.
    bool operator==(const Wish&) const = default;
  };

  /// Who decodes images, and how large they may be for the GPU.
  void set_images(Decode decode, int longest_side) {
    decode_ = decode;
    longest_side_ = longest_side;
  }
  /// Paints the geometry that `view` has now.
  void paint(const SurfaceView& view, const PoseSource& source, const Wish& wish);
  const SurfacePaint& paint() const { return paint_; }
  /// Of the finite values of kScalar, but for the outermost hundredth at each end; nothing if there are none.
  std::optional<std::array<float, 2>> range() const { return range_; }
  /// Why the surface is clay although something else was asked for; empty if it is not.
  const std::string& why_not() const { return why_not_; }
  /// It soon may be another: ask again.
  bool is_waiting() const { return waiting_; }

 private:
  void fill(const SurfaceView& view, const PoseSource& source, const Wish& wish);
  void lengths_of(const SurfaceView& view, std::span<const double> D);
  void fill_textured(const SurfaceView& view, const Asset& asset);
  void sample_image(const SurfaceView& view, const AssetTexture& texture, const Picture& image);
  void fill_own(const SurfaceView& view, const Asset& asset);
  void fill_speed(const SurfaceView& view, const PoseSource& source);
  void refuse(std::string why);

  SurfacePaint paint_;
  Wish wish_;
  std::uint64_t seen_pose_ = 0, seen_level_ = 0;
  std::optional<std::array<float, 2>> range_;
  std::string why_not_;
  bool waiting_ = false;
  Decode decode_ = Decode::kNow;
  int longest_side_ = kMaxTextureSide;
  // For the speed of streams that carry no velocities: the pose before.
  std::vector<double> before_, difference_;
  std::optional<TimeUs> before_time_;
  std::vector<float> vectors_;
  std::shared_ptr<TextureLevels> levels_;
};

/// What may be asked of a source, in the order in which key V goes through it; channels one by one.
std::vector<SurfacePainter::Wish> wishes_for(const PoseSource& source);

/// How the legend calls it: "movement from rest", "channel 4"; and its unit, "m" where the asset knows it.
std::string title_of(const SurfacePainter::Wish& wish);
std::string unit_of(const SurfacePainter::Wish& wish, double metres_per_unit);

/// The span of a legend: keeps what it has seen, from a round number to a round number, so that colours do not flicker.
/// Values of both signs get a span with zero in its middle.
class LegendRange {
 public:
  void reset() { seen_.reset(); }
  void include(const std::array<float, 2>& range);
  bool known() const { return seen_.has_value(); }
  std::array<float, 2> span() const;

 private:
  std::optional<std::array<float, 2>> seen_;
};

/// The least of 1, 1.5, 2, 3, 4, 5, 6, 8 times a power of ten that is no less than `value`. REQUIRES: value > 0,
/// finite.
double round_up(double value);

}  // namespace eigencast
