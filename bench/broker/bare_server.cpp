// SPDX-License-Identifier: MIT
// bare_server PORT epoll|uring|tls [THREADS]: what a relay is held against. Writes each message of a publisher (GET
// /pub), framed once, to every subscriber (any other path), by a send() each, in batches of io_uring, or over TLS
// (cert.pem and key.pem here); no names, no limits, no acknowledgements. A subscriber that reads too slowly misses
// some.
#include <arpa/inet.h>
#include <liburing.h>
#include <netinet/tcp.h>
#include <openssl/evp.h>
#include <openssl/sha.h>
#include <openssl/ssl.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

namespace {

using Message = std::shared_ptr<const std::string>;

constexpr unsigned kBatch = 1024;

struct Connection {
  int fd;
  SSL* ssl = nullptr;
  enum class State { kTls, kUpgrade, kSubscriber, kPublisher } state = State::kUpgrade;
  std::string in = {}, rest = {};  ///< Hold a message that was written in part.
  std::size_t index = 0;           ///< Among the subscribers.
};

std::string accept_key(const std::string& key) {
  const std::string text = key + "258EAFA5-E914-47DA-95CA-C5AB0DC85B11";
  unsigned char digest[20], base64[32];
  SHA1(reinterpret_cast<const unsigned char*>(text.data()), text.size(), digest);
  EVP_EncodeBlock(base64, digest, sizeof digest);
  return reinterpret_cast<const char*>(base64);
}

Message framed(std::string_view payload) {
  const std::size_t size = payload.size();
  std::string frame(1, static_cast<char>(0x82));
  frame += static_cast<char>(size < 126 ? size : size < 65536 ? 126 : 127);
  const int bytes = size < 126 ? 0 : size < 65536 ? 2 : 8;
  for (int i = bytes - 1; i >= 0; --i) frame += static_cast<char>(size >> (8 * i));
  return std::make_shared<const std::string>(frame.append(payload));
}

/// One thread with its share of the connections.
class Loop {
 public:
  Loop(std::vector<std::unique_ptr<Loop>>& all, SSL_CTX* tls, bool uring) : all_(all), tls_(tls), uring_(uring) {
    watch(wake_, EPOLL_CTL_ADD, EPOLLIN, nullptr);
    if (!uring_) return;
    io_uring_params parameters{};
    parameters.flags = IORING_SETUP_CQSIZE | IORING_SETUP_COOP_TASKRUN;
    parameters.cq_entries = 4 * kBatch;
    if (io_uring_queue_init_params(kBatch, &ring_, &parameters) < 0) throw std::runtime_error("no io_uring here");
  }

  /// May be called from any thread.
  void adopt(int fd) {
    auto* connection = new Connection{.fd = fd};
    if (tls_ != nullptr) {
      connection->state = Connection::State::kTls;
      connection->ssl = SSL_new(tls_);
      SSL_set_fd(connection->ssl, fd);
      SSL_set_accept_state(connection->ssl);
    }
    watch(fd, EPOLL_CTL_ADD, EPOLLIN, connection);
  }

  [[noreturn]] void run() {
    epoll_event events[256];
    for (;;) {
      const int count = ::epoll_wait(poll_, events, 256, -1);
      for (int i = 0; i < count; ++i) {
        auto* connection = static_cast<Connection*>(events[i].data.ptr);
        if (connection == nullptr) {
          write_posted();
          continue;
        }
        if ((events[i].events & EPOLLOUT) != 0) write_rest(*connection);
        if ((events[i].events & ~std::uint32_t{EPOLLOUT}) != 0) read(connection);
      }
    }
  }

 private:
  void watch(int fd, int operation, std::uint32_t events, Connection* connection) const {
    epoll_event event{};
    event.events = events;
    event.data.ptr = connection;
    ::epoll_ctl(poll_, operation, fd, &event);
  }

  void post(const Message& message) {
    {
      const std::lock_guard lock(mutex_);
      posted_.push_back(message);
    }
    ::eventfd_write(wake_, 1);
  }

  void write_posted() {
    eventfd_t ignored;
    ::eventfd_read(wake_, &ignored);
    std::vector<Message> messages;
    {
      const std::lock_guard lock(mutex_);
      messages.swap(posted_);
    }
    for (const Message& message : messages) write_to_all(*message);
  }

  void write_to_all(const std::string& message) {
    if (uring_) return write_in_batches(message);
    for (Connection* subscriber : subscribers_) {
      if (subscriber->rest.empty()) written(*subscriber, message, write(*subscriber, message));
    }
  }

  void write_in_batches(const std::string& message) {
    for (std::size_t next = 0; next < subscribers_.size();) {
      unsigned count = 0;
      for (; next < subscribers_.size() && count < kBatch; ++next) {
        Connection* subscriber = subscribers_[next];
        if (!subscriber->rest.empty()) continue;
        io_uring_sqe* entry = io_uring_get_sqe(&ring_);
        io_uring_prep_send(entry, subscriber->fd, message.data(), message.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
        io_uring_sqe_set_data(entry, subscriber);
        ++count;
      }
      io_uring_submit_and_wait(&ring_, count);
      for (io_uring_cqe* done; count > 0 && io_uring_wait_cqe(&ring_, &done) == 0; --count) {
        written(*static_cast<Connection*>(io_uring_cqe_get_data(done)), message, done->res);
        io_uring_cqe_seen(&ring_, done);
      }
    }
  }

  static ssize_t write(Connection& connection, std::string_view bytes) {
    if (connection.ssl != nullptr) return SSL_write(connection.ssl, bytes.data(), static_cast<int>(bytes.size()));
    return ::send(connection.fd, bytes.data(), bytes.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
  }
  void written(Connection& subscriber, std::string_view bytes, ssize_t put) const {
    if (put <= 0 || put == static_cast<ssize_t>(bytes.size())) return;
    subscriber.rest = bytes.substr(static_cast<std::size_t>(put));
    watch(subscriber.fd, EPOLL_CTL_MOD, EPOLLIN | EPOLLOUT, &subscriber);
  }
  void write_rest(Connection& subscriber) const {
    const ssize_t put = subscriber.rest.empty() ? 0 : write(subscriber, subscriber.rest);
    if (put > 0) subscriber.rest.erase(0, static_cast<std::size_t>(put));
    if (subscriber.rest.empty()) watch(subscriber.fd, EPOLL_CTL_MOD, EPOLLIN, &subscriber);
  }

  void read(Connection* connection) {
    if (connection->state == Connection::State::kTls) {
      const int done = SSL_accept(connection->ssl);
      if (done == 1)
        connection->state = Connection::State::kUpgrade;
      else if (SSL_get_error(connection->ssl, done) == SSL_ERROR_WANT_READ)
        return;
      else
        return close(connection);
    }
    char part[65536];
    ssize_t got;
    if (connection->ssl == nullptr) {
      got = ::recv(connection->fd, part, sizeof part, MSG_DONTWAIT);
      if (got < 0 && errno == EAGAIN) return;
    } else {
      got = SSL_read(connection->ssl, part, sizeof part);
      if (got <= 0 && SSL_get_error(connection->ssl, static_cast<int>(got)) == SSL_ERROR_WANT_READ) return;
    }
    if (got <= 0) return close(connection);
    if (connection->state == Connection::State::kSubscriber) return;
    connection->in.append(part, static_cast<std::size_t>(got));
    if (connection->state == Connection::State::kUpgrade) upgrade(*connection);
    if (connection->state == Connection::State::kPublisher) publish(connection->in);
  }

  void upgrade(Connection& connection) {
    constexpr std::string_view kKey = "Sec-WebSocket-Key: ";
    const std::size_t end = connection.in.find("\r\n\r\n"), key = connection.in.find(kKey);
    if (end == std::string::npos || key == std::string::npos) return;
    const std::size_t from = key + kKey.size();
    write(connection,
          "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: " +
              accept_key(connection.in.substr(from, connection.in.find("\r\n", from) - from)) + "\r\n\r\n");
    const bool publishes = connection.in.starts_with("GET /pub ");
    connection.state = publishes ? Connection::State::kPublisher : Connection::State::kSubscriber;
    connection.in.erase(0, end + 4);
    if (publishes) return;
    connection.in = {};
    connection.index = subscribers_.size();
    subscribers_.push_back(&connection);
  }

  void publish(std::string& in) {
    std::size_t at = 0;
    while (in.size() - at >= 8) {
      const auto byte = [&](std::size_t i) { return static_cast<std::uint8_t>(in[at + i]); };
      std::size_t size = byte(1) & 127, head = 6;
      if (size == 126) size = static_cast<std::size_t>(byte(2)) << 8 | byte(3), head = 8;
      if (in.size() - at < head + size) break;
      for (std::size_t i = 0; i < size; ++i) in[at + head + i] ^= in[at + head - 4 + (i & 3)];
      if ((byte(0) & 15) <= 2) {
        const Message message = framed(std::string_view(in).substr(at + head, size));
        for (const auto& loop : all_) {
          if (loop.get() != this) loop->post(message);
        }
        write_to_all(*message);
      }
      at += head + size;
    }
    in.erase(0, at);
  }

  void close(Connection* connection) {
    if (connection->state == Connection::State::kSubscriber) {
      subscribers_[connection->index] = subscribers_.back();
      subscribers_[connection->index]->index = connection->index;
      subscribers_.pop_back();
    }
    SSL_free(connection->ssl);
    ::close(connection->fd);
    delete connection;
  }

  std::vector<std::unique_ptr<Loop>>& all_;
  SSL_CTX* tls_;
  bool uring_;
  int poll_ = ::epoll_create1(0), wake_ = ::eventfd(0, EFD_NONBLOCK);
  io_uring ring_{};
  std::vector<Connection*> subscribers_;
  std::mutex mutex_;
  std::vector<Message> posted_;  // GUARDED_BY(mutex_)
};

int listen_on(std::uint16_t port) {
  const int door = ::socket(AF_INET, SOCK_STREAM, 0), one = 1;
  ::setsockopt(door, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  if (::bind(door, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 || ::listen(door, 4096) != 0)
    throw std::runtime_error(std::string("cannot listen: ") + std::strerror(errno));
  return door;
}

void serve(std::uint16_t port, const std::string& mode, std::size_t threads) {
  rlimit files{};
  ::getrlimit(RLIMIT_NOFILE, &files);
  files.rlim_cur = files.rlim_max;
  ::setrlimit(RLIMIT_NOFILE, &files);
  SSL_CTX* tls = mode == "tls" ? SSL_CTX_new(TLS_server_method()) : nullptr;
  if (tls != nullptr) {
    SSL_CTX_set_mode(tls,
                     SSL_MODE_RELEASE_BUFFERS | SSL_MODE_ENABLE_PARTIAL_WRITE | SSL_MODE_ACCEPT_MOVING_WRITE_BUFFER);
    if (SSL_CTX_use_certificate_chain_file(tls, "cert.pem") != 1 ||
        SSL_CTX_use_PrivateKey_file(tls, "key.pem", SSL_FILETYPE_PEM) != 1)
      throw std::runtime_error("cert.pem and key.pem are not here");
  }
  static std::vector<std::unique_ptr<Loop>> loops;
  for (std::size_t i = 0; i < threads; ++i) loops.push_back(std::make_unique<Loop>(loops, tls, mode == "uring"));
  const int door = listen_on(port), one = 1;
  for (const auto& loop : loops) std::thread([&loop] { loop->run(); }).detach();
  for (std::size_t next = 0;;) {
    const int fd = ::accept4(door, nullptr, nullptr, SOCK_NONBLOCK);
    if (fd < 0) continue;
    ::setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
    loops[next++ % threads]->adopt(fd);
  }
}

}  // namespace

int main(int argc, char** argv) {
  const std::string mode = argc > 2 ? argv[2] : "";
  const int threads = argc > 3 ? std::atoi(argv[3]) : 1;
  if ((mode != "epoll" && mode != "uring" && mode != "tls") || threads < 1) {
    std::fputs("usage: bare_server PORT epoll|uring|tls [THREADS]\n", stderr);
    return 2;
  }
  try {
    serve(static_cast<std::uint16_t>(std::atoi(argv[1])), mode, static_cast<std::size_t>(threads));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bare_server: %s\n", error.what());
    return 1;
  }
}
