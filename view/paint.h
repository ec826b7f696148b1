// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/core/text.h"
#include "common/reconstruction/numbers.h"
#include "view/pose_source.h"
#include "view/surface_view.h"
#include "view/texture_image.h"
#include "view/texture_levels.h"

namespace eigencast {

/// What colours mean; kAuto: the surface's texture, else its own colours, else clay; kOwn: the file's vertex colours.
enum class Colouring { kAuto, kClay, kOwn, kTextured, kNormals, kMovement, kSpeed, kChannel, kError };

/// Named as --colour takes them.
inline constexpr EnumNames<Colouring, 9> kColouringNames{
    {"auto", "clay", "own", "textured", "normals", "movement", "speed", "channel", "error"}};

struct SurfacePaint {
  enum class Kind { kClay, kScalar, kColour, kNormal, kTexture };
  Kind kind = Kind::kClay;
  std::vector<float> values;  ///< N of kScalar, N x 3 (linear RGB) of kColour, and of kTexture for points and edges.
  std::shared_ptr<const TextureLevels> levels;  ///< kTexture only.
  std::shared_ptr<const Picture> image;         ///< kTexture only.
  bool times_values = false;                    ///< kTexture only: the image is multiplied by values.
  BlockVersions value_blocks;                   ///< Of values, by version.
  std::uint64_t version = 0;                    ///< Grows when kind or values have changed.
};

/// Not thread-safe.
class SurfacePainter {
 public:
  struct Wish {
    Colouring colouring = Colouring::kAuto;
    std::uint32_t channel = 3;  ///< kChannel only.
    std::string scalar{};       ///< kChannel: its name instead, where the stream has names; empty: none.
    bool operator==(const Wish&) const = default;
  };

  /// max_side: the GPU's limit for images.
  void set_images(Decode decode, int max_side) {
    decode_ = decode;
    max_side_ = max_side;
  }
  void paint(const SurfaceView& view, const PoseSource& source, const Wish& wish);
  const SurfacePaint& paint() const { return paint_; }
  /// Range of the finite values of kScalar without the outermost hundredths; nothing if there are none.
  std::optional<std::array<float, 2>> range() const { return range_; }
  /// What the numbers of kChannel are; null where the stream does not say.
  const ScalarChannel* scalar() const { return scalar_ ? &*scalar_ : nullptr; }
  /// Why the surface is clay although the wish was another; else empty.
  const std::string& why_not() const { return why_not_; }
  bool is_waiting() const { return waiting_; }

 private:
  void fill(const SurfaceView& view, const PoseSource& source, const Wish& wish);
  void numbers_of(const SurfaceView& view, std::span<const double> D, NumberOf what);
  void fill_textured(const SurfaceView& view, const Asset& asset);
  void sample_image(const SurfaceView& view, const AssetTexture& texture, const Picture& image);
  void fill_own(const SurfaceView& view, const Asset& asset);
  void fill_speed(const SurfaceView& view, const PoseSource& source);
  void refuse(std::string why);

  SurfacePaint paint_;
  Wish wish_;
  std::uint64_t seen_pose_ = 0, seen_level_ = 0;
  std::uint32_t seen_whole_ = 0;  ///< Vertices that did not move.
  std::optional<std::array<float, 2>> range_;
  std::optional<ScalarChannel> scalar_;
  std::string why_not_;
  bool waiting_ = false;
  bool more_comes_ = false;  ///< kAuto: the surface is not complete.
  Decode decode_ = Decode::kNow;
  int max_side_ = kMaxTextureSide;
  // The previous pose, for streams without velocities.
  std::vector<double> before_, difference_;
  std::optional<TimeUs> before_time_;
  std::vector<float> vectors_;
  std::shared_ptr<TextureLevels> levels_;
};

/// Lists them in the order of key V.
std::vector<SurfacePainter::Wish> wishes_for(const PoseSource& source);

/// Colours stand for numbers, over a range.
bool shows_numbers(const SurfacePainter::Wish& wish);

/// "movement from rest", "channel 4"; "m" if the asset knows its size.
std::string title_of(const SurfacePainter::Wish& wish);
std::string unit_of(const SurfacePainter::Wish& wish, double metres_per_unit);

/// Between round numbers; never shrinks, so that colours do not flicker. Symmetric for values of both signs.
class LegendRange {
 public:
  void reset() { seen_.reset(); }
  void include(const std::array<float, 2>& range);
  bool known() const { return seen_.has_value(); }
  std::array<float, 2> span() const;

 private:
  std::optional<std::array<float, 2>> seen_;
};

/// The smallest of 1, 1.5, 2, 3, 4, 5, 6, 8 times a power of ten that is >= value. REQUIRES: value > 0, finite.
double round_up(double value);

}  // namespace eigencast
