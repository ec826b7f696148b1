// SPDX-License-Identifier: MIT
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "client/options.h"

namespace eigencast {

/// A stream that a broker has, as GET /v1/streams says (docs/protocol.md).
struct ListedStream {
  std::string name, state;
  double key_rate_hz = 0;
  std::uint64_t subscribers = 0;
};

struct StreamPage {
  std::vector<ListedStream> streams;
  std::string next;  ///< The next page begins after this name; empty: it was the last.
};
/// Errors: kCorrupt.
Result<StreamPage> page_from_json(std::string_view text);

/// Waits at most two seconds for each page of 10,000 streams in all. Errors: kRefused, kUnreachable, kTimeout,
/// kDisconnected, kCorrupt, kInvalidArgument (URL, credentials).
Result<std::vector<ListedStream>> streams_of(const Target& broker);

/// `list`: writes them to standard output, or to options.json. Returns an ExitCode; errors go to the log.
int run_list(const ClientOptions& options, const LogSink& log);

/// Without a word on the command line: makes the broker's one live stream the stream to show. Errors: those of
/// streams_of(); kNotFound: none is live, or several are, which the message names.
Result<void> choose_live_stream(ClientOptions& options);

}  // namespace eigencast
