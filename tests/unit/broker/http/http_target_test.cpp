// SPDX-License-Identifier: MIT
#include "broker/http/http_target.h"

#include <gtest/gtest.h>

namespace eigencast::broker {
namespace {

using Kind = RangeRequest::Kind;

TEST(TargetTest, Paths) {
  const std::string hash(64, 'a');
  const auto asset = target_from_text("/v1/assets/" + hash);
  ASSERT_TRUE(asset);
  EXPECT_EQ(asset->kind, Target::Kind::kAsset);
  EXPECT_EQ(asset->name, hash);
  const auto watch = target_from_text("/v1/subscribe/lab/heart-1?rate=raw");
  ASSERT_TRUE(watch);
  EXPECT_EQ(watch->kind, Target::Kind::kSubscribe);
  EXPECT_EQ(watch->name, "lab/heart-1");
  EXPECT_EQ(watch->query, "rate=raw");
  EXPECT_EQ(target_from_text("/v1/subscribe")->name, "");
  EXPECT_EQ(target_from_text("/v1/publish/a")->kind, Target::Kind::kPublish);
  EXPECT_EQ(target_from_text("/v1/streams?x")->kind, Target::Kind::kStreams);
  EXPECT_EQ(target_from_text("/lab/heart-1?k=3")->kind, Target::Kind::kPage);
  EXPECT_EQ(target_from_text("/lab/heart-1?k=3")->name, "lab/heart-1");
  EXPECT_EQ(target_from_text("/")->name, "");
  EXPECT_EQ(target_from_text("/v1/web/x/page.js")->kind, Target::Kind::kWebFile);
  EXPECT_EQ(target_from_text("/v1/web/x/page.js")->name, "x/page.js");
}

TEST(TargetTest, TokenIsRemovedFromQuery) {
  const auto target = target_from_text("/v1/subscribe/a?rate=raw&access_token=abc.d-e_f.g&bands=2");
  ASSERT_TRUE(target);
  EXPECT_EQ(target->query, "rate=raw&bands=2");
  EXPECT_EQ(target->token, "abc.d-e_f.g");
  EXPECT_EQ(target_from_text("/v1/streams?access_token=x")->query, "");
  EXPECT_EQ(target_from_text("/v1/streams?xaccess_token=x")->token, "");
  for (const char* bad : {"/v1/streams?access_token=", "/v1/streams?access_token=a&access_token=b"}) {
    EXPECT_FALSE(target_from_text(bad)) << bad;
  }
}

TEST(TargetTest, ProxyPrefixIsRemoved) {
  EXPECT_EQ(target_from_text("/eigencast/v1/subscribe/a", "/eigencast")->name, "a");
  EXPECT_EQ(target_from_text("/v1/subscribe/a", "/eigencast")->name, "a");
  EXPECT_EQ(target_from_text("/eigencast/lab/a", "/eigencast")->name, "lab/a");
  EXPECT_EQ(target_from_text("/eigencast/", "/eigencast")->name, "");
  EXPECT_EQ(target_from_text("/eigencast/v1/streams")->kind, Target::Kind::kPage) << "a stream's name like others";
  EXPECT_EQ(target_from_text("/eigencast/eigencast/v1/streams", "/eigencast")->name, "eigencast/v1/streams");
}

TEST(TargetTest, HostilePathsAreRefused) {
  for (const char* bad : {"",
                          "*",
                          "v1/streams",
                          "//",
                          "/a/",
                          "/a//b",
                          "/..",
                          "/<a>",
                          "/v1/",
                          "/v1/streams/",
                          "/v1/web",
                          "/v1/assets",
                          "/v1/assets/../../etc/passwd",
                          "/v1/assets/",
                          "/v1/publish",
                          "/v1/publish/",
                          "/v1/publish/..",
                          "/v1/publish/a//b",
                          "/v1/publish/a/",
                          "/v1/publish/a%2e",
                          "/v1/subscribe/",
                          "/v1/subscribe/a b",
                          "http://host/v1/streams"}) {
    EXPECT_FALSE(target_from_text(bad)) << bad;
  }
  EXPECT_FALSE(target_from_text("/v1/assets/" + std::string(64, 'A'))) << "one name per object: lower case";
  EXPECT_FALSE(target_from_text("/v1/publish/" + std::string(129, 'a')));
}

TEST(RangeTest, SingleRangesAreServed) {
  const auto expect = [](const char* header, std::uint64_t first, std::uint64_t last) {
    const auto range = range_from_header(header, 100);
    EXPECT_EQ(range.kind, Kind::kPart) << header;
    EXPECT_EQ(range.first, first) << header;
    EXPECT_EQ(range.last, last) << header;
  };
  expect("bytes=0-0", 0, 0);
  expect("bytes=10-", 10, 99);
  expect("bytes=-10", 90, 99);
  expect("bytes=-1000", 0, 99);
  expect("bytes=50-1000", 50, 99);
  expect("bytes=99-99", 99, 99);
}

TEST(RangeTest, OtherRangesAreIgnoredOrUnsatisfiable) {
  for (const char* beyond : {"bytes=100-", "bytes=100-200", "bytes=-0"}) {
    EXPECT_EQ(range_from_header(beyond, 100).kind, Kind::kUnsatisfiable) << beyond;
  }
  EXPECT_EQ(range_from_header("bytes=0-", 0).kind, Kind::kUnsatisfiable);
  for (const char* ignored : {"", "bytes=", "bytes=-", "bytes=5-2", "bytes=0-1,3-4", "items=0-1", "bytes=a-b",
                              "bytes=1-2x", "bytes=--1", "bytes=99999999999999999999-"}) {
    EXPECT_EQ(range_from_header(ignored, 100).kind, Kind::kWhole) << ignored;
  }
}

int weight_of(std::string_view header, std::string_view name) {
  return weights_of(header, {"other", name}).back();
}

TEST(WeightTest, NamesAreComparedAndWeightsRead) {
  EXPECT_EQ(weight_of("gzip, br", "br"), 1000);
  EXPECT_EQ(weight_of("GZip ; Q=0.25 , br", "gzip"), 250);
  EXPECT_EQ(weight_of("text/html;level=1;q=0.5", "text/html"), 500);
  EXPECT_EQ(weight_of("br;q=0", "br"), 0);
  EXPECT_EQ(weight_of("br;q=7", "br"), 1000);
  for (const char* bad : {"br;q=", "br;q=x", "br;q=-1", "br;q=nan"}) EXPECT_EQ(weight_of(bad, "br"), 0) << bad;
  for (const char* other : {"", ",;,", "brr", "b", "x;br", "q=1"}) EXPECT_EQ(weight_of(other, "br"), -1) << other;
  EXPECT_EQ(weights_of("a;q=0.1, b, a", {"a", "c", "b"}), std::vector({100, -1, 1000})) << "what comes first";
}

TEST(WeightTest, OnlyTheFirstBytesOfAHeaderAreRead) {
  EXPECT_EQ(weight_of(std::string(250, ',') + "br", "br"), 1000);
  EXPECT_EQ(weight_of(std::string(16'000, ',') + "br", "br"), -1);
  EXPECT_EQ(weight_of(std::string(250, ',') + "br;     q=0", "br"), -1) << "no half of an element";
  EXPECT_EQ(weight_of(std::string(16'000, ';') + "q=0", ""), -1);
}

TEST(EtagTest, MatchesLists) {
  EXPECT_TRUE(etag_matches("\"a\"", "\"a\""));
  EXPECT_TRUE(etag_matches("\"b\" , W/\"a\"", "\"a\""));
  EXPECT_TRUE(etag_matches("*", "\"a\""));
  EXPECT_FALSE(etag_matches("\"ab\"", "\"a\""));
  EXPECT_FALSE(etag_matches("", "\"a\""));
}

}  // namespace
}  // namespace eigencast::broker
