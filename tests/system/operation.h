// SPDX-License-Identifier: MIT
#pragma once

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/system/scene.h"

namespace eigencast::testing {

/// A blocking TCP connection to a port of this machine, whose reads give up after 20 s; -1: none.
///   from  the address it comes from, for limits that count by address
int connect_to(const std::string& port, const char* from = "127.0.0.1");
/// A connection that has asked for a WebSocket at `target`, and read the answer's head; -1: refused. Its owner speaks,
/// or not, as it likes.
int upgrade(const std::string& port, const std::string& target, const char* from = "127.0.0.1");
bool send_all(int fd, const std::string& bytes);
/// A whole WebSocket message of a client, below 126 bytes.
std::string websocket_text(const std::string& text);
/// The whole answer to one HTTP request, head and body; empty if there was none.
std::string ask(const std::string& port, const std::string& method, const std::string& target,
                const std::string& body = {});
std::string body_of(const std::string& answer);

/// A scene whose broker is observed through its admin port.
class Operation : public ::testing::Test {
 protected:
  std::string get(const std::string& target) { return ask(scene_.admin_port(), "GET", target); }
  std::string post(const std::string& target) { return ask(scene_.admin_port(), "POST", target); }
  nlohmann::json api(const std::string& name);
  /// The first client of the report that is one: "sender", "viewer"; null: none.
  nlohmann::json client_of_kind(const std::string& kind);
  /// Reads a metric without labels. A metric that is not there fails the test.
  double metric(const std::string& name);
  /// The first stream takes keys: ten more arrive.
  bool live();
  /// Ten more poses arrive at client `name`.
  bool grows(const std::string& name);
  static void kill(Process& process);
  std::vector<std::string> recordings() const;

  Scene scene_;
};

}  // namespace eigencast::testing
