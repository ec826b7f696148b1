// SPDX-License-Identifier: MIT
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "tests/support/process.h"
#include "tools/compare/compare.h"

namespace eigencast::testing {

/// What a condition is given, at most; no test waits this long.
inline constexpr milliseconds kPatience{60'000};

/// Arguments of a viewer of raw keys that runs until it is stopped.
inline const std::vector<std::string> kEndless{"--frames", "1000000", "--rate", "raw"};

/// A broker, senders and clients as real processes, all on loopback, all in one temporary folder: assets, cache, logs,
/// records.
///
///   Scene scene;
///   auto broker = scene.start_broker();
///   auto sender = scene.start_sender({"torus", "--rate", "30"});
///   auto client = scene.start_client("a", {"--frames", "60"});
class Scene {
 public:
  Scene();

  /// Starts a broker; the first call takes any free port, later ones the same again. Waits until it listens.
  /// `wrapper` is a program that runs the broker, with its arguments; `more` are arguments of the broker.
  std::unique_ptr<Process> start_broker(std::vector<std::string> more = {}, std::vector<std::string> wrapper = {});
  /// eigencast-sender play ARGUMENTS --to the stream --record sent.jsonl
  /// `to`: another URL than url().
  std::unique_ptr<Process> start_sender(std::vector<std::string> arguments, const std::string& to = {});
  /// eigencast-client STREAM --headless --record NAME.jsonl --json NAME.json ARGUMENTS; pictures go to the folder NAME.
  std::unique_ptr<Process> start_client(const std::string& name, std::vector<std::string> arguments);
  /// Runs a program of the build to its end; returns its exit status. Its output is in file(NAME.log).
  int run(const std::string& name, std::vector<std::string> arguments, milliseconds timeout = milliseconds(120000));

  const std::string& port() const { return port_; }
  const std::string& admin_port() const { return admin_port_; }
  std::string url() const { return other_url_.empty() ? scheme_ + "://127.0.0.1:" + port_ + "/live/test" : other_url_; }
  void use_tls() { scheme_ = "wss"; }
  /// Makes url() this one from now on.
  void watch(const std::string& url) { other_url_ = url; }
  std::string file(const std::string& name) const { return folder_.file(name); }
  /// What client NAME received so far; a half-written last line is left out.
  std::vector<RecordedPose> received(const std::string& name) const;
  SentFrames sent() const;
  /// How often client NAME reconnected, by the report that it writes at its end; stops it if it runs.
  std::optional<std::uint64_t> reconnects(const std::string& name, Process& client) const;
  /// All logs, for the message of a failed test.
  std::string logs() const;

 private:
  TemporaryFolder folder_;
  std::string port_ = "0";
  std::string admin_port_;
  std::string scheme_ = "ws";
  std::string other_url_;
};

/// What a file holds.
std::string text_of(const std::string& path);

/// Poses by (sequence, step at, step of); a key is (sequence, 0, 0).
using PoseKey = std::pair<std::uint64_t, std::pair<int, int>>;
std::map<PoseKey, RecordedPose> by_step(const std::vector<RecordedPose>& poses);

}  // namespace eigencast::testing
