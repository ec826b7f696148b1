// SPDX-License-Identifier: MIT
//
// What HTTP clients of a whole broker are answered.
#include <gmock/gmock.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "broker/access/token_file.h"
#include "broker/http/asset_transfer.h"
#include "broker/http/http_connection.h"
#include "common/core/clock.h"
#include "tests/unit/broker/service.h"

namespace eigencast::broker {
namespace {

using namespace testing;
using ::testing::AllOf;
using ::testing::AnyOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;
using HttpSessionTest = ServiceTest;

TEST_F(HttpSessionTest, AssetsAreStoredAndServed) {
  const std::string id = put_asset("0123456789");
  const std::string target = "/v1/assets/" + id;
  EXPECT_EQ(request("GET", target).body, "0123456789");
  const auto part = request("GET", target, {}, "bytes=2-4");
  EXPECT_EQ(part.status, 206);
  EXPECT_EQ(part.body, "234");
  EXPECT_EQ(part.headers.at("Content-Range"), "bytes 2-4/10");
  const auto beyond = request("GET", target, {}, "bytes=10-");
  EXPECT_EQ(beyond.status, 416);
  EXPECT_EQ(beyond.headers.at("Content-Range"), "bytes */10");
  EXPECT_EQ(beyond.headers.count("Cache-Control"), 0u) << "a cache would keep the error";
  EXPECT_EQ(beyond.headers.count("ETag"), 0u);
  const auto head = request("HEAD", target);
  EXPECT_EQ(head.status, 200);
  EXPECT_EQ(head.headers.at("ETag"), "\"" + id + "\"");
  EXPECT_EQ(head.headers.at("Content-Length"), "10");
  EXPECT_EQ(request("PUT", target, "0123456789").status, 200);
  EXPECT_EQ(request("PUT", target, "something else").status, 422);
  EXPECT_EQ(request("PUT", target, std::string(100'001, 'x')).status, 413);
  EXPECT_EQ(request("DELETE", target).status, 405);
  EXPECT_EQ(request("GET", "/v1/assets/" + std::string(64, '0')).status, 404);
  EXPECT_EQ(request("GET", "/v1/assets/xyz").status, 400);
  const std::string empty = put_asset("");
  EXPECT_EQ(request("GET", "/v1/assets/" + empty).body, "");
  EXPECT_THAT(request("GET", "/v1/streams").body, HasSubstr("\"streams\":[]"));
}

TEST_F(HttpSessionTest, DownloadsThatAreNotReadHoldNoFile) {
  constexpr int kDownloads = 8, kDiskThreads = 2;
  stop();
  config_.assets.max_object_bytes = 16 << 20;
  start();
  const std::string content(16 << 20, 'x');
  const std::string id = put_asset(content);
  std::vector<std::unique_ptr<Wire>> wires;
  for (int i = 0; i < kDownloads; ++i) {
    wires.push_back(std::make_unique<Wire>(port_));
    wires.back()->write("GET /v1/assets/" + id + " HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
  }
  const auto shows = [&](const std::string& name) {
    const std::string text = http_request(admin_port_, "GET", "/metrics").body;
    return text.find("\n" + name + " " + std::to_string(kDownloads) + "\n") != std::string::npos;
  };
  while (!shows("eigencast_broker_downloads_total")) std::this_thread::yield();
  int files = 0;
  for (const auto& descriptor : std::filesystem::directory_iterator("/proc/self/fd")) {
    std::error_code closed;
    files += std::filesystem::read_symlink(descriptor, closed).filename() == id;
  }
  EXPECT_LE(files, kDiskThreads);
  EXPECT_TRUE(shows("eigencast_broker_downloads"));
  std::filesystem::remove(folder_ + "/assets/" + id.substr(0, 2) + "/" + id);
  for (const auto& wire : wires) {
    EXPECT_LT(wire->read_all().value_or("").size(), content.size()) << "cut off, not of other bytes";
  }
}

TEST_F(HttpSessionTest, StrangersLeaveUploadsToTokensAndToEachOther) {
  stop();
  const auto token = create_static_token("camera", {"**"}, {}, false);
  std::ofstream(folder_ + "/tokens") << token->line << "\n";
  std::filesystem::permissions(folder_ + "/tokens", std::filesystem::perms::owner_read);
  config_.access.tokens_file = folder_ + "/tokens";
  config_.access.anonymous = "anywhere";
  config_.proxy.trusted = {"127.0.0.1"};
  config_.limits.max_uploads = 16;
  start();
  const auto put = [&](const std::string& who, const std::string& body, std::size_t length) {
    auto wire = std::make_unique<Wire>(port_);
    wire->write("PUT /v1/assets/" + name_of_asset(body) + " HTTP/1.1\r\nHost: localhost\r\n" + who +
                "\r\nConnection: close\r\nContent-Length: " + std::to_string(length) + "\r\n\r\n" + body);
    return wire;
  };
  const auto whole = [&](const std::string& who, const std::string& body) {
    return put(who, body, body.size())->read_all().value_or("reset");
  };
  const auto from = [](int address) { return "X-Forwarded-For: 192.0.2." + std::to_string(address); };
  const auto under_way = [&] {
    const std::string text = http_request(admin_port_, "GET", "/metrics").body, name = "\neigencast_broker_uploads ";
    return std::stoi(text.substr(text.find(name) + name.size()));
  };
  std::vector<std::unique_ptr<Wire>> held;
  for (int address = 1; address <= 10; ++address) {
    for (int i = 0; i < 8; ++i) {
      held.push_back(put(from(address), "half", 10'000));
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
  }
  while (under_way() < 12) std::this_thread::yield();
  EXPECT_EQ(under_way(), 12) << "three quarters";
  const std::string bearer = from(1) + "\r\nAuthorization: Bearer " + token->token;
  EXPECT_THAT(whole(bearer, "of a token"), StartsWith("HTTP/1.1 201"));
  EXPECT_THAT(whole(from(1), "of one who has some"), StartsWith("HTTP/1.1 503"));
  EXPECT_THAT(whole(from(100), "of a newcomer"), StartsWith("HTTP/1.1 201"));
  EXPECT_EQ(under_way(), 11) << "a slow one of who had most has ended";
}

TEST(UploadPace, OnlyTheTimeSpentWaitingForBytesCounts) {
  UploadPace pace;
  EXPECT_EQ(pace.behind_us(1'000'000), 0);
  pace.begin_reading(1'000'000);
  EXPECT_EQ(pace.behind_us(21'000'000), 20'000'000);
  pace.end_reading(21'000'000, 40'000);
  EXPECT_EQ(pace.behind_us(90'000'000), 10'000'000) << "40,000 bytes are what 10 s bring";
  pace.begin_reading(90'000'000);
  EXPECT_EQ(pace.behind_us(91'000'000), 11'000'000);
  pace.end_reading(91'000'000, 1'000'000);
  EXPECT_LT(pace.behind_us(91'000'000), 0) << "fast on average";
}

TEST_F(HttpSessionTest, HeadsOfManyFieldsAreRefused) {
  const auto head = [](int fields) {
    std::string text = "GET /v1/streams HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n";
    for (int i = 0; i < fields; ++i) text += "a:\r\n";
    return text;
  };
  Wire usual(port_), many(port_);
  usual.write(head(90) + "\r\n");
  EXPECT_THAT(usual.read_all().value_or("reset"), StartsWith("HTTP/1.1 200"));
  many.write(head(200));  // And no end: each is 80 bytes of memory by then.
  EXPECT_THAT(many.read_all().value_or("reset"), StartsWith("HTTP/1.1 431"));
}

TEST_F(HttpSessionTest, AnswersVaryByOrigin) {
  const std::string target = "/v1/assets/" + put_asset("0123456789");
  for (const std::string& what : {target, std::string("/v1/streams"), std::string("/v1/nothing")}) {
    EXPECT_EQ(request("GET", what).headers.at("Vary"), "Origin") << what << ": asked without an origin";
  }
}

TEST_F(HttpSessionTest, RefusedRequestsOfAProxyCountForItsClients) {
  stop();
  config_.access.anonymous = "anywhere";
  config_.proxy.trusted = {"127.0.0.1"};
  config_.per_address.requests_per_s = 1;
  start();
  const auto ask = [&](const std::string& line, const std::string& client) {
    auto wire = std::make_unique<Wire>(port_);
    wire->write(line + " HTTP/1.1\r\nHost: localhost\r\nX-Forwarded-For: " + client + "\r\nConnection: close\r\n\r\n");
    return wire;
  };
  std::vector<std::unique_ptr<Wire>> flood;
  for (int i = 0; i < 40; ++i) flood.push_back(ask("GET /v1/nothing", "192.0.2.1"));
  const auto another = ask("OPTIONS /v1/streams", "192.0.2.2");
  EXPECT_THAT(another->read_all().value_or("reset"), StartsWith("HTTP/1.1 204"));
  EXPECT_THAT(flood.back()->read_all().value_or("reset"), StartsWith("HTTP/1.1 429"));
}

TEST_F(HttpSessionTest, EachClientOfAProxyPaysForItsRequestsAndPlaces) {
  stop();
  config_.access.anonymous = "anywhere";
  config_.proxy.trusted = {"127.0.0.1"};
  config_.per_address.work_us_per_s = 50;
  config_.per_address.connections = 2;
  start();
  const auto ask = [&](const std::string& fields) {
    auto wire = std::make_unique<Wire>(port_);
    wire->write("OPTIONS /v1/streams HTTP/1.1\r\nHost: localhost\r\n" + fields + "\r\n");
    return wire;
  };
  const auto answer = [&](const std::string& fields) {
    return ask(fields + "Connection: close\r\n")->read_all().value_or("reset");
  };
  const std::string much = "X-Long: " + std::string(15'000, 'x') + "\r\n";
  EXPECT_THAT(answer(much), StartsWith("HTTP/1.1 204"));
  EXPECT_THAT(answer(much), AllOf(StartsWith("HTTP/1.1 429"), HasSubstr("work_us_per_s"))) << "nobody's";
  const std::string greedy = "X-Forwarded-For: 192.0.2.255\r\n";
  std::vector<std::unique_ptr<Wire>> kept;
  std::string refused;
  while (!refused.starts_with("HTTP/1.1 429")) {
    kept.push_back(ask(greedy));
    refused = answer(greedy);
  }
  EXPECT_THAT(refused, HasSubstr("per_address.connections = 2"));
  for (int i = 0; i < 100; ++i) {
    EXPECT_THAT(answer("X-Forwarded-For: 192.0.2." + std::to_string(i) + "\r\n"), StartsWith("HTTP/1.1 204")) << i;
  }
}

TEST_F(HttpSessionTest, StreamListGoesOnAfterAName) {
  const auto first = sender("lab/a"), second = sender("lab/b");
  Client viewer(port_, "/v1/subscribe/invented");
  viewer.wait_for<control::StreamInfo>();
  const std::string all = request("GET", "/v1/streams").body;
  EXPECT_THAT(all, AllOf(HasSubstr("lab/a"), HasSubstr("lab/b"), Not(HasSubstr("invented"))));
  EXPECT_THAT(request("GET", "/v1/streams?after=lab/a").body, AllOf(Not(HasSubstr("lab/a")), HasSubstr("lab/b")));
  EXPECT_EQ(request("GET", "/v1/streams?after=//").status, 400);
}

TEST_F(HttpSessionTest, RequestsOfAnAddressHaveARate) {
  stop();
  config_.per_address.requests_per_s = 1;
  start();
  std::vector<std::unique_ptr<Wire>> wires;
  int refused = 0;
  for (int i = 0; i < 100; ++i) {
    wires.push_back(std::make_unique<Wire>(port_));
    wires.back()->write("GET /v1/assets/" + std::string(64, '0') +
                        " HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
  }
  for (const auto& wire : wires) refused += wire->read_all().value_or("").starts_with("HTTP/1.1 429") ? 1 : 0;
  EXPECT_GT(refused, 0);
  EXPECT_LT(refused, 100);
}

TEST_F(HttpSessionTest, ListsOfAnAddressDelayNoOtherRequests) {
  stop();
  config_.per_address.requests_per_s = 2;
  for (int i = 0; i < 200; ++i) config_.access.anonymous_publish.push_back("studio-" + std::to_string(i));
  start();
  Client viewer(port_, "/v1/subscribe");
  for (int i = 0; i < 20; ++i) {
    viewer.send(control::Subscribe{"s" + std::to_string(i), kRaw});
    viewer.wait_for<control::StreamInfo>();
  }
  Answer refused;
  while (refused.status != 429) refused = request("GET", "/v1/streams");
  EXPECT_EQ(refused.headers.at("Retry-After"), "5");
  EXPECT_THAT(refused.body, HasSubstr("per_address.requests_per_s = 2"));
  EXPECT_EQ(request("GET", "/v1/assets/" + std::string(64, '0')).status, 404);
  EXPECT_EQ(Client(port_, "/v1/subscribe").status(), 101);
  viewer.send(control::Ping{7, 9});
  EXPECT_EQ(viewer.wait_for<control::Pong>().id, 7u) << "who is in goes on";
}

TEST_F(HttpSessionTest, RequestsOfAConnectionWaitTheirTurn) {
  stop();
  config_.limits.requests_per_s = 10;
  start();
  Wire wire(port_);
  std::string requests;
  for (int i = 0; i < 29; ++i) requests += "GET /v1/streams HTTP/1.1\r\nHost: localhost\r\n\r\n";
  const TimeUs began_us = steady_now_us();
  wire.write(requests + "GET /v1/streams HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
  const std::string answers = wire.read_all().value_or("reset");
  EXPECT_GE(steady_now_us() - began_us, 1'900'000) << "ten at once, ten a second";
  std::size_t count = 0;
  for (auto at = answers.find("HTTP/1.1 200"); at != std::string::npos; at = answers.find("HTTP/1.1 200", at + 1)) {
    ++count;
  }
  EXPECT_EQ(count, 30u);
}

TEST_F(HttpSessionTest, RequestsOfAllTakeHalfOfTheLoopsTime) {
  stop();
  config_.limits.requests_per_s = config_.per_address.requests_per_s = 100'000;
  config_.per_address.work_us_per_s = 1'000'000'000;
  start();
  const std::string head = "OPTIONS /v1/streams HTTP/1.1\r\nHost: localhost\r\nX-Long: " + std::string(15'000, 'x');
  const TimeUs began_us = steady_now_us();
  std::vector<std::unique_ptr<Wire>> wires;
  for (int i = 0; i < 10; ++i) {
    std::string requests;
    for (int j = 1; j <= 100; ++j) requests += head + (j < 100 ? "\r\n\r\n" : "\r\nConnection: close\r\n\r\n");
    wires.push_back(std::make_unique<Wire>(port_));
    wires.back()->write(requests);
  }
  for (const auto& wire : wires) EXPECT_THAT(wire->read_all().value_or("reset"), StartsWith("HTTP/1.1 204"));
  EXPECT_GE(steady_now_us() - began_us, 10 * 100 * (15'000 / 64) * 2 - 10'000);
}

TEST_F(HttpSessionTest, BodiesTakeHalfOfTheLoopsTime) {
  stop();
  config_.web.enabled = true;
  config_.web.folder = folder_ + "/page";
  config_.assets.max_object_bytes = 1 << 20;
  config_.limits.max_unfinished_bytes = config_.per_address.unfinished_bytes = 1 << 30;
  std::filesystem::create_directories(config_.web.folder);
  const std::string body(1 << 20, 'x');
  std::ofstream(config_.web.folder + "/a.js") << body;
  start();
  for (const std::string& target : {std::string("/v1/web/a.js"), "/v1/assets/" + put_asset(body)}) {
    const std::string head = "GET " + target + " HTTP/1.1\r\nHost: localhost\r\n";
    const TimeUs began_us = steady_now_us();
    std::vector<std::unique_ptr<Wire>> wires;
    for (int i = 0; i < 4; ++i) {
      wires.push_back(std::make_unique<Wire>(port_));
      for (int j = 1; j < 50; ++j) wires.back()->write(head + "\r\n");
      wires.back()->write(head + "Connection: close\r\n\r\n");
    }
    for (const auto& wire : wires) EXPECT_GT(wire->read_all().value_or("reset").size(), 50 * body.size()) << target;
    EXPECT_GE(steady_now_us() - began_us, 4 * 50 * (1 << 20) / 2000 * 2 - 10'000) << target;
  }
}

TEST_F(HttpSessionTest, DownloadsThatAreNotReadAreChargedAndEndWithAReset) {
  stop();
  config_.assets.max_object_bytes = 16 << 20;
  config_.per_address.unfinished_bytes = 2 << 20;
  config_.timeouts.transfer_ms = 1'000;
  start();
  const std::string ask =
      "GET /v1/assets/" + put_asset(std::string(16 << 20, 'x')) + " HTTP/1.1\r\nHost: localhost\r\n";
  std::vector<std::unique_ptr<Wire>> unread;
  for (int i = 0; i < 20; ++i) {
    unread.push_back(std::make_unique<Wire>(port_));
    unread.back()->write(ask + "\r\n");
  }
  Wire more(port_);
  more.write(ask + "Connection: close\r\n\r\n");
  EXPECT_THAT(more.read_all().value_or("reset"), AllOf(StartsWith("HTTP/1.1 429"), HasSubstr("unfinished_bytes")));
  const auto under_way = [&] {
    return http_request(admin_port_, "GET", "/metrics").body.find("\neigencast_broker_downloads 0\n") ==
           std::string::npos;
  };
  while (under_way()) std::this_thread::sleep_for(std::chrono::milliseconds(20));
  EXPECT_EQ(unread.front()->read_all(), std::nullopt) << "the kernel keeps nothing for it";
}

TEST(HttpConnection, AnswersThatNobodyTakesAreAskedForEverMoreRarely) {
  EXPECT_EQ(next_settle_us(0), 100'000) << "soon, for who takes it";
  int asked = 0;
  TimeUs wait_us = 0;
  for (TimeUs now_us = 0; now_us <= 30'000'000; now_us += wait_us) {
    wait_us = next_settle_us(wait_us);
    EXPECT_LE(wait_us, 2'000'000);
    ++asked;
  }
  EXPECT_LE(asked, 20) << "in 30 s";
}

// The kernel says for ever that they are unacknowledged.
TEST_F(HttpSessionTest, WhoResetsWithoutTakingAnAnswerHoldsNothing) {
  stop();
  config_.timeouts.transfer_ms = 3'600'000;
  start();
  const std::string target = "/v1/assets/" + put_asset(std::string(100'000, 'x'));
  const std::string ask = "GET " + target + " HTTP/1.1\r\nHost: localhost\r\n\r\n";
  const auto until_none = [&](const std::string& gauge) {
    const std::string none = "\neigencast_broker_" + gauge + " 0\n";
    while (http_request(admin_port_, "GET", "/metrics").body.find(none) == std::string::npos)
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
  };
  for (int i = 0; i < 8; ++i) {
    auto wire = std::make_unique<Wire>(port_, 4096);
    wire->write(ask);
    wire->end_writing();
    until_none("downloads");
    wire.reset();
  }
  until_none("connections");
}

TEST_F(HttpSessionTest, AConnectionIsNoWebSocketBeforeItsAnswersAreRead) {
  const std::string asset = "/v1/assets/" + put_asset(std::string(100'000, 'x'));
  Wire wire(port_, 4096);
  wire.write("GET " + asset + " HTTP/1.1\r\nHost: localhost\r\n\r\n");
  wire.write(
      "GET /v1/subscribe HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade, close\r\nUpgrade: websocket\r\n"
      "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
      "Sec-WebSocket-Protocol: " +
      std::string(control::kSubprotocol) + "\r\n\r\n");
  const std::string all = wire.read_all().value_or("reset");
  EXPECT_THAT(all, HasSubstr("HTTP/1.1 429"));
  EXPECT_THAT(all, Not(HasSubstr("HTTP/1.1 101")));
}

/// Of many networks of a site, as each may fail some times a minute.
TEST_F(HttpSessionTest, ChecksOfTokensTakeHalfOfTheLoopsTime) {
  stop();
  config_.access.jwt_secret = "a secret of the tests, of more than 32 bytes";
  config_.access.anonymous = "anywhere";
  config_.proxy.trusted = {"127.0.0.1"};
  config_.per_address.work_us_per_s = 1'000'000'000;
  start();
  constexpr int kTokens = 500;
  const TimeUs began_us = steady_now_us();
  std::vector<std::unique_ptr<Wire>> wires;
  for (int i = 0; i < 10; ++i) {
    std::string requests;
    for (int j = i * kTokens / 10; j < (i + 1) * kTokens / 10; ++j) {
      requests += "GET /v1/streams HTTP/1.1\r\nHost: localhost\r\nX-Forwarded-For: 2001:db8:1:" + std::to_string(j) +
                  "::1\r\nAuthorization: Bearer a.b.c\r\n\r\n";
    }
    wires.push_back(std::make_unique<Wire>(port_));
    wires.back()->write(requests + "OPTIONS / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
  }
  for (const auto& wire : wires) EXPECT_THAT(wire->read_all().value_or("reset"), StartsWith("HTTP/1.1 401"));
  EXPECT_GE(steady_now_us() - began_us, kTokens * 200 * 2 - 10'000);
}

TEST_F(HttpSessionTest, FilesOfAFolderThatHaveNotChangedAreNotReadAgain) {
  stop();
  config_.web.enabled = true;
  config_.web.folder = folder_ + "/page";
  std::filesystem::create_directories(config_.web.folder);
  const std::string path = config_.web.folder + "/a.js";
  const auto write = [&](const char* text) { std::ofstream(path) << text; };
  const auto get = [&](const std::string& known) {
    Wire wire(port_);
    wire.write("GET /v1/web/a.js HTTP/1.1\r\nHost: localhost\r\nIf-None-Match: " + known +
               "\r\nConnection: close\r\n\r\n");
    return wire.read_all().value_or("reset");
  };
  write("one");
  start();
  const std::string etag = request("GET", "/v1/web/a.js").headers.at("ETag");
  EXPECT_THAT(get("\"another\""), AllOf(StartsWith("HTTP/1.1 200"), HasSubstr("one")));
  EXPECT_THAT(get(etag), StartsWith("HTTP/1.1 304"));
  const auto changed = std::filesystem::last_write_time(path);
  write("two");
  std::filesystem::last_write_time(path, changed);
  EXPECT_THAT(get(etag), StartsWith("HTTP/1.1 304")) << "as if nothing had changed";
  std::filesystem::last_write_time(path, changed + std::chrono::seconds(1));
  EXPECT_THAT(get(etag), AllOf(StartsWith("HTTP/1.1 200"), HasSubstr("two")));
  write("three");
  std::filesystem::last_write_time(path, changed);
  EXPECT_THAT(get(etag), AllOf(StartsWith("HTTP/1.1 200"), HasSubstr("three")));
}

TEST_F(HttpSessionTest, UnreadBodyIsNotTheNextRequest) {
  const std::string id = put_asset("0123456789");
  const std::string inner = "GET /v1/streams HTTP/1.1\r\nHost: localhost\r\n\r\n";
  for (const std::string& target : {"/v1/assets/" + id, std::string("/v1/streams"), std::string("/v1/nothing")}) {
    Wire wire(port_);
    wire.write("GET " + target + " HTTP/1.1\r\nHost: localhost\r\nContent-Length: " + std::to_string(inner.size()) +
               "\r\n\r\n" + inner);
    const auto answers = wire.read_all();
    ASSERT_TRUE(answers) << target;
    EXPECT_EQ(answers->find("HTTP/1.1 "), answers->rfind("HTTP/1.1 ")) << *answers;
    EXPECT_THAT(*answers, HasSubstr("Connection: close")) << target;
  }
}

TEST_F(HttpSessionTest, UnknownTransferCodingIsNotImplemented) {
  const std::string inner = "GET /v1/streams HTTP/1.1\r\nHost: localhost\r\n\r\n";
  for (const std::string coding : {"gzip", "identity", "xchunked", "chunked, gzip", "gzip, chunked", "",
                                   "chunked\r\nTransfer-Encoding: gzip", "gzip\r\nContent-Length: 5"}) {
    for (const std::uint16_t port : {port_, admin_port_}) {
      Wire wire(port);
      wire.write("GET /v1/streams HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: " + coding + "\r\n\r\n" + inner);
      const std::string answers = wire.read_all().value_or("reset");
      EXPECT_THAT(answers, AnyOf(StartsWith("HTTP/1.1 501"), StartsWith("HTTP/1.1 400"))) << coding;
      EXPECT_EQ(answers.rfind("HTTP/1.1 "), 0u) << "the rest is not a request: " << answers;
      EXPECT_THAT(answers, HasSubstr("Connection: close")) << coding;
    }
  }
  Wire gzip(port_);
  gzip.write("PUT /v1/assets/" + std::string(64, 'a') +
             " HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: gzip\r\n\r\nx");
  EXPECT_THAT(gzip.read_all().value_or("reset"), StartsWith("HTTP/1.1 501"));
  Wire old(port_);
  old.write("GET /v1/streams HTTP/1.0\r\nConnection: keep-alive\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n" +
            inner);
  const std::string answers = old.read_all().value_or("reset");
  EXPECT_EQ(answers.rfind("HTTP/1.1 "), 0u) << answers;
}

TEST_F(HttpSessionTest, SlowHeadTimesOut) {
  stop();
  config_.timeouts.header_ms = 300;
  start();
  Wire wire(port_);
  wire.write("GET /v1/str");
  EXPECT_EQ(wire.read_all().value_or(""), "");
}

TEST_F(HttpSessionTest, AdminPortReportsBadRequests) {
  const std::string much(60'000, 'x');
  for (const std::string& body : {std::string(), std::string("stream=lab/horse"), much}) {
    const Answer answer = http_request(admin_port_, "POST", "/api/recordings/start", body);
    EXPECT_EQ(answer.status, 400) << body.size();
    EXPECT_THAT(answer.body, HasSubstr("?stream=NAME")) << body.size();
  }
  EXPECT_EQ(http_request(admin_port_, "POST", "/api/drain", much + much).status, 413);
  EXPECT_EQ(http_request(admin_port_, "DELETE", "/api/clients").status, 405);
  EXPECT_THAT(http_request(admin_port_, "GET", "/nothing").body, HasSubstr("\"error\":\"not-found\""));
  Wire wire(admin_port_);
  wire.write("what?\r\n\r\n");
  EXPECT_THAT(wire.read_all().value_or(""), HasSubstr("HTTP/1.1 400"));
}

}  // namespace
}  // namespace eigencast::broker
