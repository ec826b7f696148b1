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

using ::testing::ElementsAre;
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

std::vector<Warning::Code> codes(const Outcome& outcome) {
  std::vector<Warning::Code> all;
  for (const Warning& warning : warnings_of(outcome)) all.push_back(warning.code);
  return all;
}

nlohmann::json report(const Outcome& outcome) {
  return nlohmann::json::parse(json_report(outcome, "1.2.3"));
}

TEST(Report, JsonIsValidAndHasItsInputs) {
  Outcome o = sample();
  o.load.emplace();
  const auto json = report(o);
  EXPECT_EQ(json["schema"], "eigencast-latency");
  EXPECT_EQ(json["schema_version"], 1);
  EXPECT_EQ(json["inputs"]["rate_hz"], 30);
  EXPECT_EQ(json["inputs"]["url"], "ws://broker:80/test");
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

TEST(Report, PassiveRunReportsTheStreamWithoutASender) {
  Outcome o = sample();
  o.inputs.mode = "passive";
  o.rank = 24;
  o.key_rate_hz = 10;
  const auto json = report(o);
  EXPECT_TRUE(json["inputs"]["source"].is_null());
  EXPECT_EQ(json["key_rate_hz"], 10);
  EXPECT_EQ(json["rank"], 24);
  EXPECT_THAT(table(o), Not(HasSubstr(o.inputs.source)));
}

TEST(Report, TokenIsInNone) {
  Outcome o = sample();
  o.inputs.mode = "passive";
  o.inputs.url = o.inputs.viewer_url = "wss://broker/test?access_token=SECRET";
  o.inputs.credentials.token = "SECRET";
  EXPECT_THAT(table(o) + json_report(o, "1"), Not(HasSubstr("SECRET")));
  EXPECT_EQ(report(o)["environment"]["tls"], "yes");
}

TEST(Report, EachDoubtIsAWarning) {
  using Code = Warning::Code;
  const auto codes_after = [](const auto& change) {
    Outcome o = sample();
    change(o);
    return codes(o);
  };
  EXPECT_THAT(codes(sample()), IsEmpty());
  EXPECT_THAT(codes_after([](Outcome& o) { o.impossible = 1; }), ElementsAre(Code::kImpossible));
  EXPECT_THAT(codes_after([](Outcome& o) { o.sums_wrong = 3; }), ElementsAre(Code::kSumsWrong));
  EXPECT_THAT(codes_after([](Outcome& o) { o.viewer_clock.add({0, 5000, 100}); }), ElementsAre(Code::kOtherClock));
  EXPECT_THAT(codes_after([](Outcome& o) { o.load.emplace().cpu_share = 0.95; }), ElementsAre(Code::kLoadIsBottleneck));
  EXPECT_THAT(codes_after([](Outcome& o) { o.counts.sends_dropped = 3; }), ElementsAre(Code::kSendsDropped));
  EXPECT_THAT(codes_after([](Outcome& o) { o.trouble = "no broker", o.reconnects = 2; }),
              ElementsAre(Code::kStreamEnded, Code::kReconnected));
  EXPECT_THAT(codes_after([](Outcome& o) { o.inputs.clients = 1000, o.load.emplace().viewers = 600; }),
              ElementsAre(Code::kViewersMissing));
  EXPECT_THAT(codes_after([](Outcome& o) { o.inputs.clients = 1000, o.load.emplace().viewers = 999; }), IsEmpty());
}

TEST(Report, WarningsAreInTableAndJson) {
  Outcome o = sample();
  o.trouble = "no broker at ws://broker";
  const std::string text = warnings_of(o).at(0).text;
  EXPECT_THAT(text, HasSubstr(o.trouble));
  EXPECT_THAT(table(o), HasSubstr(text));
  EXPECT_EQ(report(o)["warnings"], nlohmann::json::array({text}));
}

TEST(Report, StagesMustAddUp) {
  Outcome o = sample();
  EXPECT_FALSE(sums_are_wrong(o));
  o.sums_wrong = 3;
  EXPECT_TRUE(sums_are_wrong(o));
}

TEST(Report, TimeBelowTheClockErrorIsUnknown) {
  Outcome o = sample();
  o.stage_error_us[static_cast<std::size_t>(Stage::kToBroker)] = 400;
  HdrHistogram& h = o.key_stages[static_cast<std::size_t>(Stage::kToBroker)];
  for (int i = 0; i < 100; ++i) h.add(i - 30);
  const auto stage = report(o)["traced"]["keys"]["stages"]["to_broker"];
  EXPECT_TRUE(stage["p50_us"].is_null());
  EXPECT_TRUE(stage["min_us"].is_null());
  EXPECT_EQ(stage["error_us"], 400);
  EXPECT_EQ(stage["negative_count"], 30);
}

TEST(Report, CsvHasALinePerSecond) {
  const Outcome o = sample();
  EXPECT_EQ(csv_report(o), "start_s,kind,count,p50_us,p90_us,p99_us,max_us\n0.000,key,30,1000,,,1000\n");
  const std::string samples = samples_report(o);
  EXPECT_EQ(std::count(samples.begin(), samples.end(), '\n'), 3);
  EXPECT_THAT(hdr_log(o), HasSubstr("Tag=key,0.000,1.000,1.000,HIST"));
}

TEST(Intervals, WidenInLongRuns) {
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
  ASSERT_EQ(intervals.all().size(), Intervals::kMax);
  EXPECT_EQ(intervals.all()[7].start_us, 7 * kSecond);
  run_until(901);
  EXPECT_EQ(intervals.all().size(), 451u) << "by two seconds now";
  EXPECT_EQ(intervals.all()[7].start_us, 14 * kSecond);
  EXPECT_EQ(intervals.all()[7].length_us, 2 * kSecond);
  EXPECT_EQ(intervals.all()[7].keys.min(), 14);
  EXPECT_EQ(intervals.all()[7].keys.max(), 15);
  run_until(10'000);
  EXPECT_LE(intervals.all().size(), Intervals::kMax);
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
  for (const char* condition : {"p50>60ms", "p50>2ms", "in_broker.p50>100us", "lost>0"})
    EXPECT_FALSE(judged(condition, o).value().holds) << condition;
  EXPECT_TRUE(judged("p50>1ms", o).value().holds);
  EXPECT_EQ(judged("p50>1ms", o).value().value, 1499);
  EXPECT_TRUE(judged("key.p99>1980us", o).value().holds);
  EXPECT_TRUE(judged("max<1s", o).value().holds);
  EXPECT_EQ(judged("in_broker.p50>40us", o).value().value, 50);
}

TEST(Conditions, TooFewSamplesFail) {
  const Outcome o = sample();
  for (const char* condition : {"p99.9>60ms", "synthetic.p99>60ms", "synthetic.max>60ms"}) {
    EXPECT_TRUE(judged(condition, o).value().holds) << condition;
    EXPECT_FALSE(judged(condition, o).value().value) << condition;
  }
  EXPECT_THAT(judged("p99.9>60ms", o).value().text, HasSubstr("10000")) << "how many it takes";
}

TEST(Conditions, NonsenseIsRefused) {
  const Outcome o = sample();
  for (const char* text :
       {"", "p99", "p99>", "p99>60", "p99>60m", "p101>1ms", "px>1ms", "what.p50>1ms", "lost>1ms", ">1ms", "p99>nanms"})
    EXPECT_FALSE(judged(text, o)) << text;
}

TEST(Comparison, ShowsWhatDiffers) {
  const testing::TemporaryFolder folder;
  Outcome b = sample(500);
  b.inputs.rate_hz = 60;
  std::ofstream(folder.file("a.json")) << json_report(sample(), "1");
  std::ofstream(folder.file("b.json")) << json_report(b, "2");
  const auto text = comparison(folder.file("a.json"), folder.file("b.json"));
  ASSERT_TRUE(text) << text.error().message;
  EXPECT_THAT(*text, HasSubstr("rate_hz"));
  EXPECT_THAT(*text, HasSubstr("eigencast_version"));
  EXPECT_THAT(*text, HasSubstr("+0.5"));
  std::ofstream(folder.file("c.json")) << "{\"schema\":5}";
  EXPECT_FALSE(comparison(folder.file("a.json"), folder.file("c.json")));
  EXPECT_FALSE(comparison(folder.file("a.json"), folder.file("none.json")));
}

}  // namespace
}  // namespace eigencast::latency
