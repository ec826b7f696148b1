// SPDX-License-Identifier: MIT
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "client/hud_text.h"

namespace eigencast {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

TEST(HudText, LinesShowTheFigures) {
  HudFigures f;
  f.keys_hz = 29.97;
  f.poses_hz = 89.9;
  f.drawn_hz = 60.2;
  f.kbit_per_s = 56.4;
  f.link_kbit_per_s = 71.2;
  f.tls_kbit_per_s = 76.6;
  f.latency_p50_us = 4'100;
  f.latency_p99_us = 38'400;
  f.latency_count = 10;
  f.vertices = 13'777;
  f.vertices_total = 32'802;
  f.faces = 27'550;
  f.bands = 3;
  f.bands_total = 4;
  f.rank = 200;
  f.received = true;
  f.mode = "raw";
  const auto lines = hud_lines(f);
  ASSERT_EQ(lines.size(), 5u);
  for (const char* number : {"30 ", "90 ", "60 "}) EXPECT_THAT(lines[0], HasSubstr(number));
  for (const char* number : {"56 kbit/s", "71 ", "77", "4.1 ms", "38 ms"}) EXPECT_THAT(lines[1], HasSubstr(number));
  for (const char* number : {"0.42", "13,777", "32,802", "27,550"}) EXPECT_THAT(lines[2], HasSubstr(number));
  EXPECT_EQ(lines[3], f.mode);
  for (const char* number : {"3 of 4", "200"}) EXPECT_THAT(lines[4], HasSubstr(number));
  f.memory_bytes = 11'600;
  f.recalled = 0.96;
  for (const char* number : {"11.6 kB", "96 %"}) EXPECT_THAT(hud_lines(f)[4], HasSubstr(number));
}

TEST(HudText, SaysWhatWasLoweredAndWhy) {
  LevelSettings settings;
  HudFigures f;
  EXPECT_EQ(text_from_lowered(LevelControl(settings), f), "");
  settings.quality = QualityMode::kLow;
  for (const char* part : {"50 %", "1 sample", "shadow"})
    EXPECT_THAT(text_from_lowered(LevelControl(settings), f), HasSubstr(part));
  settings = {};
  settings.kind = ResolverKind::kBudget;
  settings.target_fps = 20;
  f.vertices = 62;
  f.vertices_total = 100;
  f.vertices_wanted = 62;
  EXPECT_EQ(text_from_lowered(LevelControl(settings), f), "") << "it is what was asked for";
  f.vertices_wanted = 100;
  for (const char* part : {"20/s", "62 %"}) EXPECT_THAT(text_from_lowered(LevelControl(settings), f), HasSubstr(part));
  f.lowered = "lowered";
  EXPECT_THAT(hud_lines(f), ::testing::Contains(f.lowered));
}

TEST(HudText, LinesDependOnWhatIsKnown) {
  HudFigures f;
  EXPECT_EQ(hud_lines(f).size(), 3u);
  f.received = true;
  EXPECT_EQ(hud_lines(f).size(), 5u) << "what is played here has no connection";
  f.shown = "live";
  f.resolver = "budget";
  f.levels = {1, 0.42, 0.071};
  const auto lines = hud_lines(f);
  ASSERT_EQ(lines.size(), 8u);
  EXPECT_EQ(lines[4], f.shown);
  EXPECT_EQ(lines[5], f.resolver);
  EXPECT_THAT(lines[7], HasSubstr("1.00 0.42 0.07"));
}

TEST(HudText, ModeNamesRateAndScheme) {
  EXPECT_EQ(text_from_mode({Profile::Rate::kRaw}), "raw");
  EXPECT_EQ(text_from_mode({Profile::Rate::kInterpolated, 4}), "interpolated x4");
  Profile estimated;
  estimated.rate = Profile::Rate::kEstimated;
  estimated.scheme = default_scheme(estimated.rate);
  EXPECT_EQ(text_from_mode(estimated), "estimated x3 damped");
}

TEST(HudText, ShownStatesDelayAndSmoothness) {
  PlayoutSettings settings;
  EXPECT_THAT(text_from_shown(Shown::kLive, false, Playout(settings)), Not(HasSubstr(" ms")));
  settings.mode = PlayoutMode::kEstimate;
  settings.smoothness = 0.25;
  EXPECT_THAT(text_from_shown(Shown::kEstimated, true, Playout(settings)), HasSubstr("25 %"));
  settings.delay_us = 80'000;
  const std::string fixed = text_from_shown(Shown::kHeld, false, Playout(settings));
  EXPECT_THAT(fixed, HasSubstr("80 ms"));
  EXPECT_THAT(fixed, Not(HasSubstr("%")));
}

TEST(Download, CountsCachedBytesAndTimeLeft) {
  Subscriber::Stats stats;
  stats.asset_bytes_downloaded = 3'000'000;
  stats.asset_bytes_cached = 1'100'000;
  stats.asset_bytes_total = 11'300'000;
  const Download download = download_of(stats, 1'000'000);
  EXPECT_EQ(download.bytes, 4'100'000u);
  EXPECT_EQ(download.total, 11'300'000u);
  EXPECT_DOUBLE_EQ(download.seconds_left.value(), 7.2);
  EXPECT_FALSE(download_of(stats, 0).seconds_left) << "the rate is unknown";
  stats.asset_bytes_downloaded = 10'200'000;
  EXPECT_FALSE(download_of(stats, 1'000'000).seconds_left) << "all of it is there";
}

TEST(ConnectionLine, SaysNothingTwice) {
  Subscriber::Stats stats;
  control::StreamInfo info;
  info.stream = "demo";
  stats.state = Subscriber::State::kLive;
  stats.detail = "the link takes 30 poses/s";
  EXPECT_THAT(connection_line(stats, info), HasSubstr(stats.detail)) << "what the broker says";
  EXPECT_THAT(connection_line(stats, info), HasSubstr(info.stream));
  stats.state = Subscriber::State::kLost;
  stats.detail = "next try in 400 ms";
  EXPECT_THAT(connection_line(stats, info), HasSubstr(stats.detail));
  EXPECT_THAT(connection_line(stats, info, 0, true), Not(HasSubstr(stats.detail))) << "the banner says the rest";
  stats.state = Subscriber::State::kWaiting;
  stats.detail = "waiting for a sender at ws://h/demo";
  EXPECT_EQ(connection_line(stats, info), stats.detail);
}

TEST(Banner, AppearsOnlyWhileASurfaceStandsStill) {
  Subscriber::Stats stats;
  stats.state = Subscriber::State::kLive;
  EXPECT_THAT(banner_text(stats, 3'200'000), IsEmpty());
  stats.state = Subscriber::State::kLost;
  stats.detail = "next try in 400 ms";
  EXPECT_THAT(banner_text(stats, std::nullopt), IsEmpty()) << "nothing was ever shown: the connection line says it";
  EXPECT_THAT(banner_text(stats, 3'200'000), HasSubstr("3.2 s"));
  EXPECT_THAT(banner_text(stats, 3'200'000), HasSubstr(stats.detail));
}

}  // namespace
}  // namespace eigencast
