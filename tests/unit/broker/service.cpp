// SPDX-License-Identifier: MIT
#include "tests/unit/broker/service.h"

#include <unistd.h>

#include <boost/asio/connect.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/read.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/core/buffers_to_string.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <filesystem>

#include "broker/broker.h"
#include "common/core/hash/sha256.h"

namespace eigencast::broker::testing {
namespace {

namespace fs = std::filesystem;
namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;

asio::ip::tcp::socket connected(asio::io_context& loop, std::uint16_t port) {
  asio::ip::tcp::socket socket(loop);
  socket.connect({asio::ip::address_v4::loopback(), port});
  return socket;
}

}  // namespace

// ---- Client ----

struct Client::Socket {
  explicit Socket(std::uint16_t port) : stream(connected(loop, port)) {}
  asio::io_context loop;
  websocket::stream<asio::ip::tcp::socket, false> stream;
  websocket::response_type response;
  beast::flat_buffer buffer;
  ErrorOf error;
  std::map<std::uint32_t, EnvelopeReader> readers;  ///< By stream id.
  std::uint8_t tag = 0;                             ///< Of the epoch that this sender was granted.
};

Client::Client(std::uint16_t port, const std::string& target, const std::string& subprotocol)
    : socket_(std::make_unique<Socket>(port)) {
  socket_->stream.set_option(websocket::stream_base::decorator([&](websocket::request_type& request) {
    if (!subprotocol.empty()) request.set(http::field::sec_websocket_protocol, subprotocol);
  }));
  socket_->stream.handshake(socket_->response, "localhost", target, socket_->error);
  if (failed()) return;
  const auto welcome = next_control();
  EXPECT_TRUE(failed() || std::holds_alternative<control::Welcome>(welcome));
}

Client::~Client() = default;

int Client::status() const {
  return static_cast<int>(socket_->response.result_int());
}

std::string Client::subprotocol() const {
  return std::string(socket_->response[http::field::sec_websocket_protocol]);
}

void Client::send(const ControlMessage& message) {
  send_text(text_from_control(message));
}

void Client::send_text(const std::string& text) {
  socket_->stream.text(true);
  socket_->stream.write(asio::buffer(text), socket_->error);
}

void Client::send_frame(Bytes frame) {
  if (frame.size() > 2 && socket_->tag != 0) frame[2] = socket_->tag;
  socket_->stream.binary(true);
  socket_->stream.write(asio::buffer(frame), socket_->error);
}

bool Client::failed() const {
  return static_cast<bool>(socket_->error);
}

std::string Client::failure() const {
  return socket_->error.message();
}

bool Client::read() {
  socket_->buffer.clear();
  socket_->stream.read(socket_->buffer, socket_->error);
  return !failed();
}

bool Client::got_text() {
  if (!socket_->stream.got_text()) return false;
  const auto message = control_from_text(beast::buffers_to_string(socket_->buffer.data()));
  const auto* announced = message ? std::get_if<control::Announced>(&*message) : nullptr;
  if (announced != nullptr) socket_->tag = announced->tag;
  const auto* info = message ? std::get_if<control::StreamInfo>(&*message) : nullptr;
  if (info != nullptr) socket_->readers[info->stream_id].begin(info->stream_id, info->tag, info->epoch);
  return true;
}

ControlMessage Client::next_control() {
  do {
    if (!read()) return control::Bye{"(closed)", 0};
  } while (!got_text());
  return control_from_text(beast::buffers_to_string(socket_->buffer.data())).value();
}

FramePtr Client::next_frame() {
  do {
    if (!read()) return nullptr;
  } while (got_text());
  const auto data = socket_->buffer.cdata();
  auto frame = std::make_shared<Frame>();
  frame->wire.assign(static_cast<const std::uint8_t*>(data.data()),
                     static_cast<const std::uint8_t*>(data.data()) + data.size());
  const auto parsed = parse_frame(frame->wire).value();
  EnvelopeReader& reader = socket_->readers[parsed.envelope.stream_id];
  frame->envelope = reader.read(parsed).value().envelope;
  return frame;
}

int Client::close_code() {
  while (read()) {
  }
  return socket_->stream.reason().code;
}

// ---- Wire ----

struct Wire::Socket {
  explicit Socket(std::uint16_t port) : stream(connected(loop, port)) {}
  asio::io_context loop;
  asio::ip::tcp::socket stream;
};

Wire::Wire(std::uint16_t port, int receive_buffer) : socket_(std::make_unique<Socket>(port)) {
  if (receive_buffer > 0) socket_->stream.set_option(asio::ip::tcp::socket::receive_buffer_size(receive_buffer));
}
Wire::~Wire() = default;

void Wire::write(const std::string& text) {
  asio::write(socket_->stream, asio::buffer(text));
}

void Wire::end_writing() {
  socket_->stream.shutdown(asio::ip::tcp::socket::shutdown_send);
}

std::optional<std::string> Wire::read_all() {
  std::string all;
  ErrorOf error;
  asio::read(socket_->stream, asio::dynamic_buffer(all), error);
  if (error != asio::error::eof) return std::nullopt;
  return all;
}

std::string name_of_asset(const std::string& content) {
  return sha256(content).hex();
}

Answer http_request(std::uint16_t port, const std::string& method, const std::string& target, const std::string& body,
                    const std::string& range) {
  asio::io_context loop;
  auto socket = connected(loop, port);
  http::request<http::string_body> out(http::string_to_verb(method), target, 11, body);
  out.set(http::field::host, "localhost");
  if (!range.empty()) out.set(http::field::range, range);
  out.prepare_payload();
  ErrorOf error;
  http::write(socket, out, error);
  beast::flat_buffer buffer;
  http::response_parser<http::string_body> in;
  in.skip(method == "HEAD");
  http::read(socket, buffer, in, error);
  EXPECT_FALSE(error) << error.message();
  Answer answer;
  answer.status = static_cast<int>(in.get().result_int());
  answer.body = in.get().body();
  for (const auto& field : in.get()) answer.headers[std::string(field.name_string())] = std::string(field.value());
  return answer;
}

// ---- The broker ----

ServiceTest::ServiceTest() {
  std::string pattern = (fs::temp_directory_path() / "eigencast-service-XXXXXX").string();
  folder_ = ::mkdtemp(pattern.data());
  config_.server.listen = config_.server.admin_listen = "127.0.0.1:0";
  config_.server.data_dir = folder_;
  config_.limits.max_control_bytes = 4096;
  config_.assets.max_object_bytes = 100'000;
}

ServiceTest::~ServiceTest() {
  stop();
  fs::remove_all(folder_);
}

void ServiceTest::start() {
  auto created = Broker::create(config_, "test", log_);
  ASSERT_TRUE(created) << created.error().message;
  broker_ = std::move(*created);
  port_ = broker_->port();
  admin_port_ = broker_->admin_port();
  thread_ = std::thread([this] { broker_->run(); });
}

void ServiceTest::begin_to_stop() {
  broker_->stop();
}

void ServiceTest::stop() {
  if (!thread_.joinable()) return;
  broker_->stop();
  thread_.join();
  broker_.reset();
}

std::string ServiceTest::put_asset(const std::string& content) const {
  const std::string id = name_of_asset(content);
  EXPECT_EQ(request("PUT", "/v1/assets/" + id, content).status, 201);
  return id;
}

std::unique_ptr<Client> ServiceTest::sender(const std::string& stream) {
  auto client = std::make_unique<Client>(port_, "/v1/publish/" + stream);
  control::Announce announce = small_announce();
  announce.asset = asset_.empty() ? asset_ = put_asset("manifest") : asset_;
  client->send(announce);
  announced_ = client->wait_for<control::Announced>();
  return client;
}

}  // namespace eigencast::broker::testing
