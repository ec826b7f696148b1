// SPDX-License-Identifier: MIT
// fanout_load SCENARIO.json: publishers and subscribers of a WebSocket relay on one thread; prints what became of every
// message, as JSON. It knows no particular relay: bench/broker/harness.py writes the scenarios. Loopback only.
//
// Each message is `frame` (hex), with a sequence number and the time when it was to leave (microseconds on the steady
// clock) written into it, both 64 bits, little-endian. Latency counts from that time, so that a publisher that is held
// up is not forgiven. Subscribers find the frame at the beginning of a message, or by its first bytes, `magic`.
#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/tcp.h>
#include <openssl/ssl.h>
#include <sys/epoll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "common/core/clock.h"
#include "common/core/histogram.h"

namespace {

using eigencast::Histogram;
using eigencast::steady_now_us;
using eigencast::TimeUs;
using nlohmann::json;

constexpr std::size_t kConnectingAtOnce = 250;
constexpr std::size_t kMaxBehind = 4 << 20;  // bytes that a publisher keeps for a relay that does not read
constexpr TimeUs kSettleUs = 300'000;
constexpr TimeUs kPollUs = 150;  // after the last event; a wake-up for each delivery would be charged to the relay
constexpr TimeUs kStaleUs = 100'000, kStaleWindowUs = 1'500'000;

std::string bytes_from_hex(const std::string& hex) {
  std::string bytes;
  for (std::size_t i = 0; i + 1 < hex.size(); i += 2)
    bytes += static_cast<char>(std::stoi(hex.substr(i, 2), nullptr, 16));
  return bytes;
}

std::vector<std::string> all_bytes_from_hex(const json& list) {
  std::vector<std::string> all;
  for (const auto& hex : list) all.push_back(bytes_from_hex(hex.get<std::string>()));
  return all;
}

/// How one side speaks to the relay. {i} in the path is the connection's number, {s} its stream's.
struct Role {
  std::string path, head;
  int opcode;
  std::vector<std::string> hello, ready;  ///< Sent after the upgrade; then seen, in this order.

  explicit Role(const json& j) : path(j.value("path", "/")), opcode(j.value("opcode", 1)) {
    for (const auto& header : j.value("headers", json::array())) head += header.get<std::string>() + "\r\n";
    hello = all_bytes_from_hex(j.value("hello", json::array()));
    ready = all_bytes_from_hex(j.value("ready", json::array()));
  }
};

struct Scenario {
  std::uint16_t port;
  int pid;  ///< Names the relay.
  bool tls, publish, several;
  std::size_t subscribers, streams;
  double rate_hz, seconds, warm_s, drain_s;
  std::string frame, magic, prefix, suffix;
  std::size_t sequence_at, time_at;
  std::size_t stalled;  ///< Subscribers that stop reading for a while.
  double stall_at_s, stall_s;
  int receive_buffer;
  Role subscriber, publisher;

  explicit Scenario(const json& j)
      : port(j.at("port").get<std::uint16_t>()),
        pid(j.at("pid").get<int>()),
        tls(j.value("tls", false)),
        publish(j.value("publish", true)),
        several(j.value("several", false)),
        subscribers(j.value("subscribers", std::size_t{100})),
        streams(j.value("streams", std::size_t{1})),
        rate_hz(j.value("rate_hz", 30.0)),
        seconds(j.value("seconds", 5.0)),
        warm_s(j.value("warm_s", 1.0)),
        drain_s(j.value("drain_s", 2.0)),
        frame(bytes_from_hex(j.at("frame").get<std::string>())),
        magic(bytes_from_hex(j.value("magic", ""))),
        prefix(bytes_from_hex(j.value("prefix", ""))),
        suffix(bytes_from_hex(j.value("suffix", ""))),
        sequence_at(j.at("sequence_at").get<std::size_t>()),
        time_at(j.at("time_at").get<std::size_t>()),
        stalled(j.value("stalled", std::size_t{0})),
        stall_at_s(j.value("stall_at_s", 1.0)),
        stall_s(j.value("stall_s", 1.0)),
        receive_buffer(j.value("receive_buffer", 0)),
        subscriber(j.value("subscriber", json::object())),
        publisher(j.value("publisher", json::object())) {}
};

std::string filled(std::string text, std::size_t number, std::size_t stream) {
  for (const auto& [key, value] : {std::pair{"{i}", number}, std::pair{"{s}", stream}}) {
    for (std::size_t at = 0; (at = text.find(key, at)) != std::string::npos;)
      text.replace(at, 3, std::to_string(value));
  }
  return text;
}

// Numbers of frames are varints of nine bytes, which begin at 2^56 (payloads.py, WIDE), so that frames have one size.
void put_number(char* to, std::uint64_t value) {
  for (int i = 0; i < 8; ++i) to[i] = static_cast<char>(0x80 | (value >> 7 * i & 0x7f));
  to[8] = static_cast<char>(1);
}
std::uint64_t number_at(const char* from) {
  std::uint64_t value = 0;
  for (int i = 0; i < 8; ++i) value |= std::uint64_t{static_cast<unsigned char>(from[i]) & 0x7fU} << 7 * i;
  return value;
}

std::string masked_frame(int opcode, std::string_view payload) {
  constexpr char kMask[] = {0x37, 0x7a, 0x21, 0x3d};
  std::string frame(1, static_cast<char>(0x80 | opcode));
  const std::size_t size = payload.size();
  frame += static_cast<char>(0x80 | (size < 126 ? size : size < 65536 ? 126 : 127));
  const int bytes = size < 126 ? 0 : size < 65536 ? 2 : 8;
  for (int i = bytes - 1; i >= 0; --i) frame += static_cast<char>(size >> (8 * i));
  frame.append(kMask, 4);
  for (std::size_t i = 0; i < size; ++i) frame += static_cast<char>(payload[i] ^ kMask[i & 3]);
  return frame;
}

/// A connection of either side: TCP, or TLS over it.
class Connection {
 public:
  ~Connection() {
    SSL_free(ssl_);
    if (fd_ >= 0) ::close(fd_);
  }

  void connect(const Scenario& scenario, SSL_CTX* tls) {
    fd_ = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    const int one = 1;
    ::setsockopt(fd_, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
    if (scenario.receive_buffer > 0)
      ::setsockopt(fd_, SOL_SOCKET, SO_RCVBUF, &scenario.receive_buffer, sizeof scenario.receive_buffer);
    const timeval patience{10, 0};
    ::setsockopt(fd_, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    const linger reset{1, 0};  // No port is left waiting.
    ::setsockopt(fd_, SOL_SOCKET, SO_LINGER, &reset, sizeof reset);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(scenario.port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (::connect(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
      throw std::runtime_error(std::string("connect: ") + std::strerror(errno));
    if (tls == nullptr) return;
    ssl_ = SSL_new(tls);
    SSL_set_fd(ssl_, fd_);
    if (SSL_connect(ssl_) != 1) throw std::runtime_error("TLS handshake failed");
  }
  void request_upgrade(const Role& role, std::size_t number, std::size_t stream) {
    write_all(
        "GET " + filled(role.path, number, stream) +
        " HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: x3JJHMbDL1EzLkh9GBhXDw==\r\n" +
        role.head + "\r\n");
  }
  void finish_upgrade(const Role& role, std::size_t number, std::size_t stream) {
    std::size_t end;
    while ((end = in_.find("\r\n\r\n")) == std::string::npos) read_blocking();
    if (!in_.starts_with("HTTP/1.1 101")) throw std::runtime_error("not upgraded: " + in_.substr(0, 200));
    in_.erase(0, end + 4);
    for (const std::string& hello : role.hello) write_all(masked_frame(role.opcode, filled(hello, number, stream)));
  }
  void wait_ready(const Role& role) {
    auto wanted = role.ready.begin();
    const auto check = [&](std::string_view message) {
      if (wanted != role.ready.end() && message.find(*wanted) != std::string_view::npos) ++wanted;
    };
    for (take_messages(check); wanted != role.ready.end(); take_messages(check)) read_blocking();
    ::fcntl(fd_, F_SETFL, ::fcntl(fd_, F_GETFL) | O_NONBLOCK);
  }

  /// Gives each message that has come to `on_message`. False: the relay has closed, or broken the protocol.
  template <typename OnMessage>
  bool read_messages(OnMessage on_message) {
    static std::vector<char> buffer(1 << 20);
    while (open_) {
      const ssize_t got = read(buffer.data(), buffer.size());
      if (got < 0 && (errno == EAGAIN || errno == EINTR)) return true;
      if (got <= 0) return open_ = false;
      in_.append(buffer.data(), static_cast<std::size_t>(got));
      take_messages(on_message);
    }
    return false;
  }
  /// Writes what fits; returns how much did.
  std::size_t write_some(std::string_view bytes) {
    const ssize_t put = ssl_ != nullptr ? SSL_write(ssl_, bytes.data(), static_cast<int>(bytes.size()))
                                        : ::send(fd_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
    return put > 0 ? static_cast<std::size_t>(put) : 0;
  }
  int fd() const { return fd_; }
  bool open() const { return open_; }

 private:
  ssize_t read(char* into, std::size_t size) {
    if (ssl_ == nullptr) return ::recv(fd_, into, size, 0);
    const int got = SSL_read(ssl_, into, static_cast<int>(size));
    if (got > 0) return got;
    const int error = SSL_get_error(ssl_, got);
    errno = EAGAIN;
    return error == SSL_ERROR_WANT_READ || error == SSL_ERROR_WANT_WRITE ? -1 : 0;
  }
  void read_blocking() {
    char part[8192];
    const ssize_t got = read(part, sizeof part);
    if (got <= 0 || !open_) throw std::runtime_error("closed, or no answer in 10 s: " + in_.substr(0, 200));
    in_.append(part, static_cast<std::size_t>(got));
  }
  void write_all(std::string_view bytes) {
    if (write_some(bytes) != bytes.size()) throw std::runtime_error("cannot write");
  }
  template <typename OnMessage>
  void take_messages(OnMessage on_message) {
    std::size_t at = 0;
    while (in_.size() - at >= 2) {
      const auto byte = [&](std::size_t i) { return static_cast<std::uint8_t>(in_[at + i]); };
      std::size_t size = byte(1), head = 2;
      if ((byte(0) & 0x70) != 0 || size > 127) {  // reserved bits; a server that masks
        open_ = false;
        return;
      }
      if (size >= 126) {
        const std::size_t extra = size == 126 ? 2 : 8;
        head += extra;
        if (in_.size() - at < head) break;
        size = 0;
        for (std::size_t i = 0; i < extra; ++i) size = size << 8 | byte(2 + i);
      }
      if (in_.size() - at < head + size) break;
      const int opcode = byte(0) & 15;
      const std::string_view payload = std::string_view(in_).substr(at + head, size);
      if (opcode == 8) open_ = false;
      if (opcode == 9) write_some(masked_frame(10, payload));
      if (opcode <= 2) on_message(payload);
      at += head + size;
    }
    in_.erase(0, at);
  }

  int fd_ = -1;
  SSL* ssl_ = nullptr;
  bool open_ = true;
  std::string in_;
};

struct Subscriber {
  Connection connection;
  std::vector<std::uint64_t> next;  ///< Sequence of each stream that is expected; 0: any.
  bool paused = false;
  TimeUs resumed_us = 0;
  std::optional<TimeUs> first_age_us;  ///< Belongs to the first message after a stall.
  std::uint64_t stale = 0;
};

struct Publisher {
  Connection connection;
  std::string out;
  std::uint64_t sequence = 0;
};

/// Processor time of a process in all its threads, seconds.
double cpu_seconds(int pid) {
  double ns = 0;
  for (const auto& task : std::filesystem::directory_iterator("/proc/" + std::to_string(pid) + "/task")) {
    double own = 0;
    if (std::ifstream(task.path() / "schedstat") >> own) ns += own;
  }
  return ns * 1e-9;
}

double resident_kb(int pid) {
  std::ifstream status("/proc/" + std::to_string(pid) + "/status");
  for (std::string word; status >> word;) {
    if (double kb = 0; word == "VmRSS:" && status >> kb) return kb;
  }
  return 0;
}

class Load {
 public:
  explicit Load(const Scenario& scenario)
      : scenario_(scenario), subscribers_(scenario.subscribers), publishers_(scenario.publish ? scenario.streams : 0) {
    if (!scenario.tls) return;
    tls_.reset(SSL_CTX_new(TLS_client_method()));
    SSL_CTX_set_mode(tls_.get(), SSL_MODE_ENABLE_PARTIAL_WRITE | SSL_MODE_ACCEPT_MOVING_WRITE_BUFFER);
  }
  ~Load() { ::close(poll_); }

  void connect() {
    start_kb_ = resident_kb(scenario_.pid);
    const TimeUs begun_us = steady_now_us();
    for (std::size_t from = 0; from < subscribers_.size(); from += kConnectingAtOnce) {
      const std::size_t to = std::min(from + kConnectingAtOnce, subscribers_.size());
      const Role& role = scenario_.subscriber;
      for (std::size_t i = from; i < to; ++i) {
        subscribers_[i].connection.connect(scenario_, tls_.get());
        subscribers_[i].connection.request_upgrade(role, i, i % scenario_.streams);
      }
      for (std::size_t i = from; i < to; ++i) subscribers_[i].connection.finish_upgrade(role, i, i % scenario_.streams);
      for (std::size_t i = from; i < to; ++i) {
        subscribers_[i].connection.wait_ready(role);
        subscribers_[i].next.resize(scenario_.several ? scenario_.streams : 1);
        watch(subscribers_[i].connection, i, 0);
      }
    }
    for (std::size_t i = 0; i < publishers_.size(); ++i) {
      Connection& connection = publishers_[i].connection;
      connection.connect(scenario_, tls_.get());
      connection.request_upgrade(scenario_.publisher, i, i);
      connection.finish_upgrade(scenario_.publisher, i, i);
      connection.wait_ready(scenario_.publisher);
      watch(connection, subscribers_.size() + i, EPOLLOUT);
    }
    connect_s_ = static_cast<double>(steady_now_us() - begun_us) * 1e-6;
    ::usleep(kSettleUs);
    idle_kb_ = peak_kb_ = resident_kb(scenario_.pid);
  }

  void run() {
    const TimeUs start_us = steady_now_us() + 50'000;
    const auto after = [](TimeUs from_us, double seconds) { return from_us + static_cast<TimeUs>(seconds * 1e6); };
    window_us_[0] = after(start_us, scenario_.warm_s);
    window_us_[1] = after(window_us_[0], scenario_.seconds);
    const TimeUs end_us = after(window_us_[1], scenario_.drain_s);
    const TimeUs stall_us[] = {after(start_us, scenario_.stall_at_s),
                               after(start_us, scenario_.stall_at_s + scenario_.stall_s)};
    // What is to be done at its time, in order.
    std::vector<std::pair<TimeUs, std::function<void()>>> plan{{window_us_[0], [this] { mark(0); }},
                                                               {window_us_[1], [this] { mark(1); }},
                                                               {stall_us[0], [this] { pause(true); }},
                                                               {stall_us[1], [this] { pause(false); }}};
    for (TimeUs at = start_us; at < end_us; at += 500'000)
      plan.emplace_back(at, [this] { peak_kb_ = std::max(peak_kb_, resident_kb(scenario_.pid)); });
    std::sort(plan.begin(), plan.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    auto next = plan.begin();
    TimeUs last_event_us = 0;
    for (TimeUs now = steady_now_us(); now < end_us; now = steady_now_us()) {
      for (; next != plan.end() && next->first <= now; ++next) next->second();
      TimeUs wake_us = std::min(publish_due(start_us, now), next != plan.end() ? next->first : end_us);
      if (now >= window_us_[1] && scenario_.publish && delivered_ >= expected_) break;
      if (now - last_event_us <= kPollUs) wake_us = 0;
      if (serve(std::max<TimeUs>(0, wake_us - now))) last_event_us = steady_now_us();
    }
  }

  json figures() const {
    const double wall_s = static_cast<double>(marks_[1].at_us - marks_[0].at_us) * 1e-6;
    const double cpu_s = marks_[1].cpu_s - marks_[0].cpu_s;
    const auto arrived = static_cast<double>(marks_[1].arrived - marks_[0].arrived);
    TimeUs stale_first_us = 0;
    std::uint64_t stale = 0, closed = 0;
    for (const Subscriber& subscriber : subscribers_) {
      stale_first_us = std::max(stale_first_us, subscriber.first_age_us.value_or(0));
      stale += subscriber.stale;
      closed += subscriber.connection.open() ? 0 : 1;
    }
    const auto ms = [&](double p) { return static_cast<double>(latency_us_.percentile(p)) * 1e-3; };
    return {
        {"expected", expected_},
        {"delivered", delivered_},
        {"loss_pct",
         expected_ > 0 ? 100 - 100.0 * static_cast<double>(delivered_) / static_cast<double>(expected_) : 0},
        {"delivered_per_s", wall_s > 0 ? arrived / wall_s : 0},
        {"p50_ms", ms(50)},
        {"p95_ms", ms(95)},
        {"p99_ms", ms(99)},
        {"max_ms", ms(100)},
        {"cpu_pct", wall_s > 0 ? 100 * cpu_s / wall_s : 0},
        {"cpu_s_per_1M", arrived > 0 ? cpu_s / arrived * 1e6 : 0},
        {"rss_conn_kb", (idle_kb_ - start_kb_) / static_cast<double>(std::max<std::size_t>(1, subscribers_.size()))},
        {"rss_idle_kb", idle_kb_},
        {"rss_peak_kb", std::max(peak_kb_, resident_kb(scenario_.pid))},
        {"send_lag_p99_ms", static_cast<double>(send_lag_us_.percentile(99)) * 1e-3},
        {"missed", missed_},
        {"out_of_order", out_of_order_},
        {"closed", closed},
        {"connect_s", connect_s_},
        {"stale_first_ms", static_cast<double>(stale_first_us) * 1e-3},
        {"stale_msgs", stale}};
  }

 private:
  void watch(const Connection& connection, std::size_t id, std::uint32_t more) {
    epoll_event event{};
    event.events = EPOLLIN | EPOLLET | EPOLLRDHUP | more;
    event.data.u64 = id;
    ::epoll_ctl(poll_, EPOLL_CTL_ADD, connection.fd(), &event);
  }

  void mark(int index) { marks_[index] = {steady_now_us(), cpu_seconds(scenario_.pid), arrived_}; }

  void pause(bool paused) {
    for (std::size_t i = 0; i < std::min(scenario_.stalled, subscribers_.size()); ++i) {
      subscribers_[i].paused = paused;
      if (paused) continue;
      subscribers_[i].resumed_us = steady_now_us();
      read(subscribers_[i]);
    }
  }

  /// Sends all that is due; returns when the next is.
  TimeUs publish_due(TimeUs start_us, TimeUs now) {
    TimeUs next_us = std::numeric_limits<TimeUs>::max();
    const double period_us = 1e6 / scenario_.rate_hz;
    for (std::size_t i = 0; i < publishers_.size(); ++i) {
      Publisher& publisher = publishers_[i];
      const double offset = static_cast<double>(i) / static_cast<double>(publishers_.size());  // Streams take turns.
      for (;; ++publisher.sequence) {
        const TimeUs due_us =
            start_us + static_cast<TimeUs>((static_cast<double>(publisher.sequence) + offset) * period_us);
        if (due_us >= window_us_[1]) break;
        if (due_us > now || publisher.out.size() > kMaxBehind) {
          next_us = std::min(next_us, std::max(due_us, now + 100));
          break;
        }
        send(publisher, i, due_us);
      }
    }
    return next_us;
  }

  void send(Publisher& publisher, std::size_t stream, TimeUs due_us) {
    std::string body = scenario_.frame;
    const std::uint64_t sequence = publisher.sequence | std::uint64_t{stream} << 48;
    put_number(&body[scenario_.sequence_at], sequence);
    put_number(&body[scenario_.time_at], static_cast<std::uint64_t>(due_us));
    publisher.out += masked_frame(2, scenario_.prefix + body + scenario_.suffix);
    flush(publisher);
    if (due_us < window_us_[0]) return;
    send_lag_us_.add(steady_now_us() - due_us);
    const std::size_t streams = scenario_.streams;
    expected_ += scenario_.several ? subscribers_.size() : (subscribers_.size() + streams - 1 - stream) / streams;
  }

  static void flush(Publisher& publisher) {
    while (!publisher.out.empty()) {
      const std::size_t put = publisher.connection.write_some(publisher.out);
      if (put == 0) return;
      publisher.out.erase(0, put);
    }
  }

  /// False: nothing happened.
  bool serve(TimeUs patience_us) {
    epoll_event events[64];
    patience_us = std::min<TimeUs>(patience_us, 500'000);
    const timespec timeout{0, patience_us * 1000};
    const int count = ::epoll_pwait2(poll_, events, 64, &timeout, nullptr);
    for (int i = 0; i < count; ++i) {
      const std::size_t id = events[i].data.u64;
      if (id < subscribers_.size()) {
        if (!subscribers_[id].paused) read(subscribers_[id]);
        continue;
      }
      Publisher& publisher = publishers_[id - subscribers_.size()];
      if (!publisher.connection.read_messages([](std::string_view) {}))
        throw std::runtime_error("the relay closed a publisher's connection");
      flush(publisher);
    }
    return count > 0;
  }

  void read(Subscriber& subscriber) {
    const TimeUs now = steady_now_us();
    subscriber.connection.read_messages([&](std::string_view message) {
      const std::string& magic = scenario_.magic;
      for (std::size_t at = 0; (at = message.find(magic, at)) != std::string_view::npos; at += scenario_.frame.size()) {
        if (message.size() - at < scenario_.frame.size()) break;
        take(subscriber, message.substr(at), now);
        if (magic.empty()) break;
      }
    });
  }

  void take(Subscriber& subscriber, std::string_view frame, TimeUs now) {
    const std::size_t wide_id = (frame[1] & 0x80) != 0 ? 1 : 0;  // The broker's id of the stream takes two bytes.
    const std::uint64_t sequence = number_at(&frame[scenario_.sequence_at + wide_id]);
    const auto due_us = static_cast<TimeUs>(number_at(&frame[scenario_.time_at + wide_id]));
    ++arrived_;
    std::uint64_t& next = subscriber.next[(sequence >> 48) % subscriber.next.size()];
    if (next != 0 && sequence < next) ++out_of_order_;
    if (next != 0 && sequence > next) missed_ += sequence - next;
    next = std::max(next, sequence + 1);
    const bool after_stall = subscriber.resumed_us != 0 && now - subscriber.resumed_us < kStaleWindowUs;
    if (after_stall) {
      if (!subscriber.first_age_us) subscriber.first_age_us = now - due_us;
      subscriber.stale += now - due_us > kStaleUs ? 1 : 0;
    }
    if (due_us < window_us_[0] || due_us >= window_us_[1]) return;
    ++delivered_;
    if (!after_stall) latency_us_.add(now - due_us);
  }

  struct Mark {
    TimeUs at_us = 0;
    double cpu_s = 0;
    std::uint64_t arrived = 0;
  };
  struct FreeContext {
    void operator()(SSL_CTX* context) const { SSL_CTX_free(context); }
  };

  const Scenario& scenario_;
  std::unique_ptr<SSL_CTX, FreeContext> tls_;
  int poll_ = ::epoll_create1(EPOLL_CLOEXEC);
  std::vector<Subscriber> subscribers_;
  std::vector<Publisher> publishers_;
  TimeUs window_us_[2] = {};  ///< Messages that were to leave within are counted.
  Mark marks_[2];
  std::uint64_t arrived_ = 0, delivered_ = 0, expected_ = 0, missed_ = 0, out_of_order_ = 0;
  double connect_s_ = 0, start_kb_ = 0, idle_kb_ = 0, peak_kb_ = 0;
  Histogram latency_us_, send_lag_us_;
};

}  // namespace

int main(int argc, char** argv) {
  try {
    std::ifstream in(argc == 2 ? argv[1] : "");
    if (!in) throw std::runtime_error("usage: fanout_load SCENARIO.json");
    const Scenario scenario(json::parse(in));
    rlimit files{};
    ::getrlimit(RLIMIT_NOFILE, &files);
    files.rlim_cur = files.rlim_max;
    ::setrlimit(RLIMIT_NOFILE, &files);
    Load load(scenario);
    load.connect();
    load.run();
    const json figures = load.figures();
    std::puts(figures.dump().c_str());
    return figures["closed"] == 0 ? 0 : 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "fanout_load: %s\n", error.what());
    return 2;
  }
}
