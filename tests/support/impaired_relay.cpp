// SPDX-License-Identifier: MIT
#include "tests/support/impaired_relay.h"

#include <array>
#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/write.hpp>
#include <chrono>
#include <deque>
#include <thread>
#include <vector>

namespace eigencast::testing {
namespace {

namespace asio = boost::asio;
using asio::ip::tcp;
using boost::system::error_code;

constexpr std::size_t kSegmentBytes = 1448;  // What one Ethernet frame carries of a TCP stream.
constexpr int kSocketBytes = 64 * 1024;      // Kernel buffers would be a queue beside the modelled one.
constexpr std::size_t kMaxHeldBytes = 8 * 1024 * 1024;

using Counter = std::atomic<std::uint64_t>;

/// One direction of one connection.
struct Lane {
  Lane(tcp::socket& source, tcp::socket& sink, ImpairedPath& through, Counter& passed)
      : from(source), to(sink), path(through), bytes(passed), timer(source.get_executor()) {}
  struct Segment {
    TimeUs due_us;
    std::vector<std::uint8_t> bytes;  ///< Empty: the end of the stream.
  };
  tcp::socket& from;
  tcp::socket& to;
  ImpairedPath& path;
  Counter& bytes;
  ImpairedPath::Flow flow;
  std::deque<Segment> held;  ///< Bounded by kMostHeldBytes.
  std::size_t held_bytes = 0;
  std::array<std::uint8_t, kSegmentBytes> buffer{};
  asio::steady_timer timer;
  bool sending = false, reading = false, ended = false;
};

std::chrono::steady_clock::time_point at(TimeUs time_us) {
  return std::chrono::steady_clock::time_point(std::chrono::microseconds(time_us));
}

/// Both directions of one connection. Kept alive by its pending operations.
class Tunnel : public std::enable_shared_from_this<Tunnel> {
 public:
  Tunnel(tcp::socket near, asio::io_context& io, ImpairedPath& to, ImpairedPath& from, TimeUs max_queued_us,
         Counter& bytes_to, Counter& bytes_from)
      : near_(std::move(near)),
        far_(io),
        max_queued_us_(max_queued_us),
        to_target_(near_, far_, to, bytes_to),
        from_target_(far_, near_, from, bytes_from) {}

  void start(const tcp::endpoint& target) {
    far_.async_connect(target, [self = shared_from_this()](error_code ec) {
      if (ec) return self->cut();
      self->tune(self->near_);
      self->tune(self->far_);
      self->read(self->to_target_);
      self->read(self->from_target_);
    });
  }

  void cut() {
    error_code ignored;
    near_.close(ignored);
    far_.close(ignored);
    to_target_.timer.cancel();
    from_target_.timer.cancel();
  }

 private:
  static void tune(tcp::socket& socket) {
    error_code ignored;
    socket.set_option(tcp::no_delay(true), ignored);
    socket.set_option(asio::socket_base::receive_buffer_size(kSocketBytes), ignored);
    socket.set_option(asio::socket_base::send_buffer_size(kSocketBytes), ignored);
  }

  void read(Lane& lane) {
    if (lane.reading || lane.ended || lane.held_bytes > kMaxHeldBytes) return;
    lane.reading = true;
    const TimeUs queued_us = lane.path.busy_until_us() - steady_now_us();
    if (queued_us <= max_queued_us_) return read_now(lane);
    // The link has enough to do: what is not read makes the writer's TCP wait, as a full router makes it slow down.
    auto wait =
        std::make_shared<asio::steady_timer>(lane.timer.get_executor(), at(lane.path.busy_until_us() - max_queued_us_));
    wait->async_wait([self = shared_from_this(), &lane, wait](error_code ec) {
      lane.reading = false;
      if (!ec && lane.from.is_open()) self->read(lane);
    });
  }

  void read_now(Lane& lane) {
    lane.from.async_read_some(
        asio::buffer(lane.buffer), [self = shared_from_this(), &lane](error_code ec, std::size_t size) {
          lane.reading = false;
          if (ec == asio::error::operation_aborted) return;
          if (ec && ec != asio::error::eof) return self->cut();
          lane.ended = static_cast<bool>(ec);
          const TimeUs due_us = lane.path.leaves_at(lane.flow, size, steady_now_us());
          lane.held.push_back({due_us, {lane.buffer.begin(), lane.buffer.begin() + static_cast<std::ptrdiff_t>(size)}});
          lane.held_bytes += size;
          self->send(lane);
          self->read(lane);
        });
  }

  void send(Lane& lane) {
    if (lane.sending || lane.held.empty()) return;
    lane.sending = true;
    lane.timer.expires_at(at(lane.held.front().due_us));
    lane.timer.async_wait([self = shared_from_this(), &lane](error_code ec) {
      if (ec) return;
      if (lane.held.front().bytes.empty()) {
        error_code ignored;
        lane.to.shutdown(tcp::socket::shutdown_send, ignored);
        if (self->to_target_.ended && self->from_target_.ended) self->cut();
        return;
      }
      asio::async_write(lane.to, asio::buffer(lane.held.front().bytes),
                        [self, &lane](error_code failed, std::size_t size) {
                          if (failed) return self->cut();
                          lane.bytes += size;
                          lane.held_bytes -= size;
                          lane.held.pop_front();
                          lane.sending = false;
                          self->send(lane);
                          self->read(lane);
                        });
    });
  }

  tcp::socket near_, far_;
  TimeUs max_queued_us_;
  Lane to_target_, from_target_;
};

}  // namespace

class ImpairedRelay::Impl {
 public:
  explicit Impl(const Options& options)
      : options_(options), to_target_(options.to_target), from_target_(options.from_target), acceptor_(io_) {}

  Result<void> listen() {
    error_code ec;
    const tcp::endpoint here(asio::ip::address_v4::loopback(), options_.port);
    acceptor_.open(here.protocol(), ec);
    if (!ec) acceptor_.set_option(asio::socket_base::reuse_address(true), ec);
    if (!ec) acceptor_.bind(here, ec);
    if (!ec) acceptor_.listen(asio::socket_base::max_listen_connections, ec);
    if (ec)
      return fail(ErrorCode::kUnreachable,
                  "relay: cannot listen on port " + std::to_string(options_.port) + ": " + ec.message());
    port = acceptor_.local_endpoint().port();
    accept();
    thread_ = std::thread([this] { io_.run(); });
    return {};
  }

  ~Impl() {
    asio::post(io_, [this] {
      error_code ignored;
      acceptor_.close(ignored);
      for (const auto& weak : tunnels_) {
        if (const auto tunnel = weak.lock()) tunnel->cut();
      }
    });
    if (thread_.joinable()) thread_.join();
  }

  std::uint16_t port = 0;
  Counter bytes_to{0}, bytes_from{0};

 private:
  void accept() {
    acceptor_.async_accept([this](error_code ec, tcp::socket socket) {
      if (ec) return;
      auto tunnel = std::make_shared<Tunnel>(std::move(socket), io_, to_target_, from_target_, options_.max_queued_us,
                                             bytes_to, bytes_from);
      std::erase_if(tunnels_, [](const std::weak_ptr<Tunnel>& weak) { return weak.expired(); });
      tunnels_.push_back(tunnel);
      tunnel->start({asio::ip::address_v4::loopback(), options_.target_port});
      accept();
    });
  }

  const Options options_;
  asio::io_context io_{1};
  ImpairedPath to_target_, from_target_;
  tcp::acceptor acceptor_;
  std::vector<std::weak_ptr<Tunnel>> tunnels_;
  std::thread thread_;
};

ImpairedRelay::ImpairedRelay(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ImpairedRelay::~ImpairedRelay() = default;

Result<std::unique_ptr<ImpairedRelay>> ImpairedRelay::start(const Options& options) {
  for (const Impairment* impairment : {&options.to_target, &options.from_target}) {
    if (auto fits = check_impairment(*impairment); !fits) return fits.error();
  }
  auto impl = std::make_unique<Impl>(options);
  if (auto listening = impl->listen(); !listening) return listening.error();
  return std::unique_ptr<ImpairedRelay>(new ImpairedRelay(std::move(impl)));
}

std::uint16_t ImpairedRelay::port() const {
  return impl_->port;
}
std::uint64_t ImpairedRelay::bytes_from_target() const {
  return impl_->bytes_from;
}
std::uint64_t ImpairedRelay::bytes_to_target() const {
  return impl_->bytes_to;
}

}  // namespace eigencast::testing
