// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>

namespace eigencast {

/// What messages take on a link beyond themselves, in bytes. Without what carries IP, and acknowledgements, which go
/// the other way.
struct LinkBytes {
  double websocket = 0;  ///< RFC 6455, 5.2: headers of a server's frames.
  double tcp_ip = 0;     ///< RFC 791, RFC 9293, RFC 7323: of IPv4, with time stamps; IPv6 takes 20 more a segment.
  double tls = 0;        ///< RFC 8446, 5.2: of version 1.3, with a tag of 16 bytes. On encrypted links only.

  double total() const { return websocket + tcp_ip + tls; }
};

/// Of binary messages that are sent one by one, as those of a stream are, each of the mean size.
///   bytes  of all, envelopes included
inline LinkBytes link_bytes(double messages, double bytes) {
  constexpr double kHeaders = 20 + 20 + 12, kSegment = 1500 - kHeaders, kRecord = 5 + 1 + 16;
  if (!(messages > 0)) return {};
  const double mean = bytes / messages;
  const double websocket = mean < 126 ? 2 : mean < 65'536 ? 4 : 10;
  double segments = 1;
  while (segments * kSegment < mean + websocket + kRecord) ++segments;
  return {messages * websocket, messages * segments * kHeaders, messages * kRecord};
}

}  // namespace eigencast
