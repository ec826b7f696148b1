// SPDX-License-Identifier: MIT
#pragma once

#include "broker/http/http_connection.h"
#include "broker/http/http_target.h"

namespace eigencast::broker {

/// What the data port answers: who may come in, assets, the stream list, and upgrades, which hand the socket on: a
/// viewer's to the loop with the fewest connections.
class HttpSession final : public HttpConnection {
 public:
  HttpSession(Context& context, Transport transport);

 private:
  Limits limits() const override;
  void on_head() override;
  void decorate(HttpHeaders& headers) const override;
  /// Who asks; false: it was answered that they may not come in.
  bool admit(const Target& target);
  void serve(const Target& target);
  void answer_preflight();
  void serve_streams();
  void upgrade(const Target& target);
  /// Hands the socket on; `first` is the stream of a subscriber's URL.
  void publish(const std::string& stream);
  void subscribe(std::optional<control::Subscribe> first);
  /// Whether this WebSocket may begin; else it is answered why not.
  bool may_begin(const Target& target);
  std::string upgrade_answer();

  Seat seat_;
  GrantPtr grant_;  ///< Of the connection at first, then of who sent the latest request. Null: too many connections.
};

}  // namespace eigencast::broker
