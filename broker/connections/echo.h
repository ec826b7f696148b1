// SPDX-License-Identifier: MIT
#pragma once

#include "broker/connections/connection.h"

namespace eigencast::broker {

/// /echo in builds with EIGENCAST_TEST_ENDPOINTS, for conformance suites of WebSocket servers (Autobahn). No
/// subprotocol; messages of up to 16 MiB.
class Echo final : public Connection {
 public:
  Echo(Context& context, Transport transport, GrantPtr grant)
      : Connection(context, std::move(transport), std::move(grant), {kMaxMessageBytes, kMaxMessageBytes}, &kLimits) {}

 private:
  static constexpr std::size_t kMaxMessageBytes = 16 * 1024 * 1024;
  static constexpr Outbox::Limits kLimits = {.max_control_messages = 10'000, .max_control_bytes = 4 * kMaxMessageBytes};

  void on_open() override {}
  void on_text(std::string_view text) override { send_framed(websocket::framed(websocket::Opcode::kText, text)); }
  void on_binary(ByteView message) override {
    send_framed(
        websocket::framed(websocket::Opcode::kBinary, {reinterpret_cast<const char*>(message.data()), message.size()}));
  }
  void on_closed() override {}
  std::string label() const override { return "echo"; }
};

}  // namespace eigencast::broker
