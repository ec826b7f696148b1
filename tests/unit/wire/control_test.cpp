// SPDX-License-Identifier: MIT
#include "common/wire/control.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <limits>
#include <sstream>

#include "common/wire/limits.h"
#include "tests/support/paths.h"

namespace eigencast {
namespace {

using namespace control;

const std::string kAsset(64, 'a');
const std::string kSecret(64, '5');
const StreamFormat kFormat{200, 3, {14, 54, 104, 200}, "quantised"};
const StreamFormat kScalars{8, 5, {8}, "quantised", 0, 1'000'000, {{"stress", "MPa", -2, 3e6, 0.25}, {"label"}}};

/// One of each message, in the order of tests/golden/control.jsonl.
std::vector<ControlMessage> samples() {
  const std::vector<double> world = {1, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 1, 0, -2.25, 3, 4, 1};
  return {
      Welcome{"0.1.0", "b6e1", 1'700'000'000'000'000},
      Announce{kAsset, kFormat, 30, std::nullopt},
      Announce{kAsset, {8, 4, {8}, "float64"}, 29.97, world},
      Announce{kAsset, kScalars, 30, std::nullopt},
      Announce{kAsset, {8, 3, {8}, "float32"}, 0, std::nullopt, kSecret},
      Announced{"lab/horse", 7, 3, 3},
      Announced{"lab/horse", 7, 4, 4, kSecret},
      Subscribers{"lab/horse", 12},
      Subscribe{"lab/horse", {Profile::Rate::kRaw, 3, 8}},
      Subscribe{"lab/horse", {Profile::Rate::kInterpolated, 5, 2}},
      Unsubscribe{"lab/horse"},
      StreamInfo{"lab/horse", StreamInfo::State::kWaiting, 7, 0, 0, "", {}, 0, {}, std::nullopt},
      StreamInfo{"lab/horse", StreamInfo::State::kLive, 7, 3, 3, kAsset, kFormat, 30, {}, std::nullopt},
      StreamInfo{"lab/horse", StreamInfo::State::kStalled, 7, 3, 3, kAsset, kFormat, 30, {}, world},
      Ack{{{7, 18446744073709551615u, 0x23}, {8, 9007199254740993u, 0}}, limits::kMaxTimeUs},
      Ping{18446744073709551615u, 12},
      Pong{18446744073709551615u, 12, 34},
      Trace{7, 100, {{"started", 1}, {"sent", 250}}, 0, 0, Trace::BrokerClock{-1840, 210}},
      Trace{7, 100, {{"arrived", 1}, {"scheduled", 250}, {"written", 310}}, 3, 0x23, std::nullopt},
      TraceRequest{"lab/horse", 30},
      Notice{"lab/horse", "link is slow: 12 frames dropped; ask for fewer bands", 12},
      ErrorMessage{"not-found", "asset \"x\": not here\n", "lab/horse"},
      ErrorMessage{"corrupt", "frame: unknown kind 9", ""},
      Bye{"shutting down", 500},
      Remember{"lab/horse", 4, 0, {kAsset, kSecret}},
      Remember{"lab/horse", 5, 2, {std::string(64, 'c')}},
      Remember{"lab/horse", 4294967295u, 256, {}},
      Remembered{"lab/horse", 5},
      Remembered{"lab/horse", 5, "too-large", "memory: 1025 poses"},
      Ack{{{7, 1234, 0x23, 5}, {8, 1, 0}}, 1},
      Announce{kAsset, kFormat, 30, std::nullopt, kSecret, true},
      StreamInfo{"lab/horse",
                 StreamInfo::State::kLive,
                 7,
                 3,
                 3,
                 kAsset,
                 kFormat,
                 30,
                 {},
                 std::nullopt,
                 StreamInfo::Next{"", 0.25}},
      StreamInfo{"lab/horse",
                 StreamInfo::State::kLive,
                 7,
                 3,
                 3,
                 kAsset,
                 kFormat,
                 30,
                 {},
                 std::nullopt,
                 StreamInfo::Next{kSecret, 1}},
      Progress{"lab/horse", 0.25},
      Prepared{"lab/horse", kAsset},
      ErrorMessage{"refused", "anonymous may not speak", "", "lab/horse"},
      Enter{"lab/horse", "Ada \"A\"", "#ff8000"},
      Enter{"lab/horse", "Ada", "#808080", kSecret},
      Leave{"lab/horse"},
      Say{"lab/horse", {{"camera", R"({"eye":[1,2.5,-3]})"}, {"pointer", "null"}}},
      Say{"lab/horse", {{"pin.1", R"("\u00e9")"}}, true},
      Say{"lab/horse", {{"pin.1", "null"}}, false, 7},
      Subscribe{"lab/horse", {Profile::Rate::kRaw, 3, 8}, "lecture-1"},
      Late{"lab/horse", -1'699'999'999'955'000},
      Moment{"lab/horse", -1'699'999'999'900'000, 40'000},
      Floor{"lab/horse", "lead"},
      Floor{"lab/horse", "lead", false},
      Room{"lab/horse", 3, kSecret, true},
      Room{
          .room = "lab/horse",
          .whole = true,
          .members = {{3, "Ada", "#ff8000", true, {{"camera", "[1]"}}}, {2, "Bob", "#0000ff", false, {{"pin.1", "0"}}}},
          .floors = {{"lead", 3}}},
      Room{
          .room = "lab/horse", .members = {{3, {}, {}, true, {{"camera", "null"}}}}, .gone = {2}, .floors = {{"lead"}}},
      History{"lab/horse"},
      History{"lab/horse", 1'800'000'060'000'000, {{1'800'000'000'000'000, 1'800'000'060'000'000}}},
      History{"lab/horse", 5, {{1, 2}, {3, 4}}, "refused", "anonymous may not rewind"},
      Seek{"lab/horse", 1'800'000'030'000'000},
      Seek{"lab/horse", limits::kMaxTimeUs, true, 0},
      Seek{"lab/horse", 0, false, 0.125},
      StreamInfo{"lab/horse",
                 StreamInfo::State::kWaiting,
                 9,
                 0,
                 0,
                 "",
                 {},
                 0,
                 {},
                 std::nullopt,
                 std::nullopt,
                 StreamInfo::Rewind{1'800'000'030'000'000, 17, 0.5}},
      Announce{kAsset, kFormat, 30, std::nullopt, {}, false, 1'800'000'000'000'000},
      StreamInfo{"lab/horse",
                 StreamInfo::State::kLive,
                 7,
                 3,
                 3,
                 kAsset,
                 kFormat,
                 30,
                 {},
                 std::nullopt,
                 std::nullopt,
                 std::nullopt,
                 -5},
  };
}

TEST(Control, ManyUnknownFieldsAreIgnored) {
  std::string text = R"({"op":"ping","id":1,)";
  for (int i = 0; text.size() < limits::kMaxControlBytes - 40; ++i) text += "\"" + std::to_string(i) + "\":0,";
  text += R"("time_us":2})";
  const auto message = control_from_text(text);
  ASSERT_TRUE(message) << message.error().message;
  EXPECT_EQ(std::get<Ping>(*message).time_us, 2);
}

TEST(Control, StatesHaveNamesOnTheWire) {
  EXPECT_EQ(name_of(StreamInfo::State::kWaiting), "waiting");
  EXPECT_EQ(name_of(StreamInfo::State::kLive), "live");
  EXPECT_EQ(name_of(StreamInfo::State::kStalled), "stalled");
}

TEST(Control, GoldenMessagesRoundTrip) {
  std::string text;
  for (const ControlMessage& message : samples()) text += text_from_control(message) + "\n";
  const std::string path = golden_dir() + "/control.jsonl";
  if (std::getenv("EIGENCAST_WRITE_GOLDEN") != nullptr) std::ofstream(path) << text;
  std::ifstream file(path);
  std::stringstream golden;
  golden << file.rdbuf();
  EXPECT_EQ(golden.str(), text);

  std::string line;
  for (std::size_t i = 0; std::getline(golden, line); ++i) {
    const auto parsed = control_from_text(line);
    ASSERT_TRUE(parsed) << line << ": " << parsed.error().message;
    EXPECT_EQ(parsed->index(), samples()[i].index());
    EXPECT_EQ(text_from_control(*parsed), line);
  }
}

TEST(Control, SixtyFourBitIntegersAreExact) {
  const auto ack =
      control_from_text(R"({"op":"ack","items":[{"stream_id":4294967295,"sequence":9007199254740993,"step":255}],)"
                        R"("time_us":4611686018427387903})");
  ASSERT_TRUE(ack) << ack.error().message;
  EXPECT_EQ(std::get<Ack>(*ack).items[0].sequence, 9007199254740993u);
  EXPECT_EQ(std::get<Ack>(*ack).time_us, 4611686018427387903);
}

TEST(Control, UnknownFieldsAreIgnoredAndDefaultsHold) {
  const auto subscribe = control_from_text(R"({"op":"subscribe","stream":"a","colour":{"deep":[1,2]}})");
  ASSERT_TRUE(subscribe);
  EXPECT_EQ(std::get<Subscribe>(*subscribe).profile, Profile{});
  EXPECT_EQ(std::get<Bye>(control_from_text(R"({"op":"bye"})").value()).retry_after_ms, 0u);
}

TEST(Control, EveryTruncationIsRejected) {
  for (const ControlMessage& message : samples()) {
    const std::string text = text_from_control(message);
    for (std::size_t size = 0; size < text.size(); ++size) EXPECT_FALSE(control_from_text(text.substr(0, size)));
    EXPECT_FALSE(control_from_text(text + "x"));
    EXPECT_FALSE(control_from_text(text + "{}"));
  }
}

TEST(Control, NoFlippedByteCrashes) {
  for (const ControlMessage& message : samples()) {
    const std::string text = text_from_control(message);
    for (std::size_t i = 0; i < text.size(); ++i) {
      for (const int flip : {1, 2, 4, 8, 16, 32, 64, 128}) {
        std::string changed = text;
        changed[i] = static_cast<char>(changed[i] ^ flip);
        if (const auto parsed = control_from_text(changed)) {
          EXPECT_TRUE(control_from_text(text_from_control(*parsed))) << changed;
        }
      }
    }
  }
}

TEST(Control, RefusalsNameTheField) {
  const std::string format = R"("format":{"rows":8,"channels":3,"band_ends":[8],"codec":"quantised"})";
  const std::string asset = R"("asset":")" + kAsset + "\"";
  const std::vector<std::pair<std::string, std::string>> cases = {
      {R"({})", "'op' is missing"},
      {R"({"op":7})", "'op'"},
      {R"({"op":"unsubscribe"})", "'stream' is missing"},
      {R"({"op":"unsubscribe","stream":"a//b"})", "'stream'"},
      {R"({"op":"ping","id":1})", "'time_us' is missing"},
      {R"({"op":"ping","id":-1,"time_us":0})", "'id'"},
      {R"({"op":"ping","id":1.0,"time_us":0})", "'id'"},
      {R"({"op":"ping","id":18446744073709551616,"time_us":0})", "'id'"},
      {R"({"op":"ping","id":"1","time_us":0})", "'id'"},
      {R"({"op":"ping","id":true,"time_us":0})", "'id'"},
      {R"({"op":"ping","id":1,"time_us":4611686018427387904})", "'time_us'"},
      {R"({"op":"ack","items":{},"time_us":0})", "'items'"},
      {R"({"op":"ack","items":[7],"time_us":0})", "'items'"},
      {R"({"op":"ack","items":[{"stream_id":1,"sequence":1,"step":256}],"time_us":0})", "'items.step'"},
      {R"({"op":"seek","stream":"a"})", "'at_us' is missing"},
      {R"({"op":"seek","stream":"a","at_us":-1})", "'at_us'"},
      {R"({"op":"seek","stream":"a","at_us":4611686018427387904})", "'at_us'"},
      {R"({"op":"seek","stream":"a","at_us":1.5})", "'at_us'"},
      {R"({"op":"seek","stream":"a","at_us":1,"speed":-1})", "'speed'"},
      {R"({"op":"seek","stream":"a","at_us":1,"speed":10.5})", "'speed'"},
      {R"({"op":"seek","stream":"a","at_us":1,"speed":0.09})", "'speed'"},
      {R"({"op":"seek","stream":"a","at_us":1,"speed":null})", "'speed'"},
      {R"({"op":"seek","stream":"a","at_us":1,"next":1})", "'next'"},
      {R"({"op":"history","stream":"a","spans":[1]})", "'spans'"},
      {R"({"op":"announce","asset":"AB",)" + format + "}", "'asset'"},
      {R"({"op":"announce",)" + asset + R"(,"format":[]})", "'format'"},
      {R"({"op":"announce",)" + asset + R"(,"format":{"rows":8,"band_ends":[9],"codec":"quantised"}})", "band_ends"},
      {R"({"op":"announce",)" + asset + R"(,"format":{"rows":8,"band_ends":[-8],"codec":"quantised"}})",
       "'format.band_ends'"},
      {R"({"op":"announce",)" + asset + "," + format + R"(,"key_rate_hz":-1})", "'key_rate_hz'"},
      {R"({"op":"announce",)" + asset + "," + format + R"(,"key_rate_hz":null})", "'key_rate_hz'"},
      {R"({"op":"announce",)" + asset + "," + format + R"(,"world":[1,2,3]})", "'world'"},
      {R"({"op":"announce",)" + asset + "," + format + R"(,"world":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,null]})", "'world'"},
      {R"({"op":"subscribe","stream":"a","profile":{"k":16}})", "'profile.k'"},
      {R"({"op":"subscribe","stream":"a","profile":{"rate":"fast"}})",
       "'profile.rate' must be one of: raw, interpolated, estimated"},
      {R"({"op":"stream","stream":"a","state":"dead","stream_id":1,"epoch":1})", "'state'"},
      {R"({"op":"stream","stream":"a","state":"live","stream_id":1,"epoch":1})", "'tag' is missing"},
      {R"({"op":"announced","stream":"a","stream_id":1,"epoch":1,"tag":256})", "'tag'"},
      {R"({"op":"remember","stream":"a","generation":0,"segments":[]})", "'generation'"},
      {R"({"op":"remember","stream":"a","generation":4294967296,"segments":[]})", "'generation'"},
      {R"({"op":"remember","stream":"a","generation":1})", "'segments' is missing"},
      {R"({"op":"remember","stream":"a","generation":1,"segments":[7]})", "'segments'"},
      {R"({"op":"remember","stream":"a","generation":1,"segments":["AB"]})", "'segments'"},
      {R"({"op":"remember","stream":"a","generation":1,"kept":257,"segments":[]})", "'kept'"},
      {R"({"op":"remembered","stream":"a"})", "'generation' is missing"},
      {R"({"op":"ack","items":[{"stream_id":1,"sequence":1,"step":0,"generation":-1}],"time_us":0})",
       "'items.generation'"},
      {R"({"op":"enter","room":"a","name":""})", "'name'"},
      {R"({"op":"enter","room":"a","name":"a\nb"})", "'name'"},
      {R"({"op":"enter","room":"a","name":")" + std::string(65, 'a') + R"("})", "'name'"},
      {R"({"op":"enter","room":"a","name":"Ada","colour":"red"})", "'colour'"},
      {R"({"op":"enter","room":"a//b","name":"Ada"})", "'room'"},
      {R"({"op":"say","room":"a"})", "'values' is missing"},
      {R"({"op":"say","room":"a","values":[]})", "'values'"},
      {R"({"op":"say","room":"a","values":{"A":1}})", "'values'"},
      {R"({"op":"say","room":"a","values":{"":1}})", "'values'"},
      {R"({"op":"say","room":"a","values":{"a":[[[[[]]]]]}})", "'values'"},
      {R"({"op":"say","room":"a","values":{},"member":-1})", "'member'"},
      {R"({"op":"subscribe","stream":"a","sync":"A B"})", "'sync'"},
      {R"({"op":"late","stream":"a","lag_us":-4611686018427387904})", "'lag_us'"},
      {R"({"op":"late","stream":"a","lag_us":0.5})", "'lag_us'"},
      {R"({"op":"moment","stream":"a","lag_us":1})", "'delay_us' is missing"},
      {R"({"op":"stream","stream":"a","state":"waiting","stream_id":1,"epoch":0,"utc_us":"1"})", "'utc_us'"},
      {R"({"op":"floor","room":"a","floor":"a b"})", "'floor'"},
      {R"({"op":"room","room":"a","members":[{"id":0}]})", "'members.id'"},
      {R"({"op":"room","room":"a","members":[{"id":1,"values":{"a/b":1}}]})", "'members.values'"},
  };
  for (const auto& [text, expected] : cases) {
    const auto parsed = control_from_text(text);
    ASSERT_FALSE(parsed) << text;
    EXPECT_EQ(parsed.error().code, ErrorCode::kCorrupt) << text;
    EXPECT_NE(parsed.error().message.find(expected), std::string::npos) << text << "\n" << parsed.error().message;
  }
}

TEST(Control, AnythingButAJsonObjectIsCorrupt) {
  for (const char* text : {"", "null", "[]", "7", "{", "{\"op\":\"bye\",}", "{'op':'bye'}", "{\"op\":\"b\xff\"}", "NaN",
                           "{\"op\":\"ping\",\"id\":NaN}", "{\"op\":\"bye\",\"x\":1e999}", "{\"op\":\"bye\"}//"}) {
    EXPECT_EQ(control_from_text(text).error().code, ErrorCode::kCorrupt) << text;
  }
  EXPECT_EQ(control_from_text(R"({"op":"dance"})").error().code, ErrorCode::kUnsupported);
}

TEST(Control, SizeAndDepthAreCapped) {
  EXPECT_EQ(control_from_text(std::string(limits::kMaxControlBytes + 1, ' ')).error().code, ErrorCode::kTooLarge);
  const auto nested = [](int depth) {
    const auto n = static_cast<std::size_t>(depth);
    return R"({"op":"bye","x":)" + std::string(n, '[') + std::string(n, ']') + "}";
  };
  EXPECT_TRUE(control_from_text(nested(limits::kMaxControlDepth - 1)));
  EXPECT_EQ(control_from_text(nested(limits::kMaxControlDepth)).error().code, ErrorCode::kTooLarge);
  EXPECT_EQ(control_from_text(std::string(60'000, '[')).error().code, ErrorCode::kTooLarge);
  EXPECT_TRUE(control_from_text(R"({"op":"bye","reason":"[[[[[[[[[[[[\"{{{{{{{{{{{{"})"))
      << "brackets in strings do not nest";

  Ack ack;
  ack.items.resize(limits::kMaxAcksPerMessage);
  EXPECT_TRUE(control_from_text(text_from_control(ack)));
  ack.items.emplace_back();
  EXPECT_FALSE(control_from_text(text_from_control(ack)));

  Remember most{"a", 1, 0, std::vector<std::string>(limits::kMaxMemorySegments, kSecret)};
  EXPECT_TRUE(control_from_text(text_from_control(most)));
  most.segments.push_back(kSecret);
  EXPECT_FALSE(control_from_text(text_from_control(most)));
}

TEST(Control, InvalidUtf8IsReplaced) {
  const auto parsed = control_from_text(text_from_control(ErrorMessage{"io", "file \xff", ""}));
  ASSERT_TRUE(parsed);
  EXPECT_EQ(std::get<ErrorMessage>(*parsed).message, "file \xEF\xBF\xBD");
}

}  // namespace
}  // namespace eigencast
