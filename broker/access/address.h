// SPDX-License-Identifier: MIT
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "common/core/result.h"

namespace eigencast::broker {

/// An IPv4 or IPv6 address; IPv4 as ::ffff:a.b.c.d, so that both compare as one.
struct IpAddress {
  std::array<std::uint8_t, 16> bytes{};

  /// "127.0.0.1", "::1", "fe80::1%eth0" (the zone is dropped).
  static std::optional<IpAddress> from_text(std::string_view text);
  /// As people write it.
  std::string text() const;
  bool is_v4() const;
  bool is_loopback() const;
  /// Whom limits count as one: the address; of IPv6 the /64 that it lies in, which one host has as a rule.
  std::string limit_key() const;
  auto operator<=>(const IpAddress&) const = default;
};

/// A range of addresses: "10.0.0.0/8", "2001:db8::/32", or one address.
struct IpRange {
  IpAddress first;
  int bits = 128;  ///< Of the 16 bytes.

  /// Errors: kInvalidArgument (no range; bits set behind the prefix).
  static Result<IpRange> from_text(std::string_view text);
  bool contains(const IpAddress& address) const;
};

/// What a request says about where it came from.
struct ForwardedHeaders {
  std::string x_forwarded_for;  ///< All fields of the name, joined by commas in their order.
  std::string forwarded;        ///< RFC 7239, likewise.
};

/// The one header that trusted proxies write. The other one comes from the client, whom a proxy that does not know it
/// lets through with it.
enum class ProxyHeader : std::uint8_t { kXForwardedFor, kForwarded };

/// Who sent a request that came from `peer`: the peer itself, or, where that is a trusted proxy, whom it names, from
/// the right, up to the first who is not trusted. What cannot be read stops at the proxy that said it. Safe on hostile
/// input: nobody who is not trusted is believed, and no header but `believed`.
struct Sender {
  IpAddress address;
  /// A header names others, but the peer is no trusted proxy (it may be one that the configuration forgot), or a proxy
  /// names somebody who cannot be read, or by the other header: that `address` is on loopback says nothing about where
  /// the request comes from.
  bool uncertain = false;
};
Sender sender_of(const IpAddress& peer, const ForwardedHeaders& headers, std::span<const IpRange> trusted,
                 ProxyHeader believed = ProxyHeader::kXForwardedFor);

}  // namespace eigencast::broker
