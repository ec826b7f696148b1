// SPDX-License-Identifier: MIT
#include "common/net/probe.h"

#include "common/net/http.h"
#include "common/net/websocket_failure.h"

namespace eigencast {
namespace {

constexpr std::uint64_t kMaxAnswerBytes = 64 * 1024;
/// What a WebSocket's address says to those who may upgrade and do not.
constexpr int kUpgradeRequired = 426;

}  // namespace

Result<void> probe(const BrokerUrl& url, const std::string& endpoint, std::chrono::milliseconds silence) {
  HttpConnection http(url, silence);
  const auto answer = http.get(endpoint, kMaxAnswerBytes);
  if (!answer) return answer.error();
  if (answer->status == kUpgradeRequired) return {};
  const std::string_view said(reinterpret_cast<const char*>(answer->body.data()), answer->body.size());
  WebSocketFailure failure =
      failure_of_answer(static_cast<unsigned>(answer->status), said, url.origin(), !url.credentials.token.empty());
  if (failure.least_wait < kHopelessRetry) failure.error.code = ErrorCode::kUnreachable;
  return failure.error;
}

}  // namespace eigencast
