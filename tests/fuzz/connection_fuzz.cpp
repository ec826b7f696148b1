// SPDX-License-Identifier: MIT
//
// A session of up to four connections with the broker behind its port: HTTP, upgrades, frames, control messages and
// assets, in one event loop that is stepped here. Only accepting is left out. The input is a script of operations: what
// each peer sends, in what pieces, who reads, who closes, and how time passes; this file masks frames and makes valid
// requests and keys, so that the script gets far, and sends raw bytes where the script says so. The peers' sockets are
// pairs of the kernel's (AF_UNIX), and clock and addresses are made here: nothing depends on the machine.
//
// Beyond not crashing: whatever the broker writes is an HTTP answer or a valid frame of the protocol, nothing follows a
// close frame, frames are of the epoch that was announced last, memory is bounded, and after the session no connection,
// stream or count is left.
#include <malloc.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <boost/asio/detail/scheduler.hpp>
#include <boost/asio/thread_pool.hpp>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "broker/access/gate.h"
#include "broker/connections/connection.h"
#include "broker/http/http_session.h"
#include "broker/loops/loops.h"
#include "broker/relay/ownership.h"
#include "broker/sockets/disk_threads.h"
#include "broker/storage/asset_store.h"
#include "broker/storage/history.h"
#include "broker/storage/recorder.h"
#include "broker/websocket/protocol.h"
#include "common/core/bytes.h"
#include "common/core/text.h"
#include "common/wire/control.h"
#include "common/wire/envelope.h"
#include "common/wire/limits.h"
#include "tests/unit/broker/support.h"

using namespace eigencast;
using namespace eigencast::broker;

namespace {

constexpr std::size_t kPeers = 4;
constexpr int kMaxOperations = 48;
constexpr std::size_t kMaxSessionBytes = std::size_t{24} << 20;  ///< Heap that one session may hold at a time.
constexpr std::size_t kMaxKeptBytes = std::size_t{64} << 20;     ///< Heap that all sessions may leave behind.
constexpr std::int64_t kSecondUs = 1'000'000;

#define REQUIRE(condition)                                                          \
  do {                                                                              \
    if (!(condition)) {                                                             \
      std::fprintf(stderr, "%s:%d: %s is false\n", __FILE__, __LINE__, #condition); \
      std::abort();                                                                 \
    }                                                                               \
  } while (false)

// The steady clock of this thread, and the addresses at the other ends of sockets.
thread_local bool clock_is_stepped = false;
std::int64_t stepped_us = 1'000'000 * kSecondUs;
constexpr std::size_t kMaxSockets = 1024;
std::array<std::uint32_t, kMaxSockets> address_of_peer{};

}  // namespace

extern "C" __attribute__((weak)) std::size_t __sanitizer_get_current_allocated_bytes();

// Instead of libc's, which the sanitizers' own calls reach as well.
extern "C" int clock_gettime(clockid_t clock, timespec* out) noexcept {
  if (clock != CLOCK_MONOTONIC || !clock_is_stepped) {
    return static_cast<int>(::syscall(SYS_clock_gettime, clock, out));
  }
  *out = {stepped_us / kSecondUs, stepped_us % kSecondUs * 1000};
  return 0;
}

// The kernel's timers know nothing of that clock. Without them Asio looks at its own whenever it looks at sockets.
extern "C" int timerfd_create(int, int) noexcept {
  errno = ENOSYS;
  return -1;
}

extern "C" int getpeername(int socket, sockaddr* address, socklen_t* size) noexcept {
  sockaddr_in peer{};
  if (socket < 0 || static_cast<std::size_t>(socket) >= kMaxSockets || *size < sizeof peer) return -1;
  peer.sin_family = AF_INET;
  peer.sin_addr.s_addr = htonl(address_of_peer[static_cast<std::size_t>(socket)]);
  std::memcpy(address, &peer, sizeof peer);
  *size = sizeof peer;
  return 0;
}

namespace {

std::size_t heap_bytes() {
  return __sanitizer_get_current_allocated_bytes != nullptr ? __sanitizer_get_current_allocated_bytes()
                                                            : ::mallinfo2().uordblks;
}

/// Checks what the broker writes to one peer.
class Output {
 public:
  void take(std::string_view bytes) {
    text_ += bytes;
    while (upgraded_ ? take_frame() : take_answer()) continue;
  }
  bool is_upgraded() const { return upgraded_; }
  const std::string& last_ping() const { return ping_; }
  std::uint8_t tag() const { return tag_; }  ///< Of the sender's epoch.
  std::uint32_t stream_id() const { return newest_.empty() ? 0 : newest_.begin()->first; }
  std::uint64_t sequence() const { return sequence_; }

 private:
  bool take_answer() {
    const std::size_t end = text_.find("\r\n\r\n");
    REQUIRE(end != std::string::npos || text_.size() < 16'384);
    if (end == std::string::npos) return false;
    const std::string_view head = std::string_view(text_).substr(0, end);
    const auto lines = split(head, '\n');
    REQUIRE(head.starts_with("HTTP/1.1 ") || head.starts_with("HTTP/1.0 "));
    const int status = std::atoi(text_.c_str() + 9);
    REQUIRE(status >= 100 && status <= 599);
    std::size_t length = 0;
    bool is_json = false;
    for (std::size_t i = 1; i < lines.size(); ++i) {
      const std::string_view line = trimmed(lines[i]);
      REQUIRE(line.find(": ") != std::string_view::npos);
      for (const char c : line) REQUIRE((static_cast<unsigned char>(c) >= 0x20 || c == '\t') && c != 0x7f);
      if (line.starts_with("Content-Length: ")) length = static_cast<std::size_t>(std::atoll(line.data() + 16));
      is_json = is_json || line == "Content-Type: application/json";
    }
    const std::string_view rest = std::string_view(text_).substr(end + 4);
    if (status == 101) {
      REQUIRE(head.find("\r\nSec-WebSocket-Accept: ") != std::string_view::npos);
      upgraded_ = true;
    } else if (length > 0 && !rest.starts_with("HTTP/1.1 ")) {  // Else the request was a HEAD.
      if (rest.size() < length) return false;
      if (is_json) REQUIRE(nlohmann::json::accept(rest.substr(0, length)));
    } else {
      length = 0;
    }
    text_.erase(0, end + 4 + (status == 101 ? 0 : length));
    return true;
  }

  bool take_frame() {
    REQUIRE(!closed_ || text_.empty());  // Nothing after a close frame.
    if (text_.size() < 2) return false;
    const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(text_[i]); };
    REQUIRE((byte(0) & 0xf0) == 0x80 && byte(1) < 128);  // Whole messages, no reserved bits, no mask.
    std::size_t head = 2, size = byte(1);
    if (size >= 126) {
      const std::size_t count = size == 126 ? 2 : 8;
      if (text_.size() < 2 + count) return false;
      size = 0;
      for (std::size_t i = 0; i < count; ++i) size = size << 8 | byte(2 + i);
      REQUIRE(count == 2 ? size >= 126 : size >= 65'536);
      head += count;
    }
    REQUIRE(size <= limits::kMaxFrameBytes);
    if (text_.size() < head + size) return false;
    take_message(static_cast<websocket::Opcode>(byte(0) & 0x0f), std::string_view(text_).substr(head, size));
    text_.erase(0, head + size);
    return true;
  }

  void take_message(websocket::Opcode opcode, std::string_view payload) {
    using websocket::Opcode;
    if (opcode == Opcode::kText) return take_control(payload);
    if (opcode == Opcode::kBinary) return take_pose(payload);
    REQUIRE(payload.size() <= websocket::kMaxControlBytes);
    REQUIRE(opcode == Opcode::kClose || opcode == Opcode::kPing || opcode == Opcode::kPong);
    if (opcode == Opcode::kPing) ping_ = payload;
    if (opcode != Opcode::kClose) return;
    closed_ = true;
    REQUIRE(payload.size() != 1);
    if (payload.empty()) return;
    const auto code = static_cast<unsigned char>(payload[0]) << 8 | static_cast<unsigned char>(payload[1]);
    REQUIRE(websocket::is_valid_close_code(static_cast<std::uint16_t>(code)));
    websocket::Utf8Check check;
    const std::string_view reason = payload.substr(2);
    REQUIRE(check.add({reinterpret_cast<const std::uint8_t*>(reason.data()), reason.size()}) && check.is_whole());
  }

  void take_control(std::string_view text) {
    const auto message = control_from_text(text);
    REQUIRE(message.has_value());
    REQUIRE(std::holds_alternative<control::Welcome>(*message) == !std::exchange(welcomed_, true));
    if (const auto* announced = std::get_if<control::Announced>(&*message)) tag_ = announced->tag;
    if (const auto* info = std::get_if<control::StreamInfo>(&*message)) {
      auto& epoch = newest_[info->stream_id];
      if (info->state != control::StreamInfo::State::kWaiting) {
        REQUIRE(info->epoch >= epoch);
        epoch = info->epoch;
      }
      readers_[info->stream_id].begin(info->stream_id, info->tag, info->epoch);
    }
  }

  void take_pose(std::string_view bytes) {
    const auto frame = parse_frame({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()});
    REQUIRE(frame.has_value());
    const auto stream = readers_.find(frame->envelope.stream_id);
    REQUIRE(stream != readers_.end());
    const auto whole = stream->second.read(*frame);  // A viewer gets no frame that it cannot use.
    REQUIRE(whole.has_value());
    sequence_ = whole->envelope.sequence;
  }

  std::string text_;
  bool upgraded_ = false, welcomed_ = false, closed_ = false;
  std::map<std::uint32_t, std::uint32_t> newest_;  ///< Epochs by stream.
  std::map<std::uint32_t, EnvelopeReader> readers_;
  std::uint64_t sequence_ = 0;
  std::uint8_t tag_ = 0;
  std::string ping_;
};

Config make_config() {
  Config config;
  config.access.anonymous = "anywhere";
  config.access.anonymous_subscribe = {"**"};
  config.access.jwt_secret = "0123456789abcdef0123456789abcdef";
  config.proxy.trusted = {"10.0.0.3"};
  config.per_address.connections = 6;
  config.per_address.streams = 8;
  config.per_address.sent_streams = 2;
  config.per_address.waiting_streams = 3;
  config.per_address.messages_per_s = 200;
  config.per_address.requests_per_s = 40;
  config.limits.max_streams = 3;
  config.limits.max_waiting_streams = 4;
  config.limits.max_profiles_per_stream = 3;
  config.limits.max_subscribers_per_stream = 3;
  config.limits.max_streams_per_connection = 3;
  config.limits.max_frame_bytes = 4096;
  config.limits.max_control_bytes = 2048;
  config.limits.max_queued_control_messages = 16;
  config.limits.max_queued_control_bytes = 65'536;
  config.limits.control_messages_per_s = 400;
  config.limits.requests_per_s = 20;
  config.assets.max_object_bytes = 8192;
  config.assets.max_total_bytes = 64 * 1024;
  config.assets.max_objects = 8;
  config.streams.second_sender = "replace";
  config.sockets.writes = "epoll";
  config.sockets.send_buffer_bytes = 4096;
  return config;
}

const Config& config() {
  static const Config made = make_config();
  return made;
}

/// The broker behind its port, for all sessions of this process.
class Service {
 public:
  Service()
      : folder_(make_folder()),
        policy_(AccessPolicy::from_config(config()).value()),
        gate_(policy_),
        assets_(AssetStore::open(folder_, asset_settings()).value()),
        recorder_({.folder = folder_ + "/recordings",
                   .software = "fuzz",
                   .streams = StreamPatterns::from({}).value(),
                   .include_asset = false},
                  *assets_, {}),
        history_({.folder = folder_ + "/history", .software = "fuzz", .streams = {}}, *assets_, {}),
        ownership_([this]() -> Result<std::uint32_t> { return ++epoch_; }),
        disk_(0),
        loops_(config(),
               {disk_, disk_, disk_, gate_, *assets_, recorder_, history_, ownership_, nullptr, {}, "fuzz", "session"},
               {assets_.get(), &recorder_}) {
    std::signal(SIGPIPE, SIG_IGN);
    clock_is_stepped = true;
    loops_.first().begin();
    asset_ = store({reinterpret_cast<const std::uint8_t*>(kAsset.data()), kAsset.size()});
    segment_ = store(*broker::testing::segment_of(0, 10, Sha256::from_hex(asset_)->digest).coded);
  }
  ~Service() { std::filesystem::remove_all(folder_); }

  Context& context() { return loops_.first().context(); }
  Hub& hub() { return loops_.first().hub(); }
  Gate& gate() { return gate_; }

  /// Runs everything that can run now.
  void run() {
    auto& disk = asio::use_service<asio::detail::scheduler>(disk_.pool());
    ErrorOf ignored;
    do {
      loops_.first().io().poll();  // Returns when nothing is ready.
    } while (disk.poll(ignored) > 0);
  }
  void pass(TimeUs us) {
    stepped_us += us;
    run();
  }
  /// Puts other rules in force, as a reload does.
  void reload(bool anonymous) {
    Config other = config();
    if (!anonymous) other.access.anonymous_publish.clear();
    gate_.replace_policy(AccessPolicy::from_config(other).value());
  }
  void restore_policy() {
    if (gate_.policy() != policy_) gate_.replace_policy(policy_);
  }
  const std::string& asset() const { return asset_; }
  const std::string& segment() const { return segment_; }  ///< Of a memory of poses of that asset.

  static constexpr std::string_view kAsset = "a surface";

 private:
  static std::string make_folder() {
    const bool has_memory = std::filesystem::is_directory("/dev/shm");
    std::string name = (has_memory ? "/dev/shm" : std::filesystem::temp_directory_path().string()) + "/fuzzXXXXXX";
    REQUIRE(::mkdtemp(name.data()) != nullptr);
    return name;
  }
  static AssetStore::Settings asset_settings() {
    AssetStore::Settings settings;
    settings.max_object_bytes = static_cast<std::uint64_t>(config().assets.max_object_bytes);
    settings.max_total_bytes = static_cast<std::uint64_t>(config().assets.max_total_bytes);
    settings.max_objects = static_cast<std::uint64_t>(config().assets.max_objects);
    return settings;
  }
  /// Its name.
  std::string store(ByteView bytes) {
    const Sha256 id = sha256(bytes);
    auto upload = assets_->begin_upload(id);
    REQUIRE(upload && (*upload)->write(bytes) && (*upload)->commit());
    return id.hex();
  }

  const std::string folder_;
  std::string asset_, segment_;
  std::uint32_t epoch_ = 0;
  std::shared_ptr<const AccessPolicy> policy_;
  Gate gate_;
  std::unique_ptr<AssetStore> assets_;
  Recorder recorder_;
  History history_;
  SoleOwnership ownership_;
  DiskThreads disk_;  ///< Without threads: run() does its work.
  Loops loops_;
};

Service& service() {
  static auto* const made = new Service;
  static const bool removed = std::atexit([] { delete made; }) == 0;
  (void)removed;
  return *made;
}

/// Requests that get somewhere.
const std::vector<std::string>& requests() {
  static const std::vector<std::string> all = [] {
    const std::string upgrade =
        " HTTP/1.1\r\nHost: broker\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: eigencast.v2\r\n";
    const std::string plain = " HTTP/1.1\r\nHost: broker\r\n", end = "\r\n";
    const std::string asset = "/v1/assets/" + service().asset();
    const TokenKey key = TokenKey::from_secret({}, config().access.jwt_secret).value();
    const std::string token = create_token({.subject = "camera",
                                            .audience = "eigencast",
                                            .issuer = {},
                                            .publish = {"a"},
                                            .subscribe = {"**"},
                                            .admin = false,
                                            .issued_s = 1,
                                            .expires_s = 4'000'000'000},
                                           key)
                                  .value();
    const std::string size = std::to_string(Service::kAsset.size());
    const std::string content(Service::kAsset);
    return std::vector<std::string>{
        "GET /v1/publish/a" + upgrade + end,
        "GET /v1/publish/b" + upgrade + end,
        "GET /v1/subscribe/a?rate=raw" + upgrade + end,
        "GET /v1/subscribe/a?rate=interpolated&k=3" + upgrade + end,
        "GET /v1/subscribe/b?rate=interpolated&k=2&scheme=catmull-rom&bands=1" + upgrade + end,
        "GET /v1/subscribe/a?rate=estimated&k=2" + upgrade + end,
        "GET /v1/subscribe" + upgrade + end,
        "GET /v1/publish/a?access_token=" + token + upgrade + end,
        "GET /v1/subscribe/a" + upgrade + "Authorization: Bearer " + token + "\r\n" + end,
        "GET /v1/streams" + plain + end,
        "HEAD /v1/streams" + plain + end,
        "GET /a/b?embed=1" + plain + "Accept: text/html, */*;q=0.8\r\nX-Forwarded-Host: a;b\r\n" + end,
        "GET /" + plain + "Accept: application/json;q=0.5, text/*;q=0.1\r\n" + end,
        "GET /v1/web/page.js" + plain + "Accept-Encoding: gzip, br;q=0.5, *;q=0\r\nIf-None-Match: W/\"x\"\r\n" + end,
        "GET " + asset + plain + end,
        "GET " + asset + plain + "Range: bytes=2-5\r\nIf-None-Match: \"x\"\r\n" + end,
        "PUT " + asset + plain + "Content-Length: " + size + "\r\n" + end + content,
        "PUT " + asset + plain + "Transfer-Encoding: chunked\r\nExpect: 100-continue\r\n" + end + "9\r\n" + content +
            "\r\n0\r\n" + end,
        "PUT /v1/assets/" + std::string(64, 'b') + plain + "Content-Length: 100\r\n" + end + "half of it",
        "OPTIONS /v1/streams" + plain + "Origin: https://example.org\r\n" + end,
        "GET /v1/subscribe/a" + plain + "Connection: close\r\n" + end,
        "GET /v1/subscribe/a" + upgrade + "X-Forwarded-For: 192.0.2.7, 10.0.0.3\r\n" + end,
        "GET /v1/publish/a" + upgrade + "Origin: https://example.org\r\n" + end,
    };
  }();
  return all;
}

/// Control messages that get somewhere.
const std::vector<std::string>& messages() {
  static const std::vector<std::string> all = [] {
    control::Announce announce = broker::testing::small_announce();
    announce.asset = service().asset();
    const std::string small = text_from_control(announce);
    announce.format = {64, 3, {16, 64}, "float32"};
    const std::string floats = text_from_control(announce);
    announce.format = {8, 6, {4, 8}, "quantised", 3, 1'000'000};
    const std::string moving = text_from_control(announce);
    announce.format = {4096, 8, {4096}, "float64"};
    const std::string large = text_from_control(announce);
    const Profile raw{Profile::Rate::kRaw}, full{},
        hermite{Profile::Rate::kInterpolated, 2, 1, Profile::Scheme::kHermite};
    std::vector<std::string> texts{small, floats, moving, large};
    for (const ControlMessage& message : std::vector<ControlMessage>{
             control::Subscribe{"a", raw}, control::Subscribe{"a", full}, control::Subscribe{"b", hermite},
             control::Subscribe{"c/d", full}, control::Unsubscribe{"a"}, control::Unsubscribe{"b"},
             control::TraceRequest{"a", 1}, control::TraceRequest{"a", 0}, control::Ping{7, 1}, control::Pong{7, 1, 2},
             control::Trace{1, 1, {{"started", 1}, {"sent", 5}}, 1, 0, {}}, control::Bye{"enough", 0}}) {
      texts.push_back(text_from_control(message));
    }
    texts.push_back(R"({"op":"unknown"})");
    announce = broker::testing::small_announce();
    announce.asset = service().asset();
    announce.continues = true;
    for (const ControlMessage& message : std::vector<ControlMessage>{
             announce, control::Prepared{"a", announce.asset}, control::Progress{"a", 0.5},
             control::Remember{"a", 1, 0, {service().segment()}}, control::Remember{"a", 2, 1, {}},
             control::Remember{"a", 3, 0, {}}, control::Ack{{{1, 1, 0, 1}}, 1}, control::Ack{{{1, 1, 0, 2}}, 1}}) {
      texts.push_back(text_from_control(message));
    }
    return texts;
  }();
  return all;
}

struct Peer {
  int socket = -1;
  bool reads = true;
  Output output;
  testing::FakeSender sender;
  std::string sent;  ///< By the last operation.
};

class Session {
 public:
  Session(const std::uint8_t* data, std::size_t size) : in_(ByteView(data, size)), heap_before_(heap_bytes()) {}

  void run() {
    pieces_ = in_.u8();
    for (int i = 0; i < kMaxOperations && in_.remaining() > 0; ++i) {
      const std::uint8_t what = in_.u8();
      operate(what & 15, peers_[what >> 4 & 3], what >> 4 & 3, what >> 6);
      settle();
    }
    end();
  }

 private:
  std::string text(std::size_t most) {
    const ByteView bytes = in_.bytes(std::min<std::size_t>(most, in_.remaining()));
    return {bytes.begin(), bytes.end()};
  }

  void operate(int what, Peer& peer, int number, int how) {
    switch (what) {
      case 0:
        return send(peer, number, text(in_.u8()));
      case 1:
        return send(peer, number, requests()[in_.u8() % requests().size()]);
      case 2:
        return send_request(peer, number);
      case 3: {
        const std::uint8_t head = in_.u8();
        return send(peer, number, frame(head, text(in_.u8())));
      }
      case 4:
        return send(peer, number, frame(0x81, message()));
      case 5: {
        std::string changed = message();
        const std::size_t at = in_.u8() % (changed.size() + 1);
        changed.replace(at, how, text(in_.u8() % 16));
        return send(peer, number, frame(0x81, changed));
      }
      case 6:
        return send_key(peer, number, how);
      case 7: {
        constexpr std::array<TimeUs, 8> kPasses{1'000,         10'000,        33'333,         200'000,
                                                1 * kSecondUs, 3 * kSecondUs, 16 * kSecondUs, 40 * kSecondUs};
        return service().pass(kPasses[in_.u8() % kPasses.size()]);
      }
      case 8:
        peer.reads = how != 0;
        return;
      case 9:
        return how == 0 && peer.socket >= 0 ? void(::shutdown(peer.socket, SHUT_WR)) : close(peer);
      case 10:
        return send(peer, number, frame(how == 0 ? 0x8a : 0x89, how == 0 ? peer.output.last_ping() : text(how)));
      case 11: {
        const std::string whole = message();
        const std::size_t at = in_.u8() % (whole.size() + 1);
        return send(peer, number, frame(0x01, whole.substr(0, at)) + frame(0x80, whole.substr(at)));
      }
      case 12:
        return administer(how);
      case 13: {
        const control::Ack ack{{{peer.output.stream_id(), peer.output.sequence(), 0}}, stepped_us};
        return send(peer, number, frame(0x81, text_from_control(ack)));
      }
      case 14: {  // A head that claims more than comes.
        std::string head =
            frame(static_cast<std::uint8_t>(how == 0 ? 0x82 : 0x81), std::string(how == 3 ? 65'536 : 126, ' '));
        head.resize(in_.u8());
        return send(peer, number, head);
      }
      default: {  // What the peer sent last, many times; floods of floods would take most of the time.
        const std::string once = peer.sent;
        const bool has_frames = peer.socket >= 0 && peer.output.is_upgraded();
        std::string flood;
        for (int i = 0; i < (has_frames ? 1 << (2 * how) : 1 + how); ++i) flood += once;
        send(peer, number, flood);
        peer.sent = once;
      }
    }
  }

  std::string message() { return messages()[in_.u8() % messages().size()]; }

  /// `head` is the frame's first byte; the rest is as RFC 6455 wants it of clients.
  std::string frame(std::uint8_t head, std::string payload) {
    Bytes bytes;
    websocket::append_header(static_cast<websocket::Opcode>(0), payload.size(), bytes);
    bytes[0] = head;
    bytes[1] |= 0x80;
    const std::array<std::uint8_t, 4> mask{head, 0x5a, 0, static_cast<std::uint8_t>(payload.size())};
    std::string text(bytes.begin(), bytes.end());
    text.append(mask.begin(), mask.end());
    for (std::size_t i = 0; i < payload.size(); ++i) payload[i] = static_cast<char>(payload[i] ^ mask[i % 4]);
    return text + payload;
  }

  void send_request(Peer& peer, int number) {
    std::string request = requests()[in_.u8() % requests().size()];
    const std::size_t at = in_.u8() * 2 % (request.size() + 1);
    request.replace(at, in_.u8() % 32, text(in_.u8()));
    send(peer, number, request);
  }

  void send_key(Peer& peer, int number, int how) {
    if (how == 1) peer.sender.begin_anew();
    peer.sender.tag = peer.output.tag();
    Bytes key = peer.sender.next(stepped_us);
    if (how == 2) key[in_.u8() % key.size()] ^= static_cast<std::uint8_t>(1 + in_.u8() % 255);
    if (how == 3) key.resize(in_.u8());
    send(peer, number, frame(0x82, {key.begin(), key.end()}));
  }

  static void administer(int how) {
    Context& context = service().context();
    std::vector<Connection*> open;
    for (const auto& [id, connection] : context.connections) open.push_back(connection);
    if (how == 0 && !open.empty()) open.front()->send_bye("kicked", 0, websocket::CloseCode::kPolicy);
    if (how == 1) service().reload(false);
    if (how == 2) service().reload(true);
    if (how == 3) {
      context.draining = true;
      for (Connection* each : open) each->send_bye("stopping", 500, websocket::CloseCode::kServiceRestart);
    }
  }

  void connect(Peer& peer, int number) {
    std::array<int, 2> ends{};
    REQUIRE(::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, ends.data()) == 0);
    REQUIRE(static_cast<std::size_t>(ends[1]) < kMaxSockets);
    // Two share an address; one is a trusted proxy; one is on this machine.
    constexpr std::array<std::uint32_t, kPeers> kAddresses{0xc000'0201, 0xc000'0201, 0x7f00'0001, 0x0a00'0003};
    address_of_peer[static_cast<std::size_t>(ends[1])] = kAddresses[static_cast<std::size_t>(number)];
    peer = Peer{};
    peer.socket = ends[0];
    Context& context = service().context();
    Socket socket(context.loop.get_executor());
    socket.assign(Tcp::v4(), ends[1]);
    serve_data(context, Transport(std::move(socket)));
  }

  /// In the pieces that the script says, the first of which the broker reads one by one.
  void send(Peer& peer, int number, const std::string& bytes) {
    if (peer.socket < 0) connect(peer, number);
    peer.sent = bytes.substr(0, 1024);
    constexpr int kMaxPieces = 2;
    std::string_view rest = bytes;
    for (int i = 0; !rest.empty(); ++i) {
      const std::size_t piece = pieces_ < 192 || i == kMaxPieces ? rest.size() : 1 + pieces_ % 64;
      if (::send(peer.socket, rest.data(), std::min(piece, rest.size()), MSG_NOSIGNAL) < 0) break;
      rest.remove_prefix(std::min(piece, rest.size()));
      if (!rest.empty()) service().run();
    }
  }

  void settle() {
    service().run();
    std::array<pollfd, kPeers> sockets{};
    for (std::size_t i = 0; i < kPeers; ++i) {
      sockets[i] = {peers_[i].reads ? peers_[i].socket : -1, POLLIN | POLLRDHUP, 0};
    }
    if (::poll(sockets.data(), sockets.size(), 0) > 0) {
      for (std::size_t i = 0; i < kPeers; ++i) {
        if (sockets[i].revents != 0) read(peers_[i], (sockets[i].revents & POLLRDHUP) != 0);
      }
    }
    REQUIRE(heap_bytes() < heap_before_ + kMaxSessionBytes);
  }

  static void read(Peer& peer, bool to_end) {
    std::array<char, 16'384> buffer;
    for (;;) {
      const ssize_t count = ::recv(peer.socket, buffer.data(), buffer.size(), MSG_DONTWAIT);
      if (count > 0) peer.output.take({buffer.data(), static_cast<std::size_t>(count)});
      if (count == 0 || (count < 0 && errno != EAGAIN && errno != EINTR)) return close(peer);
      if (count < 2048 && !(to_end && count > 0)) return;
      service().run();  // There is room for more.
    }
  }

  static void close(Peer& peer) {
    if (peer.socket >= 0) ::close(peer.socket);
    peer.socket = -1;
  }

  void end() {
    for (Peer& peer : peers_) close(peer);
    Context& context = service().context();
    service().run();
    for (int i = 0; i < 4 && context.connection_count > 0; ++i) service().pass(35 * kSecondUs);
    REQUIRE(context.connection_count == 0 && context.connections.empty());
    REQUIRE(context.counters.uploads_now == 0 && context.counters.downloads_now == 0);
    // What senders have left is held, on purpose; all else is gone.
    std::vector<std::string> held;
    for (const Stream* stream : service().hub().streams()) {
      REQUIRE(!stream->has_publisher() && stream->watchers() == 0 && stream->epoch() > 0);
      held.push_back(stream->name());
    }
    REQUIRE(held.size() <= static_cast<std::size_t>(context.config.limits.max_streams));
    for (const std::string& name : held) service().hub().drop(*service().hub().find(name));
    context.draining = false;
    service().restore_policy();
    // Rates and failed logins are whole again. Not more: std::chrono counts 292 years, for all sessions of a process.
    service().pass(60 * kSecondUs);
    REQUIRE(may_enter());
    const std::size_t heap = heap_bytes();
    REQUIRE(heap < heap_before_ + kMaxKeptBytes);
  }

  /// Whether every connection has given back what it took of its address's quota.
  static bool may_enter() {
    for (const char* address : {"192.0.2.1", "127.0.0.1", "10.0.0.3"}) {
      std::vector<GrantPtr> all;
      for (std::int64_t i = 0; i < config().per_address.connections; ++i) {
        auto accepted = service().gate().accept(IpAddress::from_text(address).value(), 0, stepped_us);
        if (std::holds_alternative<Denial>(accepted)) return false;
        all.push_back(std::get<GrantPtr>(std::move(accepted)));
      }
    }
    return true;
  }

  ByteReader in_;
  std::array<Peer, kPeers> peers_;
  std::uint8_t pieces_ = 0;
  std::size_t heap_before_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  service();
  clock_is_stepped = true;
  Session(data, size).run();
  clock_is_stepped = false;
  return 0;
}
