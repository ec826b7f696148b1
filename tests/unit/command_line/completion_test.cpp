// SPDX-License-Identifier: MIT
#include "common/command_line/command_line.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <CLI/CLI.hpp>
#include <algorithm>

namespace eigencast {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

/// A program of two commands, one below the other, with every kind of option.
struct Program {
  CLI::App app{"Moves things.", "mover"};
  std::string text;
  double number = 0;
  bool flag = false;

  Program() {
    app.add_flag("-q,--quiet", flag, "say 'nothing': [at all]");
    CLI::App* go = app.add_subcommand("go", "Go somewhere");
    go->add_option("place", text, "where to")->required();
    go->add_option("--gait", text, "how")->check(CLI::IsMember({"walk", "run"}));
    go->add_option_group("end")->add_flag("--at-dusk", flag, "until it is dark");
    go->add_option("-s,--speed", number, "metres a second");
    CLI::App* back = go->add_subcommand("back", "And return");
    back->add_flag("--slowly", flag, "without haste");
    app.add_subcommand("secret", "Not shown")->group("");
    app.add_flag("--hidden", flag, "not shown")->group("");
  }
};

TEST(Completion, NamesEveryShownCommandAndOption) {
  const Program program;
  for (const char* shell : {"bash", "zsh"}) {
    const std::string text = completion_script(program.app, shell).value();
    for (const char* word : {"go", "back", "gait", "walk", "run", "speed", "slowly", "quiet", "dusk"})
      EXPECT_THAT(text, HasSubstr(word)) << text;
    EXPECT_THAT(text, Not(HasSubstr("':'"))) << "a group of options is not a command";
    EXPECT_THAT(text, Not(HasSubstr("secret")));
    EXPECT_THAT(text, Not(HasSubstr("hidden")));
  }
}

TEST(CommandLine, NotANumberIsFound) {
  const auto fault = [](std::vector<std::string> words) {
    Program program;
    std::reverse(words.begin(), words.end());
    program.app.parse(words);
    return fault_of_numbers(program.app);
  };
  EXPECT_EQ(fault({"go", "nan", "--speed", "3.5"}), "") << "a place may be called so";
  EXPECT_EQ(fault({"go", "home"}), "");
  EXPECT_THAT(fault({"go", "home", "--speed", "nan"}), HasSubstr("--speed: nan"));
  EXPECT_THAT(fault({"go", "home", "--speed=-NaN"}), HasSubstr("--speed: -NaN"));
}

TEST(Completion, ZshNumbersSeveralPositionals) {
  CLI::App app{"Moves.", "mover"};
  std::string from, to, how;
  app.add_option("from", from, "where from");
  app.add_option("to", to, "where to");
  app.add_option("--gait", how, "walk, or run")->check(CLI::IsMember({"walk", "run"}));
  const std::string zsh = completion_script(app, "zsh").value();
  EXPECT_THAT(zsh, HasSubstr("'1:from:_files'"));
  EXPECT_THAT(zsh, HasSubstr("'2:to:_files'"));
  EXPECT_THAT(zsh, Not(HasSubstr("'*:"))) << "two of these are an error of zsh";
  EXPECT_THAT(zsh, HasSubstr("[walk, or run]")) << "choices that the text names are not repeated";
}

TEST(Completion, TextIsQuoted) {
  const Program program;
  EXPECT_THAT(completion_script(program.app, "zsh").value(), HasSubstr("say '\\''nothing'\\''\\: \\[at all\\]"));
}

TEST(Completion, UnknownShellHasNone) {
  EXPECT_FALSE(completion_script(Program().app, "csh"));
}

}  // namespace
}  // namespace eigencast
