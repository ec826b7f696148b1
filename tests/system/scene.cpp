// SPDX-License-Identifier: MIT
#include "tests/system/scene.h"
#include "tests/support/paths.h"

#include <csignal>
#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>

namespace eigencast::testing {
namespace {

std::string program(const std::string& name) {
  return name.starts_with("/") ? name : bin_dir() + "/" + name;
}
/// A copy of `path` that ends at its last whole line, so that a file being written can be read.
std::string whole_lines(const std::string& path) {
  std::string text = text_of(path);
  text.resize(text.rfind('\n') + 1);
  const std::string copy = path + ".whole";
  std::ofstream(copy, std::ios::trunc) << text;
  return copy;
}

}  // namespace

std::string text_of(const std::string& path) {
  std::ifstream in(path);
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

Scene::Scene() {
  // ctest names one cache for the bakes of a whole run; everything else is the scene's own.
  if (std::getenv("EIGENCAST_CACHE") == nullptr) setenv("EIGENCAST_CACHE", folder_.file("cache").c_str(), 1);
}

std::unique_ptr<Process> Scene::start_broker(std::vector<std::string> more, std::vector<std::string> wrapper) {
  const std::string port_file = file("port");
  std::filesystem::remove(port_file);
  std::vector<std::string> all = std::move(wrapper);
  all.insert(all.end(), {program("eigencast-broker"), "--listen", "127.0.0.1:" + port_, "--admin-listen", "127.0.0.1:0",
                         "--port-file", port_file, "--data-dir", file("assets")});
  all.insert(all.end(), more.begin(), more.end());
  auto broker = std::make_unique<Process>(std::move(all), file("broker.log"));
  if (!eventually([&] { return std::filesystem::exists(port_file) || !broker->running(); }) || !broker->running()) {
    throw std::runtime_error("the broker did not start: " + broker->output());
  }
  std::ifstream(port_file) >> port_ >> admin_port_;
  return broker;
}

std::unique_ptr<Process> Scene::start_sender(std::vector<std::string> arguments, const std::string& to) {
  std::vector<std::string> all{program("eigencast-sender"), "play", "--wait"};
  all.insert(all.end(), arguments.begin(), arguments.end());
  all.insert(all.end(), {"--to", to.empty() ? url() : to, "--record", file("sent.jsonl")});
  return std::make_unique<Process>(std::move(all), file("sender.log"));
}

std::unique_ptr<Process> Scene::start_client(const std::string& name, std::vector<std::string> arguments) {
  std::vector<std::string> all{
      program("eigencast-client"), url(),      "--headless",          "--out",  file(name), "--json",
      file(name + ".json"),        "--record", file(name + ".jsonl"), "--size", "160x120"};
  all.insert(all.end(), arguments.begin(), arguments.end());
  return std::make_unique<Process>(std::move(all), file(name + ".log"));
}

int Scene::run(const std::string& name, std::vector<std::string> arguments, milliseconds timeout) {
  arguments[0] = program(arguments[0]);
  Process process(std::move(arguments), file(name + ".log"));
  return process.wait(timeout).value_or(-1);
}

std::vector<RecordedPose> Scene::received(const std::string& name) const {
  auto poses = read_recorded_poses(whole_lines(file(name + ".jsonl")));
  return poses ? std::move(*poses) : std::vector<RecordedPose>{};
}

SentFrames Scene::sent() const {
  auto frames = read_sent_frames(whole_lines(file("sent.jsonl")));
  return frames ? std::move(*frames) : SentFrames{};
}

std::optional<std::uint64_t> Scene::reconnects(const std::string& name, Process& client) const {
  client.signal(SIGTERM);
  if (client.wait(kPatience) != 0) return std::nullopt;
  const auto report = nlohmann::json::parse(text_of(file(name + ".json")), nullptr, false);
  if (!report.is_object() || !report.contains("reconnects")) return std::nullopt;
  return report["reconnects"].get<std::uint64_t>();
}

std::string Scene::logs() const {
  std::string all;
  for (const auto& entry : std::filesystem::directory_iterator(folder_.path())) {
    if (entry.path().extension() == ".log")
      all += "--- " + entry.path().filename().string() + "\n" + text_of(entry.path()) + "\n";
  }
  return all;
}

std::map<PoseKey, RecordedPose> by_step(const std::vector<RecordedPose>& poses) {
  std::map<PoseKey, RecordedPose> map;
  for (const RecordedPose& pose : poses) {
    const auto step = pose.is_key() ? std::pair{0, 0} : std::pair{int{pose.at}, int{pose.of}};
    map.insert_or_assign(PoseKey{pose.sequence, step}, pose);
  }
  return map;
}

}  // namespace eigencast::testing
