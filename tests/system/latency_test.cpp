// SPDX-License-Identifier: MIT
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/system/scene.h"

namespace eigencast::testing {
namespace {

TEST(Latency, TheProgramMeasuresReportsAndJudges) {
  Scene scene;
  auto broker = scene.start_broker();
  const std::string json = scene.file("a.json"), csv = scene.file("a.csv"), hgrm = scene.file("a.hgrm"),
                    log = scene.file("a.hlog"), samples = scene.file("a.samples");
  const std::vector<std::string> run{"eigencast-latency",
                                     "loop",
                                     scene.url(),
                                     "--source",
                                     "torus",
                                     "--rank",
                                     "24",
                                     "--duration",
                                     "0.8",
                                     "--warmup",
                                     "1.2",
                                     "--interp",
                                     "2",
                                     "--json",
                                     json,
                                     "--csv",
                                     csv,
                                     "--hgrm",
                                     hgrm,
                                     "--hdr-log",
                                     log,
                                     "--samples",
                                     samples};
  ASSERT_EQ(scene.run("first", run), 0) << scene.logs();
  const auto report = nlohmann::json::parse(text_of(json));
  EXPECT_EQ(report["inputs"]["interpolation"], 2);
  EXPECT_GT(report["keys"]["count"].get<int>(), 0);
  EXPECT_GT(report["synthetic"]["count"].get<int>(), 0);
  EXPECT_EQ(report["sum_check"]["wrong"], 0);
  EXPECT_EQ(report["sum_check"]["impossible"], 0);
  EXPECT_NE(text_of(csv).find(",key,"), std::string::npos);
  EXPECT_NE(text_of(hgrm).find("Percentile"), std::string::npos);
  EXPECT_NE(text_of(log).find("Tag=synthetic,"), std::string::npos);
  EXPECT_NE(text_of(samples).find("jitter_margin_us"), std::string::npos);

  auto judged = run;
  judged.insert(judged.end(), {"--fail-if", "max<1h"});
  EXPECT_EQ(scene.run("usage", judged), 2) << "hours are not a unit";
  judged.back() = "max>1us";
  EXPECT_EQ(scene.run("judged", judged), 3) << scene.logs();
  judged.back() = "p50>60s";
  EXPECT_EQ(scene.run("passed", judged), 0) << scene.logs();

  EXPECT_EQ(scene.run("compared", {"eigencast-latency", "compare", json, json}), 0);
  EXPECT_NE(text_of(scene.file("compared.log")).find("keys in_broker"), std::string::npos);
  const std::string probed = scene.file("probe.json");
  EXPECT_EQ(scene.run("probe", {"eigencast-latency", "probe", scene.url(), "--count", "5", "--json", probed}), 0)
      << scene.logs();
  EXPECT_EQ(nlohmann::json::parse(text_of(probed))["count"], 5);
}

}  // namespace
}  // namespace eigencast::testing
