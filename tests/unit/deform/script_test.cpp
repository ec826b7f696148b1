// SPDX-License-Identifier: MIT
#include "sender/deform/script.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <numbers>

#include "common/surface/shapes/shapes.h"
#include "common/surface/vector.h"
#include "tests/support/paths.h"

namespace eigencast::deform {
namespace {

using ::testing::HasSubstr;

const std::vector<Vec3> kBar = make_box(1, 4, 1, {1, 4, 1}).positions;

Script script_from(std::string_view json) {
  auto script = Script::from_json(json, kBar);
  EXPECT_TRUE(script.has_value()) << script.error().message;
  return std::move(*script);
}

TEST(Moves, TwistCounterRotatesEndsAndBendKeepsLengths) {
  const Box box = bounding_box(kBar);
  const Vec3 top = twisted({0.5, 2, 0.5}, box, {}, std::numbers::pi);
  EXPECT_LT(length(top - turned({0.5, 2, 0.5}, {}, 1, std::numbers::pi / 2)), 1e-15);
  EXPECT_EQ(twisted({0.5, 0, 0.5}, box, {}, 3), (Vec3{0.5, 0, 0.5}));
  // The middle line becomes a half circle of the same length.
  double along = 0;
  Vec3 last = bent({0, -2, 0}, box, {}, std::numbers::pi);
  for (int i = 1; i <= 1000; ++i) {
    const Vec3 next = bent({0, -2 + 0.004 * i, 0}, box, {}, std::numbers::pi);
    along += length(next - last);
    last = next;
  }
  EXPECT_NEAR(along, 4, 1e-5);
  const Vec3 low = bent({0, -2, 0}, box, {}, std::numbers::pi), high = bent({0, 2, 0}, box, {}, std::numbers::pi);
  EXPECT_NEAR(length(high - low), 2 * 4 / std::numbers::pi, 1e-12);
  EXPECT_NEAR(low[0], high[0], 1e-12);
  EXPECT_EQ(bent({0.1, 1, 0.2}, box, {}, 0), (Vec3{0.1, 1, 0.2}));
}

TEST(Track, InterpolatesKeysWithoutOvershoot) {
  const Track track{{0, 1, 3, 4}, {0, 2, 2, -1}, 1};
  EXPECT_EQ(track.at(-1), std::vector<double>{0});
  EXPECT_EQ(track.at(1), std::vector<double>{2});
  EXPECT_EQ(track.at(9), std::vector<double>{-1});
  EXPECT_EQ(track.at(2), std::vector<double>{2}) << "flat between equal keys";
  double last = 0, slope_before = 0;
  for (double t = 0.001; t < 4; t += 0.001) {
    const double value = track.at(t)[0], slope = (value - last) / 0.001;
    EXPECT_LE(value, 2 + 1e-12);
    EXPECT_GE(value, -1 - 1e-12);
    if (t > 0.002) {
      EXPECT_LT(std::abs(slope - slope_before), 0.03) << "no kink at " << t;
    }
    last = value;
    slope_before = slope;
  }
}

TEST(Script, AppliesMovesInOrder) {
  const Script script = script_from(R"({"moves": [
    {"move": "translate", "handles": [0, 3], "keys": [{"at": 0, "by": [0, 0, 0]}, {"at": 2, "by": [1, 2, 3]}]},
    {"move": "scale", "centre": [0, 0, 0], "keys": [{"at": 0, "by": [2, 2, 2]}]},
    {"move": "translate", "handles": {"low": [-9, 1.9, -9], "high": [9, 9, 9]},
     "keys": [{"at": 0, "by": [0, 10, 0]}]}]})");
  EXPECT_EQ(script.duration_s(), 2);
  EXPECT_FALSE(script.loops());
  const std::vector<Vec3> end = script.handles_at(5);
  for (std::size_t i = 0; i < kBar.size(); ++i) {
    Vec3 expected = kBar[i];
    if (i == 0 || i == 3) expected = expected + Vec3{1, 2, 3};
    expected = 2.0 * expected;
    if (kBar[i][1] > 1.9) expected[1] += 10;
    EXPECT_LT(length(end[i] - expected), 1e-12) << i;
  }
}

TEST(Script, DocumentedExampleParses) {
  std::ifstream in(golden_dir() + "/../../docs/deform.md");
  const std::string page((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  const std::size_t begin = page.find("```json") + 7;
  ASSERT_LT(begin, page.size());
  const auto script = Script::from_json(page.substr(begin, page.find("```", begin) - begin), kBar);
  ASSERT_TRUE(script.has_value()) << script.error().message;
  EXPECT_TRUE(script->loops());
  EXPECT_EQ(script->duration_s(), 3);
}

TEST(Script, BuiltInsLoopThroughRest) {
  for (const char* name : {"twist", "bend", "both"}) {
    const auto script = Script::builtin(name, kBar);
    ASSERT_TRUE(script.has_value());
    EXPECT_EQ(script->handles_at(0), kBar);
    EXPECT_EQ(script->handles_at(5), script->handles_at(1));
    EXPECT_NE(script->handles_at(1), kBar);
  }
  EXPECT_EQ(Script::builtin("knot", kBar).error().code, ErrorCode::kNotFound);
}

TEST(Script, ErrorsNameTheField) {
  const std::pair<const char*, const char*> kWrong[] = {
      {"nonsense", ""},
      {"[]", ""},
      {R"({"moves": []})", "\"moves\""},
      {R"({"moves": [{"move": "fold", "keys": []}]})", "move 0"},
      {R"({"moves": [{"move": "twist", "axis": "w", "keys": []}]})", "\"axis\""},
      {R"({"moves": [{"move": "bend", "axis": "y", "towards": "y", "keys": []}]})", "\"towards\""},
      {R"({"moves": [{"move": "twist", "axis": "y", "keys": []}]})", "\"keys\""},
      {R"({"moves": [{"move": "twist", "axis": "y", "speed": 3, "keys": []}]})", "\"speed\""},
      {R"({"moves": [{"move": "twist", "axis": "y", "keys": [{"at": 0, "degrees": "x"}]}]})", "key 0"},
      {R"({"moves": [{"move": "twist", "axis": "y", "keys": [{"at": 1, "degrees": 0}, {"at": 1, "degrees": 0}]}]})",
       "key 1"},
      {R"({"moves": [{"move": "translate", "handles": [99], "keys": [{"at": 0, "by": [0, 0, 0]}]}]})", "\"handles\""},
      {R"({"moves": [{"move": "position", "keys": [{"at": 0, "positions": [[0, 0, 0]]}]}]})", "\"positions\""},
      {R"({"moves": [{"move": "translate", "keys": [{"at": 0, "by": [0, 0, 1e999]}]}]})", ""},
      {R"({"moves": 3})", "\"moves\""},
      {R"({"moves": [3]})", "move 0"},
      {R"({"moves": [{"move": "twist", "axis": "y", "keys": [3]}]})", "key 0"}};
  for (const auto& [json, field] : kWrong) {
    const auto script = Script::from_json(json, kBar);
    ASSERT_FALSE(script.has_value()) << json;
    EXPECT_EQ(script.error().code, ErrorCode::kCorrupt);
    EXPECT_THAT(script.error().message, HasSubstr(field));
  }
}

}  // namespace
}  // namespace eigencast::deform
