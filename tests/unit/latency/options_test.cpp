// SPDX-License-Identifier: MIT
#include "tools/latency/commands.h"

#include <gtest/gtest.h>

namespace eigencast::latency {
namespace {

std::variant<Options, ExitNow> parsed(std::vector<const char*> words) {
  words.insert(words.begin(), "eigencast-latency");
  return options_from_command_line(static_cast<int>(words.size()), words.data(), "1");
}

TEST(Options, EachCommandIsParsed) {
  const auto options = parsed({"loop", "ws://h/s", "--clients", "5", "--interp", "3", "--token", "t", "--csv", "-"});
  const auto* loop = std::get_if<Options>(&options);
  ASSERT_TRUE(loop);
  EXPECT_EQ(loop->command, Options::Command::kMeasure);
  EXPECT_EQ(loop->inputs.mode, "loop");
  EXPECT_EQ(loop->inputs.clients, 5u);
  EXPECT_EQ(loop->inputs.profile().k, 3);
  EXPECT_EQ(loop->inputs.credentials.token, "t");
  const auto pair = parsed({"pair", "--subscribe", "ws://h/s"});
  ASSERT_TRUE(std::get_if<Options>(&pair));
  EXPECT_EQ(std::get<Options>(pair).inputs.mode, "subscribe");
  EXPECT_EQ(std::get<Options>(pair).inputs.profile().rate, Profile::Rate::kRaw);
  const auto sweep = parsed({"sweep", "--rates", "30,60", "--clients", "1,100"});
  ASSERT_TRUE(std::get_if<Options>(&sweep));
  EXPECT_EQ(std::get<Options>(sweep).rates, (std::vector<double>{30, 60}));
}

TEST(Options, InvalidCommandLinesAreUsageErrors) {
  for (const std::vector<const char*>& words :
       std::vector<std::vector<const char*>>{{},
                                             {"loop", "--rate", "0"},
                                             {"loop", "--rate", "nan"},
                                             {"loop", "--duration", "-1"},
                                             {"loop", "--clients", "0"},
                                             {"loop", "--codec", "mp3"},
                                             {"loop", "--late-ms", "-5"},
                                             {"loop", "--json", "/nonexistent/folder/a.json"},
                                             {"loop", "--samples", "/"},
                                             {"pair"},
                                             {"pair", "--publish", "ws://h/s", "--subscribe", "ws://h/s"},
                                             {"passive"},
                                             {"probe", "ws://h", "--count", "0"},
                                             {"sweep", "--rates", "0"},
                                             {"sweep", "--rates", "30,1e9"},
                                             {"sweep", "--clients", "0"},
                                             {"sweep", "--interps", "16"},
                                             {"sweep", "--ranks", "2"},
                                             {"sweep", "--json", "/nonexistent/folder/a.json"},
                                             {"compare", "one.json"}}) {
    const auto options = parsed(words);
    const auto* now = std::get_if<ExitNow>(&options);
    ASSERT_TRUE(now) << (words.empty() ? "" : words.back());
    EXPECT_EQ(now->code, kExitUsage) << (words.empty() ? "" : words.back());
  }
}

}  // namespace
}  // namespace eigencast::latency
