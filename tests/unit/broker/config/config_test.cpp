// SPDX-License-Identifier: MIT
#include "broker/config/config.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>

#include "broker/backbone/nats_link.h"
#include "broker/command_line/options.h"
#include "broker/config/show.h"

namespace eigencast::broker {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::MatchesRegex;
using ::testing::StartsWith;

std::string file_text(const char* path) {
  std::ifstream file(path);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

/// A value that is not the default; within bounds where it can be.
void spoil(Config& config, const Setting& setting) {
  const auto field = setting.field(config);
  if (auto* const* text = std::get_if<std::string*>(&field)) **text = "spoilt";
  if (auto* const* flag = std::get_if<bool*>(&field)) **flag = !**flag;
  if (auto* const* number = std::get_if<std::int64_t*>(&field)) **number = **number == 1 ? 2 : 1;
  if (auto* const* list = std::get_if<std::vector<std::string>*>(&field)) **list = {"spoilt", "a \"quoted\" one"};
}

TEST(ConfigTest, ShippedDefaultFileMatchesTable) {
  EXPECT_EQ(file_text(EIGENCAST_DEFAULT_CONFIG), default_file())
      << "regenerate it: eigencast-broker --default-config > deploy/eigencast.toml";
}

TEST(ConfigTest, DefaultFileRestoresEveryDefault) {
  LoadedConfig read;
  for (const Setting& setting : settings()) spoil(read.config, setting);
  const auto result = read_config(read, default_file(), "eigencast.toml");
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_EQ(read.origins.size(), settings().size());
  for (const Setting& setting : settings()) {
    EXPECT_EQ(value_of(read.config, setting), value_of(Config{}, setting)) << setting.path();
  }
}

TEST(ConfigTest, SettingsAreDocumentedWithUnits) {
  std::set<std::string> seen;
  for (const Setting& setting : settings()) {
    EXPECT_TRUE(seen.insert(setting.path()).second) << setting.path() << " appears twice";
    EXPECT_TRUE(setting.doc.size() > 5 && setting.doc.ends_with('.')) << setting.path();
    EXPECT_TRUE(section_doc(setting.section).ends_with('.')) << setting.section;
    const std::string_view name = setting.name;
    EXPECT_EQ(name.ends_with("_ms"), setting.unit == "milliseconds") << setting.path();
    EXPECT_EQ(name.ends_with("_s") && !name.ends_with("_per_s"), setting.unit == "seconds") << setting.path();
    EXPECT_EQ(name.find("bytes") != name.npos, setting.unit.starts_with("bytes")) << setting.path();
  }
}

TEST(ConfigTest, DefaultsAreWithinTheirOwnBounds) {
  for (const Setting& setting : settings()) {
    Config config;
    EXPECT_TRUE(set_config(config, setting, value_of(config, setting))) << setting.path();
  }
  EXPECT_TRUE(check_config(Config{}));
}

TEST(ConfigTest, ReloadAppliesLiveSettingsAndReportsOthers) {
  Config running;
  Config wanted;
  for (const Setting& setting : settings()) spoil(wanted, setting);
  EXPECT_EQ(changes_between(running, wanted).size(), settings().size());
  EXPECT_TRUE(changes_between(running, running).empty());
  wanted = {};
  wanted.limits.max_uploads = 3;
  wanted.server.data_dir = "/elsewhere";
  const auto changes = changes_between(running, wanted);
  ASSERT_EQ(changes.size(), 2U);
  EXPECT_FALSE(changes[0].live);
  EXPECT_EQ(changes[0].after, "\"/elsewhere\"");
  EXPECT_TRUE(changes[1].live);
  EXPECT_EQ(changes[1].before, "64");
  const Config merged = reloaded(running, wanted);
  EXPECT_EQ(merged.limits.max_uploads, 3);
  EXPECT_EQ(merged.server.data_dir, "");
}

TEST(ConfigTest, ShownConfigurationNamesOrigins) {
  const std::string path = ::testing::TempDir() + "/eigencast_shown.toml";
  std::ofstream(path) << "\n[limits]\nmax_streams = 5\n";
  const char* argv[] = {"eigencast-broker", "--config", path.c_str(), "--limits-max-uploads", "7", "--show-config"};
  const auto options = read_options(6, argv, {"EIGENCAST_LOG__LEVEL=error"}, "0");
  ASSERT_TRUE(options) << options.error().message;
  EXPECT_THAT(*options->answer, MatchesRegex("(.|\n)*max_streams = 5 +# .*eigencast_shown.toml:3\n(.|\n)*"));
  EXPECT_THAT(*options->answer, MatchesRegex("(.|\n)*max_uploads = 7 +# --limits-max-uploads\n(.|\n)*"));
  EXPECT_THAT(*options->answer, MatchesRegex("(.|\n)*level = \"error\" +# EIGENCAST_LOG__LEVEL\n(.|\n)*"));
  EXPECT_THAT(*options->answer, MatchesRegex("(.|\n)*max_connections = 20000 +# default\n(.|\n)*"));
}

TEST(ConfigTest, MistakesAreReportedWithLineAndSuggestion) {
  LoadedConfig config;
  const auto message = [&](std::string_view toml) {
    const auto read = read_config(config, toml, "f.toml");
    return read ? std::string() : read.error().message;
  };
  EXPECT_THAT(message("[server]\n\nlissten = 'x'\n"),
              AllOf(StartsWith("f.toml:3: "), HasSubstr("'server.lissten'"), HasSubstr("'server.listen'")));
  EXPECT_THAT(message("[limits]\nmax_streams = 'many'\n"), StartsWith("f.toml:2: limits.max_streams"));
  EXPECT_THAT(message("[limits]\nmax_streams = 0\n"), StartsWith("f.toml:2: limits.max_streams = 0 "));
  EXPECT_THAT(message("[log]\nlevel = 'loud'\n"), StartsWith("f.toml:2: log.level = 'loud' "));
  EXPECT_THAT(message("[access]\nexpiry_disconnects = 1\n"), StartsWith("f.toml:2: access.expiry_disconnects"));
  EXPECT_THAT(message("[server\n"), HasSubstr("f.toml:1"));
  EXPECT_THAT(message("listen = 'x'\n"), HasSubstr("'listen'"));
  EXPECT_EQ(load_config({"/nonexistent/x.toml", {}, {}}).error().code, ErrorCode::kNotFound);
}

TEST(ConfigTest, InputThatCrashesTheParserIsRefused) {
  LoadedConfig config;
  for (const char* broken :
       {"[!ccess]", "[", "[[", "[ ", "[#]", "\t[ \xC3\xA4]", "[[!]]", "[.a]", "[\r", "[ [a]]", "[]", "[a",
        "11\xEF\xBB\xBF=.3", "x = \xC3\xA4", "x = \"\" \xC3\xA4", "x = \"\\\"\" \xC3\xA4"}) {
    const auto read = read_config(config, std::string("[limits]\nmax_streams = 5\n") + broken + "\nx = 1\n", "file");
    ASSERT_FALSE(read) << broken;
    EXPECT_THAT(read.error().message, StartsWith("file:3: ")) << broken;
  }
  EXPECT_THAT(read_config(config, "\xEF\xBB\xBF[limits]\r\n[!]\r\n", "file").error().message, StartsWith("file:2: "));
  EXPECT_TRUE(read_config(config, "# \xC3\xA4\n[server]\ndata_dir = \"\\\"\xC3\xA4\" # '\xC3\xA4\n", "file"));
  EXPECT_TRUE(read_config(config, "[ limits ]\nmax_streams = 5\n\t['assets']\n[\"log\"]\n", "file"));
}

TEST(ConfigTest, FlagsWinOverEnvironmentOverFile) {
  const std::string path = ::testing::TempDir() + "/eigencast_precedence.toml";
  std::ofstream(path) << "[limits]\nmax_streams = 5\nmax_connections = 50\n[log]\nlevel = 'error'\n";
  const std::vector<std::string> environment = {"EIGENCAST_LIMITS__MAX_STREAMS=6", "EIGENCAST_LOG__LEVEL=warning",
                                                "EIGENCAST_URL=ws://x", "OTHER__RATE=3", "HOME=/"};
  const char* argv[] = {"eigencast-broker", "--config", path.c_str(), "--log-level", "debug"};
  const auto options = read_options(5, argv, environment, "0");
  ASSERT_TRUE(options) << options.error().message;
  EXPECT_EQ(options->loaded.config.limits.max_connections, 50);
  EXPECT_EQ(options->loaded.config.limits.max_streams, 6);
  EXPECT_EQ(options->loaded.config.log.level, "debug");
  EXPECT_EQ(options->loaded.config.limits.max_uploads, Config{}.limits.max_uploads);
  for (const std::string wrong : {"EIGENCAST_LIMITS__MAX_STREMS=6", "EIGENCAST_LIMTS__MAX_STREAMS=6"}) {
    const auto refused = read_options(1, argv, {wrong}, "0");
    ASSERT_FALSE(refused) << wrong;
    EXPECT_THAT(refused.error().message, HasSubstr("'limits.max_streams'"));
  }
}

TEST(ConfigTest, VariablesMissingAnUnderscoreAreRefused) {
  for (const std::string_view wrong : {"EIGENCAST_LIMITS_MAX_STREAMS", "EIGENCAST_PER_ADDRESS_CONNECTIONS"}) {
    const std::string entry = std::string(wrong) + "=6";
    LoadedConfig config;
    const auto refused = read_environment(config, {&entry, 1});
    ASSERT_FALSE(refused) << wrong;
    EXPECT_THAT(refused.error().message,
                HasSubstr(wrong == "EIGENCAST_LIMITS_MAX_STREAMS" ? "EIGENCAST_LIMITS__MAX_STREAMS"
                                                                  : "EIGENCAST_PER_ADDRESS__CONNECTIONS"));
  }
  for (const std::string other : {"EIGENCAST_TOKEN=6", "EIGENCAST_LIMITS=6", "EIGENCAST_=6", "EIGENCAST_LIMITS_=6"}) {
    LoadedConfig loaded;
    EXPECT_TRUE(read_environment(loaded, {&other, 1})) << other;
    EXPECT_EQ(loaded.config.limits.max_streams, Config{}.limits.max_streams);
  }
}

TEST(ConfigTest, ListeningBeyondLoopbackNeedsAccessRules) {
  for (const char* open : {"0.0.0.0:7490", "[::]:7490", "192.168.1.2:7490"}) {
    Config config;
    config.server.listen = open;
    EXPECT_THAT(check_config(config).error().message, HasSubstr("server.listen = "));
    config.access.anonymous = "anywhere";
    EXPECT_TRUE(check_config(config)) << open;
    config.access.anonymous = "loopback";
    config.access.tokens_file = "/etc/eigencast/tokens";
    EXPECT_TRUE(check_config(config)) << open;
  }
  Config config;
  for (const char* loopback : {"127.0.0.1:0", "127.8.8.8:1", "[::1]:7490", "localhost:7490"}) {
    config.server.listen = loopback;
    EXPECT_TRUE(check_config(config)) << loopback;
  }
  config.access.anonymous = "anywhere";
  config.server.admin_listen = "0.0.0.0:7491";
  EXPECT_FALSE(check_config(config)) << "admin asks for a token, and there are none";
  config.access.monitors = {"10.88.0.0/16"};
  EXPECT_TRUE(check_config(config)) << "monitors need no token";
  config.access.monitors.clear();
  config.access.jwt_keys = {"main ES256 /etc/eigencast/main.pem"};
  EXPECT_TRUE(check_config(config));
}

TEST(ConfigTest, DependentSettingsAreChecked) {
  Config config;
  config.tls.certificate = "a.pem";
  EXPECT_THAT(check_config(config).error().message, HasSubstr("tls.key"));
  config.tls.key = "a.key";
  EXPECT_TRUE(check_config(config));
  config.tls.require_client_certificate = true;
  EXPECT_THAT(check_config(config).error().message, HasSubstr("tls.client_ca"));
  config = {};
  for (const char* bad : {"eigencast", "/", "/a/"}) {
    config.proxy.path_prefix = bad;
    EXPECT_THAT(check_config(config).error().message, HasSubstr("path_prefix")) << bad;
  }
}

TEST(ConfigTest, SecretsAreNeverShown) {
  const char* argv[] = {"eigencast-broker",
                        "--show-config",
                        "--access-jwt-secret",
                        "hunter2-hunter2-hunter2-hunter2-",
                        "--backbone-servers",
                        "nats://me:hunter2@a:4222,nats://b:4222"};
  const auto options = read_options(6, argv, {}, "0");
  ASSERT_TRUE(options) << options.error().message;
  EXPECT_THAT(*options->answer, HasSubstr("jwt_secret = \"(set)\""));
  EXPECT_THAT(*options->answer, ::testing::Not(HasSubstr("hunter2")));
  const auto changes = changes_between(Config{}, options->loaded.config);
  ASSERT_EQ(changes.size(), 2U);
  EXPECT_EQ(changes[0].after, "\"(set)\"");
  EXPECT_EQ(changes[1].after, R"(["nats://...@a:4222", "nats://b:4222"])");
  for (const char* bad : {"http://me:hunter2@a:1", "me:hunter2@a:1", "nats:me:hunter2@a:1"}) {
    Config config;
    config.backbone.servers = {bad};
    EXPECT_THAT(make_nats_link(config, "test", {}).error().message,
                ::testing::AllOf(HasSubstr("@a:1"), ::testing::Not(HasSubstr("hunter2"))));
  }
}

TEST(ConfigTest, InvalidAddressesAreRefused) {
  for (const char* bad : {"", ":", "7490", "127.0.0.1", "127.0.0.1:", "127.0.0.1:65536", "127.0.0.1:-1", "host:1",
                          "::1:7490", "1.2.3.4:5x"}) {
    EXPECT_FALSE(parse_address(bad)) << bad;
  }
}

/// The environment that systemd makes; nothing of it is left afterwards.
class PathsTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::filesystem::create_directories(folder_ + "/keys");
    std::filesystem::create_directories(folder_ + "/etc");
    for (const char* name : kNames) ::unsetenv(name);
  }
  void TearDown() override {
    for (const char* name : kNames) ::unsetenv(name);
    if (!home_.empty()) ::setenv("HOME", home_.c_str(), 1);
    std::filesystem::remove_all(folder_);
  }
  static constexpr const char* kNames[] = {"STATE_DIRECTORY", "XDG_STATE_HOME", "CONFIGURATION_DIRECTORY",
                                           "CREDENTIALS_DIRECTORY"};
  std::string folder_ = ::testing::TempDir() + "/eigencast-config-" + std::to_string(::getpid());
  std::string home_ = std::getenv("HOME") != nullptr ? std::getenv("HOME") : "";
};

TEST_F(PathsTest, StateDirectoryWinsOverUserFolder) {
  Config config;
  ::setenv("HOME", "/home/a", 1);
  EXPECT_EQ(data_dir_of(config), "/home/a/.local/state/eigencast");
  ::setenv("XDG_STATE_HOME", "/home/a/state", 1);
  EXPECT_EQ(data_dir_of(config), "/home/a/state/eigencast");
  ::setenv("STATE_DIRECTORY", "/var/lib/eigencast:/var/lib/other", 1);
  EXPECT_EQ(data_dir_of(config), "/var/lib/eigencast");
  config.server.data_dir = "/data";
  EXPECT_EQ(data_dir_of(config), "/data");
}

TEST_F(PathsTest, RelativeFilesResolveToCredentialsThenConfiguration) {
  EXPECT_EQ(resolved_path("tls.key"), "tls.key");
  ::setenv("CREDENTIALS_DIRECTORY", (folder_ + "/keys").c_str(), 1);
  ::setenv("CONFIGURATION_DIRECTORY", (folder_ + "/etc").c_str(), 1);
  EXPECT_EQ(resolved_path("tls.key"), "tls.key") << "in neither";
  std::ofstream(folder_ + "/etc/tls.key") << "x";
  EXPECT_EQ(resolved_path("tls.key"), folder_ + "/etc/tls.key");
  std::ofstream(folder_ + "/keys/tls.key") << "x";
  EXPECT_EQ(resolved_path("tls.key"), folder_ + "/keys/tls.key");
  EXPECT_EQ(resolved_path("/etc/tls.key"), "/etc/tls.key");
  EXPECT_EQ(resolved_path(""), "");
}

TEST_F(PathsTest, ServiceFindsItsConfigurationFile) {
  EXPECT_EQ(default_config_file(), "");
  ::setenv("CONFIGURATION_DIRECTORY", (folder_ + "/etc").c_str(), 1);
  EXPECT_EQ(default_config_file(), "");
  std::ofstream(folder_ + "/etc/eigencast.toml") << "[limits]\nmax_streams = 7\n";
  const char* argv[] = {"eigencast-broker", "--show-config"};
  const auto options = read_options(2, argv, {}, "0");
  ASSERT_TRUE(options) << options.error().message;
  EXPECT_EQ(options->loaded.config.limits.max_streams, 7);
  EXPECT_THAT(*options->answer, HasSubstr("eigencast.toml:2"));
}

TEST(OptionsTest, UsageErrorsAndAnswers) {
  const char* unknown[] = {"eigencast-broker", "--frobnicate"};
  EXPECT_THAT(read_options(2, unknown, {}, "0").error().message, HasSubstr("'--frobnicate'"));
  const char* nearly[] = {"eigencast-broker", "--port-file", "x", "--limits-max-streamz=3", "--lissten", "y"};
  EXPECT_THAT(read_options(4, nearly, {}, "0").error().message, HasSubstr("'--limits-max-streams'"));
  nearly[3] = nearly[4];
  nearly[4] = nearly[5];
  EXPECT_THAT(read_options(5, nearly, {}, "0").error().message,
              AllOf(HasSubstr("'--lissten'"), HasSubstr("'--listen'")));
  const char* alone[] = {"eigencast-broker", "3"};
  EXPECT_THAT(read_options(2, alone, {}, "0").error().message, HasSubstr("'3'"));
  const char* version[] = {"eigencast-broker", "--version"};
  EXPECT_THAT(read_options(2, version, {}, "1.2.3")->answer.value(), HasSubstr("eigencast-broker 1.2.3"));
  const char* help[] = {"eigencast-broker", "--help"};
  EXPECT_THAT(read_options(2, help, {}, "0")->answer.value(), HasSubstr("--port-file"));
}

}  // namespace
}  // namespace eigencast::broker
