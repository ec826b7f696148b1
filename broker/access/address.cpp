// SPDX-License-Identifier: MIT
#include "broker/access/address.h"

#include <arpa/inet.h>

#include <algorithm>
#include <charconv>

#include "common/core/text.h"

namespace eigencast::broker {
namespace {

constexpr std::array<std::uint8_t, 12> kV4Prefix = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff};
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

bool is_for(std::string_view name) {
  return name.size() == 3 && (name[0] | 32) == 'f' && (name[1] | 32) == 'o' && (name[2] | 32) == 'r';
}

/// The "for" of one element of Forwarded; empty: it has none.
std::string_view for_of(std::string_view element) {
  while (!element.empty()) {
    const auto end = std::min(element.find(';'), element.size());
    const std::string_view pair = trimmed(element.substr(0, end));
    const auto equals = pair.find('=');
    if (equals != std::string_view::npos && is_for(pair.substr(0, equals))) return pair.substr(equals + 1);
    element.remove_prefix(std::min(end + 1, element.size()));
  }
  return {};
}

}  // namespace

std::optional<IpAddress> IpAddress::from_text(std::string_view text) {
  text = text.substr(0, text.find('%'));
  if (text.size() >= INET6_ADDRSTRLEN) return std::nullopt;
  const std::string terminated(text);
  IpAddress address;
  if (inet_pton(AF_INET6, terminated.c_str(), address.bytes.data()) == 1) return address;
  std::copy(kV4Prefix.begin(), kV4Prefix.end(), address.bytes.begin());
  if (inet_pton(AF_INET, terminated.c_str(), address.bytes.data() + 12) == 1) return address;
  return std::nullopt;
}

bool IpAddress::is_v4() const {
  return std::equal(kV4Prefix.begin(), kV4Prefix.end(), bytes.begin());
}

bool IpAddress::is_loopback() const {
  if (is_v4()) return bytes[12] == 127;
  return bytes == std::array<std::uint8_t, 16>{0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1};
}

std::string IpAddress::text() const {
  std::array<char, INET6_ADDRSTRLEN> out{};
  const bool v4 = is_v4();
  inet_ntop(v4 ? AF_INET : AF_INET6, bytes.data() + (v4 ? 12 : 0), out.data(), out.size());
  return out.data();
}

std::string IpAddress::limit_key() const {
  if (is_v4()) return text();
  IpAddress net = *this;
  std::fill(net.bytes.begin() + 8, net.bytes.end(), std::uint8_t{0});
  return net.text() + "/64";
}

Result<IpRange> IpRange::from_text(std::string_view text) {
  const auto wrong = [&](const char* why) {
    return fail(ErrorCode::kInvalidArgument, "'" + std::string(text.substr(0, 64)) + "' is no range of addresses: " +
                                                 why + "; write 10.0.0.0/8, 2001:db8::/32 or one address");
  };
  const auto slash = text.find('/');
  const auto address = IpAddress::from_text(text.substr(0, slash));
  if (!address) return wrong("the address cannot be read");
  const int most = address->is_v4() ? 32 : 128;
  int bits = most;
  if (slash != std::string_view::npos) {
    const std::string_view number = text.substr(slash + 1);
    const auto [end, error] = std::from_chars(number.data(), number.data() + number.size(), bits);
    if (error != std::errc() || end != number.data() + number.size() || bits < 0 || bits > most) {
      return wrong("the length of the prefix is none");
    }
  }
  const IpRange range{*address, 128 - most + bits};
  for (int bit = range.bits; bit < 128; ++bit) {
    const auto byte = range.first.bytes[static_cast<std::size_t>(bit / 8)];
    if ((byte >> (7 - bit % 8) & 1) != 0) return wrong("bits behind the prefix are set");
  }
  return range;
}

bool IpRange::contains(const IpAddress& address) const {
  const auto whole = static_cast<std::size_t>(bits / 8);
  if (!std::equal(first.bytes.begin(), first.bytes.begin() + static_cast<std::ptrdiff_t>(whole),
                  address.bytes.begin())) {
    return false;
  }
  if (bits % 8 == 0) return true;
  const int unused = 8 - bits % 8;
  return first.bytes[whole] >> unused == address.bytes[whole] >> unused;
}

Sender sender_of(const IpAddress& peer, const ForwardedHeaders& headers, std::span<const IpRange> trusted,
                 ProxyHeader believed) {
  const auto is_trusted = [&](const IpAddress& address) {
    return std::any_of(trusted.begin(), trusted.end(), [&](const IpRange& range) { return range.contains(address); });
  };
  const bool standard = believed == ProxyHeader::kForwarded;
  std::string_view list = standard ? headers.forwarded : headers.x_forwarded_for;
  const std::string_view other = standard ? headers.x_forwarded_for : headers.forwarded;
  Sender sender{peer, list.empty() && !other.empty()};
  for (std::size_t hop = 0; !list.empty(); ++hop) {
    if (!is_trusted(sender.address)) {
      sender.uncertain = hop == 0;
      return sender;
    }
    const auto comma = list.rfind(',');
    const std::string_view element = list.substr(comma == std::string_view::npos ? 0 : comma + 1);
    const auto address = address_of_hop(standard ? for_of(element) : element);
    sender.uncertain = !address || hop == kMaxHops;
    if (sender.uncertain) return sender;
    sender.address = *address;
    list = list.substr(0, comma == std::string_view::npos ? 0 : comma);
  }
  return sender;
}

}  // namespace eigencast::broker
