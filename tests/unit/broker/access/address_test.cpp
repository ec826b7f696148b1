// SPDX-License-Identifier: MIT
#include "broker/access/address.h"

#include <gtest/gtest.h>

namespace eigencast::broker {
namespace {

IpAddress ip(std::string_view text) {
  return IpAddress::from_text(text).value();
}

std::vector<IpRange> ranges(const std::vector<std::string>& texts) {
  std::vector<IpRange> out;
  for (const auto& text : texts) out.push_back(IpRange::from_text(text).value());
  return out;
}

ClientAddress from(const char* peer, const std::string& x_forwarded_for, const std::string& forwarded = {},
                   const std::vector<std::string>& trusted = {"10.0.0.0/8", "127.0.0.1", "2001:db8::/32"}) {
  return client_address_of(ip(peer), {x_forwarded_for, forwarded}, ranges(trusted));
}

TEST(IpAddressTest, TextRoundTrips) {
  for (const char* text : {"127.0.0.1", "0.0.0.0", "::1", "2001:db8::5", "::"}) EXPECT_EQ(ip(text).text(), text);
  EXPECT_EQ(ip("::ffff:1.2.3.4"), ip("1.2.3.4")) << "as dual-stack sockets write IPv4";
  EXPECT_EQ(ip("fe80::1%eth0"), ip("fe80::1"));
  for (const char* bad : {"", "1.2.3", "1.2.3.4.5", "256.1.1.1", "01.2.3.4x", ":::", "localhost", "1.2.3.4/8"}) {
    EXPECT_FALSE(IpAddress::from_text(bad)) << bad;
  }
  EXPECT_TRUE(ip("127.8.8.8").is_loopback());
  EXPECT_TRUE(ip("::1").is_loopback());
  EXPECT_TRUE(ip("::ffff:127.0.0.1").is_loopback());
  EXPECT_FALSE(ip("128.0.0.1").is_loopback());
  EXPECT_FALSE(ip("::").is_loopback());
}

TEST(IpAddressTest, Ipv6KeysAreThoseOfTheNetworkAndTheSite) {
  EXPECT_EQ(ip("2001:db8:1:2:3:4:5:6").limit_key(), ip("2001:db8:1:2:ffff::").limit_key());
  EXPECT_NE(ip("2001:db8:1:2::").limit_key(), ip("2001:db8:1:3::").limit_key());
  EXPECT_EQ(ip("2001:db8:1:2:3:4:5:6").site_key(), ip("2001:db8:1:ffff::").site_key());
  EXPECT_NE(ip("2001:db8:1:2::").site_key(), ip("2001:db8:2:2::").site_key());
  EXPECT_NE(ip("1.2.3.4").limit_key(), ip("1.2.3.5").limit_key());
  EXPECT_EQ(ip("1.2.3.4").site_key(), ip("1.2.3.4").limit_key());
}

TEST(IpRangeTest, PrefixesOfEveryLengthMatch) {
  for (int bits = 0; bits <= 32; ++bits) {
    const auto range = IpRange::from_text("0.0.0.0/" + std::to_string(bits)).value();
    EXPECT_TRUE(range.contains(ip("0.0.0.0")));
    if (bits > 0) {
      IpAddress other = ip("0.0.0.0");
      other.bytes[static_cast<std::size_t>(12 + (bits - 1) / 8)] = static_cast<std::uint8_t>(1 << (7 - (bits - 1) % 8));
      EXPECT_FALSE(range.contains(other)) << bits << " " << other.text();
    }
    EXPECT_FALSE(range.contains(ip("::1"))) << "IPv4 ranges hold no IPv6";
  }
  for (const char* bad :
       {"10.0.0.1/8", "10.0.0.0/33", "::/129", "10.0.0.0/", "10.0.0.0/-1", "10.0.0.0/8x", "all", ""}) {
    EXPECT_FALSE(IpRange::from_text(bad)) << bad;
  }
}

TEST(ClientAddressTest, UntrustedPeersAreNotBelieved) {
  const ClientAddress plain = from("8.8.8.8", "1.2.3.4");
  EXPECT_EQ(plain.address, ip("8.8.8.8"));
  EXPECT_TRUE(plain.uncertain);
  const ClientAddress local = from("127.0.0.1", "1.2.3.4", "", {});
  EXPECT_EQ(local.address, ip("127.0.0.1"));
  EXPECT_TRUE(local.uncertain) << "an unknown proxy: loopback proves nothing";
  EXPECT_FALSE(from("127.0.0.1", "", "", {}).uncertain);
}

TEST(ClientAddressTest, ChainIsReadFromTheRight) {
  EXPECT_EQ(from("127.0.0.1", "1.2.3.4").address, ip("1.2.3.4"));
  EXPECT_EQ(from("127.0.0.1", "6.6.6.6, 1.2.3.4, 10.1.1.1").address, ip("1.2.3.4")) << "6.6.6.6 is what 1.2.3.4 claims";
  EXPECT_EQ(from("127.0.0.1", "127.0.0.1, 1.2.3.4").address, ip("1.2.3.4"));
  EXPECT_FALSE(from("127.0.0.1", "127.0.0.1, 1.2.3.4").uncertain);
  EXPECT_EQ(from("127.0.0.1", "10.2.2.2, 10.1.1.1").address, ip("10.2.2.2"));
  EXPECT_EQ(from("127.0.0.1", "[2001:db9::1]:4711").address, ip("2001:db9::1"));
  EXPECT_EQ(from("127.0.0.1", "1.2.3.4:80").address, ip("1.2.3.4"));
  EXPECT_EQ(from("127.0.0.1", "\t1.2.3.4 ").address, ip("1.2.3.4"));
}

TEST(ClientAddressTest, OnlyTheConfiguredHeaderIsBelieved) {
  const auto standard = [](const std::string& x, const std::string& f) {
    const std::vector<IpRange> proxies = ranges({"127.0.0.0/8", "10.0.0.0/8"});
    return client_address_of(ip("127.0.0.1"), {x, f}, proxies, ProxyHeader::kForwarded);
  };
  EXPECT_EQ(from("127.0.0.1", "9.9.9.9", "for=127.0.0.1").address, ip("9.9.9.9")) << "the client wrote the other one";
  EXPECT_EQ(standard("127.0.0.1", "for=9.9.9.9").address, ip("9.9.9.9"));
  EXPECT_FALSE(standard("127.0.0.1", "for=9.9.9.9").uncertain);
  EXPECT_TRUE(from("127.0.0.1", "", "for=1.2.3.4").uncertain) << "the proxy writes another one than was configured";
  EXPECT_TRUE(standard("1.2.3.4", "").uncertain);
  EXPECT_EQ(standard("", "For=\"[2001:db9::7]:1\";proto=https, for=10.0.0.1;by=x").address, ip("2001:db9::7"));
  EXPECT_EQ(standard("", "proto=http; for=1.2.3.4").address, ip("1.2.3.4"));
  EXPECT_TRUE(standard("", "for=unknown").uncertain);
  EXPECT_TRUE(standard("", "proto=https").uncertain);
}

TEST(ClientAddressTest, UnreadableHopsAreNotLocal) {
  for (const char* bad : {"unknown", "_hidden", "x", ",", "127.0.0.1,", "1.2.3.4, "}) {
    EXPECT_TRUE(from("127.0.0.1", bad).uncertain) << bad;
    EXPECT_EQ(from("127.0.0.1", bad).address, ip("127.0.0.1")) << bad;
  }
  std::string endless = "10.0.0.1";
  for (int i = 0; i < 1000; ++i) endless += ",10.0.0.1";
  EXPECT_TRUE(from("127.0.0.1", endless).uncertain);
}

}  // namespace
}  // namespace eigencast::broker
