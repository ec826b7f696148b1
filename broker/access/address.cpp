// SPDX-License-Identifier: MIT
#include "broker/access/address.h"

#include <strings.h>

#include <algorithm>
#include <boost/asio/ip/address.hpp>
#include <boost/asio/ip/network_v4.hpp>
#include <boost/asio/ip/network_v6.hpp>

#include "common/core/text.h"

namespace eigencast::broker {
namespace {

namespace ip = boost::asio::ip;

constexpr std::size_t kMaxHops = 32;

/// "1.2.3.4", "1.2.3.4:80", "[::1]:80", "::1", in quotes or not.
std::optional<IpAddress> address_of_hop(std::string_view text) {
  text = trimmed(text);
  if (text.size() >= 2 && text.front() == '"' && text.back() == '"') text = text.substr(1, text.size() - 2);
  if (text.starts_with('[')) return IpAddress::from_text(text.substr(1, text.find(']') - 1));
  const auto colon = text.find(':');
  if (colon != std::string_view::npos && text.find(':', colon + 1) == std::string_view::npos) {
    text = text.substr(0, colon);
  }
  return IpAddress::from_text(text);
}

/// The "for" of one element of Forwarded, or empty.
std::string_view for_of(std::string_view element) {
  for (const std::string_view part : split(element, ';')) {
    const std::string_view pair = trimmed(part);
    const auto equals = pair.find('=');
    if (equals == 3 && ::strncasecmp(pair.data(), "for", 3) == 0) return pair.substr(equals + 1);
  }
  return {};
}

}  // namespace

std::optional<std::string_view> host_of_authority(std::string_view text) {
  constexpr std::string_view kLetters = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-._~!$&'()*+,;=";
  const bool bracketed = text.starts_with('[');
  const std::size_t end = bracketed ? text.find(']') : text.find(':');
  if (bracketed && end == std::string_view::npos) return std::nullopt;
  const std::string_view host = bracketed ? text.substr(1, end - 1) : text.substr(0, end);
  const std::string_view port = text.substr(std::min(text.size(), bracketed ? end + 1 : end));
  const bool good_host = bracketed ? host.find_first_not_of("0123456789abcdefABCDEF:.") == std::string_view::npos &&
                                         host.find(':') != std::string_view::npos && IpAddress::from_text(host)
                                   : host.find_first_not_of(kLetters) == std::string_view::npos;
  const bool good_port = port.empty() || (port.front() == ':' && !host.empty() &&
                                          port.find_first_not_of("0123456789", 1) == std::string_view::npos);
  if (!good_host || !good_port) return std::nullopt;
  return host;
}

std::optional<IpAddress> IpAddress::from_text(std::string_view text) {
  boost::system::error_code error;
  const auto address = ip::make_address(text.substr(0, text.find('%')), error);
  if (error) return std::nullopt;
  return IpAddress{
      (address.is_v4() ? ip::make_address_v6(ip::v4_mapped, address.to_v4()) : address.to_v6()).to_bytes()};
}

bool IpAddress::is_v4() const {
  return ip::address_v6(bytes).is_v4_mapped();
}

bool IpAddress::is_loopback() const {
  const ip::address_v6 address(bytes);
  return is_v4() ? ip::make_address_v4(ip::v4_mapped, address).is_loopback() : address.is_loopback();
}

std::string IpAddress::text() const {
  const ip::address_v6 address(bytes);
  return is_v4() ? ip::make_address_v4(ip::v4_mapped, address).to_string() : address.to_string();
}

std::string IpAddress::limit_key() const {
  return is_v4() ? text() : ip::network_v6(ip::address_v6(bytes), 64).canonical().to_string();
}

std::string IpAddress::site_key() const {
  return is_v4() ? text() : ip::network_v6(ip::address_v6(bytes), 48).canonical().to_string();
}

Result<IpRange> IpRange::from_text(std::string_view text) {
  const auto wrong = [&](const char* why) {
    return fail(ErrorCode::kInvalidArgument, "'" + std::string(text.substr(0, 64)) + "' is not a range of addresses: " +
                                                 why + "; write 10.0.0.0/8, 2001:db8::/32 or one address");
  };
  const auto slash = text.find('/');
  const auto address = IpAddress::from_text(text.substr(0, slash));
  if (!address) return wrong("the address cannot be read");
  const bool is_v4 = text.substr(0, slash).find(':') == std::string_view::npos;
  const std::string whole = std::string(text) + (slash != std::string_view::npos ? "" : is_v4 ? "/32" : "/128");
  boost::system::error_code error;
  const int bits = is_v4 ? 96 + ip::make_network_v4(whole, error).prefix_length()
                         : ip::make_network_v6(whole, error).prefix_length();
  if (error) return wrong("the length of the prefix is not a number within the address");
  const ip::network_v6 network(ip::address_v6(address->bytes), static_cast<unsigned short>(bits));
  if (network.canonical() != network) return wrong("bits behind the prefix are set");
  return IpRange{*address, bits};
}

bool IpRange::contains(const IpAddress& address) const {
  const auto length = static_cast<unsigned short>(bits);
  return ip::network_v6(ip::address_v6(address.bytes), length).canonical().address().to_bytes() == first.bytes;
}

bool is_within(std::span<const IpRange> ranges, const IpAddress& address) {
  return std::any_of(ranges.begin(), ranges.end(), [&](const IpRange& range) { return range.contains(address); });
}

ClientAddress client_address_of(const IpAddress& peer, const ForwardedHeaders& headers,
                                std::span<const IpRange> trusted, ProxyHeader believed) {
  const bool standard = believed == ProxyHeader::kForwarded;
  std::string_view list = standard ? headers.forwarded : headers.x_forwarded_for;
  const std::string_view other = standard ? headers.x_forwarded_for : headers.forwarded;
  ClientAddress client{peer, list.empty() && !other.empty()};
  for (std::size_t hop = 0; !list.empty(); ++hop) {
    if (!is_within(trusted, client.address)) {
      client.uncertain = hop == 0;
      return client;
    }
    const auto comma = list.rfind(',');
    const std::string_view element = list.substr(comma == std::string_view::npos ? 0 : comma + 1);
    const auto address = address_of_hop(standard ? for_of(element) : element);
    client.uncertain = !address || hop == kMaxHops;
    if (client.uncertain) return client;
    client.address = *address;
    list = list.substr(0, comma == std::string_view::npos ? 0 : comma);
  }
  return client;
}

}  // namespace eigencast::broker
