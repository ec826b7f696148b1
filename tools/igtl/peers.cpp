// SPDX-License-Identifier: MIT
#include "tools/igtl/peers.h"

#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <utility>
#include <vector>

#include "common/core/clock.h"

namespace eigencast::igtl {
namespace {

constexpr TimeUs kRetryUs = 1'000'000;
constexpr std::size_t kReadBytes = std::size_t{1} << 18;
/// What the system takes of messages ahead of a slow peer, for which the newest is soon the only one of use.
constexpr int kUnsentBytes = 1 << 18;
constexpr TimeUs kPatienceUs = std::chrono::microseconds(Peers::kPatience).count();

class Socket {
 public:
  Socket() = default;
  explicit Socket(int fd) : fd_(fd) {}
  Socket(Socket&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Socket& operator=(Socket&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }
  ~Socket() {
    if (fd_ >= 0) ::close(fd_);
  }
  int fd() const { return fd_; }
  explicit operator bool() const { return fd_ >= 0; }
  void set(int level, int option, int value = 1) const { (void)::setsockopt(fd_, level, option, &value, sizeof value); }

 private:
  int fd_ = -1;
};

using Addresses = std::unique_ptr<addrinfo, void (*)(addrinfo*)>;

Result<Addresses> addresses_of(const Endpoint& where, bool listens) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = listens ? AI_PASSIVE : 0;
  addrinfo* found = nullptr;
  const int failed = ::getaddrinfo(where.host.c_str(), where.port.c_str(), &hints, &found);
  if (failed != 0) return fail(ErrorCode::kInvalidArgument, where.shown() + ": " + ::gai_strerror(failed));
  return Addresses(found, ::freeaddrinfo);
}

std::string address_of(int fd) {
  sockaddr_storage address{};
  socklen_t length = sizeof address;
  std::array<char, NI_MAXHOST> host{};
  std::array<char, NI_MAXSERV> port{};
  auto* any = reinterpret_cast<sockaddr*>(&address);
  if (::getpeername(fd, any, &length) != 0 && ::getsockname(fd, any, &length) != 0) return "somebody";
  if (::getnameinfo(any, length, host.data(), host.size(), port.data(), port.size(), NI_NUMERICHOST | NI_NUMERICSERV))
    return "somebody";
  return Endpoint{host.data(), port.data()}.shown();
}

bool would_block() {
  return errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR;
}

struct Peer {
  Socket socket;
  std::uint64_t number = 0;
  std::string name;
  TimeUs read_us = 0, written_us = 0;  ///< When it last sent, and took or had nothing to take.
  std::shared_ptr<const Bytes> writing, next;
  std::size_t written = 0;
};

class PolledPeers final : public Peers {
 public:
  PolledPeers(PeersOptions options, LogSink log)
      : options_(std::move(options)), log_(std::move(log)), read_(kReadBytes) {}

  Result<void> listen() {
    const auto addresses = addresses_of(options_.where, true);
    if (!addresses) return addresses.error();
    for (const addrinfo* a = addresses->get(); a != nullptr; a = a->ai_next) {
      Socket socket(::socket(a->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
      socket.set(SOL_SOCKET, SO_REUSEADDR);
      if (!socket || ::bind(socket.fd(), a->ai_addr, a->ai_addrlen) != 0 || ::listen(socket.fd(), 16) != 0) continue;
      listener_ = std::move(socket);
      log(log_, LogLevel::kInfo, "listens on " + address_of(listener_.fd()));
      return {};
    }
    return fail(ErrorCode::kIo, "cannot listen on " + options_.where.shown() + ": " + std::strerror(errno));
  }

  void poll(std::chrono::milliseconds timeout, const OnBytes& on_bytes) override {
    if (!options_.listens) connect();
    std::vector<pollfd> watched;
    for (const Peer& peer : peers_)
      watched.push_back({peer.socket.fd(), static_cast<short>(POLLIN | POLLRDHUP | (peer.writing ? POLLOUT : 0)), 0});
    const std::size_t peers = watched.size();
    if (listener_) watched.push_back({listener_.fd(), POLLIN, 0});
    if (connecting_) watched.push_back({connecting_.fd(), POLLOUT, 0});
    (void)::poll(watched.data(), watched.size(), static_cast<int>(timeout.count()));
    const TimeUs now = steady_now_us();
    bool ends = false;  // One that has ended, of which there may still be something to read.
    for (std::size_t i = peers; i-- > 0;) {
      Peer& peer = peers_[i];
      const bool reads = (watched[i].revents & (POLLIN | POLLERR | POLLHUP)) != 0;
      ends |= (watched[i].revents & POLLRDHUP) != 0;
      if ((reads && !read_from(peer, now, on_bytes)) || !write_to(peer, now)) drop(i);
    }
    if (watched.size() > peers && watched.back().revents != 0) {
      if (!listener_)
        finish_connecting(now);
      else if (!ends || peers_.size() < options_.max_peers)  // Else its place is free soon.
        accept(now);
    }
  }

  void offer(const std::shared_ptr<const Bytes>& message) override {
    const TimeUs now = steady_now_us();
    for (Peer& peer : peers_) {
      if (!peer.writing) {
        peer.writing = message;
        peer.written_us = now;
      } else {
        stats_.superseded += peer.next ? 1 : 0;
        peer.next = message;
      }
    }
  }

  Stats stats() const override {
    Stats now = stats_;
    now.connected = peers_.size();
    now.writing = std::any_of(peers_.begin(), peers_.end(), [](const Peer& peer) { return peer.writing != nullptr; });
    return now;
  }

 private:
  /// False: it is gone, or `on_bytes` wants it gone.
  bool read_from(Peer& peer, TimeUs now, const OnBytes& on_bytes) {
    const ssize_t got = ::recv(peer.socket.fd(), read_.data(), read_.size(), 0);
    if (got < 0) return would_block();
    if (got == 0) return false;
    peer.read_us = now;
    return on_bytes(peer.number, ByteView(read_).first(static_cast<std::size_t>(got)));
  }

  /// False: it is gone, or takes nothing.
  bool write_to(Peer& peer, TimeUs now) {
    while (peer.writing) {
      const ByteView rest = ByteView(*peer.writing).subspan(peer.written);
      const ssize_t sent = ::send(peer.socket.fd(), rest.data(), rest.size(), MSG_NOSIGNAL);
      if (sent < 0 && !would_block()) return false;
      if (sent < 0) {
        const bool stalled = now - peer.written_us > kPatienceUs;
        if (stalled) log(log_, LogLevel::kWarning, peer.name + " takes nothing for 10 s: disconnected");
        return !stalled;
      }
      peer.written_us = now;
      peer.written += static_cast<std::size_t>(sent);
      if (peer.written < peer.writing->size()) return true;
      ++stats_.sent;
      peer.writing = std::exchange(peer.next, nullptr);
      peer.written = 0;
    }
    return true;
  }

  void drop(std::size_t index) {
    log(log_, LogLevel::kInfo, peers_[index].name + " is gone");
    peers_.erase(peers_.begin() + static_cast<std::ptrdiff_t>(index));
    retry_us_ = steady_now_us() + kRetryUs;
  }

  void add(Socket socket, TimeUs now) {
    socket.set(IPPROTO_TCP, TCP_NODELAY);
    socket.set(SOL_SOCKET, SO_KEEPALIVE);
    socket.set(SOL_SOCKET, SO_SNDBUF, kUnsentBytes);
    Peer peer;
    peer.name = address_of(socket.fd());
    peer.socket = std::move(socket);
    peer.number = ++stats_.peers;
    peer.read_us = peer.written_us = now;
    log(log_, LogLevel::kInfo, "connected with " + peer.name);
    peers_.push_back(std::move(peer));
  }

  void accept(TimeUs now) {
    Socket socket(::accept4(listener_.fd(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
    if (!socket) return;
    if (peers_.size() >= options_.max_peers && options_.they_send) {
      const auto by_silence = [](const Peer& a, const Peer& b) { return a.read_us < b.read_us; };
      const auto silent = std::min_element(peers_.begin(), peers_.end(), by_silence);
      if (now - silent->read_us > kPatienceUs) drop(static_cast<std::size_t>(silent - peers_.begin()));
    }
    if (peers_.size() >= options_.max_peers) {
      log(log_, LogLevel::kWarning,
          address_of(socket.fd()) + " is refused: there are " + std::to_string(options_.max_peers) +
              " peers, which is the most");
      return;
    }
    add(std::move(socket), now);
  }

  void connect() {
    const TimeUs now = steady_now_us();
    if (connecting_ || !peers_.empty() || now < retry_us_) return;
    retry_us_ = now + kRetryUs;
    const auto addresses = addresses_of(options_.where, false);
    if (!addresses) return complain(addresses.error().message);
    const addrinfo* address = addresses->get();
    for (std::size_t skip = tries_++; skip-- > 0;)  // each in turn
      address = address->ai_next != nullptr ? address->ai_next : addresses->get();
    Socket socket(::socket(address->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
    if (!socket) return complain(std::strerror(errno));
    if (::connect(socket.fd(), address->ai_addr, address->ai_addrlen) != 0 && errno != EINPROGRESS)
      return complain(std::strerror(errno));
    connecting_ = std::move(socket);
  }

  void finish_connecting(TimeUs now) {
    int error = 0;
    socklen_t length = sizeof error;
    (void)::getsockopt(connecting_.fd(), SOL_SOCKET, SO_ERROR, &error, &length);
    Socket socket = std::exchange(connecting_, Socket());
    if (error != 0) return complain(std::strerror(error));
    complained_ = false;
    add(std::move(socket), now);
  }

  void complain(const std::string& why) {
    if (!complained_)
      log(log_, LogLevel::kWarning, "no connection to " + options_.where.shown() + ": " + why + "; tries every second");
    complained_ = true;
  }

  const PeersOptions options_;
  const LogSink log_;
  Socket listener_, connecting_;
  std::vector<Peer> peers_;
  Stats stats_;
  Bytes read_;
  TimeUs retry_us_ = 0;
  std::size_t tries_ = 0;
  bool complained_ = false;
};

}  // namespace

Result<Endpoint> endpoint_from_text(const std::string& text, const std::string& host) {
  const std::size_t colon = text.rfind(':');
  Endpoint where{colon == text.npos ? host : text.substr(0, colon), colon == text.npos ? text : text.substr(colon + 1)};
  if (where.host.size() > 2 && where.host.front() == '[' && where.host.back() == ']')
    where.host = where.host.substr(1, where.host.size() - 2);
  const bool digits = !where.port.empty() && where.port.size() <= 5 &&
                      where.port.find_first_not_of("0123456789") == where.port.npos && std::stoi(where.port) <= 65535;
  if (!digits || where.host.empty() || (where.host.find(':') != text.npos && text.front() != '['))
    return fail(ErrorCode::kInvalidArgument, "'" + text + "' must be PORT, HOST:PORT or [ADDRESS]:PORT");
  return where;
}

Result<std::unique_ptr<Peers>> Peers::create(PeersOptions options, LogSink log) {
  const bool listens = options.listens;
  auto peers = std::make_unique<PolledPeers>(std::move(options), std::move(log));
  if (listens)
    if (const auto listening = peers->listen(); !listening) return listening.error();
  return std::unique_ptr<Peers>(std::move(peers));
}

}  // namespace eigencast::igtl
