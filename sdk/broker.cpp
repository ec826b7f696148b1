// SPDX-License-Identifier: MIT
#include "sdk/broker.h"

#include "common/net/http.h"

namespace eigencast {

std::optional<BrokerUrl> located(const BrokerUrl& url) {
  constexpr std::chrono::milliseconds kSilence{500};
  constexpr std::uint64_t kMaxAnswerBytes = 4096;
  if (!url.prefix.empty() || url.stream.find('/') == std::string::npos) return std::nullopt;
  const auto answer = HttpConnection(url, kSilence).get("/" + url.stream, kMaxAnswerBytes);
  if (!answer || answer->status != 200) return std::nullopt;
  const std::string said(answer->body.begin(), answer->body.end());
  // It names the stream as the broker knows it, which is what follows the proxy's path.
  for (std::size_t at = url.stream.find('/'); at != std::string::npos; at = url.stream.find('/', at + 1)) {
    const std::string name = url.stream.substr(at + 1);
    if (said.find("v1/subscribe/" + name + '"') == std::string::npos || !check_stream_name(name)) continue;
    BrokerUrl found = url;
    found.prefix = "/" + url.stream.substr(0, at);
    found.stream = name;
    return found;
  }
  return std::nullopt;
}

}  // namespace eigencast
