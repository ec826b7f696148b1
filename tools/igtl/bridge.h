// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <cstdint>
#include <string>

#include "common/core/log.h"
#include "common/net/url.h"
#include "tools/igtl/peers.h"

namespace eigencast::igtl {

struct Options {
  bool publishes = false;  ///< POLYDATA to a stream; else a stream to POLYDATA.
  std::string url;
  PeersOptions peers;
  std::string device;  ///< Publishing: the one that counts; empty: the first. Else what messages are named after.
  int version = 1;     ///< Of the headers that are written.
  bool z_up = true;    ///< Of messages; a stream's y is.
  double scale = 1;    ///< Units of the stream in one of messages.
  double max_rate_hz = 30;
  std::uint32_t rank = 200;
  double error = 0;  ///< As of PublisherOptions.
  Credentials credentials;
};

/// Runs until `stop`, across lost connections. Errors: kInvalidArgument (URL, token), those of Peers::create().
Result<void> run_bridge(const Options& options, const std::atomic<bool>& stop, const LogSink& log);

}  // namespace eigencast::igtl
