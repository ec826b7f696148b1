// SPDX-License-Identifier: MIT
#include "broker/http/http_session.h"

#include <unistd.h>

#include <algorithm>
#include <boost/asio/write.hpp>
#include <boost/beast/http/empty_body.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/write.hpp>
#include <boost/beast/websocket/rfc6455.hpp>
#include <cerrno>
#include <ctime>
#include <exception>
#include <utility>

#include "broker/connections/echo.h"
#include "broker/connections/publisher.h"
#include "broker/connections/subscriber.h"
#include "broker/http/access_facts.h"
#include "broker/websocket/upgrade.h"

namespace eigencast::broker {
namespace {

namespace http = beast::http;

constexpr std::size_t kChunkBytes = 64 * 1024;
constexpr std::size_t kMaxHeadBytes = 16 * 1024;

bool offers_subprotocol(std::string_view header) {
  while (!header.empty()) {
    const auto comma = header.find(',');
    std::string_view one = header.substr(0, comma);
    while (!one.empty() && one.front() == ' ') one.remove_prefix(1);
    while (!one.empty() && one.back() == ' ') one.remove_suffix(1);
    if (one == control::kSubprotocol) return true;
    if (comma == std::string_view::npos) break;
    header.remove_prefix(comma + 1);
  }
  return false;
}

std::string json_of(const Stream& stream) {
  std::string json = "{\"stream\":" + json_quoted(stream.name());
  json += ",\"stream_id\":" + std::to_string(stream.id());
  json += ",\"state\":" + json_quoted(name_of(stream.state()));
  json += ",\"epoch\":" + std::to_string(stream.epoch());
  json += ",\"asset\":" + json_quoted(stream.asset());
  json += ",\"key_rate_hz\":" + std::to_string(stream.key_rate_hz());
  json += ",\"keys_received\":" + std::to_string(stream.keys_received());
  json += ",\"subscribers\":" + std::to_string(stream.watchers()) + "}";
  return json;
}

Result<std::size_t> read_at(int file, std::uint64_t at, std::vector<char>& out) {
  for (;;) {
    const ssize_t count = ::pread(file, out.data(), out.size(), static_cast<off_t>(at));
    if (count < 0 && errno == EINTR) continue;
    if (count > 0) return static_cast<std::size_t>(count);
    return fail(ErrorCode::kIo, "reading an asset failed: " +
                                    (count == 0 ? "the file ends early" : std::generic_category().message(errno)));
  }
}

/// Runs on the disk's threads, which an exception would end together with the broker.
template <typename Work>
auto guarded_by_result(Work& work) -> decltype(work()) {
  try {
    return work();
  } catch (const std::exception& exception) {
    return fail(ErrorCode::kIo, std::string("the disk's thread failed: ") + exception.what());
  }
}

}  // namespace

HttpSession::HttpSession(Context& context, Transport transport)
    : context_(context),
      transport_(std::move(transport)),
      timer_(context.loop.get_executor()),
      peer_(peer_of(transport_.socket())),
      grant_(context.gate.accept(peer_, steady_now_us())) {
  ++context_.counters.connections;
  ++context_.counters.connections_total;
}

HttpSession::~HttpSession() {
  --context_.counters.connections;
  if (uploading_) --context_.counters.uploads_now;
}

template <typename Work, typename Then>
void HttpSession::on_disk(Work work, Then then) {
  asio::post(context_.disk, [self = shared_from_this(), guard = asio::make_work_guard(context_.loop),
                             work = std::move(work), then = std::move(then)]() mutable {
    const auto kept = std::make_shared<decltype(work())>(guarded_by_result(work));
    asio::io_context& loop = self->context_.loop;
    // The session goes along and comes back: it must not end on the disk's thread.
    asio::post(loop, [self = std::move(self), then = std::move(then), kept]() mutable { then(*kept); });
  });
}

void HttpSession::arm(std::int64_t timeout_ms) {
  timer_.expires_after(std::chrono::milliseconds(timeout_ms));
  timer_.async_wait([self = weak_from_this()](ErrorOf error) {
    if (auto session = self.lock(); session && !error) session->close();
  });
}

void HttpSession::close() {
  timer_.cancel();
  transport_.close();
}

void HttpSession::start() {
  if (!transport_.is_tls()) return read_head();
  arm(context_.config.timeouts.header_ms);
  transport_.async_handshake([self = shared_from_this()](ErrorOf error) {
    if (!error) return self->read_head();
    // A close with unread bytes would reset away the alert that says what was wrong.
    self->transport_.end_writing();
    self->drain_socket();
  });
}

void HttpSession::drain_socket() {
  body_chunk_.resize(kMaxHeadBytes);
  transport_.socket().async_read_some(asio::buffer(body_chunk_),
                                      [self = shared_from_this()](ErrorOf error, std::size_t) {
                                        if (error) return self->close();
                                        self->drain_socket();
                                      });
}

void HttpSession::read_head() {
  parser_.emplace();
  parser_->header_limit(kMaxHeadBytes);
  parser_->body_limit(static_cast<std::uint64_t>(context_.config.assets.max_object_bytes));
  arm(context_.config.timeouts.header_ms);
  http::async_read_header(transport_, buffer_, *parser_, [self = shared_from_this()](ErrorOf error, std::size_t) {
    if (!error) return self->on_head();
    if (error == http::error::body_limit) {
      return self->answer_error(Status::payload_too_large,
                                fail(ErrorCode::kTooLarge, "the body is over assets.max_object_bytes"));
    }
    if (error == http::error::header_limit) {
      return self->answer_error(Status::request_header_fields_too_large,
                                fail(ErrorCode::kTooLarge, "the request head is over 16 KiB"));
    }
    if (error != http::error::end_of_stream &&
        error.category() == http::make_error_code(http::error::end_of_stream).category() &&
        error != http::error::partial_message) {
      return self->answer_error(Status::bad_request,
                                fail(ErrorCode::kCorrupt, "not an HTTP request: " + error.message()));
    }
    self->close();
  });
}

bool HttpSession::is_head() const {
  return parser_->get().method() == http::verb::head;
}

std::string HttpSession::header(http::field field) const {
  return std::string(parser_->get()[field]);
}

bool HttpSession::may_keep() const {
  const bool body_unread = !parser_->is_header_done() ||
                           (!parser_->is_done() && (parser_->content_length().value_or(0) > 0 || parser_->chunked()));
  return !body_unread && parser_->get().keep_alive();
}

void HttpSession::on_head() {
  const auto& request = parser_->get();
  const auto target = target_from_text(std::string_view(request.target().data(), request.target().size()),
                                       context_.config.proxy.path_prefix);
  if (!target) {
    const bool missing = target.error().code == ErrorCode::kNotFound;
    return answer_error(missing ? Status::not_found : Status::bad_request, target.error());
  }
  if (request.method() == http::verb::options) return answer_preflight();
  if (admit(*target)) serve(*target);
}

bool HttpSession::admit(const Target& target) {
  if (!grant_) {
    answer_denial({429, "too many connections from this address (per_address.connections)", 1, false});
    return false;
  }
  auto admitted = context_.gate.admit(access_request_from(parser_->get(), peer_, target.token), steady_now_us(),
                                      std::time(nullptr));
  if (const auto* denied = std::get_if<Denial>(&admitted)) {
    answer_denial(*denied);
    return false;
  }
  grant_.reset();  // First: it counts as a connection of the same address.
  grant_ = std::move(std::get<GrantPtr>(admitted));
  if (const auto taken = grant_->take(Share::kConnection); !taken) {
    answer_denial({429, taken.error().message, 1, false});
    return false;
  }
  return true;
}

void HttpSession::answer_denial(const Denial& denial) {
  log(context_.log, LogLevel::kInfo,
      "answered " + std::to_string(denial.status) + " to " + peer_.text() + ": " + denial.message);
  Headers headers;
  if (denial.status == 401) {
    headers.emplace_back(http::field::www_authenticate, denial.failed_login
                                                            ? "Bearer realm=\"eigencast\", error=\"invalid_token\""
                                                            : "Bearer realm=\"eigencast\"");
  }
  if (denial.retry_after_s > 0) headers.emplace_back(http::field::retry_after, std::to_string(denial.retry_after_s));
  answer_error(static_cast<Status>(denial.status), fail(ErrorCode::kRefused, denial.message), std::move(headers));
}

void HttpSession::answer_preflight() {
  answer(Status::no_content, {},
         {{http::field::access_control_allow_methods, "GET, HEAD, PUT"},
          {http::field::access_control_allow_headers, "Authorization, Content-Type, If-None-Match, If-Range, Range"},
          {http::field::access_control_max_age, "600"}});
}

template <typename Response>
void HttpSession::decorate(Response& response, const Headers& headers) {
  for (const auto& [field, value] : headers) response.set(field, value);
  const std::string origin = header(http::field::origin);
  if (origin.empty()) return;
  response.insert(http::field::vary, "Origin");
  if (!context_.gate.policy()->allows_origin(access_request_from(parser_->get(), peer_, {}))) return;
  response.set(http::field::access_control_allow_origin, origin);
  response.set(http::field::access_control_expose_headers, "Accept-Ranges, Content-Range, ETag, Retry-After");
}

void HttpSession::serve(const Target& target) {
  const auto method = parser_->get().method();
  const bool reads = method == http::verb::get || method == http::verb::head;
  switch (target.kind) {
    case Target::Kind::kPublish:
    case Target::Kind::kSubscribe:
    case Target::Kind::kEcho:
      return upgrade(target);
    case Target::Kind::kStreams:
      if (reads) return serve_streams();
      return answer_error(Status::method_not_allowed,
                          fail(ErrorCode::kUnsupported, "the stream list is read by GET or HEAD"),
                          {{http::field::allow, "GET, HEAD"}});
    case Target::Kind::kAsset:
      if (reads) return serve_asset(*Sha256::from_hex(target.name));
      if (method == http::verb::put) return receive_asset(*Sha256::from_hex(target.name));
      return answer_error(Status::method_not_allowed, fail(ErrorCode::kUnsupported, "assets take GET, HEAD and PUT"),
                          {{http::field::allow, "GET, HEAD, PUT"}});
  }
}

void HttpSession::upgrade(const Target& target) {
  if (!beast::websocket::is_upgrade(parser_->get()) || buffer_.size() > 0) {
    return answer_error(Status::upgrade_required,
                        fail(ErrorCode::kInvalidArgument, "this is a WebSocket: connect with ws://"),
                        {{http::field::upgrade, "websocket"}});
  }
  if (header(http::field::sec_websocket_version) != "13") {
    return answer_error(Status::upgrade_required,
                        fail(ErrorCode::kIncompatibleVersion, "Sec-WebSocket-Version must be 13 (RFC 6455)"),
                        {{http::field::upgrade, "websocket"}, {http::field::sec_websocket_version, "13"}});
  }
  if (!websocket::is_key(header(http::field::sec_websocket_key))) {
    return answer_error(Status::bad_request,
                        fail(ErrorCode::kInvalidArgument, "Sec-WebSocket-Key must be 16 bytes in base64 (RFC 6455)"));
  }
#ifdef EIGENCAST_TEST_ENDPOINTS
  if (target.kind == Target::Kind::kEcho) {
    timer_.cancel();
    return std::make_shared<Echo>(context_, std::move(transport_), std::move(grant_))
        ->start(websocket::upgrade_answer(header(http::field::sec_websocket_key), {}, "eigencast-broker"));
  }
#endif
  if (!offers_subprotocol(header(http::field::sec_websocket_protocol))) {
    return answer_error(Status::bad_request, fail(ErrorCode::kIncompatibleVersion,
                                                  "offer the subprotocol '" + std::string(control::kSubprotocol) +
                                                      "' (Sec-WebSocket-Protocol): this broker speaks no other"));
  }
  std::optional<control::Subscribe> first;
  if (target.kind == Target::Kind::kSubscribe && !target.name.empty()) {
    const auto profile = profile_from_query(target.query);
    if (!profile) return answer_error(Status::bad_request, profile.error());
    first = control::Subscribe{target.name, *profile};
  }
  const bool publishes = target.kind == Target::Kind::kPublish;
  const auto may = publishes ? grant_->may_publish(target.name)
                   : first   ? grant_->may_subscribe(target.name)
                             : grant_->may_fetch_assets();
  if (!may) return answer_denial({403, may.error().message, 0, false});
  if (const auto taken = publishes ? grant_->take(Share::kPublisher) : Result<void>(); !taken) {
    return answer_denial({429, taken.error().message, 1, false});
  }
  if (context_.draining) {
    return answer_error(Status::service_unavailable, fail(ErrorCode::kRefused, "the broker is stopping"));
  }
  timer_.cancel();
  std::string answer = websocket::upgrade_answer(header(http::field::sec_websocket_key), control::kSubprotocol,
                                                 "eigencast-broker/" + context_.version);
  if (publishes) {
    return std::make_shared<Publisher>(context_, std::move(transport_), std::move(grant_), target.name)
        ->start(std::move(answer));
  }
  std::make_shared<Subscriber>(context_, std::move(transport_), std::move(grant_), std::move(first))
      ->start(std::move(answer));
}

void HttpSession::serve_streams() {
  std::string json = "{\"streams\":[";
  for (const Stream* stream : context_.hub.streams()) {
    if (!grant_->may_see(stream->name())) continue;
    if (json.back() != '[') json += ',';
    json += json_of(*stream);
  }
  answer(Status::ok, json + "]}\n", {{http::field::cache_control, "no-store"}});
}

void HttpSession::serve_asset(const Sha256& id) {
  if (const auto may = grant_->may_fetch_assets(); !may) return answer_denial({403, may.error().message, 0, false});
  on_disk([this, id] { return context_.assets.read(id); },
          [this, id](Result<AssetStore::Object>& object) {
            if (object) return serve_object(id, std::move(*object));
            const bool missing = object.error().code == ErrorCode::kNotFound;
            answer_error(missing ? Status::not_found : Status::internal_server_error, object.error());
          });
}

void HttpSession::serve_object(const Sha256& id, AssetStore::Object object) {
  const std::string etag = "\"" + id.hex() + "\"";
  // What not everybody may have must not come out of somebody else's cache.
  const std::string scope = context_.gate.policy()->serves_everybody() ? "public" : "private";
  Headers headers = {{http::field::etag, etag},
                     {http::field::cache_control, scope + ", max-age=31536000, immutable"},
                     {http::field::accept_ranges, "bytes"}};
  if (etag_matches(header(http::field::if_none_match), etag))
    return answer(Status::not_modified, {}, std::move(headers));
  const std::string if_range = header(http::field::if_range);
  const bool ranged = if_range.empty() || if_range == etag;
  const auto wanted = ranged ? range_from_header(header(http::field::range), object.size) : RangeRequest{};
  const std::string size = std::to_string(object.size);
  if (wanted.kind == RangeRequest::Kind::kUnsatisfiable) {
    headers.emplace_back(http::field::content_range, "bytes */" + size);
    return answer_error(Status::range_not_satisfiable,
                        fail(ErrorCode::kInvalidArgument, "the asset has " + size + " bytes"), std::move(headers));
  }
  const std::uint64_t bytes =
      wanted.kind == RangeRequest::Kind::kWhole ? object.size : wanted.range.last + 1 - wanted.range.first;
  if (const auto taken = grant_->take_download(is_head() ? 0 : bytes, steady_now_us()); !taken) {
    return answer_denial({429, taken.error().message, 60, false});
  }
  ++context_.counters.downloads;
  if (wanted.kind == RangeRequest::Kind::kWhole) {
    const std::uint64_t length = object.size;
    return send_head_then_file(std::move(object), Status::ok, {0, length - 1}, !is_head(), std::move(headers));
  }
  headers.emplace_back(http::field::content_range, "bytes " + std::to_string(wanted.range.first) + "-" +
                                                       std::to_string(wanted.range.last) + "/" + size);
  send_head_then_file(std::move(object), Status::partial_content, wanted.range, !is_head(), std::move(headers));
}

void HttpSession::send_head_then_file(AssetStore::Object object, Status status, ByteRange range, bool with_body,
                                      Headers headers) {
  auto response = std::make_shared<http::response<http::empty_body>>(status, 11);
  decorate(*response, headers);
  response->set(http::field::content_type, "application/octet-stream");
  response->keep_alive(may_keep());
  response->content_length(range.last + 1 - range.first);
  auto download = std::make_shared<Download>();
  download->object = std::move(object);
  download->at = range.first;
  download->end = with_body ? range.last + 1 : range.first;
  auto serializer = std::make_shared<http::response_serializer<http::empty_body>>(*response);
  arm(context_.config.timeouts.transfer_ms);
  http::async_write_header(transport_, *serializer,
                           [self = shared_from_this(), response, serializer, download](ErrorOf error, std::size_t) {
                             if (error) return self->close();
                             self->send_chunk(download);
                           });
}

void HttpSession::send_chunk(std::shared_ptr<Download> download) {
  if (download->at == download->end) return finish(may_keep());
  download->chunk.resize(std::min<std::uint64_t>(kChunkBytes, download->end - download->at));
  on_disk([download] { return read_at(download->object.file.get(), download->at, download->chunk); },
          [this, download](const Result<std::size_t>& count) {
            if (!count) {  // The head promised more than the disk gives: only cutting the connection tells the peer.
              log(context_.log, LogLevel::kError, count.error().message);
              return close();
            }
            download->chunk.resize(*count);
            download->at += *count;
            write_chunk(download);
          });
}

void HttpSession::write_chunk(std::shared_ptr<Download> download) {
  arm(context_.config.timeouts.transfer_ms);
  asio::async_write(transport_, asio::buffer(download->chunk),
                    [self = shared_from_this(), download](ErrorOf error, std::size_t) {
                      if (error) return self->close();
                      self->context_.counters.download_bytes += download->chunk.size();
                      self->send_chunk(download);
                    });
}

void HttpSession::receive_asset(const Sha256& id) {
  if (const auto may = grant_->may_store_assets(); !may) return answer_denial({403, may.error().message, 0, false});
  upload_counted_ = parser_->content_length().has_value();
  if (const auto taken = grant_->take_upload(parser_->content_length().value_or(0), steady_now_us()); !taken) {
    return answer_denial({429, taken.error().message, 60, false});
  }
  if (context_.counters.uploads_now >= static_cast<std::uint64_t>(context_.config.limits.max_uploads)) {
    return answer_error(Status::service_unavailable, fail(ErrorCode::kRefused, "too many uploads at a time: try again"),
                        {{http::field::retry_after, "1"}});
  }
  ++context_.counters.uploads_now;
  uploading_ = true;
  on_disk([this, id] { return context_.assets.begin_upload(id); },
          [this](Result<std::unique_ptr<AssetStore::Upload>>& upload) {
            if (!upload) return fail_upload(upload.error());
            upload_ = std::move(*upload);
            begin_body();
          });
}

void HttpSession::begin_body() {
  body_chunk_.resize(kChunkBytes);
  if (!beast::iequals(header(http::field::expect), "100-continue")) return read_body();
  auto response = std::make_shared<http::response<http::empty_body>>(Status::continue_, 11);
  http::async_write(transport_, *response, [self = shared_from_this(), response](ErrorOf error, std::size_t) {
    if (error) return self->close();
    self->read_body();
  });
}

void HttpSession::read_body() {
  if (parser_->is_done()) return on_body_done();
  auto& body = parser_->get().body();
  body.data = body_chunk_.data();
  body.size = body_chunk_.size();
  arm(context_.config.timeouts.transfer_ms);
  http::async_read(transport_, buffer_, *parser_, [self = shared_from_this()](ErrorOf error, std::size_t) {
    if (error == http::error::need_buffer) error = {};
    if (error == http::error::body_limit) {
      return self->fail_upload(fail(ErrorCode::kTooLarge, "the body is over assets.max_object_bytes"));
    }
    if (error) {  // Cut off in the middle: nobody is there to be told.
      ++self->context_.counters.uploads_failed;
      return self->close();
    }
    self->on_body_read(self->body_chunk_.size() - self->parser_->get().body().size);
  });
}

void HttpSession::on_body_read(std::size_t count) {
  if (!upload_counted_) {
    if (auto taken = grant_->take_upload(count, steady_now_us()); !taken) return fail_upload(taken.error());
  }
  context_.counters.upload_bytes += count;
  on_disk([this, count] { return upload_->write(ByteView(body_chunk_.data(), count)); },
          [this](const Result<void>& written) { written ? read_body() : fail_upload(written.error()); });
}

void HttpSession::on_body_done() {
  timer_.cancel();
  on_disk([this] { return upload_->commit(); }, [this](const Result<bool>& committed) { on_committed(committed); });
}

void HttpSession::on_committed(const Result<bool>& committed) {
  if (!committed) return fail_upload(committed.error());
  end_upload();
  ++context_.counters.uploads;
  answer(*committed ? Status::created : Status::ok, "{}\n");
}

void HttpSession::end_upload() {
  upload_.reset();
  if (std::exchange(uploading_, false)) --context_.counters.uploads_now;
}

void HttpSession::fail_upload(const Error& error) {
  end_upload();
  ++context_.counters.uploads_failed;
  log(context_.log, LogLevel::kWarning, "upload refused: " + error.message);
  switch (error.code) {
    case ErrorCode::kCorrupt:
      return answer_error(Status::unprocessable_entity, error);
    case ErrorCode::kTooLarge:
      return answer_error(Status::payload_too_large, error);
    case ErrorCode::kRefused:
      return answer_denial({429, error.message, 60, false});
    default:
      return answer_error(Status::insufficient_storage, error);
  }
}

void HttpSession::answer_error(Status status, const Error& error, Headers headers) {
  std::string body =
      "{\"error\":" + json_quoted(name_of(error.code)) + ",\"message\":" + json_quoted(error.message) + "}\n";
  answer(status, std::move(body), std::move(headers));
}

void HttpSession::answer(Status status, std::string body, Headers headers) {
  const bool keep = may_keep();
  auto response = std::make_shared<http::response<http::string_body>>(status, 11);
  decorate(*response, headers);
  if (!body.empty()) response->set(http::field::content_type, "application/json");
  response->keep_alive(keep);
  response->body() = std::move(body);
  if (status != Status::not_modified && status != Status::no_content) response->prepare_payload();
  if (is_head()) response->body().clear();
  arm(context_.config.timeouts.transfer_ms);
  http::async_write(transport_, *response, [self = shared_from_this(), response, keep](ErrorOf error, std::size_t) {
    if (error) return self->close();
    self->finish(keep);
  });
}

void HttpSession::finish(bool keep) {
  if (keep) return read_head();
  // Half-close, then read what still comes for a while: a close with unread bytes would reset the answer away.
  transport_.end_writing();
  arm(std::min<std::int64_t>(context_.config.timeouts.transfer_ms, 2'000));
  drain();
}

void HttpSession::drain() {
  body_chunk_.resize(kChunkBytes);
  transport_.async_read_some(asio::buffer(body_chunk_), [self = shared_from_this()](ErrorOf error, std::size_t) {
    if (error) return self->close();
    self->drain();
  });
}

}  // namespace eigencast::broker
