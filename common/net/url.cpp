// SPDX-License-Identifier: MIT
#include "common/net/url.h"

#include <algorithm>
#include <cctype>
#include <charconv>

namespace eigencast {

namespace {

constexpr std::size_t kMaxUrlBytes = 2048;

Error bad_url(std::string_view text, std::string_view why) {
  return fail(ErrorCode::kInvalidArgument, "\"" + std::string(text.substr(0, 200)) + "\" is not a broker's URL: " +
                                               std::string(why) + "; it should look like ws://host:7490/stream");
}

bool starts_with_any_case(std::string_view text, std::string_view prefix) {
  return text.size() >= prefix.size() && std::equal(prefix.begin(), prefix.end(), text.begin(), [](char a, char b) {
           return a == std::tolower(static_cast<unsigned char>(b));
         });
}

bool is_host_character(char c, bool ipv6) {
  const auto u = static_cast<unsigned char>(c);
  if (ipv6) return std::isxdigit(u) || c == ':' || c == '.' || c == '%';
  return std::isalnum(u) || c == '-' || c == '.' || c == '_';
}

/// Takes the scheme off; nothing when it is none of ours.
bool take_scheme(std::string_view& rest, bool& tls) {
  struct Scheme {
    std::string_view text;
    bool tls;
  };
  for (const Scheme s : {Scheme{"ws://", false}, {"http://", false}, {"wss://", true}, {"https://", true}}) {
    if (!starts_with_any_case(rest, s.text)) continue;
    rest.remove_prefix(s.text.size());
    tls = s.tls;
    return true;
  }
  return false;
}

/// Splits "host:port" or "[v6]:port". Returns what is wrong, or nothing.
std::string_view take_authority(std::string_view authority, BrokerUrl& url) {
  if (authority.find('@') != std::string_view::npos) return "it must not contain a user name or password";
  std::string_view port;
  const bool ipv6 = authority.starts_with('[');
  if (ipv6) {
    const std::size_t close = authority.find(']');
    if (close == std::string_view::npos) return "a ']' is missing after the IPv6 address";
    url.host = authority.substr(1, close - 1);
    std::string_view tail = authority.substr(close + 1);
    if (!tail.empty() && tail.front() != ':') return "only a port may follow ']'";
    if (!tail.empty()) port = tail.substr(1);
    if (!tail.empty() && port.empty()) return "the port is missing after ':'";
  } else {
    const std::size_t colon = authority.find(':');
    url.host = authority.substr(0, colon);
    if (colon != std::string_view::npos) {
      port = authority.substr(colon + 1);
      if (port.empty()) return "the port is missing after ':'";
    }
  }
  if (url.host.empty()) return "the host is missing";
  if (!std::all_of(url.host.begin(), url.host.end(), [&](char c) { return is_host_character(c, ipv6); }))
    return "the host contains a character that no host has";
  if (!port.empty()) {
    unsigned number = 0;
    const auto [end, error] = std::from_chars(port.data(), port.data() + port.size(), number);
    if (error != std::errc() || end != port.data() + port.size() || number < 1 || number > 65535)
      return "the port must be a number from 1 to 65535";
    url.port = static_cast<std::uint16_t>(number);
  }
  return {};
}

}  // namespace

std::string BrokerUrl::origin() const {
  const bool ipv6 = host.find(':') != std::string::npos;
  return std::string(tls ? "wss://" : "ws://") + (ipv6 ? "[" + host + "]" : host) + ":" + std::to_string(port);
}

Result<BrokerUrl> parse_broker_url(std::string_view text) {
  if (text.size() > kMaxUrlBytes) return bad_url(text, "it is longer than 2048 bytes");
  for (const char c : text)
    if (c <= ' ' || c > '~' || c == '"' || c == '<' || c == '>' || c == '\\')
      return bad_url(text, "it contains a space or another character that URLs must not have");
  BrokerUrl url;
  std::string_view rest = text;
  if (!take_scheme(rest, url.tls)) return bad_url(text, "it must start with ws:// or wss://");
  if (rest.find('#') != std::string_view::npos) return bad_url(text, "a '#' has no meaning here");

  const std::size_t authority_end = rest.find_first_of("/?");
  if (const auto why = take_authority(rest.substr(0, authority_end), url); !why.empty()) return bad_url(text, why);
  rest = authority_end == std::string_view::npos ? std::string_view() : rest.substr(authority_end);

  if (const std::size_t mark = rest.find('?'); mark != std::string_view::npos) {
    url.query = rest.substr(mark + 1);
    rest = rest.substr(0, mark);
  }
  for (const std::string_view endpoint : {"/v1/subscribe", "/v1/publish"})
    if (rest.starts_with(endpoint) && (rest.size() == endpoint.size() || rest[endpoint.size()] == '/')) {
      rest.remove_prefix(endpoint.size());
      break;
    }
  if (rest.starts_with('/')) rest.remove_prefix(1);
  url.stream = rest;
  return url;
}

Result<void> check_transport(const BrokerUrl& url) {
  if (!url.tls) return {};
  return fail(ErrorCode::kUnsupported,
              "wss:// and https:// are not supported by this version: use ws:// on a trusted network, or a TLS tunnel");
}

}  // namespace eigencast
