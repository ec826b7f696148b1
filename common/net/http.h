// SPDX-License-Identifier: MIT
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "common/core/bytes.h"
#include "common/net/url.h"

namespace eigencast {

struct HttpResponse {
  int status = 0;
  std::string etag;
  std::uint64_t content_length = 0;
  Bytes body;
};

/// A blocking HTTP/1.1 connection to a broker, the URL's first, kept alive between requests and made anew when it
/// broke. Not thread-safe; cancel() alone may come from another thread: the running call and all later ones return
/// kCancelled.
class HttpConnection {
 public:
  explicit HttpConnection(const BrokerUrl& url, std::chrono::milliseconds timeout = std::chrono::seconds(10));
  ~HttpConnection();

  /// `timeout` is for silence, not for the whole transfer, nor for a name lookup, which the system's resolver bounds.
  /// Bodies over `max_bytes` are refused before they are read. An HTTP status of any kind is a value. Errors:
  /// kUnreachable, kDisconnected, kTimeout, kTooLarge, kCancelled, kRefused (its certificate is not trusted),
  /// kInvalidArgument (ca_file).
  Result<HttpResponse> get(const std::string& target, std::uint64_t max_bytes);
  Result<HttpResponse> head(const std::string& target);
  Result<HttpResponse> put(const std::string& target, ByteView body);

  /// Fetches the rest of an object of which `body` holds the beginning: appends what comes, also when the call fails in
  /// between, so that the next call goes on from there. A server that ignores the range (status 200) has `body` filled
  /// from the start. `progress` hears body.size() as it grows. The response's own body holds only what an answer other
  /// than 200 or 206 said. `max_bytes` bounds the whole object. Errors: as get().
  Result<HttpResponse> get_rest(const std::string& target, std::uint64_t max_bytes, Bytes& body,
                                const std::function<void(std::uint64_t)>& progress = {});
  void cancel();

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

/// Asks the URL's brokers, in turn, whether one would let this connection in, without making it: nobody else notices.
///   endpoint  such as "/v1/publish/lab/horse"
///   silence   how long nothing may come
/// Errors: kRefused: one is there and says no in a way that only people can change (token, right, certificate);
/// kUnreachable, kTimeout, kDisconnected: none is there now, or what answers is not a broker; kInvalidArgument (files
/// of certificates).
Result<void> probe(const BrokerUrl& url, const std::string& endpoint, std::chrono::milliseconds silence);

}  // namespace eigencast
