// SPDX-License-Identifier: MIT
#include "broker/http/http_target.h"

#include <strings.h>

#include <algorithm>
#include <charconv>

#include "common/core/hash/sha256.h"
#include "common/core/text.h"
#include "common/wire/control.h"

namespace eigencast::broker {
namespace {

std::optional<std::uint64_t> number(std::string_view text) {
  std::uint64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

Result<Target> stream_target(Target::Kind kind, std::string_view name) {
  if (auto ok = check_stream_name(name); !ok) return fail(ErrorCode::kInvalidArgument, ok.error().message);
  return Target{kind, std::string(name), {}, {}};
}

Result<Target> target_from_path(std::string_view path) {
  constexpr std::string_view kAssets = "/v1/assets/";
  constexpr std::string_view kPublish = "/v1/publish/";
  constexpr std::string_view kSubscribe = "/v1/subscribe/";
  constexpr std::string_view kWeb = "/v1/web/";
  if (path == "/v1/streams") return Target{Target::Kind::kStreams, {}, {}, {}};
#ifdef EIGENCAST_TEST_ENDPOINTS
  if (path == "/echo") return Target{Target::Kind::kEcho, {}, {}, {}};
#endif
  if (path == "/v1/subscribe") return Target{Target::Kind::kSubscribe, {}, {}, {}};
  if (path.starts_with(kPublish)) return stream_target(Target::Kind::kPublish, path.substr(kPublish.size()));
  if (path.starts_with(kSubscribe)) return stream_target(Target::Kind::kSubscribe, path.substr(kSubscribe.size()));
  if (path.starts_with(kAssets)) {
    const std::string_view name = path.substr(kAssets.size());
    if (Sha256::from_hex(name)) return Target{Target::Kind::kAsset, std::string(name), {}, {}};
    return fail(ErrorCode::kInvalidArgument, "an asset is named by 64 lower-case hexadecimal digits, its SHA-256");
  }
  if (path.starts_with(kWeb)) return Target{Target::Kind::kWebFile, std::string(path.substr(kWeb.size())), {}, {}};
  if (path == "/") return Target{Target::Kind::kPage, {}, {}, {}};
  if (path.starts_with('/') && !path.starts_with("/v1/")) return stream_target(Target::Kind::kPage, path.substr(1));
  return fail(
      ErrorCode::kNotFound,
      "there is nothing here; see /STREAM, /v1/streams, /v1/assets/SHA256, /v1/publish/STREAM, /v1/subscribe/STREAM");
}

/// Splits the token from the query, so that the query can be logged. Tokens need no percent-encoding.
Result<void> take_query(std::string_view query, Target& target) {
  constexpr std::string_view kToken = "access_token=";
  for (const std::string_view parameter : split(query, '&')) {
    if (parameter.empty()) continue;
    if (!parameter.starts_with(kToken)) {
      if (!target.query.empty()) target.query += '&';
      target.query += parameter;
      continue;
    }
    if (!target.token.empty() || parameter.size() == kToken.size()) {
      return fail(ErrorCode::kInvalidArgument, "access_token must appear once in the query, with a token");
    }
    target.token = parameter.substr(kToken.size());
  }
  return {};
}

}  // namespace

Result<Target> target_from_text(std::string_view text, std::string_view prefix) {
  const auto question = text.find('?');
  std::string_view path = text.substr(0, question);
  if (!prefix.empty() && path.starts_with(prefix) && path.substr(prefix.size()).starts_with('/')) {
    path.remove_prefix(prefix.size());
  }
  auto target = target_from_path(path);
  if (!target || question == std::string_view::npos) return target;
  if (auto taken = take_query(text.substr(question + 1), *target); !taken) return taken.error();
  return target;
}

RangeRequest range_from_header(std::string_view header, std::uint64_t size) {
  constexpr std::string_view kUnit = "bytes=";
  RangeRequest whole;
  if (!header.starts_with(kUnit) || header.find(',') != std::string_view::npos) return whole;
  const std::string_view spec = trimmed(header.substr(kUnit.size()));
  const auto dash = spec.find('-');
  if (dash == std::string_view::npos) return whole;
  const auto first = number(trimmed(spec.substr(0, dash)));
  const auto last = number(trimmed(spec.substr(dash + 1)));
  const bool open_start = dash == 0;
  const bool open_end = dash + 1 == spec.size();
  if ((open_start && open_end) || (!open_start && !first) || (!open_end && !last)) return whole;
  if (first && last && *last < *first) return whole;
  if (size == 0 || (open_start ? *last == 0 : *first >= size)) return {RangeRequest::Kind::kUnsatisfiable};
  if (open_start) return {RangeRequest::Kind::kPart, size - std::min(size, *last), size - 1};
  return {RangeRequest::Kind::kPart, *first, open_end ? size - 1 : std::min(*last, size - 1)};
}

std::vector<int> weights_of(std::string_view header, std::initializer_list<std::string_view> names) {
  constexpr std::size_t kMaxBytes = 256;  // Browsers send 150.
  if (header.size() > kMaxBytes) header = header.substr(0, header.rfind(',', kMaxBytes) + 1);
  const auto take = [](std::string_view& rest, char end) {
    const std::string_view part = rest.substr(0, rest.find(end));
    rest.remove_prefix(std::min(part.size() + 1, rest.size()));
    return trimmed(part);
  };
  std::vector<int> weights(names.size(), -1);
  while (!header.empty()) {
    std::string_view element = take(header, ',');
    const std::string_view word = take(element, ';');
    const auto name = std::find_if(names.begin(), names.end(), [&](std::string_view each) {
      return word.size() == each.size() && ::strncasecmp(word.data(), each.data(), each.size()) == 0;
    });
    if (name == names.end() || weights[static_cast<std::size_t>(name - names.begin())] >= 0) continue;
    double weight = 1;
    while (!element.empty()) {
      const std::string_view parameter = take(element, ';');
      if (!parameter.starts_with("q=") && !parameter.starts_with("Q=")) continue;
      const auto read = std::from_chars(parameter.data() + 2, parameter.data() + parameter.size(), weight);
      if (read.ec != std::errc() || !(weight >= 0)) weight = 0;
    }
    weights[static_cast<std::size_t>(name - names.begin())] = static_cast<int>(1000 * std::min(weight, 1.0));
  }
  return weights;
}

bool etag_matches(std::string_view header, std::string_view etag) {
  const auto parts = split(header, ',');
  return std::any_of(parts.begin(), parts.end(), [&](std::string_view part) {
    part = trimmed(part);
    if (part.starts_with("W/")) part.remove_prefix(2);
    return part == etag || part == "*";
  });
}

}  // namespace eigencast::broker
