// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <cmath>

#include "common/wire/control.h"
#include "common/wire/limits.h"

namespace eigencast {
namespace {

TEST(StreamName, SegmentsOfPlainCharacters) {
  for (const char* name : {"a", "horse", "lab-1/cam_2/v1.0", "A.b-C_9", "...", "a/.b"})
    EXPECT_TRUE(check_stream_name(name)) << name;
  for (const char* name :
       {"", "/", "/a", "a/", "a//b", ".", "..", "a/../b", "a/.", "a b", "a\n", "ä", "a?b", "a\\b", "a%2fb"}) {
    EXPECT_EQ(check_stream_name(name).error().code, ErrorCode::kInvalidArgument) << name;
  }
  EXPECT_FALSE(check_stream_name(std::string_view("a\0b", 3)));
  EXPECT_TRUE(check_stream_name(std::string(limits::kMaxStreamNameBytes, 'a')));
  EXPECT_FALSE(check_stream_name(std::string(limits::kMaxStreamNameBytes + 1, 'a')));
}

TEST(Format, EachFieldIsChecked) {
  const StreamFormat good{200, 3, {14, 54, 104, 200}, "quantised"};
  EXPECT_TRUE(check_format(good));
  EXPECT_TRUE(check_format({4096, 8, {4096}, "float64"}));
  EXPECT_TRUE(check_format({8, 16, {1, 2, 3, 4, 5, 6, 7, 8}, "float32"}));
  const auto refused = [](StreamFormat format, const char* field) {
    const auto checked = check_format(format);
    ASSERT_FALSE(checked) << field;
    EXPECT_EQ(checked.error().code, ErrorCode::kInvalidArgument);
    EXPECT_NE(checked.error().message.find(field), std::string::npos) << checked.error().message;
  };
  refused({0, 3, {}, "quantised"}, "rows");
  refused({4097, 3, {4097}, "quantised"}, "rows");
  refused({200, 0, {200}, "quantised"}, "channels");
  refused({200, 17, {200}, "quantised"}, "channels");
  refused({4096, 9, {4096}, "quantised"}, "rows * format.channels");
  refused({200, 3, {}, "quantised"}, "band_ends");
  refused({200, 3, {0, 200}, "quantised"}, "band_ends");
  refused({200, 3, {100, 100, 200}, "quantised"}, "band_ends");
  refused({200, 3, {100}, "quantised"}, "band_ends");
  refused({200, 3, {100, 201}, "quantised"}, "band_ends");
  refused({9, 3, {1, 2, 3, 4, 5, 6, 7, 8, 9}, "quantised"}, "band_ends");
  refused({200, 3, {200}, "rans"}, "codec");
}

TEST(ProfileQuery, ReadsWhatItWrites) {
  for (const Profile::Rate rate : {Profile::Rate::kRaw, Profile::Rate::kInterpolated}) {
    for (std::uint8_t k = 2; k <= limits::kMaxInterpolation; ++k) {
      for (std::uint8_t bands = 1; bands <= limits::kMaxBands; ++bands) {
        Profile profile;
        profile.rate = rate;
        profile.bands = bands;
        if (rate == Profile::Rate::kInterpolated) profile.k = k;
        const auto read = profile_from_query(query_from_profile(profile));
        ASSERT_TRUE(read) << read.error().message;
        EXPECT_EQ(*read, profile);
      }
    }
  }
}

TEST(ProfileQuery, DefaultsAndShortForms) {
  EXPECT_EQ(profile_from_query("").value(), Profile{});
  EXPECT_EQ(profile_from_query("rate=3").value(), Profile{});
  EXPECT_EQ(profile_from_query("rate=5").value().k, 5);
  EXPECT_EQ(profile_from_query("rate=1").value().rate, Profile::Rate::kRaw);
  EXPECT_EQ(profile_from_query("k=4&&bands=2&").value(), (Profile{Profile::Rate::kInterpolated, 4, 2}));
}

TEST(ProfileQuery, RefusalsNameTheParameter) {
  for (const auto& [query, parameter] : {std::pair{"rate=fast", "rate"},
                                         {"rate=0", "rate"},
                                         {"rate=16", "rate"},
                                         {"k=1", "k"},
                                         {"k=16", "k"},
                                         {"k=3x", "k"},
                                         {"k=", "k"},
                                         {"k", "k"},
                                         {"form=compact", "form"},
                                         {"bands=0", "bands"},
                                         {"bands=9", "bands"},
                                         {"bands=-1", "bands"},
                                         {"colour=red", "colour"},
                                         {"rate=raw&k=3", "rate=raw"},
                                         {"rate=raw&scheme=linear", "rate=raw"},
                                         {"scheme=cubic", "scheme"},
                                         {"scheme=damped", "damped"},
                                         {"rate=estimated&scheme=hermite", "hermite"}}) {
    const auto read = profile_from_query(query);
    ASSERT_FALSE(read) << query;
    EXPECT_EQ(read.error().code, ErrorCode::kInvalidArgument);
    EXPECT_NE(read.error().message.find(parameter), std::string::npos) << read.error().message;
  }
}

TEST(ProfileSchemes, DefaultsFollowTheRate) {
  using Scheme = Profile::Scheme;
  EXPECT_EQ(profile_from_query("rate=estimated")->scheme, Scheme::kDamped);
  EXPECT_EQ(profile_from_query("rate=estimated&k=5&scheme=linear").value(),
            (Profile{Profile::Rate::kEstimated, 5, 8, Scheme::kLinear}));
  for (const char* query : {"rate=estimated", "rate=estimated&scheme=linear", "scheme=catmull-rom", "scheme=hermite"}) {
    const Profile profile = profile_from_query(query).value();
    EXPECT_EQ(profile_from_query(query_from_profile(profile)).value(), profile) << query;
    const auto text = text_from_control(control::Subscribe{"a", profile});
    EXPECT_EQ(std::get<control::Subscribe>(control_from_text(text).value()).profile, profile) << text;
  }
}

TEST(Format, VelocitiesAreAtMostHalfTheChannels) {
  StreamFormat format{8, 6, {8}, "quantised", 3, 25'000};
  EXPECT_TRUE(check_format(format));
  const control::Announce announce{std::string(64, 'a'), format, 30, {}};
  EXPECT_EQ(std::get<control::Announce>(control_from_text(text_from_control(announce)).value()).format, format);
  format.velocity_channels = 4;
  EXPECT_NE(check_format(format).error().message.find("velocity_channels"), std::string::npos);
  format = {8, 6, {8}, "quantised", 3, 0};
  EXPECT_NE(check_format(format).error().message.find("velocity_us"), std::string::npos);
}

TEST(Format, ScalarsAreNamedAndInRange) {
  StreamFormat format{8, 5, {8}, "quantised"};
  format.scalars = {{"stress", "MPa", -2, 3e6, 0.25}, {"T", "°C"}};
  const control::Announce announce{std::string(64, 'a'), format, 30, {}};
  EXPECT_EQ(std::get<control::Announce>(control_from_text(text_from_control(announce)).value()).format, format);
  const std::vector<ScalarChannel> wrong = {{""},
                                            {"a/b"},
                                            {"a b"},
                                            {std::string(65, 'a')},
                                            {"T"},
                                            {"a", "\x1b[2J"},
                                            {"a", std::string(17, 'm')},
                                            {"a", "", 2, 1},
                                            {"a", "", 0, 1e31},
                                            {"a", "", 0, NAN},
                                            {"a", "", 0, 1, 0},
                                            {"a", "", 0, 1, -1},
                                            {"a", "", 0, 1, 1e-31},
                                            {"a", "", 0, 1, NAN}};
  for (const ScalarChannel& scalar : wrong) {
    format.scalars[0] = scalar;
    EXPECT_FALSE(check_format(format)) << scalar.name << " " << scalar.unit << " " << scalar.scale;
  }
  format.scalars = {{"stress"}};
  EXPECT_FALSE(check_format(format)) << "of two channels";
  format.scalars.clear();
  EXPECT_TRUE(check_format(format)) << "channels may be nameless";
}

}  // namespace
}  // namespace eigencast
