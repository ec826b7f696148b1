// SPDX-License-Identifier: MIT
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
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
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <thread>

#include "broker/broker.h"
#include "tests/unit/broker/support.h"

// The whole broker in this process, on a thread of its own, with blocking clients on loopback.
namespace eigencast::broker {
namespace {

namespace fs = std::filesystem;
namespace http = beast::http;
namespace websocket = beast::websocket;
using testing::FakeSender;
using ::testing::HasSubstr;
using testing::key_number;
using testing::small_announce;
using testing::small_layout;

/// A blocking WebSocket client. A read that waits in vain ends with the test's time limit.
class Client {
 public:
  Client(std::uint16_t port, const std::string& target, const std::string& subprotocol = "eigencast.v1")
      : socket_(loop_) {
    asio::connect(socket_.next_layer(), asio::ip::tcp::resolver(loop_).resolve("127.0.0.1", std::to_string(port)));
    socket_.set_option(websocket::stream_base::decorator([&](websocket::request_type& request) {
      if (!subprotocol.empty()) request.set(http::field::sec_websocket_protocol, subprotocol);
    }));
    socket_.handshake(response, "localhost", target, error);
    if (error) return;
    const auto welcome = next_control();
    EXPECT_TRUE(error || std::holds_alternative<control::Welcome>(welcome));
  }
  void send(const ControlMessage& message) { send_text(text_from_control(message)); }
  void send_text(const std::string& text) {
    socket_.text(true);
    socket_.write(asio::buffer(text), error);
  }
  void send_frame(const Bytes& frame) {
    socket_.binary(true);
    socket_.write(asio::buffer(frame), error);
  }
  /// The next message; false when the connection is closed.
  bool read() {
    buffer_.clear();
    socket_.read(buffer_, error);
    return !error;
  }
  ControlMessage next_control() {
    do {
      if (!read()) return control::Bye{"(closed)", 0};
    } while (!socket_.got_text());
    return control_from_text(beast::buffers_to_string(buffer_.data())).value();
  }
  template <typename T>
  T wait_for() {
    for (;;) {
      const auto message = next_control();
      if (const auto* wanted = std::get_if<T>(&message)) return *wanted;
      if (error) {
        ADD_FAILURE() << "closed: " << error.message();
        return {};
      }
    }
  }
  FramePtr next_frame() {
    do {
      if (!read()) return nullptr;
    } while (socket_.got_text());
    const auto data = buffer_.cdata();
    const Bytes bytes(static_cast<const std::uint8_t*>(data.data()),
                      static_cast<const std::uint8_t*>(data.data()) + data.size());
    const auto view = parse_frame(bytes).value();
    return make_frame(view.envelope, view.payload);
  }
  int close_code() {
    while (read()) {
    }
    return socket_.reason().code;
  }

  ErrorOf error;
  websocket::response_type response;

 private:
  asio::io_context loop_;
  websocket::stream<asio::ip::tcp::socket> socket_;
  beast::flat_buffer buffer_;
};

class ServiceTest : public ::testing::Test {
 protected:
  ServiceTest() {
    std::string pattern = (fs::temp_directory_path() / "eigencast-service-XXXXXX").string();
    folder_ = ::mkdtemp(pattern.data());
    config_.server.listen = "127.0.0.1:0";
    config_.server.data_dir = folder_;
    config_.timeouts.header_ms = 300;
    config_.limits.max_control_bytes = 4096;
    config_.assets.max_object_bytes = 100'000;
    start();
  }
  ~ServiceTest() override {
    stop();
    fs::remove_all(folder_);
  }
  void start() {
    auto created = Broker::create(config_, "test", log_);
    ASSERT_TRUE(created) << created.error().message;
    broker_ = std::move(*created);
    port_ = broker_->port();
    thread_ = std::thread([this] { broker_->run(); });
  }
  void stop() {
    if (!thread_.joinable()) return;
    broker_->stop();
    thread_.join();
    broker_.reset();
  }
  http::response<http::string_body> request(http::verb method, const std::string& target, const std::string& body = {},
                                            const std::string& range = {}) {
    asio::io_context loop;
    asio::ip::tcp::socket socket(loop);
    asio::connect(socket, asio::ip::tcp::resolver(loop).resolve("127.0.0.1", std::to_string(port_)));
    http::request<http::string_body> out(method, target, 11, body);
    if (!range.empty()) out.set(http::field::range, range);
    out.prepare_payload();
    ErrorOf error;
    http::write(socket, out, error);
    beast::flat_buffer buffer;
    http::response_parser<http::string_body> in;
    in.skip(method == http::verb::head);
    http::read(socket, buffer, in, error);
    EXPECT_FALSE(error) << error.message();
    return in.release();
  }
  std::string put_asset(const std::string& content) {
    const std::string id =
        sha256(ByteView(reinterpret_cast<const std::uint8_t*>(content.data()), content.size())).hex();
    EXPECT_EQ(request(http::verb::put, "/v1/assets/" + id, content).result_int(), 201u);
    return id;
  }
  std::unique_ptr<Client> sender(const std::string& stream) {
    auto client = std::make_unique<Client>(port_, "/v1/publish/" + stream);
    control::Announce announce = small_announce();
    announce.asset = asset_.empty() ? asset_ = put_asset("manifest") : asset_;
    client->send(announce);
    announced_ = client->wait_for<control::Announced>();
    return client;
  }

  Config config_;
  LogSink log_;
  std::string folder_;
  std::string asset_;
  control::Announced announced_;
  std::unique_ptr<Broker> broker_;
  std::uint16_t port_ = 0;
  std::thread thread_;
};

TEST_F(ServiceTest, PosesTravelFromSenderToViewers) {
  Client early(port_, "/v1/subscribe/a?rate=raw");
  EXPECT_EQ(early.wait_for<control::StreamInfo>().state, control::StreamInfo::State::kWaiting);
  auto publisher = sender("a");
  EXPECT_EQ(publisher->wait_for<control::Subscribers>().count, 1u);
  const auto info = early.wait_for<control::StreamInfo>();
  EXPECT_EQ(info.state, control::StreamInfo::State::kLive);
  EXPECT_EQ(info.epoch, announced_.epoch);
  FakeSender motion;
  testing::FakeReceiver receiver;
  for (int i = 0; i < 20; ++i) {
    publisher->send_frame(motion.next(i * 33'000));
    receiver.decode(*early.next_frame());
    ASSERT_EQ(receiver.poses.back().key, key_number(i));
  }
  EXPECT_EQ(receiver.undecodable, 0);

  Client late(port_, "/v1/subscribe");
  late.send(control::Subscribe{"a", Profile{}});
  EXPECT_EQ(late.wait_for<control::StreamInfo>().stream_id, announced_.stream_id);
  const FramePtr join = late.next_frame();
  EXPECT_EQ(join->envelope.kind, FrameKind::kJoin);
  EXPECT_EQ(join->envelope.sequence, 19u);

  publisher.reset();
  EXPECT_EQ(late.wait_for<control::StreamInfo>().state, control::StreamInfo::State::kStalled);
  auto second = sender("a");
  EXPECT_GT(late.wait_for<control::StreamInfo>().epoch, info.epoch);
}

TEST_F(ServiceTest, InterpolatedPosesComeThreeToAKey) {
  auto publisher = sender("a");
  Client viewer(port_, "/v1/subscribe/a");
  viewer.wait_for<control::StreamInfo>();
  FakeSender motion;
  testing::FakeReceiver receiver;
  constexpr int kKeys = 6;
  std::thread feeding([&] {
    for (int i = 0; i < kKeys; ++i) {
      publisher->send_frame(motion.next(i * 20'000));
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
  });
  do {
    receiver.decode(*viewer.next_frame());
  } while (receiver.poses.empty() || receiver.poses.back().key != key_number(kKeys - 1));
  feeding.join();
  EXPECT_EQ(receiver.undecodable, 0);
  for (const auto& pose : receiver.poses) {
    const int s = static_cast<int>(pose.envelope.sequence);
    const auto [at, of] = pose.envelope.step;
    if (pose.envelope.kind != FrameKind::kSynthetic) continue;
    EXPECT_EQ(pose.key, interpolate_keys(small_layout(), key_number(s - 1), key_number(s), at, of).value());
  }
}

TEST_F(ServiceTest, ASecondSenderIsRefusedAndTheFirstGoesOn) {
  auto first = sender("a");
  Client second(port_, "/v1/publish/a");
  EXPECT_EQ(second.wait_for<control::ErrorMessage>().code, "refused");
  EXPECT_EQ(second.close_code(), 1008);
  first->send(control::Ping{7, 9});
  EXPECT_EQ(first->wait_for<control::Pong>().id, 7u);
}

TEST_F(ServiceTest, GarbageClosesItsSenderOnly) {
  auto bad = sender("bad");
  auto good = sender("good");
  bad->send_frame(Bytes(40, 0xff));
  EXPECT_EQ(bad->wait_for<control::ErrorMessage>().code, "corrupt");
  EXPECT_EQ(bad->close_code(), 1008);
  Client viewer(port_, "/v1/subscribe/good?rate=raw");
  FakeSender motion;
  good->send_frame(motion.next(0));
  EXPECT_EQ(viewer.next_frame()->envelope.sequence, 0u);
}

TEST_F(ServiceTest, CloseCodesAreThoseOfTheProtocol) {
  Client not_json(port_, "/v1/subscribe");
  not_json.send_text("{nonsense");
  EXPECT_EQ(not_json.wait_for<control::ErrorMessage>().code, "corrupt");
  EXPECT_EQ(not_json.close_code(), 1007);
  Client bad_utf8(port_, "/v1/subscribe");
  bad_utf8.send_text("\xff\xfe");
  EXPECT_EQ(bad_utf8.close_code(), 1007);
  Client binary(port_, "/v1/subscribe");
  binary.send_frame(Bytes(10, 1));
  EXPECT_EQ(binary.wait_for<control::ErrorMessage>().code, "invalid-argument");
  EXPECT_EQ(binary.close_code(), 1003);
  Client large(port_, "/v1/subscribe");
  large.send_text(std::string(10'000, ' '));
  EXPECT_EQ(large.wait_for<control::ErrorMessage>().code, "too-large");
  EXPECT_EQ(large.close_code(), 1009);
  Client large_announce(port_, "/v1/publish/a");
  large_announce.send_text(std::string(10'000, ' '));
  EXPECT_EQ(large_announce.wait_for<control::ErrorMessage>().code, "too-large") << "over limits.max_control_bytes";
  EXPECT_EQ(large_announce.close_code(), 1009);
  Client much_too_large(port_, "/v1/publish/b");
  much_too_large.send_frame(Bytes(3'000'000, 1));
  EXPECT_EQ(much_too_large.close_code(), 1009);
  Client unknown(port_, "/v1/subscribe");
  unknown.send_text(R"({"op":"dance"})");
  EXPECT_EQ(unknown.wait_for<control::ErrorMessage>().code, "unsupported");
  unknown.send(control::Ping{1, 2});
  EXPECT_EQ(unknown.wait_for<control::Pong>().time_us, 2) << "an unknown op does not close";
}

TEST_F(ServiceTest, UpgradesAreChecked) {
  for (const char* protocol : {"", "eigencast.v2", "chat"}) {
    Client client(port_, "/v1/subscribe/a", protocol);
    EXPECT_EQ(client.response.result_int(), 400u) << protocol;
  }
  EXPECT_EQ(Client(port_, "/v1/subscribe/a?rate=99").response.result_int(), 400u);
  EXPECT_EQ(Client(port_, "/v1/subscribe/a/../b").response.result_int(), 400u);
  EXPECT_EQ(Client(port_, "/nothing").response.result_int(), 404u);
  EXPECT_EQ(request(http::verb::get, "/v1/subscribe/a").result_int(), 426u);
  const Client several(port_, "/v1/subscribe/a", "chat, eigencast.v1");
  EXPECT_EQ(several.response[http::field::sec_websocket_protocol], "eigencast.v1");
}

TEST_F(ServiceTest, AnnouncementsAreChecked) {
  Client client(port_, "/v1/publish/a");
  control::Announce announce = small_announce();
  client.send(announce);
  EXPECT_EQ(client.wait_for<control::ErrorMessage>().code, "not-found");
  announce.asset = put_asset("x");
  client.send(announce);
  EXPECT_EQ(client.wait_for<control::Announced>().stream, "a")
      << "after the asset was put, the same connection goes on";
}

TEST_F(ServiceTest, OneConnectionWatchesManyStreamsAndChangesItsProfile) {
  auto a = sender("a");
  auto b = sender("b");
  Client viewer(port_, "/v1/subscribe");
  viewer.send(control::Subscribe{"a", Profile{Profile::Rate::kRaw}});
  const auto info_a = viewer.wait_for<control::StreamInfo>();
  viewer.send(control::Subscribe{"b", Profile{Profile::Rate::kRaw}});
  const auto info_b = viewer.wait_for<control::StreamInfo>();
  FakeSender motion_a;
  FakeSender motion_b;
  a->send_frame(motion_a.next(0));
  EXPECT_EQ(viewer.next_frame()->envelope.stream_id, info_a.stream_id);
  b->send_frame(motion_b.next(0));
  EXPECT_EQ(viewer.next_frame()->envelope.stream_id, info_b.stream_id);
  viewer.send(control::Subscribe{"a", Profile{Profile::Rate::kRaw, 3, Profile::Form::kFull, 1}});
  EXPECT_EQ(viewer.wait_for<control::StreamInfo>().profile.bands, 1);
  const FramePtr join = viewer.next_frame();
  EXPECT_EQ(join->envelope.kind, FrameKind::kJoin);
  EXPECT_EQ(join->envelope.bands, 1);
  viewer.send(control::Unsubscribe{"a"});
  viewer.send(control::Ping{1, 1});
  viewer.wait_for<control::Pong>();
  a->send_frame(motion_a.next(1));
  b->send_frame(motion_b.next(1));
  EXPECT_EQ(viewer.next_frame()->envelope.stream_id, info_b.stream_id);
  viewer.send(control::Unsubscribe{"a"});
  EXPECT_EQ(viewer.wait_for<control::ErrorMessage>().code, "not-found");
}

TEST_F(ServiceTest, Assets) {
  const std::string id = put_asset("0123456789");
  const std::string target = "/v1/assets/" + id;
  EXPECT_EQ(request(http::verb::get, target).body(), "0123456789");
  const auto part = request(http::verb::get, target, {}, "bytes=2-4");
  EXPECT_EQ(part.result_int(), 206u);
  EXPECT_EQ(part.body(), "234");
  EXPECT_EQ(part[http::field::content_range], "bytes 2-4/10");
  EXPECT_EQ(request(http::verb::get, target, {}, "bytes=10-").result_int(), 416u);
  const auto head = request(http::verb::head, target);
  EXPECT_EQ(head.result_int(), 200u);
  EXPECT_EQ(head[http::field::etag], "\"" + id + "\"");
  EXPECT_EQ(head[http::field::content_length], "10");
  EXPECT_EQ(request(http::verb::put, target, "0123456789").result_int(), 200u);
  EXPECT_EQ(request(http::verb::put, target, "something else").result_int(), 422u);
  EXPECT_EQ(request(http::verb::put, target, std::string(100'001, 'x')).result_int(), 413u);
  EXPECT_EQ(request(http::verb::delete_, target).result_int(), 405u);
  EXPECT_EQ(request(http::verb::get, "/v1/assets/" + std::string(64, '0')).result_int(), 404u);
  EXPECT_EQ(request(http::verb::get, "/v1/assets/xyz").result_int(), 400u);
  const std::string empty = put_asset("");
  EXPECT_EQ(request(http::verb::get, "/v1/assets/" + empty).body(), "");
  EXPECT_THAT(request(http::verb::get, "/v1/streams").body(), HasSubstr("\"streams\":[]"));
}

TEST_F(ServiceTest, ABodyThatNobodyReadsIsNotTheNextRequest) {
  const std::string id = put_asset("0123456789");
  const std::string inner = "GET /v1/streams HTTP/1.1\r\n\r\n";
  for (const std::string& target : {"/v1/assets/" + id, std::string("/v1/streams"), std::string("/nothing")}) {
    asio::io_context loop;
    asio::ip::tcp::socket socket(loop);
    asio::connect(socket, asio::ip::tcp::resolver(loop).resolve("127.0.0.1", std::to_string(port_)));
    asio::write(socket, asio::buffer("GET " + target + " HTTP/1.1\r\nContent-Length: " + std::to_string(inner.size()) +
                                     "\r\n\r\n" + inner));
    std::string answers;
    ErrorOf error;
    asio::read(socket, asio::dynamic_buffer(answers), error);
    EXPECT_EQ(error, asio::error::eof) << target;
    EXPECT_EQ(answers.find("HTTP/1.1 "), answers.rfind("HTTP/1.1 ")) << answers;
    EXPECT_THAT(answers, HasSubstr("Connection: close")) << target;
  }
}

TEST_F(ServiceTest, StoppingSaysByeWithARetryAndTheNextRunHasHigherEpochs) {
  auto publisher = sender("a");
  const std::uint32_t epoch = announced_.epoch;
  Client viewer(port_, "/v1/subscribe/a");
  viewer.wait_for<control::StreamInfo>();
  broker_->stop();
  EXPECT_GT(viewer.wait_for<control::Bye>().retry_after_ms, 0u);
  EXPECT_EQ(viewer.close_code(), 1012);
  EXPECT_EQ(publisher->close_code(), 1012);
  stop();
  start();
  publisher = sender("a");
  EXPECT_GT(announced_.epoch, epoch);
}

TEST_F(ServiceTest, StoppingInTheMiddleOfEverythingIsClean) {
  auto publisher = sender("a");
  Client viewer(port_, "/v1/subscribe/a");
  asio::io_context loop;
  asio::ip::tcp::socket upload(loop);
  asio::connect(upload, asio::ip::tcp::resolver(loop).resolve("127.0.0.1", std::to_string(port_)));
  asio::write(upload, asio::buffer("PUT /v1/assets/" + asset_ + " HTTP/1.1\r\nContent-Length: 9\r\n\r\nhalf"));
  viewer.wait_for<control::StreamInfo>();
  broker_->stop();
  broker_->stop();
  stop();
  start();
  std::size_t left = 0;
  for (const auto& entry : fs::recursive_directory_iterator(folder_ + "/assets"))
    left += entry.is_regular_file() ? 1 : 0;
  EXPECT_EQ(left, 1u) << "the manifest, and nothing of the upload";
}

TEST_F(ServiceTest, WhatOneHandlerCannotDoEndsNobodyElsesStream) {
  stop();
  std::atomic<int> thrown = 0;
  std::atomic<bool> told = false;
  log_ = [&](LogLevel, std::string_view line) {
    if (line.find("no memory") == std::string_view::npos && line.find("'unlucky'") != std::string_view::npos &&
        thrown++ == 0)
      throw std::runtime_error("no memory");
    if (line.find("no memory") != std::string_view::npos) told = true;
  };
  start();
  auto publisher = sender("a");
  Client viewer(port_, "/v1/subscribe/a?rate=raw");
  viewer.wait_for<control::StreamInfo>();
  Client unlucky(port_, "/v1/publish/unlucky");
  unlucky.close_code();
  unlucky.error.clear();
  Client again(port_, "/v1/publish/unlucky");
  again.send(control::Ping{7, 9});
  EXPECT_EQ(again.wait_for<control::Pong>().id, 7u) << "the name is free again";
  FakeSender motion;
  publisher->send_frame(motion.next(0));
  EXPECT_EQ(viewer.next_frame()->envelope.sequence, 0u);
  EXPECT_EQ(request(http::verb::get, "/v1/streams").result_int(), 200u);
  EXPECT_GE(thrown, 1);
  EXPECT_TRUE(told);
  stop();
}

TEST_F(ServiceTest, ASlowHeadIsCutOff) {
  asio::io_context loop;
  asio::ip::tcp::socket socket(loop);
  asio::connect(socket, asio::ip::tcp::resolver(loop).resolve("127.0.0.1", std::to_string(port_)));
  asio::write(socket, asio::buffer(std::string("GET /v1/str")));
  char byte = 0;
  ErrorOf error;
  socket.read_some(asio::buffer(&byte, 1), error);
  EXPECT_TRUE(error);
}

/// The same with three event loops, which share the viewers.
class LoopsTest : public ServiceTest {
 protected:
  LoopsTest() {
    stop();
    config_.server.threads = 3;
    config_.server.admin_listen = "127.0.0.1:0";
    config_.limits.max_control_bytes = 65'536;
    start();
  }
  std::unique_ptr<Client> viewer(const std::string& stream = "a") {
    auto client = std::make_unique<Client>(port_, "/v1/subscribe/" + stream + "?rate=raw");
    info_ = client->wait_for<control::StreamInfo>();
    return client;
  }
  std::vector<std::unique_ptr<Client>> viewers(int count) {
    std::vector<std::unique_ptr<Client>> all;
    for (int i = 0; i < count; ++i) all.push_back(viewer());
    return all;
  }
  std::string admin(const std::string& target, http::verb method = http::verb::get) {
    const std::uint16_t data_port = std::exchange(port_, broker_->admin_port());
    const auto answer = request(method, target);
    port_ = data_port;
    return answer.result_int() == 200 ? answer.body() : std::to_string(answer.result_int());
  }
  nlohmann::json facts(const std::string& target) { return nlohmann::json::parse(admin(target)); }
  double metric(const std::string& name) {
    const std::string text = "\n" + admin("/metrics");
    const auto at = text.find("\n" + name + " ");
    return at == std::string::npos ? -1 : std::stod(text.substr(at + name.size() + 2));
  }
  static std::uint32_t wait_for_count(Client& publisher, std::uint32_t count) {
    for (;;) {
      const auto told = publisher.wait_for<control::Subscribers>().count;
      if (told == count || publisher.error) return told;
    }
  }

  control::StreamInfo info_;
};

TEST_F(LoopsTest, ViewersOfAllLoopsSeeOneStream) {
  auto early = viewer();
  EXPECT_EQ(info_.state, control::StreamInfo::State::kWaiting);
  auto publisher = sender("a");
  EXPECT_EQ(early->wait_for<control::StreamInfo>().epoch, announced_.epoch);
  auto all = viewers(8);
  all.push_back(std::move(early));
  EXPECT_EQ(info_.stream_id, announced_.stream_id);
  EXPECT_EQ(wait_for_count(*publisher, 9), 9u);
  EXPECT_THAT(request(http::verb::get, "/v1/streams").body(), HasSubstr("\"subscribers\":9"));
  for (const char* thread : {"0", "1", "2"}) {
    EXPECT_GE(metric("eigencast_broker_thread_connections{thread=\"" + std::string(thread) + "\"}"), 3) << thread;
  }
  ASSERT_EQ(admin("/api/recordings/start?stream=a", http::verb::post), "{}\n");
  FakeSender motion;
  std::vector<testing::FakeReceiver> receivers(all.size());
  for (int i = 0; i < 20; ++i) {
    publisher->send_frame(motion.next(i * 33'000));
    for (std::size_t v = 0; v < all.size(); ++v) {
      receivers[v].decode(*all[v]->next_frame());
      ASSERT_EQ(receivers[v].undecodable, 0);
      ASSERT_EQ(receivers[v].poses.back().key, key_number(i)) << "viewer " << v;
    }
  }
  const auto broker = facts("/api/broker");
  EXPECT_EQ(broker["threads"], 3);
  EXPECT_EQ(broker["frames_sent"], 20 * 9);
  EXPECT_EQ(metric("eigencast_broker_frames_sent_total"), 20 * 9);
  EXPECT_EQ(metric("eigencast_broker_subscriptions"), 9);
  const auto stream = facts("/api/streams")["streams"][0];
  EXPECT_EQ(stream["viewers"], 9);
  EXPECT_EQ(stream["keys_received"], 20);
  EXPECT_EQ(stream["profiles"], 3) << "each loop has its own feed";
  EXPECT_EQ(admin("/api/recordings/stop?stream=a", http::verb::post), "{}\n");
  auto recordings = facts("/api/recordings")["recordings"];
  while (recordings.empty() || recordings[0]["state"] != "finished") {  // Of the disk.
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    recordings = facts("/api/recordings")["recordings"];
  }
  EXPECT_EQ(recordings[0]["frames_lost"], 0);
  EXPECT_GE(recordings[0]["frames"], 19) << "the first may be the checkpoint alone";

  auto late = viewer();
  EXPECT_EQ(late->next_frame()->envelope.sequence, 19u) << "the present pose";
  publisher.reset();
  for (const auto& one : all) {
    EXPECT_EQ(one->wait_for<control::StreamInfo>().state, control::StreamInfo::State::kStalled);
  }
  publisher = sender("a");
  for (const auto& one : all) EXPECT_EQ(one->wait_for<control::StreamInfo>().epoch, announced_.epoch);
  EXPECT_EQ(wait_for_count(*publisher, 10), 10u);
  all.clear();
  late.reset();
  EXPECT_EQ(wait_for_count(*publisher, 0), 0u);
}

TEST_F(LoopsTest, ASecondSenderIsRefusedOrReplacesTheFirst) {
  auto first = sender("a");
  auto all = viewers(3);
  Client second(port_, "/v1/publish/a");
  EXPECT_EQ(second.wait_for<control::ErrorMessage>().code, "refused");
  EXPECT_EQ(second.close_code(), 1008);
  stop();
  config_.streams.second_sender = "replace";
  start();
  first = sender("a");
  all = viewers(3);
  auto third = sender("a");
  EXPECT_EQ(first->close_code(), 4409);
  for (const auto& one : all) {
    control::StreamInfo info;
    do {
      info = one->wait_for<control::StreamInfo>();
    } while (info.epoch != announced_.epoch && !one->error);
    EXPECT_EQ(info.state, control::StreamInfo::State::kLive);
  }
}

TEST_F(LoopsTest, TheOperatorSeesAndSendsAwayClientsOfAllLoops) {
  auto publisher = sender("a");
  auto all = viewers(5);
  const auto clients = facts("/api/clients")["clients"];
  ASSERT_EQ(clients.size(), 6u);
  EXPECT_EQ(clients[0]["kind"], "sender");
  for (std::size_t i = 1; i < clients.size(); ++i) {
    EXPECT_LT(clients[i - 1]["id"], clients[i]["id"]);
    EXPECT_EQ(clients[i]["streams"][0]["stream"], "a");
  }
  const auto kick = [&](std::uint64_t id) {
    return admin("/api/clients/kick?id=" + std::to_string(id), http::verb::post);
  };
  for (std::size_t i = 1; i < clients.size(); ++i) {
    EXPECT_EQ(kick(clients[i]["id"].get<std::uint64_t>()), "{}\n");
    EXPECT_EQ(all[i - 1]->close_code(), 1008) << "the one of that id, and nobody else";
  }
  EXPECT_EQ(kick(clients[1]["id"].get<std::uint64_t>()), "404");
  EXPECT_EQ(metric("eigencast_broker_kicked_total"), 5);
  EXPECT_EQ(wait_for_count(*publisher, 0), 0u);
}

TEST_F(LoopsTest, LimitsCountInAllLoopsTogether) {
  stop();
  config_.limits.max_subscribers_per_stream = 4;
  config_.limits.max_streams = 1;
  config_.limits.max_connections = 8;
  config_.per_address.streams = 6;
  start();
  auto publisher = sender("a");
  auto all = viewers(4);
  Client fifth(port_, "/v1/subscribe/a");
  EXPECT_EQ(fifth.wait_for<control::ErrorMessage>().code, "too-large");
  fifth.send(control::Subscribe{"b", Profile{}});
  EXPECT_EQ(fifth.wait_for<control::ErrorMessage>().code, "too-large") << "the broker has its one stream";
  Client sixth(port_, "/v1/subscribe/b");
  EXPECT_EQ(sixth.wait_for<control::ErrorMessage>().code, "too-large");
  all.pop_back();
  EXPECT_EQ(wait_for_count(*publisher, 3), 3u);
  fifth.send(control::Subscribe{"a", Profile{}});
  EXPECT_EQ(fifth.wait_for<control::StreamInfo>().epoch, announced_.epoch) << "there is room again";
  EXPECT_EQ(facts("/api/broker")["connections"], 6);
  std::vector<std::unique_ptr<Client>> more;
  for (int i = 0; i < 2; ++i) more.push_back(std::make_unique<Client>(port_, "/v1/subscribe"));
  EXPECT_EQ(request(http::verb::get, "/v1/streams").result_int(), 503u);
}

TEST_F(LoopsTest, StoppingSaysByeInEveryLoop) {
  auto publisher = sender("a");
  auto all = viewers(6);
  broker_->stop();
  for (const auto& one : all) {
    EXPECT_GT(one->wait_for<control::Bye>().retry_after_ms, 0u);
    EXPECT_EQ(one->close_code(), 1012);
  }
  EXPECT_EQ(publisher->close_code(), 1012);
  stop();
}

TEST_F(LoopsTest, ComingAndGoingWhileItStops) {
  auto publisher = sender("a");
  std::atomic<bool> over = false;
  std::vector<std::thread> crowd;
  for (int i = 0; i < 4; ++i) {
    crowd.emplace_back([&, port = port_] {
      while (!over) {
        try {
          Client client(port, "/v1/subscribe");
          if (client.error) continue;
          client.send(control::Subscribe{"a", Profile{}});
          client.send(control::Subscribe{"nobody", Profile{}});
          if (client.read()) client.send(control::Unsubscribe{"a"});
        } catch (const std::exception&) {  // Nobody listens any more.
        }
      }
    });
  }
  FakeSender motion;
  for (int i = 0; i < 100; ++i) {
    publisher->send_frame(motion.next(i * 2'000));
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  EXPECT_FALSE(publisher->error);
  broker_->stop();
  stop();
  over = true;
  for (std::thread& one : crowd) one.join();
}

}  // namespace
}  // namespace eigencast::broker
