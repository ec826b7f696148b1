// SPDX-License-Identifier: MIT
#include "tools/latency/load.h"

#include <arpa/inet.h>
#include <netdb.h>
#include <netinet/tcp.h>
#include <sys/epoll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <optional>
#include <thread>
#include <vector>

#include "common/wire/envelope.h"
#include "common/wire/limits.h"

namespace eigencast::latency {
namespace {

constexpr std::size_t kConnectingAtOnce = 64;
constexpr TimeUs kTickUs = 10'000;
constexpr std::size_t kMaxBuffered = limits::kMaxFrameBytes + limits::kMaxControlBytes + 64;

/// A viewer's message as one masked frame. The mask is zero: it hides nothing on a link that carries no secrets.
std::string masked(std::uint8_t opcode, std::string_view payload) {
  std::string frame(1, static_cast<char>(0x80 | opcode));
  if (payload.size() < 126) {
    frame += static_cast<char>(0x80 | payload.size());
  } else {
    frame += static_cast<char>(0x80 | 126);
    frame += static_cast<char>(payload.size() >> 8);
    frame += static_cast<char>(payload.size() & 255);
  }
  frame.append(4, '\0');
  frame += payload;
  return frame;
}

struct Viewer {
  int fd = -1;
  enum class State : std::uint8_t { kConnecting, kUpgrading, kWatching, kGone } state = State::kConnecting;
  Bytes in;
  std::optional<ChainClock> newest;
  std::optional<control::Ack::Item> ack;
};

Result<void> allow_files(std::uint64_t count) {
  rlimit limit{};
  getrlimit(RLIMIT_NOFILE, &limit);
  if (limit.rlim_cur >= count) return {};
  if (limit.rlim_max < count)
    return fail(ErrorCode::kTooLarge, "so many viewers need " + std::to_string(count) +
                                          " open files, this process may have " + std::to_string(limit.rlim_max) +
                                          ": raise it with ulimit -Hn");
  limit.rlim_cur = count;
  setrlimit(RLIMIT_NOFILE, &limit);
  return {};
}

Result<sockaddr_storage> address_of(const BrokerUrl& url) {
  addrinfo hints{}, *found = nullptr;
  hints.ai_socktype = SOCK_STREAM;
  if (getaddrinfo(url.host.c_str(), std::to_string(url.port).c_str(), &hints, &found) != 0 || found == nullptr)
    return fail(ErrorCode::kUnreachable, "host \"" + url.host + "\" is not known");
  sockaddr_storage address{};
  std::memcpy(&address, found->ai_addr, found->ai_addrlen);
  freeaddrinfo(found);
  return address;
}

class LightViewers final : public Load {
 public:
  LightViewers(const Options& options, const BrokerUrl& url, const sockaddr_storage& address)
      : options_(options), address_(address), viewers_(options.viewers) {
    const std::string& token = url.credentials.token;
    request_ = "GET " + url.prefix + "/v1/subscribe/" + url.stream + "?" + query_from_profile(options.profile) +
               " HTTP/1.1\r\nHost: " + url.host + ":" + std::to_string(url.port) +
               (token.empty() ? "" : "\r\nAuthorization: Bearer " + token) +
               "\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
               "Sec-WebSocket-Key: ZWlnZW5jYXN0LWxvYWRlcg==\r\nSec-WebSocket-Protocol: eigencast.v2\r\n\r\n";
    poll_ = epoll_create1(EPOLL_CLOEXEC);
    thread_ = std::thread([this] { run(); });
  }

  ~LightViewers() override {
    end();
    for (const Viewer& viewer : viewers_)
      if (viewer.fd >= 0) ::close(viewer.fd);
    ::close(poll_);
  }

  std::uint32_t settled() const { return watching_ + gone_; }
  std::uint32_t watching() const { return watching_; }
  void begin() override { begin_ = true; }

  Figures finish() override {
    end();
    figures_.viewers = watching_;
    figures_.refused = gone_;
    return figures_;
  }

 private:
  void end() {
    stopping_ = true;
    if (thread_.joinable()) thread_.join();
  }

  void run() {
    epoll_event events[256];
    TimeUs next_tick_us = steady_now_us() + kTickUs;
    double cpu_start = seconds_of(CLOCK_THREAD_CPUTIME_ID);
    TimeUs start_us = steady_now_us();
    while (!stopping_) {
      connect_some();
      const TimeUs wait_us = std::max<TimeUs>(0, next_tick_us - steady_now_us());
      const int count = epoll_wait(poll_, events, 256, static_cast<int>((wait_us + 999) / 1000));
      for (int i = 0; i < count; ++i) serve(viewers_[events[i].data.u32], events[i].events);
      const TimeUs now = steady_now_us();
      if (now < next_tick_us) continue;
      if (counting_) figures_.lag_us.add(now - next_tick_us);
      next_tick_us = now + kTickUs;
      acknowledge(now);
      if (begin_.exchange(false)) {
        figures_ = {};
        counting_ = true;
        cpu_start = seconds_of(CLOCK_THREAD_CPUTIME_ID);
        start_us = now;
      }
    }
    const double seconds = static_cast<double>(steady_now_us() - start_us) / 1e6;
    figures_.cpu_share = seconds > 0 ? (seconds_of(CLOCK_THREAD_CPUTIME_ID) - cpu_start) / seconds : 0;
  }

  void connect_some() {
    while (begun_ < viewers_.size() && begun_ - settled() < kConnectingAtOnce) {
      Viewer& viewer = viewers_[begun_++];
      viewer.fd = ::socket(address_.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
      if (viewer.fd < 0) {
        lose(viewer);
        continue;
      }
      const int one = 1;
      setsockopt(viewer.fd, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
      const socklen_t size = address_.ss_family == AF_INET6 ? sizeof(sockaddr_in6) : sizeof(sockaddr_in);
      if (::connect(viewer.fd, reinterpret_cast<const sockaddr*>(&address_), size) != 0 && errno != EINPROGRESS) {
        lose(viewer);
        continue;
      }
      watch(viewer, EPOLL_CTL_ADD, EPOLLOUT | EPOLLIN);
    }
  }

  void watch(Viewer& viewer, int operation, std::uint32_t events) {
    epoll_event event{};
    event.events = events;
    event.data.u32 = static_cast<std::uint32_t>(&viewer - viewers_.data());
    epoll_ctl(poll_, operation, viewer.fd, &event);
  }

  void lose(Viewer& viewer) {
    if (viewer.state == Viewer::State::kGone) return;
    if (viewer.state == Viewer::State::kWatching) --watching_;
    viewer.state = Viewer::State::kGone;
    ++gone_;
    if (viewer.fd >= 0) ::close(viewer.fd);
    viewer.fd = -1;
  }

  void serve(Viewer& viewer, std::uint32_t events) {
    if (viewer.state == Viewer::State::kGone) return;
    if (viewer.state == Viewer::State::kConnecting && (events & EPOLLOUT) != 0) {
      if (!put(viewer, request_)) return;
      viewer.state = Viewer::State::kUpgrading;
      watch(viewer, EPOLL_CTL_MOD, EPOLLIN);
    }
    if ((events & (EPOLLIN | EPOLLHUP | EPOLLERR)) == 0) return;
    std::uint8_t part[32 * 1024];
    const ssize_t got = ::recv(viewer.fd, part, sizeof part, 0);
    if (got <= 0) {
      if (got == 0 || (errno != EAGAIN && errno != EINTR)) lose(viewer);
      return;
    }
    const TimeUs now = steady_now_us();
    viewer.in.insert(viewer.in.end(), part, part + got);
    if (viewer.in.size() > kMaxBuffered) return lose(viewer);
    if (viewer.state == Viewer::State::kUpgrading && !upgraded(viewer)) return;
    take_messages(viewer, now);
  }

  bool upgraded(Viewer& viewer) {
    static constexpr std::string_view kEnd = "\r\n\r\n";
    const auto end = std::search(viewer.in.begin(), viewer.in.end(), kEnd.begin(), kEnd.end());
    if (end == viewer.in.end()) return false;
    const std::string_view head(reinterpret_cast<const char*>(viewer.in.data()), 12);
    if (head != "HTTP/1.1 101") {
      lose(viewer);
      return false;
    }
    viewer.in.erase(viewer.in.begin(), end + 4);
    viewer.state = Viewer::State::kWatching;
    ++watching_;
    return true;
  }

  void take_messages(Viewer& viewer, TimeUs now) {
    std::size_t at = 0;
    while (viewer.state == Viewer::State::kWatching) {
      const ByteView in = ByteView(viewer.in).subspan(at);
      if (in.size() < 2) break;
      std::size_t head = 2, length = in[1] & 127;
      if (length >= 126) {
        const std::size_t extra = length == 126 ? 2 : 8;
        head += extra;
        if (in.size() < head) break;
        length = 0;
        for (std::size_t i = 0; i < extra; ++i) length = length << 8 | in[2 + i];
      }
      if (length > kMaxBuffered) return lose(viewer);
      if (in.size() < head + length) break;
      const std::uint8_t opcode = in[0] & 15;
      const ByteView payload = in.subspan(head, length);
      if (opcode == 2) take_frame(viewer, payload, now);
      if (opcode == 8) return lose(viewer);
      if (opcode == 9) put(viewer, masked(10, {reinterpret_cast<const char*>(payload.data()), payload.size()}));
      at += head + length;
    }
    viewer.in.erase(viewer.in.begin(), viewer.in.begin() + static_cast<std::ptrdiff_t>(std::min(at, viewer.in.size())));
  }

  void take_frame(Viewer& viewer, ByteView bytes, TimeUs now) {
    const auto parsed = parse_frame(bytes);
    const ChainClock* newest = viewer.newest ? &*viewer.newest : nullptr;
    const auto frame = parsed ? resolved(*parsed, newest, 0) : std::nullopt;
    if (!frame) return void(++figures_.undecodable);
    const Envelope& head = frame->envelope;
    viewer.ack = control::Ack::Item{head.stream_id, head.sequence, head.step.byte()};
    ++figures_.frames;
    figures_.bytes += bytes.size();
    if (head.is_key()) {
      if (newest != nullptr && head.sequence > newest->sequence + 1)
        figures_.keys_missed += head.sequence - newest->sequence - 1;
      viewer.newest = ChainClock::after(head);
    }
    // The first join may hold an old pose: its age is not a delay of the stream.
    if (counting_ && head.kind != FrameKind::kJoin && head.shows())
      figures_.latency_us.add(now - (head.is_ahead() ? shown_us(head) : head.capture_us));
  }

  void acknowledge(TimeUs now) {
    // A tenth of the viewers each tick, so that their acknowledgements do not come in one burst.
    const auto turns = static_cast<std::size_t>(std::max<TimeUs>(1, options_.ack_every_us / kTickUs));
    ++tick_;
    for (std::size_t i = tick_ % turns; i < viewers_.size(); i += turns) {
      Viewer& viewer = viewers_[i];
      if (viewer.state != Viewer::State::kWatching || !viewer.ack) continue;
      put(viewer, masked(1, text_from_control(control::Ack{{*viewer.ack}, now})));
      viewer.ack.reset();
    }
  }

  /// What is sent is small and seldom: a socket that does not take it whole is lost.
  bool put(Viewer& viewer, const std::string& bytes) {
    if (::send(viewer.fd, bytes.data(), bytes.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(bytes.size())) return true;
    lose(viewer);
    return false;
  }

  const Options options_;
  const sockaddr_storage address_;
  std::string request_;
  int poll_ = -1;
  std::vector<Viewer> viewers_;
  std::size_t begun_ = 0, tick_ = 0;
  Figures figures_;
  bool counting_ = false;
  std::atomic<std::uint32_t> watching_{0}, gone_{0};
  std::atomic<bool> begin_{false}, stopping_{false};
  std::thread thread_;
};

}  // namespace

double seconds_of(clockid_t clock) {
  timespec t{};
  clock_gettime(clock, &t);
  return static_cast<double>(t.tv_sec) + static_cast<double>(t.tv_nsec) * 1e-9;
}

Result<BrokerUrl> Load::check_url(const std::string& text) {
  auto url = parse_broker_url(text);
  if (url && url->tls)
    return fail(ErrorCode::kInvalidArgument,
                "light viewers speak no TLS: take one client, or name a door of ws:// with --viewer-url");
  return url;
}

Result<std::unique_ptr<Load>> Load::start(const Options& options, TimeUs patience_us) {
  auto url = check_url(options.url);
  if (!url) return url.error();
  if (auto usable = complete_credentials(*url, options.credentials); !usable) return usable.error();
  if (auto files = allow_files(std::uint64_t{options.viewers} + 64); !files) return files.error();
  const auto address = address_of(*url);
  if (!address) return address.error();
  auto load = std::make_unique<LightViewers>(options, *url, *address);
  const TimeUs until_us = steady_now_us() + patience_us;
  while (load->settled() < options.viewers && steady_now_us() < until_us)
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  if (options.viewers > 0 && load->watching() == 0)
    return fail(ErrorCode::kUnreachable,
                "none of " + std::to_string(options.viewers) + " viewers could connect to " + options.url);
  return std::unique_ptr<Load>(std::move(load));
}

}  // namespace eigencast::latency
