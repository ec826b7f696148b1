// SPDX-License-Identifier: MIT
#include "view/paint.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <utility>

#include "common/surface/appearance.h"

namespace eigencast {
namespace {

const std::array<float, 256> kLight = [] {
  std::array<float, 256> light{};
  for (std::size_t i = 0; i < light.size(); ++i) light[i] = linear_from_srgb(static_cast<float>(i) / 255);
  return light;
}();
constexpr TimeUs kMaxIntervalUs = 1'000'000;  // poses further apart give no speed

/// `count` columns of C from `first` on, times `scale`, as r x 3; missing ones are zero.
std::vector<double> columns_of(std::span<const double> C, std::uint32_t channels, std::uint32_t first,
                               std::uint32_t count, double scale = 1) {
  const std::size_t rank = C.size() / channels;
  std::vector<double> D(rank * 3, 0.0);
  for (std::size_t k = 0; k < rank; ++k) {
    for (std::uint32_t d = 0; d < count && first + d < channels; ++d)
      D[3 * k + d] = scale * C[k * channels + first + d];
  }
  return D;
}

std::uint32_t scalar_channels(const PoseSource& source) {
  if (!source.info()) return 0;
  const auto& format = source.info()->format;
  return format.channels < 3 + format.velocity_channels ? 0 : format.channels - 3 - format.velocity_channels;
}

}  // namespace

void SurfacePainter::paint(const SurfaceView& view, const PoseSource& source, const Wish& wish) {
  const std::uint64_t pose = view.geometry().pose_version;
  // What was refused may have become possible, such as a truth that was being prepared.
  const bool done = wish == wish_ && why_not_.empty() && !more_comes_;
  if (pose == seen_pose_ && done) return;
  const bool settled = done && seen_level_ == view.level_version();
  // Colours that do not depend on the pose.
  const bool still = paint_.kind == SurfacePaint::Kind::kColour || paint_.kind == SurfacePaint::Kind::kTexture;
  if (settled && still) return;
  seen_level_ = view.level_version();
  const bool is_new = !(wish == wish_);
  wish_ = wish;
  seen_pose_ = pose;
  why_not_.clear();
  more_comes_ = false;
  if (wish.colouring == Colouring::kClay && paint_.kind == SurfacePaint::Kind::kClay) return;
  if (is_new) before_time_.reset();
  waiting_ = false;
  fill(view, source, wish);
  const std::uint32_t whole = view.morph().whole(), before = std::exchange(seen_whole_, whole);
  if (!done || !still)
    paint_.value_blocks.clear();
  else
    mark_from(3 * std::size_t{std::min(before, whole)}, paint_.values.size(), paint_.version + 1, paint_.value_blocks);
  range_ = paint_.kind == SurfacePaint::Kind::kScalar ? range_without_outliers(paint_.values) : std::nullopt;
  ++paint_.version;
}

void SurfacePainter::fill(const SurfaceView& view, const PoseSource& source, const Wish& wish) {
  const Asset* asset = source.asset();
  const std::uint32_t N = view.geometry().vertex_count();
  const std::span<const double> C = view.coefficients();
  if (asset == nullptr || N == 0 || C.empty() || C.size() % asset->rank != 0 || N > asset->rows_ready)
    return refuse("");  // nothing has come yet
  const auto channels = static_cast<std::uint32_t>(C.size() / asset->rank);
  paint_.kind = SurfacePaint::Kind::kScalar;
  scalar_.reset();
  switch (wish.colouring) {
    case Colouring::kAuto:
      more_comes_ = !asset->complete();
      if (asset->texture) return fill_textured(view, *asset);
      return asset->colours.size() >= N ? fill_own(view, *asset) : refuse("");
    case Colouring::kClay:
      return refuse("");
    case Colouring::kNormals:
      paint_.kind = SurfacePaint::Kind::kNormal;
      paint_.values.clear();
      return;
    case Colouring::kOwn:
      return fill_own(view, *asset);
    case Colouring::kTextured:
      return fill_textured(view, *asset);
    case Colouring::kMovement: {
      std::vector<double> D = columns_of(C, channels, 0, 3);
      for (std::size_t i = 0; i < D.size(); ++i) D[i] -= asset->rest[i];
      return numbers_of(view, D, NumberOf::kLength);
    }
    case Colouring::kSpeed:
      return fill_speed(view, source);
    case Colouring::kChannel: {
      const auto known = source.info() ? source.info()->format.scalars : std::vector<ScalarChannel>();
      const auto named = std::find_if(known.begin(), known.end(), [&](const auto& s) { return s.name == wish.scalar; });
      const std::size_t k = wish.scalar.empty() ? wish.channel - 3 : static_cast<std::size_t>(named - known.begin());
      if (k < known.size()) scalar_ = known[k];
      if (k >= channels - 3 || (!wish.scalar.empty() && named == known.end()))
        return refuse("the stream has no " + title_of(wish));
      return numbers_of(view, columns_of(C, channels, static_cast<std::uint32_t>(3 + k), 1), NumberOf::kFirst);
    }
    case Colouring::kError: {
      Truth* truth = source.truth();
      paint_.values.resize(N);
      if (truth == nullptr) return refuse("nothing to compare with: --truth FILE or --compare STREAM names it");
      if (!truth->errors(C, channels, view.shown_capture_us(), view.positions(vectors_), paint_.values))
        refuse(truth->why());
      more_comes_ = truth->difference().has_value();  // the other may move alone
      return;
    }
  }
}

void SurfacePainter::fill_own(const SurfaceView& view, const Asset& asset) {
  const std::size_t N = view.geometry().vertex_count();
  if (asset.colours.size() < N) return refuse("the surface has no colours of its own");
  paint_.kind = SurfacePaint::Kind::kColour;
  paint_.values.resize(3 * N);
  for (std::size_t i = 0; i < N; ++i) {
    for (std::size_t c = 0; c < 3; ++c) paint_.values[3 * i + c] = kLight[asset.colours[i][c]];
  }
  view.blend(paint_.values);
}

void SurfacePainter::fill_textured(const SurfaceView& view, const Asset& asset) {
  if (!asset.texture) {
    return refuse(asset.complete() || asset.is_point_cloud() ? "the surface has no texture"
                                                             : "the texture comes with the last of the surface");
  }
  TextureImage image = image_of(asset.texture, decode_, max_side_);
  if (image.failed) return refuse(image.failed->message);
  waiting_ = !image.picture;
  if (waiting_) return refuse("the texture is being decoded");
  paint_.times_values = !asset.colours.empty();
  paint_.times_values ? fill_own(view, asset) : sample_image(view, *asset.texture, *image.picture);
  if (!levels_) levels_ = std::make_shared<TextureLevels>();
  levels_->follow(asset.texture, view.geometry(), view.morph());
  paint_.kind = SurfacePaint::Kind::kTexture;
  paint_.levels = levels_;
  paint_.image = std::move(image.picture);
}

void SurfacePainter::sample_image(const SurfaceView& view, const AssetTexture& texture, const Picture& image) {
  const std::size_t N = view.geometry().vertex_count();
  paint_.values.assign(3 * N, 1);
  const auto pixel = [](float part, int size) {
    const float inside = part - std::floor(part);
    return std::min(static_cast<int>(inside * static_cast<float>(size)), size - 1);
  };
  for (std::size_t i = 0; i < N; ++i) {
    const std::uint32_t wedge = texture.first_wedge[i];
    if (wedge == texture.first_wedge[i + 1] || texture.uvs[wedge] == AssetTexture::kNone) continue;
    const std::array<float, 2> uv = texture.uv(wedge);
    const std::uint8_t* texel = image.pixel(pixel(uv[0], image.width), pixel(uv[1], image.height));
    for (std::size_t c = 0; c < 3; ++c) paint_.values[3 * i + c] = kLight[texel[c]];
  }
  view.blend(paint_.values);
}

void SurfacePainter::refuse(std::string why) {
  paint_.kind = SurfacePaint::Kind::kClay;
  paint_.values.clear();
  why_not_ = std::move(why);
}

void SurfacePainter::numbers_of(const SurfaceView& view, std::span<const double> D, NumberOf what) {
  paint_.values.resize(view.geometry().vertex_count());
  numbers_from_coefficients(view.reconstructor(), D, what, vectors_, paint_.values);
}

void SurfacePainter::fill_speed(const SurfaceView& view, const PoseSource& source) {
  const std::span<const double> C = view.coefficients();
  const auto channels = static_cast<std::uint32_t>(C.size() / source.asset()->rank);
  const auto& info = source.info();
  if (info && info->format.velocity_channels >= 3 && info->format.channels == channels) {
    const std::uint32_t first = channels - info->format.velocity_channels;
    return numbers_of(view, columns_of(C, channels, first, 3, 1e6 / static_cast<double>(info->format.velocity_us)),
                      NumberOf::kLength);
  }
  const TimeUs now = view.shown_capture_us().value_or(0);
  const std::vector<double> X = columns_of(C, channels, 0, 3);
  if (before_time_ && *before_time_ != now && before_.size() == X.size()) {
    const TimeUs step = now - *before_time_;
    difference_.assign(X.size(), 0.0);
    if (step > 0 && step <= kMaxIntervalUs) {
      for (std::size_t i = 0; i < X.size(); ++i) difference_[i] = (X[i] - before_[i]) * 1e6 / static_cast<double>(step);
    }
  }
  if (difference_.size() != X.size()) difference_.assign(X.size(), 0.0);
  if (!before_time_ || *before_time_ != now) before_ = X;
  before_time_ = now;
  numbers_of(view, difference_, NumberOf::kLength);
}

std::vector<SurfacePainter::Wish> wishes_for(const PoseSource& source) {
  std::vector<SurfacePainter::Wish> wishes{{Colouring::kAuto, 3}, {Colouring::kClay, 3}};
  if (source.asset() != nullptr && !source.asset()->colours.empty()) wishes.push_back({Colouring::kOwn, 3});
  if (source.asset() != nullptr && source.asset()->texture) wishes.push_back({Colouring::kTextured, 3});
  if (source.asset() == nullptr || !source.asset()->is_point_cloud()) wishes.push_back({Colouring::kNormals, 3});
  wishes.push_back({Colouring::kMovement, 3});
  wishes.push_back({Colouring::kSpeed, 3});
  for (std::uint32_t i = 0; i < scalar_channels(source); ++i) {
    const auto& scalars = source.info()->format.scalars;
    wishes.push_back({Colouring::kChannel, 3 + i, i < scalars.size() ? scalars[i].name : std::string()});
  }
  if (source.truth() != nullptr) wishes.push_back({Colouring::kError, 3});
  return wishes;
}

bool shows_numbers(const SurfacePainter::Wish& wish) {
  return wish.colouring == Colouring::kMovement || wish.colouring == Colouring::kSpeed ||
         wish.colouring == Colouring::kChannel || wish.colouring == Colouring::kError;
}

std::string title_of(const SurfacePainter::Wish& wish) {
  constexpr std::array<const char*, 9> kTitles{"automatic",   "clay",     "its own colours",
                                               "its texture", "normals",  "movement from rest",
                                               "speed",       "channel ", "error"};
  const std::string title = kTitles[static_cast<std::size_t>(wish.colouring)];
  if (wish.colouring != Colouring::kChannel) return title;
  return wish.scalar.empty() ? title + std::to_string(wish.channel) : wish.scalar;
}

std::string unit_of(const SurfacePainter::Wish& wish, double metres_per_unit) {
  const bool metres = metres_per_unit > 0;
  switch (wish.colouring) {
    case Colouring::kMovement:
    case Colouring::kError:
      return metres ? "m" : "units";
    case Colouring::kSpeed:
      return metres ? "m/s" : "units/s";
    default:
      return {};
  }
}

void LegendRange::include(const std::array<float, 2>& range) {
  if (!seen_) {
    seen_ = range;
    return;
  }
  (*seen_)[0] = std::min((*seen_)[0], range[0]);
  (*seen_)[1] = std::max((*seen_)[1], range[1]);
}

std::array<float, 2> LegendRange::span() const {
  if (!seen_) return {0, 1};
  const double largest =
      std::max(std::abs(static_cast<double>((*seen_)[0])), std::abs(static_cast<double>((*seen_)[1])));
  // A surface at rest has rounding errors only: no colours for those.
  const auto end = static_cast<float>(largest > 1e-30 ? round_up(largest) : 1);
  return {(*seen_)[0] < 0 ? -end : 0, end};
}

double round_up(double value) {
  assert(value > 0 && std::isfinite(value));
  const double power = std::pow(10.0, std::floor(std::log10(value)));
  for (const double digit : {1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0}) {
    if (digit * power >= value * (1 - 1e-6)) return digit * power;
  }
  return 10 * power;
}

}  // namespace eigencast
