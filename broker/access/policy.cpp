// SPDX-License-Identifier: MIT
#include "broker/access/policy.h"

#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <utility>

#include "common/core/text.h"

namespace eigencast::broker {
namespace {

Result<void> add_key(std::vector<TokenKey>& keys, Result<TokenKey> key, const char* setting) {
  if (!key) return in_context(setting, key.error());
  if (std::any_of(keys.begin(), keys.end(), [&](const TokenKey& other) { return other.id() == key->id(); })) {
    return in_context(
        setting, fail(ErrorCode::kInvalidArgument, "key id '" + key->id() + "' occurs twice: one algorithm for each"));
  }
  keys.push_back(std::move(*key));
  return {};
}

Result<TokenRules> token_rules_from(const Config& config) {
  const auto& access = config.access;
  TokenRules rules{{}, access.jwt_audience, access.jwt_issuer, access.jwt_leeway_s};
  for (const std::string& text : access.jwt_keys) {
    if (auto good = add_key(rules.keys, key_from_setting(text), "access.jwt_keys"); !good) return good.error();
  }
  if (access.jwt_secret.empty()) return rules;
  const auto good = add_key(rules.keys, TokenKey::from_secret({}, access.jwt_secret), "access.jwt_secret");
  return good ? Result<TokenRules>(std::move(rules)) : good.error();
}

/// `pattern` is an origin, "scheme://*.host" or "*".
bool origin_matches(std::string_view pattern, std::string_view origin) {
  if (pattern == "*" || pattern == origin) return true;
  const auto star = pattern.find("://*.");
  if (star == std::string_view::npos) return false;
  const std::string_view scheme = pattern.substr(0, star + 3);
  const std::string_view tail = pattern.substr(star + 4);
  return origin.starts_with(scheme) && origin.ends_with(tail) && origin.size() > scheme.size() + tail.size() &&
         origin.substr(scheme.size()).find('/') == std::string_view::npos;
}

bool is_listed(const std::vector<std::string>& origins, std::string_view origin) {
  constexpr std::size_t kMaxOriginBytes = 512;  // A connection keeps its own.
  return origin.size() <= kMaxOriginBytes &&
         std::any_of(origins.begin(), origins.end(),
                     [&](const std::string& pattern) { return origin_matches(pattern, origin); });
}

/// Names have no case, and the dot at the end of a full name may be left out.
bool is_same_host(std::string_view a, std::string_view b) {
  for (std::string_view* name : {&a, &b}) name->remove_suffix(name->ends_with('.') ? 1 : 0);
  return a.size() == b.size() && ::strncasecmp(a.data(), b.data(), a.size()) == 0;
}

/// The names of this machine: its own, and that of mDNS.
std::vector<std::string> own_hosts() {
  std::array<char, 256> name{};
  if (::gethostname(name.data(), name.size() - 1) != 0 || name[0] == '\0') return {};
  const std::string own(name.data());
  return {own, own.substr(0, own.find('.')) + ".local"};
}

/// Equality of the origin with the Host header proves nothing: a foreign name can resolve to 127.0.0.1 (DNS rebinding).
bool is_local_page(std::string_view origin) {
  const auto scheme = origin.find("://");
  if (scheme == std::string_view::npos) return false;
  const auto host = host_of_authority(origin.substr(scheme + 3));
  const auto address = host ? IpAddress::from_text(*host) : std::nullopt;
  return host == "localhost" || (address && address->is_loopback());
}

template <typename T>
Result<void> assign(T& to, Result<T> value, const char* setting) {
  const auto stored = store(to, std::move(value));
  return stored ? stored : in_context(setting, stored.error());
}

Result<std::vector<IpRange>> ranges_from(const std::vector<std::string>& texts) {
  std::vector<IpRange> ranges;
  for (const std::string& text : texts) {
    const auto range = IpRange::from_text(text);
    if (!range) return range.error();
    ranges.push_back(*range);
  }
  return ranges;
}

std::string_view bearer_of(std::string_view header) {
  constexpr std::string_view kScheme = "bearer ";
  if (header.size() < kScheme.size() || ::strncasecmp(header.data(), kScheme.data(), kScheme.size()) != 0) return {};
  return trimmed(header.substr(kScheme.size()));
}

/// The one token of a request that sends one; empty: it is not one.
std::string_view token_of(const AccessRequest& request) {
  const std::string_view token =
      request.query_token.empty() ? bearer_of(request.authorization) : std::string_view(request.query_token);
  return token.size() > kMaxTokenBytes ? std::string_view() : token;
}

template <typename Limits>
Quota quota_from(const Limits& limits) {
  return {{limits.connections, limits.publishers, limits.streams, limits.uploads, limits.sent_streams,
           limits.waiting_streams},
          limits.unfinished_bytes,
          limits.messages_per_s,
          limits.requests_per_s,
          limits.work_us_per_s,
          limits.upload_bytes_per_hour,
          limits.download_bytes_per_hour};
}

}  // namespace

std::string exposure_of(const std::string& path) {
  struct stat status {};
  constexpr mode_t kTooOpen = S_IWGRP | S_IXGRP | S_IRWXO;
  if (::stat(path.c_str(), &status) != 0 || !S_ISREG(status.st_mode) || (status.st_mode & kTooOpen) == 0) return {};
  return path + ": holds secrets, and others than its owner and group may get at it: chmod 640 " + path;
}

std::string key_file_of(const std::string& text) {
  return resolved_path(text.substr(text.find(' ', text.find(' ') + 1) + 1));
}

std::vector<std::string> exposed_secrets(const LoadedConfig& loaded, const std::string& config_file) {
  const Config& config = loaded.config;
  std::vector<std::string> paths;
  for (const auto& [setting, origin] : loaded.origins) {
    const bool here = paths.empty() && origin.starts_with(config_file + ":") && find_setting(setting)->secret;
    if (here && value_of(config, *find_setting(setting)) != SettingValue(std::string())) paths.push_back(config_file);
  }
  for (const std::string& text : config.access.jwt_keys) {
    const auto key = key_from_setting(text);
    if (key && key->can_sign()) paths.push_back(key_file_of(text));  // A public key is for everybody.
  }
  const auto& backbone = config.backbone;
  for (const std::string& path : {config.access.tokens_file, config.tls.key, backbone.key, backbone.credentials})
    paths.push_back(resolved_path(path));
  std::vector<std::string> warnings;
  for (const std::string& path : paths) {
    if (const std::string warning = exposure_of(path); !warning.empty()) warnings.push_back(warning);
  }
  return warnings;
}

Result<TokenKey> key_from_setting(const std::string& text) {
  const auto first = text.find(' ');
  const auto second = first == std::string::npos ? first : text.find(' ', first + 1);
  if (second == std::string::npos || first == 0) {
    return fail(
        ErrorCode::kInvalidArgument,
        "'" + text + "' is not a key: write \"KEY-ID ALGORITHM FILE\", like \"main ES256 /etc/eigencast/main.pem\"");
  }
  const std::string name = text.substr(first + 1, second - first - 1);
  const auto algorithm = kAlgorithms.find(name);
  if (!algorithm) {
    return fail(ErrorCode::kInvalidArgument,
                "'" + name.substr(0, 32) + "' is not an algorithm for tokens: HS256, RS256, ES256 or EdDSA");
  }
  return TokenKey::from_file(text.substr(0, first), *algorithm, key_file_of(text));
}

Result<std::shared_ptr<const AccessPolicy>> AccessPolicy::from_config(const Config& config) {
  auto policy = std::make_shared<AccessPolicy>();
  const std::string& anonymous = config.access.anonymous;
  policy->anonymous_ = anonymous == "nowhere"    ? Anonymous::kNobody
                       : anonymous == "anywhere" ? Anonymous::kAnywhere
                                                 : Anonymous::kLoopback;
  policy->origins_ = config.access.origins;
  policy->hosts_ = config.access.hosts;
  policy->own_hosts_ = own_hosts();
  policy->of_address_ = quota_from(config.per_address);
  policy->of_token_ = quota_from(config.per_token);
  policy->max_connections_ = config.limits.max_connections;
  policy->max_watched_streams_ = config.limits.max_watched_streams;
  policy->max_unfinished_bytes_ = config.limits.max_unfinished_bytes;
  policy->failures_per_minute_ = config.access.failures_per_minute;
  policy->expiry_disconnects_ = config.access.expiry_disconnects;
  policy->proxy_header_ = config.proxy.header == "forwarded" ? ProxyHeader::kForwarded : ProxyHeader::kXForwardedFor;
  const auto& access = config.access;
  auto tokens = access.tokens_file.empty() ? Result<TokenFile>(TokenFile())
                                           : TokenFile::from_file(resolved_path(access.tokens_file));
  const Result<void> parts[] = {
      assign(policy->anonymous_rights_.publish, StreamPatterns::from(access.anonymous_publish),
             "access.anonymous_publish"),
      assign(policy->anonymous_rights_.subscribe, StreamPatterns::from(access.anonymous_subscribe),
             "access.anonymous_subscribe"),
      assign(policy->anonymous_rights_.speak, StreamPatterns::from(access.anonymous_speak), "access.anonymous_speak"),
      assign(policy->anonymous_rights_.rewind, StreamPatterns::from(access.anonymous_rewind),
             "access.anonymous_rewind"),
      assign(policy->static_tokens_, std::move(tokens), "access.tokens_file"),
      assign(policy->proxies_, ranges_from(config.proxy.trusted), "proxy.trusted"),
      assign(policy->monitors_, ranges_from(access.monitors), "access.monitors")};
  for (const Result<void>& part : parts) {
    if (!part) return part.error();
  }
  if (auto stored = store(policy->tokens_, token_rules_from(config)); !stored) return stored.error();
  return std::shared_ptr<const AccessPolicy>(std::move(policy));
}

bool AccessPolicy::names_broker(std::string_view host) const {
  const auto name = host_of_authority(host);
  return name &&
         (name->empty() || is_same_host(*name, "localhost") || IpAddress::from_text(*name) ||
          std::any_of(hosts_.begin(), hosts_.end(), [&](const std::string& own) { return is_same_host(*name, own); }));
}

bool AccessPolicy::may_be_rebound(const AccessRequest& request) const {
  // A page that came over TLS had the certificate of its name, and the browser does not let it speak plain HTTP.
  if (!request.origin.starts_with("http://") || is_trusted_proxy(request.peer)) return false;
  const auto name = host_of_authority(request.host);
  const auto is_own = [&](const std::string& own) { return is_same_host(*name, own); };
  return !names_broker(request.host) && !is_listed(origins_, request.origin) &&
         !(name && std::any_of(own_hosts_.begin(), own_hosts_.end(), is_own));
}

bool AccessPolicy::is_direct(const AccessRequest& request) const {
  return !request.forwarded.any() && names_broker(request.host);
}

bool AccessPolicy::is_monitor(const AccessRequest& request) const {
  // Browser pages are not monitors, whatever their machine.
  return is_direct(request) && request.origin.empty() && is_within(monitors_, request.peer);
}

bool AccessPolicy::vouches_for(const Identity& identity, const AccessPolicy& former) const {
  if (!identity.listed_page.empty() && !is_listed(origins_, identity.listed_page)) return false;
  if (identity.key.empty()) {
    const bool welcome = anonymous_ == Anonymous::kAnywhere || (anonymous_ == Anonymous::kLoopback && identity.local);
    return welcome && identity.rights == anonymous_rights_;
  }
  if (!identity.expires_s) return static_tokens_.has(identity.token_hash, identity.rights);
  const auto same_key = [&](const TokenKey& was) {
    const auto& keys = tokens_.keys;
    return was.id() == identity.key_id &&
           std::any_of(keys.begin(), keys.end(), [&](const TokenKey& key) { return key.is_same_as(was); });
  };
  return tokens_.audience == former.tokens_.audience && tokens_.issuer == former.tokens_.issuer &&
         std::any_of(former.tokens_.keys.begin(), former.tokens_.keys.end(), same_key);
}

const std::string& AccessPolicy::host_of_page(const AccessRequest& request) const {
  const bool proxied = !request.forwarded_host.empty() && is_trusted_proxy(request.peer);
  return proxied ? request.forwarded_host : request.host;
}

bool AccessPolicy::is_own_page(const AccessRequest& request) const {
  if (request.origin.empty()) return true;
  const std::string& host = host_of_page(request);
  return !host.empty() && (request.origin == "http://" + host || request.origin == "https://" + host);
}

bool AccessPolicy::must_verify(const AccessRequest& request, std::int64_t now_unix_s) const {
  const std::string_view token = token_of(request);
  return token.find('.') != std::string_view::npos && !checked_.find(sha256(token), tokens_.leeway_s, now_unix_s);
}

std::variant<Identity, Denial> AccessPolicy::identify(const AccessRequest& request, std::int64_t now_unix_s) const {
  Identity identity;
  identity.client = client_address(request);
  if (!allows_origin(request)) {
    return Denial{403, "pages of this origin may not use this broker: name it in access.origins"};
  }
  if (!is_own_page(request)) identity.listed_page = request.origin;
  if (request.authorization.empty() && request.query_token.empty()) {
    return identify_anonymous(request, std::move(identity));
  }
  if (!request.authorization.empty() && !request.query_token.empty()) {
    return Denial{400, "send one token: in the Authorization header or as access_token, not both"};
  }
  const std::string_view token = token_of(request);
  if (token.empty()) {
    return Denial{401, "Authorization must be: Bearer TOKEN, with a token of at most 8 KiB", 0, true};
  }
  return identify_token(token, std::move(identity), now_unix_s);
}

std::variant<Identity, Denial> AccessPolicy::identify_token(std::string_view token, Identity identity,
                                                            std::int64_t now_s) const {
  if (token.find('.') == std::string_view::npos) {
    const StaticToken* known = static_tokens_.find(token);
    if (known == nullptr) return Denial{401, "this broker does not know the token: get one from its operator", 0, true};
    identity.name = "token '" + known->name + "'";
    identity.key = "file " + known->name;
    identity.token_hash = sha256(token);
    identity.rights = known->rights;
    return identity;
  }
  const Sha256 hash = sha256(token);
  auto claims = checked_.find(hash, tokens_.leeway_s, now_s);
  if (!claims) {
    auto verified = verify_token(token, tokens_, now_s);
    if (!verified) return Denial{401, verified.error().message, 0, true};
    checked_.keep(hash, *verified);
    claims = std::move(*verified);
  }
  identity.name =
      claims->subject.empty() ? "a token of key '" + claims->key_id + "'" : "token '" + claims->subject + "'";
  identity.key = "jwt " + claims->key_id + " " + claims->subject;
  identity.key_id = claims->key_id;
  identity.rights = std::move(claims->rights);
  identity.expires_s = claims->expires_s + tokens_.leeway_s;
  return identity;
}

bool AccessPolicy::allows_origin(const AccessRequest& request) const {
  return is_own_page(request) || is_listed(origins_, request.origin);
}

bool AccessPolicy::is_local(const AccessRequest& request, bool listed_pages) const {
  return request.peer.is_loopback() && is_direct(request) &&
         (request.origin.empty() || is_local_page(request.origin) ||
          (listed_pages && is_listed(origins_, request.origin)));
}

std::variant<Identity, Denial> AccessPolicy::identify_anonymous(const AccessRequest& request, Identity identity) const {
  const bool local = is_local(request, true);
  if (anonymous_ == Anonymous::kNobody || (anonymous_ == Anonymous::kLoopback && !local) || may_be_rebound(request)) {
    std::string why = "this broker asks for a token";
    if (request.peer.is_loopback() && request.forwarded.any()) {
      why += " (the request came through a proxy, so it does not count as local)";
    } else if (!names_broker(request.host)) {
      why += " ('" + request.host.substr(0, 64) + "' is not an address, localhost or a name of access.hosts)";
    }
    return Denial{401, std::move(why)};
  }
  identity.name = "anonymous";
  identity.local = local;
  identity.rights = anonymous_rights_;
  return identity;
}

}  // namespace eigencast::broker
