// SPDX-License-Identifier: MIT
#include "common/command_line/documents.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <CLI/CLI.hpp>
#include <algorithm>

namespace eigencast {
namespace {

using testing::HasSubstr;
using testing::Not;

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
    go->add_option("-s,--speed", number, "metres a second")->envname("MOVER_SPEED");
    CLI::App* back = go->add_subcommand("back", "And return");
    back->add_flag("--slowly", flag, "without haste");
    app.add_subcommand("secret", "Not shown")->group("");
    app.add_flag("--hidden", flag, "not shown")->group("");
  }
};

TEST(Documents, EachNamesEveryCommandAndOptionThatTheHelpShows) {
  const Program program;
  const std::string man = man_page_from(program.app, "1.2.3", "0 done", "mover go home");
  for (const std::string& text :
       {man, completion_from(program.app, Shell::kBash), completion_from(program.app, Shell::kZsh),
        completion_from(program.app, Shell::kFish)}) {
    for (const char* word : {"go", "back", "gait", "walk", "run", "speed", "slowly", "quiet", "dusk"})
      EXPECT_THAT(text, HasSubstr(word)) << text;
    EXPECT_THAT(text, Not(HasSubstr("':'"))) << "a group of options is no command";
    EXPECT_THAT(text, Not(HasSubstr("secret")));
    EXPECT_THAT(text, Not(HasSubstr("hidden")));
  }
  EXPECT_THAT(man, HasSubstr("MOVER_SPEED"));
  EXPECT_THAT(man, HasSubstr(".SS \"go back\""));
  EXPECT_THAT(man, HasSubstr("1.2.3"));
  EXPECT_THAT(man, HasSubstr("mover go home"));
}

TEST(CommandLine, NumbersThatAreNoneAreFound) {
  const auto fault = [](std::vector<std::string> words) {
    Program program;
    std::reverse(words.begin(), words.end());
    program.app.parse(words);
    return fault_of_numbers(program.app);
  };
  EXPECT_EQ(fault({"go", "nan", "--speed", "3.5"}), "") << "a place may be called so";
  EXPECT_EQ(fault({"go", "home"}), "");
  EXPECT_EQ(fault({"go", "home", "--speed", "nan"}), "--speed: nan is no number");
  EXPECT_EQ(fault({"go", "home", "--speed=-NaN"}), "--speed: -NaN is no number");
}

TEST(Documents, ArgumentsOfACommandThatHasSeveralHaveTheirPlaces) {
  CLI::App app{"Moves.", "mover"};
  std::string from, to, how;
  app.add_option("from", from, "where from");
  app.add_option("to", to, "where to");
  app.add_option("--gait", how, "walk, or run")->check(CLI::IsMember({"walk", "run"}));
  const std::string zsh = completion_from(app, Shell::kZsh);
  EXPECT_THAT(zsh, HasSubstr("'1:from:_files'"));
  EXPECT_THAT(zsh, HasSubstr("'2:to:_files'"));
  EXPECT_THAT(zsh, Not(HasSubstr("'*:"))) << "two of these are an error of zsh";
  EXPECT_THAT(zsh, HasSubstr("[walk, or run]")) << "what a text tells is not told again";
}

TEST(Documents, TextIsNeverTakenForACommand) {
  CLI::App app{"Moves.", "mover"};
  bool flag = false;
  app.add_flag("--dot", flag, ".SH a line that begins with a dot\n'and one with a quote, and a \\backslash");
  const std::string man = man_page_from(app, "1", "", ".br\n'br");
  EXPECT_THAT(man, HasSubstr("\\&.SH a line"));
  EXPECT_THAT(man, HasSubstr("\\&'and one"));
  EXPECT_THAT(man, HasSubstr("\\ebackslash"));
  EXPECT_THAT(man, HasSubstr("\\&.br\n\\&'br"));
  const Program program;
  EXPECT_THAT(completion_from(program.app, Shell::kZsh), HasSubstr("say '\\''nothing'\\''\\: \\[at all\\]"));
}

TEST(Documents, ShellsAreKnownByName) {
  EXPECT_EQ(shell_from_name("fish"), Shell::kFish);
  EXPECT_FALSE(shell_from_name("csh"));
}

}  // namespace
}  // namespace eigencast
