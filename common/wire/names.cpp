// SPDX-License-Identifier: MIT
#include <algorithm>
#include <charconv>
#include <optional>
#include <set>

#include "common/wire/control.h"
#include "common/wire/limits.h"
#include "common/wire/sizes.h"

namespace eigencast {
namespace {

Error invalid(std::string what) {
  return fail(ErrorCode::kInvalidArgument, std::move(what));
}

bool is_name_character(char c) {
  return (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '.' || c == '_' || c == '-';
}

Error bad_parameter(std::string_view name, std::string_view value, std::string_view allowed) {
  return invalid("profile: parameter '" + std::string(name) + "' is '" + std::string(value.substr(0, 32)) +
                 "'; allowed: " + std::string(allowed));
}

std::optional<std::uint8_t> number_from_text(std::string_view text, unsigned low, unsigned high) {
  unsigned value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || value < low || value > high) return std::nullopt;
  return static_cast<std::uint8_t>(value);
}

struct QueryParts {
  std::optional<Profile::Rate> rate;
  std::optional<std::uint8_t> k, bands;
  std::optional<Profile::Scheme> scheme;
};

Result<void> read_parameter(std::string_view name, std::string_view value, QueryParts& parts) {
  if (name == "rate") {
    parts.rate = kRateNames.find(value);
    if (parts.rate) return {};
    if (const auto k = number_from_text(value, 1, limits::kMaxInterpolation)) {
      parts.rate = *k == 1 ? Profile::Rate::kRaw : Profile::Rate::kInterpolated;
      if (*k > 1) parts.k = k;
    } else {
      return bad_parameter(name, value, "raw, interpolated, estimated, 1 to 15");
    }
  } else if (name == "k") {
    parts.k = number_from_text(value, 2, limits::kMaxInterpolation);
    if (!parts.k) return bad_parameter(name, value, "2 to 15");
  } else if (name == "scheme") {
    parts.scheme = kSchemeNames.find(value);
    if (!parts.scheme) return bad_parameter(name, value, "linear, catmull-rom, hermite, damped");
  } else if (name == "bands") {
    parts.bands = number_from_text(value, 1, limits::kMaxBands);
    if (!parts.bands) return bad_parameter(name, value, "1 to 8");
  } else {
    return invalid("profile: unknown parameter '" + std::string(name.substr(0, 32)) +
                   "'; known: rate, k, scheme, bands");
  }
  return {};
}

}  // namespace

Profile::Scheme default_scheme(Profile::Rate rate) {
  return rate == Profile::Rate::kEstimated ? Profile::Scheme::kDamped : Profile::Scheme::kLinear;
}

Result<void> check_profile(const Profile& profile) {
  using Rate = Profile::Rate;
  using Scheme = Profile::Scheme;
  const bool between = profile.scheme == Scheme::kCatmullRom || profile.scheme == Scheme::kHermite;
  if (profile.rate == Rate::kEstimated && between) {
    return invalid(
        "profile: scheme=" + std::string(kSchemeNames[profile.scheme]) +
        " passes between keys and cannot estimate beyond them; with rate=estimated ask for damped or linear");
  }
  if (profile.rate == Rate::kInterpolated && profile.scheme == Scheme::kDamped) {
    return invalid(
        "profile: scheme=damped estimates beyond the keys; with rate=interpolated ask for linear, "
        "catmull-rom or hermite");
  }
  return {};
}

Result<void> check_stream_name(std::string_view name) {
  const auto refuse = [&](std::string_view why) {
    return invalid("stream name '" + std::string(name.substr(0, limits::kMaxStreamNameBytes)) +
                   "': " + std::string(why));
  };
  if (name.empty()) return refuse("it is empty; give one, such as lab/horse");
  if (name.size() > limits::kMaxStreamNameBytes) return refuse("it is longer than 128 bytes");
  if (name.starts_with("v1/")) return refuse("names below v1/ are paths of the protocol's own");
  for (const std::string_view segment : split(name, '/')) {
    if (segment.empty()) return refuse("a segment is empty; segments are joined by single '/'");
    if (segment == "." || segment == "..") return refuse("a segment is '.' or '..'");
    if (!std::all_of(segment.begin(), segment.end(), is_name_character))
      return invalid("stream name: only A-Z a-z 0-9 . _ - and '/' between segments are allowed");
  }
  return {};
}

Result<void> check_sizes(const StreamFormat& format) {
  const auto refuse = [](std::string_view field, std::uint64_t value, std::string_view allowed) {
    return invalid("format." + std::string(field) + " is " + std::to_string(value) +
                   "; allowed: " + std::string(allowed));
  };
  if (format.rows < 1 || format.rows > limits::kMaxRows) return refuse("rows", format.rows, "1 to 4096");
  if (format.channels < 1 || format.channels > limits::kMaxChannels)
    return refuse("channels", format.channels, "1 to 16");
  if (std::size_t{format.rows} * format.channels > limits::kMaxCoefficients) {
    return refuse("rows * format.channels", std::uint64_t{format.rows} * format.channels, "up to 32768");
  }
  if (format.band_ends.empty() || format.band_ends.size() > limits::kMaxBands) {
    return invalid("format.band_ends has " + std::to_string(format.band_ends.size()) + " entries; allowed: 1 to 8");
  }
  std::uint32_t before = 0;
  for (const std::uint32_t end : format.band_ends) {
    if (end <= before) return refuse("band_ends", end, "strictly ascending, from 1 on");
    before = end;
  }
  if (before != format.rows) return refuse("band_ends, last,", before, "equal to rows");
  if (format.codec != "quantised" && format.codec != "float32" && format.codec != "float64") {
    return invalid("format.codec is '" + format.codec.substr(0, 32) + "'; allowed: quantised, float32, float64");
  }
  if (2 * std::uint64_t{format.velocity_channels} > format.channels)
    return refuse("velocity_channels", format.velocity_channels, "0 to half of format.channels");
  if (format.velocity_us < 1 || format.velocity_us > limits::kMaxVelocityUs)
    return refuse("velocity_us", format.velocity_us, "1 to 10000000");
  const std::size_t scalars = format.scalars.size();
  if (scalars > 0 && 3 + scalars + format.velocity_channels != format.channels)
    return refuse("scalars", scalars, "as many entries as channels between positions and velocities, or none");
  for (const ScalarChannel& s : format.scalars) {
    if (!(s.scale > 0 && s.low <= s.high && std::max({-s.low, s.high, s.scale, 1 / s.scale}) <= limits::kMaxScalar))
      return invalid("format.scalars: a range or scale is out of range");
  }
  return {};
}

Result<void> check_format(const StreamFormat& format) {
  if (auto good = check_sizes(format); !good) return good;
  std::set<std::string_view> names;
  for (const auto& [name, unit, low, high, scale] : format.scalars) {
    const bool named = check_stream_name(name) && name.find('/') == name.npos && name.size() <= 64;
    if (!named || !names.insert(name).second || unit.size() > 16 || escaped(unit) != unit)
      return invalid("format.scalars has '" + escaped(name.substr(0, 64)) + "' in '" + escaped(unit.substr(0, 16)) +
                     "'; allowed: different names of 1 to 64 of A-Z a-z 0-9 . _ -, units of at most 16 bytes");
  }
  return {};
}

Result<Profile> profile_from_query(std::string_view query) {
  QueryParts parts;
  for (const std::string_view pair : split(query, '&')) {
    if (pair.empty()) continue;
    const std::string_view name = pair.substr(0, pair.find('='));
    const std::string_view value = pair.substr(std::min(name.size() + 1, pair.size()));
    if (const auto read = read_parameter(name, value, parts); !read) return read.error();
  }
  Profile profile;
  profile.rate = parts.rate.value_or(Profile::Rate::kInterpolated);
  if (profile.rate == Profile::Rate::kRaw && (parts.k || parts.scheme)) {
    return invalid("profile: k and scheme say how poses are made, but rate=raw asks for the keys alone");
  }
  profile.k = parts.k.value_or(profile.k);
  profile.bands = parts.bands.value_or(profile.bands);
  profile.scheme = parts.scheme.value_or(default_scheme(profile.rate));
  if (const auto checked = check_profile(profile); !checked) return checked.error();
  return profile;
}

std::string query_from_profile(const Profile& profile) {
  std::string query = "rate=" + std::string(kRateNames[profile.rate]);
  if (profile.rate != Profile::Rate::kRaw) {
    query += "&k=" + std::to_string(profile.k);
    if (profile.scheme != default_scheme(profile.rate)) query += "&scheme=" + std::string(kSchemeNames[profile.scheme]);
  }
  return query + "&bands=" + std::to_string(profile.bands);
}

}  // namespace eigencast
