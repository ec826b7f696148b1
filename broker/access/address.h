// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "common/core/result.h"

namespace eigencast::broker {

/// An IPv4 or IPv6 address; IPv4 as ::ffff:a.b.c.d, so that both forms compare equal.
struct IpAddress {
  std::array<std::uint8_t, 16> bytes{};

  /// "127.0.0.1", "::1", "fe80::1%eth0" (the zone is dropped).
  static std::optional<IpAddress> from_text(std::string_view text);
  std::string text() const;
  bool is_v4() const;
  bool is_loopback() const;
  /// The key of failures, rates and quotas: the address; for IPv6 its /64, one network.
  std::string limit_key() const;
  /// The key of shares of what all need, of streams and of event loops' time: the same; for IPv6 its /48, the largest
  /// that one site is given (RFC 6177).
  std::string site_key() const;
  auto operator<=>(const IpAddress&) const = default;
};

/// The host of "host", "host:port" or "[IPv6]:port", without brackets; empty in an empty text. Nothing: RFC 3986, 3.2.2
/// has no such host, or it holds a '%' (an escape or a zone).
std::optional<std::string_view> host_of_authority(std::string_view text);

/// A range of addresses: "10.0.0.0/8", "2001:db8::/32", or one address.
struct IpRange {
  IpAddress first;
  int bits = 128;  ///< Prefix length in the 16 bytes.

  /// Errors: kInvalidArgument (no range; bits set behind the prefix).
  static Result<IpRange> from_text(std::string_view text);
  bool contains(const IpAddress& address) const;
};

bool is_within(std::span<const IpRange> ranges, const IpAddress& address);

struct ForwardedHeaders {
  std::string x_forwarded_for;  ///< All fields in order, joined by commas.
  std::string forwarded;        ///< RFC 7239, likewise.
  bool others = false;          ///< Via, X-Real-IP or any X-Forwarded- header is there, even empty.
  /// Whether a proxy, or a client that pretends to be one, speaks for somebody.
  bool any() const { return others || !x_forwarded_for.empty() || !forwarded.empty(); }
};

/// The header that trusted proxies write; they pass on the other one as the client sent it.
enum class ProxyHeader : std::uint8_t { kXForwardedFor, kForwarded };

struct ClientAddress {
  IpAddress address;
  /// The headers name other addresses that cannot be believed: the peer is not a trusted proxy, an entry is unreadable,
  /// or the wrong header is set. A loopback `address` then proves nothing.
  bool uncertain = false;
};
/// The address of the client: `peer` or, behind trusted proxies, the first untrusted address in the header, read from
/// the right. An unreadable entry ends the search at the proxy that wrote it. Safe on hostile input.
ClientAddress client_address_of(const IpAddress& peer, const ForwardedHeaders& headers,
                                std::span<const IpRange> trusted, ProxyHeader believed = ProxyHeader::kXForwardedFor);

}  // namespace eigencast::broker
