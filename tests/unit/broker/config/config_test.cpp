// SPDX-License-Identifier: MIT
#include "broker/config/config.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <set>
#include <sstream>

#include "broker/config/options.h"

namespace eigencast::broker {
namespace {

using ::testing::HasSubstr;

std::string value_of(Config& config, const ConfigKey& key) {
  const auto field = key.field(config);
  if (const auto* text = std::get_if<std::string*>(&field)) return **text;
  if (const auto* flag = std::get_if<bool*>(&field)) return **flag ? "true" : "false";
  return std::to_string(*std::get<std::int64_t*>(field));
}

std::string default_file() {
  std::ifstream file(EIGENCAST_DEFAULT_CONFIG);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

TEST(ConfigTest, TheDefaultFileNamesEveryKeyOnceWithItsDefaultAndAComment) {
  std::istringstream lines(default_file());
  std::set<std::string> seen;
  std::string section;
  std::string line;
  std::string before;
  for (; std::getline(lines, line); before = line) {
    if (line.starts_with("[")) section = line.substr(1, line.find(']') - 1);
    const auto equals = line.find(" = ");
    if (line.starts_with("#") || equals == std::string::npos) continue;
    EXPECT_TRUE(seen.insert(section + "." + line.substr(0, equals)).second) << line;
    EXPECT_TRUE(before.starts_with("#")) << line << " has no comment";
  }
  std::set<std::string> known;
  for (const ConfigKey& key : config_keys()) known.insert(key.path());
  EXPECT_EQ(seen, known);

  // Every value is spoilt first, so that only the file can bring the defaults back.
  Config defaults;
  Config read;
  for (const ConfigKey& key : config_keys()) {
    const auto field = key.field(read);
    if (const auto* text = std::get_if<std::string*>(&field)) **text = "spoilt";
    if (const auto* flag = std::get_if<bool*>(&field)) **flag = !**flag;
    if (const auto* number = std::get_if<std::int64_t*>(&field)) **number = -1;
  }
  const auto result = read_config(read, default_file(), "eigencast.toml");
  ASSERT_TRUE(result) << result.error().message;
  for (const ConfigKey& key : config_keys()) EXPECT_EQ(value_of(read, key), value_of(defaults, key)) << key.path();
}

TEST(ConfigTest, DefaultsAreWithinTheirOwnBounds) {
  for (const ConfigKey& key : config_keys()) {
    Config config;
    EXPECT_TRUE(set_config(config, key.path(), value_of(config, key))) << key.path();
  }
  EXPECT_TRUE(check_config(Config{}));
}

TEST(ConfigTest, MistakesAreNamedWithLineAndSuggestion) {
  Config config;
  const auto message = [&](std::string_view toml) {
    const auto read = read_config(config, toml, "f.toml");
    return read ? std::string() : read.error().message;
  };
  EXPECT_THAT(message("[server]\n\nlissten = 'x'\n"),
              HasSubstr("f.toml:3: unknown key 'server.lissten'; did you mean 'server.listen'?"));
  EXPECT_THAT(message("[limits]\nmax_streams = 'many'\n"), HasSubstr("limits.max_streams must be a whole number"));
  EXPECT_THAT(message("[limits]\nmax_streams = 0\n"), HasSubstr("outside 1.."));
  EXPECT_THAT(message("[log]\nlevel = 'loud'\n"), HasSubstr("debug, info, warning, error"));
  EXPECT_THAT(message("[server]\nallow_anonymous = 1\n"), HasSubstr("true or false"));
  EXPECT_THAT(message("[server\n"), HasSubstr("f.toml:1"));
  EXPECT_THAT(message("listen = 'x'\n"), HasSubstr("unknown key"));
  EXPECT_EQ(read_config_file(config, "/nonexistent/x.toml").error().code, ErrorCode::kNotFound);
}

TEST(ConfigTest, FlagsWinOverEnvironmentOverFile) {
  const std::string path = ::testing::TempDir() + "/eigencast_precedence.toml";
  std::ofstream(path) << "[limits]\nmax_streams = 5\nmax_connections = 50\n[log]\nlevel = 'error'\n";
  const std::vector<std::string_view> environment = {"EIGENCAST_LIMITS__MAX_STREAMS=6", "EIGENCAST_LOG__LEVEL=warning",
                                                     "EIGENCAST_URL=ws://x", "EIGENCAST_SENDER__RATE=3", "HOME=/"};
  const char* argv[] = {"eigencast-broker", "--config", path.c_str(), "--log-level", "debug"};
  const auto options = read_options(5, argv, environment, "0");
  ASSERT_TRUE(options) << options.error().message;
  EXPECT_EQ(options->config.limits.max_connections, 50);
  EXPECT_EQ(options->config.limits.max_streams, 6);
  EXPECT_EQ(options->config.log.level, "debug");
  EXPECT_EQ(options->config.limits.max_uploads, Config{}.limits.max_uploads);
  const std::vector<std::string_view> wrong = {"EIGENCAST_LIMITS__MAX_STREMS=6"};
  EXPECT_THAT(read_options(1, argv, wrong, "0").error().message, HasSubstr("did you mean 'limits.max_streams'?"));
}

TEST(ConfigTest, NobodyListensBeyondLoopbackUnasked) {
  Config config;
  for (const char* open : {"0.0.0.0:7490", "[::]:7490", "192.168.1.2:7490"}) {
    config.server.listen = open;
    config.server.allow_anonymous = false;
    EXPECT_THAT(check_config(config).error().message, HasSubstr("allow_anonymous"));
    config.server.allow_anonymous = true;
    EXPECT_TRUE(check_config(config)) << open;
  }
  for (const char* loopback : {"127.0.0.1:0", "127.8.8.8:1", "[::1]:7490", "localhost:7490"}) {
    config.server.listen = loopback;
    config.server.allow_anonymous = false;
    EXPECT_TRUE(check_config(config)) << loopback;
  }
  config.server.admin_listen = "0.0.0.0:7491";
  EXPECT_FALSE(check_config(config));
}

TEST(ConfigTest, AddressesThatAreNone) {
  for (const char* bad : {"", ":", "7490", "127.0.0.1", "127.0.0.1:", "127.0.0.1:65536", "127.0.0.1:-1", "host:1",
                          "::1:7490", "1.2.3.4:5x"}) {
    EXPECT_FALSE(parse_address(bad)) << bad;
  }
}

TEST(OptionsTest, UsageErrorsAndAnswers) {
  const char* unknown[] = {"eigencast-broker", "--frobnicate"};
  EXPECT_FALSE(read_options(2, unknown, {}, "0"));
  const char* version[] = {"eigencast-broker", "--version"};
  EXPECT_THAT(read_options(2, version, {}, "1.2.3")->answer.value(), HasSubstr("eigencast-broker 1.2.3"));
  const char* help[] = {"eigencast-broker", "--help"};
  EXPECT_THAT(read_options(2, help, {}, "0")->answer.value(), HasSubstr("Exit codes"));
}

}  // namespace
}  // namespace eigencast::broker
