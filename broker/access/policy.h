// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "broker/access/address.h"
#include "broker/access/jwt.h"
#include "broker/access/token_file.h"
#include "broker/config/sources.h"

/// Access rules. Pure decisions on their arguments, times included; no sockets.
namespace eigencast::broker {

struct AccessRequest {
  IpAddress peer;             ///< The socket's.
  std::string authorization;  ///< The header.
  std::string query_token;    ///< access_token of the query, for browsers, whose WebSockets send no headers.
  std::string origin;         ///< The header: browsers send it.
  std::string host;           ///< The header, or X-Forwarded-Host of a trusted proxy.
  std::string forwarded_host;
  ForwardedHeaders forwarded;
};

struct Denial {
  int status = 403;       ///< 400, 401, 403, 408, 429 or 503.
  std::string message;    ///< For the user: what is wrong and what to do.
  int retry_after_s = 0;  ///< 429 only.
  bool failed_login = false;
};

struct Identity {
  std::string name;  ///< For logs: "token 'camera-1'", "anonymous".
  std::string key;   ///< The key of per-token limits; empty: anonymous.
  ClientAddress client;
  bool local = false;       ///< The request came from this machine.
  std::string listed_page;  ///< The origin that access.origins lets in; empty: no page, or one of the broker's host.
  std::string key_id;       ///< For signed tokens.
  Sha256 token_hash;        ///< For fixed tokens.
  Rights rights;
  std::optional<std::int64_t> expires_s;

  bool is_stranger() const { return key.empty() && !local; }
};

/// Loads a key from its setting: "KEY-ID ALGORITHM FILE". Errors: those of TokenKey::from_file().
Result<TokenKey> key_from_setting(const std::string& text);

/// A warning, if others than the owner and group of a file can get at it, or its group can change it; else empty. Only
/// that: a mounted secret may be so, in a folder that nobody else can enter.
std::string exposure_of(const std::string& path);
/// The file of a key's setting. REQUIRES: key_from_setting() takes it.
std::string key_file_of(const std::string& text);
/// The warnings for all files with secrets that a configuration names, and `config_file` (empty: none) if it has any.
std::vector<std::string> exposed_secrets(const LoadedConfig& loaded, const std::string& config_file);

enum class Resource : std::uint8_t { kConnection, kPublisher, kStream, kUpload, kSentStream, kWaitingStream };
inline constexpr std::size_t kResources = 6;

struct Quota {
  std::array<std::int64_t, kResources> resources{};
  std::int64_t unfinished_bytes = 0;
  std::int64_t messages_per_s = 0;
  std::int64_t requests_per_s = 0;
  std::int64_t work_us_per_s = 0;
  std::int64_t upload_bytes_per_hour = 0;
  std::int64_t download_bytes_per_hour = 0;
};

/// The configured rules. Immutable and thread-safe.
class AccessPolicy {
 public:
  /// Reads the files it names. Errors: kInvalidArgument, kNotFound, kRefused; the message names the setting.
  static Result<std::shared_ptr<const AccessPolicy>> from_config(const Config& config);

  std::variant<Identity, Denial> identify(const AccessRequest& request, std::int64_t now_unix_s) const;
  /// Whether identify() has to check a signature, as it has not met the token yet.
  bool must_verify(const AccessRequest& request, std::int64_t now_unix_s) const;
  /// Whether an identity that the `former` policy admitted keeps exactly its rights.
  bool vouches_for(const Identity& identity, const AccessPolicy& former) const;
  bool is_trusted_proxy(const IpAddress& address) const { return is_within(proxies_, address); }
  /// Whether a peer is on this machine, which is trusted (access.anonymous lets it in), and no proxy of others.
  bool is_own_machine(const IpAddress& peer) const {
    return peer.is_loopback() && anonymous_ != Anonymous::kNobody && !is_trusted_proxy(peer);
  }
  /// Whether the request may read the admin port without a token.
  bool is_monitor(const AccessRequest& request) const;
  ClientAddress client_address(const AccessRequest& request) const {
    return client_address_of(request.peer, request.forwarded, proxies_, proxy_header_);
  }
  /// Keeps pages of other sites from using their visitor's access; only browsers send an origin.
  bool allows_origin(const AccessRequest& request) const;
  /// The authority that a browser has for this broker, as the request or a trusted proxy says; hostile.
  const std::string& host_of_page(const AccessRequest& request) const;
  /// Whether a request comes from this machine: over loopback, through no proxy, and not from a foreign page in a
  /// browser here. Pages that access.origins lists count if `listed_pages`. Claimed addresses never do.
  bool is_local(const AccessRequest& request, bool listed_pages) const;
  bool has_tokens() const { return !tokens_.keys.empty() || static_tokens_.size() > 0; }
  /// Whether anonymous clients anywhere may fetch assets.
  bool serves_everybody() const {
    return anonymous_ == Anonymous::kAnywhere &&
           !(anonymous_rights_.publish.empty() && anonymous_rights_.subscribe.empty());
  }
  const TokenRules& token_rules() const { return tokens_; }
  const Quota& quota(bool of_token) const { return of_token ? of_token_ : of_address_; }
  std::int64_t max_connections() const { return max_connections_; }            ///< Of all together.
  std::int64_t max_watched_streams() const { return max_watched_streams_; }    ///< The same.
  std::int64_t max_unfinished_bytes() const { return max_unfinished_bytes_; }  ///< The same.
  std::int64_t failures_per_minute() const { return failures_per_minute_; }
  bool expiry_disconnects() const { return expiry_disconnects_; }

 private:
  /// Whether `host` is an address, localhost, or listed in access.hosts. Any other name may be a foreign page's own,
  /// which its owner lets resolve to this machine (DNS rebinding).
  bool names_broker(std::string_view host) const;
  /// Whether it may be a foreign page that reached this broker by a name of its own, as names_broker() says; the names
  /// of this machine are known, too.
  bool may_be_rebound(const AccessRequest& request) const;
  bool is_direct(const AccessRequest& request) const;
  bool is_own_page(const AccessRequest& request) const;  ///< Of the broker's host, or no page at all.
  std::variant<Identity, Denial> identify_token(std::string_view token, Identity identity, std::int64_t now_s) const;
  std::variant<Identity, Denial> identify_anonymous(const AccessRequest& request, Identity identity) const;

  enum class Anonymous { kNobody, kLoopback, kAnywhere };
  Anonymous anonymous_ = Anonymous::kLoopback;
  Rights anonymous_rights_;
  TokenRules tokens_;
  TokenFile static_tokens_;
  mutable TokenCache checked_;
  std::vector<std::string> origins_;
  std::vector<std::string> hosts_, own_hosts_;
  std::vector<IpRange> proxies_;
  ProxyHeader proxy_header_ = ProxyHeader::kXForwardedFor;
  std::vector<IpRange> monitors_;
  Quota of_address_;
  Quota of_token_;
  std::int64_t max_connections_ = 0;
  std::int64_t max_watched_streams_ = 0;
  std::int64_t max_unfinished_bytes_ = 0;
  std::int64_t failures_per_minute_ = 0;
  bool expiry_disconnects_ = true;
};

}  // namespace eigencast::broker
