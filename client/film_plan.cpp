// SPDX-License-Identifier: MIT
#include "client/film_plan.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <string_view>

#include "common/core/text.h"

namespace eigencast {
namespace {

struct NumberFormat {
  std::size_t begin = 0, end = 0;  ///< In the path.
  std::size_t width = 0;
};

/// The one %d or %0Nd of a path; nothing: there is none, or something else after a %.
std::optional<NumberFormat> number_format_in(std::string_view path) {
  const std::size_t begin = path.find('%');
  if (begin == std::string_view::npos || path.find('%', begin + 1) != std::string_view::npos) return std::nullopt;
  const std::string_view rest = path.substr(begin + 1);
  if (rest.starts_with("d")) return NumberFormat{begin, begin + 2, 0};
  const bool padded = rest.size() > 2 && rest[0] == '0' && rest[1] >= '1' && rest[1] <= '9' && rest[2] == 'd';
  if (!padded) return std::nullopt;
  return NumberFormat{begin, begin + 4, static_cast<std::size_t>(rest[1] - '0')};
}

}  // namespace

Result<FilmClock> FilmClock::create(double seconds, double fps) {
  if (!(seconds > 0) || !(fps > 0) || !std::isfinite(seconds * fps))
    return fail(ErrorCode::kInvalidArgument, "a film needs seconds and pictures a second above 0");
  const double pictures = std::max(1.0, std::round(seconds * fps));
  if (pictures > static_cast<double>(kMaxPictures))
    return fail(ErrorCode::kTooLarge, formatted("%.0f pictures: a film has at most %llu", pictures,
                                                static_cast<unsigned long long>(kMaxPictures)));
  return FilmClock(static_cast<std::uint64_t>(pictures), fps);
}

TimeUs FilmClock::time_us(std::uint64_t picture) const {
  return std::llround(1e6 * static_cast<double>(picture) / fps_);
}

Result<FilmTarget> FilmTarget::from_path(const std::string& path) {
  const std::string name = path.substr(path.find_last_of('/') + 1);
  if (path.ends_with(".png")) {
    if (number_format_in(path)) return FilmTarget{Kind::kPictures, path};
    return fail(ErrorCode::kInvalidArgument,
                path + ": say once where the number of each picture goes, as in frame_%04d.png");
  }
  if (name.ends_with(".mp4") && name.size() > 4) return FilmTarget{Kind::kMp4, path};
  if (name.ends_with(".webm") && name.size() > 5) return FilmTarget{Kind::kWebm, path};
  return fail(ErrorCode::kInvalidArgument, path + ": a film is a .mp4 or .webm, or pictures such as frame_%04d.png");
}

std::string FilmTarget::picture_path(std::uint64_t number) const {
  const NumberFormat format = number_format_in(path).value_or(NumberFormat{});
  const std::string digits = std::to_string(number);
  const std::string zeros(format.width > digits.size() ? format.width - digits.size() : 0, '0');
  return path.substr(0, format.begin) + zeros + digits + path.substr(format.end);
}

}  // namespace eigencast
