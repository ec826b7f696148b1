// SPDX-License-Identifier: MIT
#include "common/net/url.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cstdlib>
#include <tuple>
#include <utility>

#include "common/core/files.h"
#include "common/core/text.h"
#include "common/core/user_info.h"
#include "common/net/client_stream.h"

namespace eigencast {

namespace {

constexpr std::size_t kMaxUrlBytes = 12 * 1024;  // A token may be part of it.
constexpr std::size_t kMaxTokenBytes = 8 * 1024;
constexpr std::size_t kMaxBrokers = 16;
constexpr std::uint16_t kDefaultPort = 7490;  ///< Without a scheme.

Error bad_url(std::string_view text, std::string_view why) {
  // Without what may be secret: query and fragment, and what stands before a host.
  std::string shown = without_user_info(text);
  shown.resize(std::min({shown.size(), std::size_t{200}, shown.find_first_of("?#")}));
  return fail(ErrorCode::kInvalidArgument, "\"" + shown + "\" is not a broker's URL: " + std::string(why) +
                                               "; a URL is, for example, http://host:7490/stream");
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

/// Returns false if it is none that is known.
bool take_scheme(std::string_view& rest, BrokerUrl& url) {
  constexpr std::pair<std::string_view, bool> kSchemes[] = {
      {"ws://", false}, {"http://", false}, {"wss://", true}, {"https://", true}};
  for (const auto& [scheme, is_tls] : kSchemes) {
    if (!starts_with_any_case(rest, scheme)) continue;
    rest.remove_prefix(scheme.size());
    url.tls = is_tls;
    url.port = is_tls ? 443 : 80;
    return true;
  }
  url.port = kDefaultPort;
  return rest.find_first_of("/?#") != rest.find("://") + 1;
}

/// Splits "host:port" or "[v6]:port". Returns what is wrong, or nothing.
std::string_view take_broker(std::string_view authority, std::string& host, std::uint16_t& number_of_port) {
  std::string_view port;
  const bool ipv6 = authority.starts_with('[');
  if (ipv6) {
    const std::size_t close = authority.find(']');
    if (close == std::string_view::npos) return "a ']' is missing after the IPv6 address";
    host = authority.substr(1, close - 1);
    port = authority.substr(close + 1);
    if (!port.empty() && port.front() != ':') return "only a port may follow ']'";
  } else {
    const std::size_t colon = std::min(authority.find(':'), authority.size());
    host = authority.substr(0, colon);
    port = authority.substr(colon);
  }
  if (port == ":") return "the port is missing after ':'";
  if (host.empty()) return "the host is missing";
  if (!std::all_of(host.begin(), host.end(), [&](char c) { return is_host_character(c, ipv6); }))
    return "the host contains a character that no host has";
  if (!port.empty()) {
    port.remove_prefix(1);
    unsigned number = 0;
    const auto [end, error] = std::from_chars(port.data(), port.data() + port.size(), number);
    if (error != std::errc() || end != port.data() + port.size() || number < 1 || number > 65535)
      return "the port must be a number from 1 to 65535";
    number_of_port = static_cast<std::uint16_t>(number);
  }
  return {};
}

/// Splits what stands between commas; `rest` follows. Returns what is wrong, or nothing.
std::string_view take_authority(std::string_view authority, std::string_view rest, BrokerUrl& url) {
  if (authority.find('@') != std::string_view::npos) return "it must not contain a user name or password";
  if (rest.starts_with("//") && authority.ends_with(':') && authority.find(',') != std::string_view::npos) {
    return "the scheme stands once, before the first of several brokers, and is the same for all: ws://a,b/stream";
  }
  const std::size_t end = std::min(authority.find(','), authority.size());
  const std::uint16_t usual = url.port;
  std::string_view why = take_broker(authority.substr(0, end), url.host, url.port);
  for (std::size_t comma = end; why.empty() && comma < authority.size();) {
    authority.remove_prefix(comma + 1);
    comma = std::min(authority.find(','), authority.size());
    if (url.brokers() == kMaxBrokers) return "it names more than 16 brokers";
    auto& [host, port] = url.others.emplace_back("", usual);
    why = take_broker(authority.substr(0, comma), host, port);
  }
  return why;
}

std::string authority_of(const std::string& host, std::uint16_t port) {
  const bool ipv6 = host.find(':') != std::string::npos;
  return (ipv6 ? "[" + host + "]" : host) + ":" + std::to_string(port);
}

/// Splits the token off, so that it is never shown with the query, and what is meant for the page.
void take_query(std::string_view query, BrokerUrl& url) {
  constexpr std::string_view kToken = "access_token=";
  while (!query.empty()) {
    const std::size_t end = std::min(query.find('&'), query.size());
    const std::string_view parameter = query.substr(0, end);
    query.remove_prefix(std::min(end + 1, query.size()));
    if (parameter.starts_with(kToken)) {
      url.credentials.token = parameter.substr(kToken.size());
    } else if (!parameter.starts_with("embed=")) {
      url.query += (url.query.empty() ? "" : "&") + std::string(parameter);
    }
  }
}

/// Takes ".../v1/subscribe" or ".../v1/publish" off, of which the dots are the prefix.
void take_endpoint(std::string_view& path, BrokerUrl& url) {
  for (const std::string_view endpoint : {"/v1/subscribe", "/v1/publish"}) {
    const std::size_t at = path.find(endpoint);
    if (at == std::string_view::npos) continue;
    const std::size_t end = at + endpoint.size();
    if (end != path.size() && path[end] != '/') continue;
    url.prefix = path.substr(0, at);
    path.remove_prefix(end);
    return;
  }
}

Result<std::string> token_from(const std::string& given) {
  if (!given.starts_with('@')) return given;
  const auto text = read_file(given.substr(1), 2 * kMaxTokenBytes);
  if (!text) return text.error();
  const std::string_view token = trimmed(std::string_view(*text).substr(0, text->find('\n')));
  if (token.empty()) return fail(ErrorCode::kInvalidArgument, given.substr(1) + ": holds no token in its first line");
  return std::string(token);
}

}  // namespace

BrokerUrl BrokerUrl::at(std::size_t index) const {
  BrokerUrl one = *this;
  if (index > 0) std::tie(one.host, one.port) = others[index - 1];
  one.others.clear();
  return one;
}

std::string BrokerUrl::authority() const {
  return authority_of(host, port);
}

std::string BrokerUrl::origin() const {
  std::string all = (tls ? "wss://" : "ws://") + authority();
  for (const auto& [other, its_port] : others) all += "," + authority_of(other, its_port);
  return all;
}

bool is_same_broker(const BrokerUrl& a, const BrokerUrl& b) {
  return a.origin() == b.origin() && a.address == b.address && a.prefix == b.prefix && a.credentials == b.credentials;
}

Result<BrokerUrl> parse_broker_url(std::string_view text) {
  if (text.size() > kMaxUrlBytes) return bad_url(text, "it is longer than 12 KiB");
  for (const char c : text)
    if (c <= ' ' || c > '~' || c == '"' || c == '<' || c == '>' || c == '\\')
      return bad_url(text, "it contains a space or another character that URLs must not have");
  BrokerUrl url;
  std::string_view rest = text;
  if (!take_scheme(rest, url))
    return bad_url(text, "it must start with http:// or https:// (ws:// and wss:// do as well), or with the host");
  BrokerUrl fragment;
  if (const std::size_t mark = rest.find('#'); mark != std::string_view::npos) {
    take_query(rest.substr(mark + 1), fragment);
    rest = rest.substr(0, mark);
  }

  const std::size_t authority_end = rest.find_first_of("/?");
  const std::string_view authority = rest.substr(0, authority_end);
  rest.remove_prefix(authority.size());
  if (const auto why = take_authority(authority, rest, url); !why.empty()) return bad_url(text, why);

  if (const std::size_t mark = rest.find('?'); mark != std::string_view::npos) {
    take_query(rest.substr(mark + 1), url);
    rest = rest.substr(0, mark);
  }
  if (url.credentials.token.empty()) url.credentials = std::move(fragment.credentials);
  take_endpoint(rest, url);
  if (rest.starts_with('/')) rest.remove_prefix(1);
  url.stream = rest;
  return url;
}

Result<void> complete_credentials(BrokerUrl& url, const Credentials& given, const LogSink& log) {
  Credentials& own = url.credentials;
  if (!given.ca_file.empty()) own.ca_file = given.ca_file;
  if (!given.token.empty()) own.token = given.token;
  if (!given.certificate_file.empty()) own.certificate_file = given.certificate_file;
  if (!given.key_file.empty()) own.key_file = given.key_file;
  own.insecure = own.insecure || given.insecure;
  const char* environment = std::getenv("EIGENCAST_TOKEN");
  if (own.token.empty() && environment != nullptr) own.token = environment;
  if (const auto good = store(own.token, token_from(own.token)); !good) return good;
  const auto fits = [](char c) { return c > ' ' && c <= '~'; };
  if (own.token.size() > kMaxTokenBytes || !std::all_of(own.token.begin(), own.token.end(), fits)) {
    return fail(ErrorCode::kInvalidArgument, "the token is invalid: it is over 8 KiB or contains blanks");
  }
  if (const auto tls = make_client_tls(url); !tls) return tls.error();
  if (url.tls && own.insecure) {
    eigencast::log(log, LogLevel::kWarning,
                   "the certificate of " + url.origin() +
                       " is not checked (--insecure): anybody in between can read and change everything");
  }
  return {};
}

}  // namespace eigencast
