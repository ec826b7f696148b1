// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/core/log.h"
#include "common/core/result.h"

namespace eigencast {

/// How a client proves its identity, and which authorities it trusts.
struct Credentials {
  std::string token = {};    ///< The token itself, or @FILE. Empty: EIGENCAST_TOKEN of the environment, if that is set.
  std::string ca_file = {};  ///< PEM file of the authorities that count for wss:// and https://. Empty: the system's.
  std::string certificate_file = {};  ///< PEM file of the client's own certificate, for brokers that ask for one.
  std::string key_file = {};          ///< Its private key, PEM, without passphrase.
  bool insecure = false;              ///< The broker's certificate is not checked: anybody may be in between.
  bool operator==(const Credentials&) const = default;
};

/// Where a broker and, if the path names one, a stream are: http://host[:port]/stream/name?rate=raw, the URL of its
/// page. ws:// and http:// are the same (port 80), so are wss:// and https:// (443); none at all is http:// on port
/// 7490. http://a:7490,b:7490/stream names several brokers of one cluster: all else, credentials included, is the same
/// for each. Of a fragment only access_token counts.
struct BrokerUrl {
  bool tls = false;  ///< wss:// or https://
  std::string host;  ///< Name or address; IPv6 without its brackets. Of the first broker, as is the port.
  std::uint16_t port = 0;
  std::vector<std::pair<std::string, std::uint16_t>> others;  ///< Host and port of each further broker; as a rule none.
  std::string address;  ///< Of those that the host has, the one to connect to; empty: any.
  std::string stream;   ///< Without a leading '/', and without "/v1/subscribe/" or "/v1/publish/". May be empty.
  std::string query;    ///< Without '?', and without access_token.
  std::string prefix;   ///< The path before /v1: "/eigencast", for a broker behind a proxy. Empty as a rule.
  Credentials credentials;

  std::size_t brokers() const { return 1 + others.size(); }
  /// The same at one broker alone. REQUIRES: index < brokers()
  BrokerUrl at(std::size_t index) const;
  std::string authority() const;  ///< "host:port", "[v6]:port": of the first broker.
  std::string origin() const;     ///< "ws://host:port", "ws://host:port,other:port"
  /// "ws://host:port/stream": for people, without anything secret.
  std::string shown() const { return origin() + prefix + "/" + stream; }
};

/// Whether both reach the same broker in the same way and with the same credentials.
bool is_same_broker(const BrokerUrl& a, const BrokerUrl& b);

/// Errors: kInvalidArgument, saying what is wrong and what a URL has to be.
Result<BrokerUrl> parse_broker_url(std::string_view text);

/// Completes the URL's credentials by `given`, which win, and by the environment. Warns of `insecure`.
/// Errors: kNotFound, kInvalidArgument (@FILE, characters that no token has, files of certificates): before anything is
/// connected.
Result<void> complete_credentials(BrokerUrl& url, const Credentials& given, const LogSink& log = {});

}  // namespace eigencast
