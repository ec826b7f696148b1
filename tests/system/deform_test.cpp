// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/system/scene.h"

namespace eigencast::testing {
namespace {

/// Runs `deform` to its end and returns its report.
nlohmann::json deformed(Scene& scene, std::vector<std::string> arguments) {
  const auto broker = scene.start_broker();
  const auto client = scene.start_client("viewer", {"--frames", "10000"});
  std::vector<std::string> all{"eigencast-sender", "deform"};
  all.insert(all.end(), arguments.begin(), arguments.end());
  all.insert(all.end(), {"--to", scene.url(), "--json", scene.file("report"), "--rank", "40", "--rate", "15"});
  EXPECT_EQ(scene.run("deform", all, milliseconds(120000)), 0) << scene.logs();
  EXPECT_GE(scene.received("viewer").size(), 1u) << scene.logs();
  std::ifstream in(scene.file("report"));
  return nlohmann::json::parse(in, nullptr, false);
}

TEST(Deform, AScriptedCageStreamsAndReportsItsError) {
  Scene scene;
  const nlohmann::json report =
      deformed(scene, {"sphere", "--script", "both", "--once", "--cage-out", scene.file("cage.obj")});
  ASSERT_TRUE(report.is_object());
  EXPECT_EQ(
      report["frames_sent"].get<int>() + report["frames_dropped"].get<int>() + report["frames_skipped"].get<int>(), 61)
      << "4 s at 15 poses a second, both ends";
  EXPECT_GT(report["rms_over_diagonal"].get<double>(), 0);
  EXPECT_LT(report["rms_over_diagonal"].get<double>(), 0.01);
  EXPECT_GT(report["handles"].get<int>(), 50);

  // The cage that was written is a cage that is read.
  Scene again;
  const nlohmann::json same = deformed(
      again, {"sphere", "--cage", scene.file("cage.obj"), "--script", "twist", "--frames", "20", "--memory", "off"});
  EXPECT_EQ(same["handles"], report["handles"]);
  EXPECT_EQ(same["frames_recalled"], 0);
  EXPECT_EQ(same["memory_bytes"], 0);
}

TEST(Deform, HandlesFollowAScriptFile) {
  Scene scene;
  std::ofstream(scene.file("handles.json"))
      << R"({"handles": [{"low": [-2, 0.9, -2], "high": [2, 2, 2]}, {"low": [-2, -2, -2], "high": [2, -0.9, 2]}]})";
  std::ofstream(scene.file("keys.json")) << R"({"moves": [{"move": "translate", "handles": [0],
    "keys": [{"at": 0, "by": [0, 0, 0]}, {"at": 1, "by": [0.3, 0.5, 0]}]}]})";
  const nlohmann::json report =
      deformed(scene, {"sphere", "--handles", scene.file("handles.json"), "--script", scene.file("keys.json")});
  ASSERT_TRUE(report.is_object());
  EXPECT_EQ(report["handles"], 2);
  EXPECT_LT(report["rms_over_diagonal"].get<double>(), 0.02);
}

}  // namespace
}  // namespace eigencast::testing
