// SPDX-License-Identifier: MIT
#pragma once

#include "broker/http/http_connection.h"
#include "broker/http/http_target.h"
#include "common/wire/control.h"

namespace eigencast::broker {

/// Serves the data port: assets, the stream list, and WebSocket upgrades, which move the socket to a Publisher or
/// Subscriber.
class HttpSession final : public HttpConnection {
 public:
  HttpSession(Context& context, Transport transport);

 private:
  Limits limits() const override;
  void on_head() override;
  void decorate(HttpHeaders& headers) const override;
  /// Identifies the client; false: answered with a refusal.
  bool admit(const Target& target);
  void serve(const Target& target);
  void answer_preflight();
  void serve_streams();
  void upgrade(const Target& target);
  /// Moves the socket to a Publisher or Subscriber; `first` is the stream of a subscriber's URL.
  void publish(const std::string& stream);
  void subscribe(std::optional<control::Subscribe> first);
  /// Whether this WebSocket may begin; false: answered with a refusal.
  bool may_begin(const Target& target);
  std::string upgrade_answer();

  ConnectionCount counted_;
  GrantPtr grant_;  ///< The connection's at first, then the latest requester's. Null: too many connections.
};

}  // namespace eigencast::broker
