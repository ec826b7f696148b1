// SPDX-License-Identifier: MIT
#include "tools/latency/report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/support/process.h"

namespace eigencast::latency {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

Outcome sample(int shift_us = 0) {
  Outcome o;
  o.inputs.url = "ws://broker/test";
  o.one_machine = true;
  for (int i = 0; i < 1000; ++i) {
    o.keys.add(1000 + i + shift_us);
    o.key_stages[static_cast<std::size_t>(Stage::kInBroker)].add(50);
    o.key_totals.add(1000 + i + shift_us);
  }
  o.sums_checked = 1000;
  o.whole_asset_us = 1;
  o.counts.keys_sent = o.counts.keys_received = 1000;
  o.counts.traced = 1000;
  for (int i = 0; i < 30; ++i) o.intervals.at(0).keys.add(1000);
  o.samples.resize(2);
  return o;
}

TEST(Report, JsonIsValidFiniteAndEchoesItsInputs) {
  Outcome o = sample();
  Load::Figures load;
  o.load = load;
  const auto json = nlohmann::json::parse(json_report(o, "1.2.3"));
  EXPECT_EQ(json["schema"], "eigencast-latency");
  EXPECT_EQ(json["schema_version"], 1);
  EXPECT_EQ(json["inputs"]["rate_hz"], 30);
  EXPECT_EQ(json["inputs"]["url"], "ws://broker:7490/test");
  EXPECT_EQ(json["inputs"]["mode"], "loop");
  EXPECT_EQ(json["environment"]["eigencast_version"], "1.2.3");
  EXPECT_EQ(json["keys"]["count"], 1000);
  EXPECT_NEAR(json["keys"]["p50_us"].get<double>(), 1500, 2);
  EXPECT_TRUE(json["keys"]["p99.9_us"].is_null()) << "one sample beyond it is luck";
  EXPECT_EQ(json["traced"]["keys"]["stages"]["in_broker"]["p50_us"], 50);
  EXPECT_TRUE(json["synthetic"]["p50_us"].is_null());
  EXPECT_TRUE(json["clocks"]["viewer_to_broker"]["offset_us"].is_null());
  EXPECT_THAT(json["warnings"], IsEmpty());
}

TEST(Report, WhoOnlyWatchesTellsOfTheStreamAndNotOfASenderThatIsNotThere) {
  Outcome o = sample();
  o.inputs.mode = "passive";
  o.rank = 24;
  o.key_rate_hz = 10;
  o.held_us.add(66'667);
  EXPECT_THAT(table(o), HasSubstr("ws://broker:7490/test"));
  EXPECT_THAT(table(o), HasSubstr("r = 24, 10 poses/s"));
  EXPECT_THAT(table(o), Not(HasSubstr("heart")));
  EXPECT_THAT(table(o), HasSubstr("0.667 of a key interval"));
  EXPECT_THAT(table(o), Not(HasSubstr(" sent")));
  const auto json = nlohmann::json::parse(json_report(o, "1"));
  EXPECT_TRUE(json["inputs"]["source"].is_null());
  EXPECT_EQ(json["key_rate_hz"], 10);
  EXPECT_EQ(json["rank"], 24);
}

TEST(Report, NoTokenStandsInIt) {
  Outcome o = sample();
  o.inputs.mode = "passive";
  o.inputs.url = o.inputs.viewer_url = "wss://broker/test?access_token=SECRET";
  o.inputs.credentials.token = "SECRET";
  EXPECT_THAT(table(o) + json_report(o, "1"), Not(HasSubstr("SECRET")));
  EXPECT_THAT(json_report(o, "1"), HasSubstr("\"tls\": \"yes\""));
}

TEST(Report, WhoOnlySendsTellsOfThatAlone) {
  Outcome o = sample();
  o.inputs.mode = "publish";
  o.counts.sends_dropped = 3;
  EXPECT_THAT(table(o), HasSubstr("1000 sent"));
  EXPECT_THAT(table(o), HasSubstr("3 dropped"));
  EXPECT_THAT(table(o), HasSubstr("WARNING: poses were dropped"));
  EXPECT_THAT(table(o), Not(HasSubstr("received")));
}

TEST(Report, ViewersThatAreNotThereAreSaid) {
  Outcome o = sample();
  o.inputs.clients = 1000;
  o.load.emplace().viewers = 600;
  EXPECT_THAT(table(o), HasSubstr("only 600 of 999 light viewers"));
  o.load->viewers = 999;
  EXPECT_THAT(table(o), Not(HasSubstr("WARNING")));
}

TEST(Report, AStreamThatEndedOrBrokeIsSaid) {
  Outcome o = sample();
  o.trouble = "no broker at ws://broker";
  o.reconnects = 2;
  EXPECT_THAT(table(o), HasSubstr("not there to the end: no broker at ws://broker"));
  EXPECT_THAT(table(o), HasSubstr("came back, times: 2"));
}

TEST(Report, StagesThatDoNotAddUpAreSaidLoudly) {
  Outcome o = sample();
  o.sums_wrong = 3;
  o.worst_unexplained_us = 12'000;
  EXPECT_TRUE(sums_are_wrong(o));
  EXPECT_THAT(table(o), HasSubstr("DO NOT ADD UP for 3 of 1000"));
}

TEST(Report, ABottleneckInTheToolIsSaid) {
  Outcome o = sample();
  o.load.emplace();
  o.load->cpu_share = 0.95;
  EXPECT_THAT(table(o), HasSubstr("light viewers' own thread was near its limit"));
}

TEST(Report, AClockThatIsNotOursIsFoundOut) {
  Outcome o = sample();
  o.viewer_clock.add({0, 5000, 100});
  EXPECT_THAT(table(o), HasSubstr("its clock is another one"));
}

TEST(Report, AOneWayTimeSmallerThanTheClocksErrorIsUnknown) {
  Outcome o = sample();
  o.stage_error_us[static_cast<std::size_t>(Stage::kToBroker)] = 400;
  HdrHistogram& h = o.key_stages[static_cast<std::size_t>(Stage::kToBroker)];
  for (int i = 0; i < 100; ++i) h.add(i - 30);
  const std::string text = table(o);
  const std::string line = text.substr(text.find("  to broker"));
  EXPECT_THAT(line.substr(0, line.find('\n')), HasSubstr("unknown"));
  EXPECT_THAT(line.substr(0, line.find('\n')), HasSubstr("+- 0.400"));
  EXPECT_THAT(line.substr(20, line.find('\n') - 20), Not(HasSubstr("-0"))) << "no negative value, none clamped";
  const auto stage = nlohmann::json::parse(json_report(o, "1"))["traced"]["keys"]["stages"]["to_broker"];
  EXPECT_TRUE(stage["p50_us"].is_null());
  EXPECT_TRUE(stage["min_us"].is_null());
  EXPECT_EQ(stage["error_us"], 400);
  EXPECT_EQ(stage["negative_count"], 30);
}

TEST(Report, TheOtherFormatsHaveALinePerSecondAndPerSample) {
  const Outcome o = sample();
  EXPECT_EQ(csv_report(o), "start_s,kind,count,p50_us,p90_us,p99_us,max_us\n0.000,key,30,1000,,,1000\n");
  const std::string samples = samples_report(o);
  EXPECT_EQ(std::count(samples.begin(), samples.end(), '\n'), 3);
  EXPECT_THAT(hdr_log(o), HasSubstr("Tag=key,0.000,1.000,1.000,HIST"));
}

TEST(Intervals, AreSecondsAndWidenSoThatDaysTakeNoMore) {
  Intervals intervals;
  constexpr TimeUs kSecond = 1'000'000;
  auto run_until = [&, next = TimeUs{0}](TimeUs until_s) mutable {
    for (; next < until_s; ++next) {
      Interval& interval = intervals.at(next * kSecond + 999'999);
      interval.keys.add(next);
      interval.synthetic.add(1);
    }
  };
  run_until(900);
  ASSERT_EQ(intervals.all().size(), Intervals::kMost);
  EXPECT_EQ(intervals.all()[7].start_us, 7 * kSecond);
  run_until(901);
  EXPECT_EQ(intervals.all().size(), 451u) << "by two seconds now";
  EXPECT_EQ(intervals.all()[7].start_us, 14 * kSecond);
  EXPECT_EQ(intervals.all()[7].length_us, 2 * kSecond);
  EXPECT_EQ(intervals.all()[7].keys.min(), 14);
  EXPECT_EQ(intervals.all()[7].keys.max(), 15);
  run_until(10'000);
  EXPECT_LE(intervals.all().size(), Intervals::kMost);
  std::uint64_t keys = 0, synthetic = 0;
  TimeUs before_us = -1;
  for (const Interval& interval : intervals.all()) {
    keys += interval.keys.count();
    synthetic += interval.synthetic.count();
    EXPECT_GT(interval.start_us, before_us);
    before_us = interval.start_us;
  }
  EXPECT_EQ(keys, 10'000u);
  EXPECT_EQ(synthetic, 10'000u);
  EXPECT_EQ(intervals.at(5).start_us, intervals.all().back().start_us) << "what comes late belongs to the newest";
}

TEST(Conditions, AreJudgedInTheirUnit) {
  const Outcome o = sample();
  EXPECT_EQ(failed_condition("p50>60ms", o).value(), "");
  EXPECT_EQ(failed_condition("p50>2ms", o).value(), "");
  EXPECT_THAT(failed_condition("p50>1ms", o).value(), HasSubstr("p50>1ms: it is 1499 us"));
  EXPECT_THAT(failed_condition("key.p99>1980us", o).value(), HasSubstr("it is 19"));
  EXPECT_THAT(failed_condition("max<1s", o).value(), HasSubstr("it is"));
  EXPECT_EQ(failed_condition("in_broker.p50>100us", o).value(), "");
  EXPECT_THAT(failed_condition("in_broker.p50>40us", o).value(), HasSubstr("it is 50 us"));
  EXPECT_EQ(failed_condition("lost>0", o).value(), "");
  EXPECT_THAT(failed_condition("p99.9>60ms", o).value(), HasSubstr("too few samples to say: p99.9 takes 10000"));
  EXPECT_THAT(failed_condition("synthetic.p99>60ms", o).value(), HasSubstr("p99 takes 1000"));
  EXPECT_THAT(failed_condition("synthetic.max>60ms", o).value(), ::testing::EndsWith("too few samples to say"));
}

TEST(Conditions, ThatCannotBeMeantAreRefused) {
  const Outcome o = sample();
  for (const char* text :
       {"", "p99", "p99>", "p99>60", "p99>60m", "p101>1ms", "px>1ms", "what.p50>1ms", "lost>1ms", ">1ms", "p99>nanms"})
    EXPECT_FALSE(failed_condition(text, o)) << text;
}

TEST(Comparison, ShowsTheDifferenceAndWhatElseDiffers) {
  const testing::TemporaryFolder folder;
  Outcome b = sample(500);
  b.inputs.rate_hz = 60;
  std::ofstream(folder.file("a.json")) << json_report(sample(), "1");
  std::ofstream(folder.file("b.json")) << json_report(b, "2");
  const auto text = comparison(folder.file("a.json"), folder.file("b.json"));
  ASSERT_TRUE(text) << text.error().message;
  EXPECT_THAT(*text, HasSubstr("inputs differ: rate_hz 30.0 / 60.0"));
  EXPECT_THAT(*text, HasSubstr("eigencast_version"));
  EXPECT_THAT(*text, HasSubstr("+0.5"));
  std::ofstream(folder.file("c.json")) << "{\"schema\":5}";
  EXPECT_FALSE(comparison(folder.file("a.json"), folder.file("c.json")));
  EXPECT_FALSE(comparison(folder.file("a.json"), folder.file("none.json")));
}

}  // namespace
}  // namespace eigencast::latency
