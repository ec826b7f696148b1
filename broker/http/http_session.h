// SPDX-License-Identifier: MIT
#pragma once

#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/buffer_body.hpp>
#include <boost/beast/http/parser.hpp>
#include <boost/beast/http/string_body.hpp>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "broker/access/gate.h"
#include "broker/context.h"
#include "broker/http/http_target.h"

namespace eigencast::broker {

/// One HTTP/1.1 connection of the data port: assets, the stream list, and upgrades, which hand the socket on. Kept
/// alive by its pending operations. Belongs to its event loop.
class HttpSession : public std::enable_shared_from_this<HttpSession> {
 public:
  HttpSession(Context& context, Transport transport);
  ~HttpSession();
  HttpSession(const HttpSession&) = delete;
  HttpSession& operator=(const HttpSession&) = delete;
  void start();

 private:
  using Status = beast::http::status;
  using Headers = std::vector<std::pair<beast::http::field, std::string>>;
  struct Download {
    AssetStore::Object object;
    std::uint64_t at = 0;
    std::uint64_t end = 0;
    std::vector<char> chunk;
  };

  /// Does `work`, which gives a Result, on the disk's threads, then `then` with it on the loop: no read or write of a
  /// file ever holds up a frame. The session lives on meanwhile.
  template <typename Work, typename Then>
  void on_disk(Work work, Then then);
  void read_head();
  void on_head();
  void serve(const Target& target);
  /// Who asks; nothing: it was answered that they may not come in.
  bool admit(const Target& target);
  void answer_denial(const Denial& denial);
  void answer_preflight();
  void upgrade(const Target& target);
  void serve_streams();
  void serve_asset(const Sha256& id);
  void serve_object(const Sha256& id, AssetStore::Object object);
  void send_head_then_file(AssetStore::Object object, Status status, ByteRange range, bool with_body, Headers headers);
  void send_chunk(std::shared_ptr<Download> download);
  void write_chunk(std::shared_ptr<Download> download);
  void receive_asset(const Sha256& id);
  void begin_body();
  void read_body();
  void on_body_read(std::size_t count);
  void on_body_done();
  void on_committed(const Result<bool>& committed);
  void end_upload();
  void fail_upload(const Error& error);

  /// Whether another request may follow on this connection. Not with body bytes of this one unread: they would be
  /// taken for the next request.
  bool may_keep() const;
  /// What every answer carries.
  template <typename Response>
  void decorate(Response& response, const Headers& headers);
  /// Sends a whole answer.
  void answer(Status status, std::string body, Headers headers = {});
  void answer_error(Status status, const Error& error, Headers headers = {});
  void finish(bool keep);
  void drain();
  void drain_socket();
  void arm(std::int64_t timeout_ms);
  void close();
  bool is_head() const;
  std::string header(beast::http::field field) const;

  Context& context_;
  Transport transport_;
  Timer timer_;
  beast::flat_buffer buffer_;
  std::optional<beast::http::request_parser<beast::http::buffer_body>> parser_;
  IpAddress peer_;
  GrantPtr grant_;  ///< Of the connection at first, then of who sent the latest request. Null: too many connections.
  bool uploading_ = false;  ///< Counted in uploads_now.
  std::unique_ptr<AssetStore::Upload> upload_;
  bool upload_counted_ = false;  ///< Its length was known, and counted at once.
  std::vector<std::uint8_t> body_chunk_;
};

}  // namespace eigencast::broker
