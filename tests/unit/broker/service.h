// SPDX-License-Identifier: MIT
#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "broker/config/config.h"
#include "common/core/log.h"
#include "common/wire/control.h"
#include "tests/unit/broker/support.h"

namespace eigencast::broker {
class Broker;
}

/// The whole broker in this process on its own thread, with blocking clients on loopback. Endless waits end with the
/// test's time limit.
namespace eigencast::broker::testing {

/// A WebSocket client. Throws if the port is closed.
class Client {
 public:
  Client(std::uint16_t port, const std::string& target, const std::string& subprotocol = "eigencast.v2");
  ~Client();
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  /// The status of the upgrade's response; 101: accepted.
  int status() const;
  /// The subprotocol that the broker chose.
  std::string subprotocol() const;

  void send(const ControlMessage& message);
  void send_text(const std::string& text);
  /// A FakeSender's, with the tag that this client was granted.
  void send_frame(Bytes frame);
  /// Whether the last call failed, as all do once the connection is closed; and why.
  bool failed() const;
  std::string failure() const;

  /// The next message; false when the connection is closed.
  bool read();
  /// The next control message; Bye when the connection is closed.
  ControlMessage next_control();
  template <typename T>
  T wait_for() {
    for (;;) {
      const auto message = next_control();
      if (const auto* wanted = std::get_if<T>(&message)) return *wanted;
      if (failed()) {
        ADD_FAILURE() << "closed: " << failure();
        return {};
      }
    }
  }
  /// In full, as the `stream` messages before it let a viewer read it.
  FramePtr next_frame();
  /// Reads to the end, and returns the code that the broker closed with.
  int close_code();

 private:
  struct Socket;
  bool got_text();  ///< Notes what the message just read says of streams.
  std::unique_ptr<Socket> socket_;
};

/// Bytes to the broker and back.
class Wire {
 public:
  explicit Wire(std::uint16_t port, int receive_buffer = 0);
  ~Wire();
  Wire(const Wire&) = delete;
  Wire& operator=(const Wire&) = delete;

  void write(const std::string& text);
  void end_writing();
  /// Everything until the broker closes; nothing on a reset.
  std::optional<std::string> read_all();

 private:
  struct Socket;
  std::unique_ptr<Socket> socket_;
};

/// The asset's id.
std::string name_of_asset(const std::string& content);

struct Answer {
  int status = 0;
  std::string body;
  std::map<std::string, std::string> headers;
};
/// `range`: the Range header; empty: none.
Answer http_request(std::uint16_t port, const std::string& method, const std::string& target,
                    const std::string& body = {}, const std::string& range = {});

class ServiceTest : public ::testing::Test {
 protected:
  ServiceTest();
  ~ServiceTest() override;
  void SetUp() override { start(); }

  void start();
  /// Calls stop() of the broker without waiting.
  void begin_to_stop();
  void stop();

  Answer request(const std::string& method, const std::string& target, const std::string& body = {},
                 const std::string& range = {}) const {
    return http_request(port_, method, target, body, range);
  }
  std::string put_asset(const std::string& content) const;
  /// A sender that has announced small_announce(); see announced_.
  std::unique_ptr<Client> sender(const std::string& stream);

  Config config_;  ///< Used by the next start().
  LogSink log_;
  std::string folder_;
  std::string asset_;
  control::Announced announced_;
  std::uint16_t port_ = 0;
  std::uint16_t admin_port_ = 0;

 private:
  std::unique_ptr<Broker> broker_;
  std::thread thread_;
};

}  // namespace eigencast::broker::testing
