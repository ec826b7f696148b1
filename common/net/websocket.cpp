// SPDX-License-Identifier: MIT
#include "common/net/websocket.h"

#include <netinet/tcp.h>

#include <algorithm>
#include <boost/asio/any_io_executor.hpp>
#include <boost/asio/connect.hpp>
#include <boost/asio/execution/executor.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/query.hpp>
#include <boost/asio/require.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/websocket.hpp>
#include <cassert>
#include <cmath>
#include <deque>
#include <mutex>
#include <optional>
#include <random>
#include <thread>
#include <type_traits>
#include <utility>

#include "common/core/clock.h"
#include "common/net/backoff.h"
#include "common/net/broker_order.h"
#include "common/net/client_stream.h"
#include "common/net/guarded_run.h"
#include "common/net/websocket_failure.h"
#include "common/wire/limits.h"

namespace eigencast {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace ws = boost::beast::websocket;
using tcp = asio::ip::tcp;
using boost::system::error_code;
using std::chrono::milliseconds;

constexpr beast::string_view kProtocol = "eigencast.v2";
constexpr milliseconds kPoliteClose{500};
/// A connection that held for so long counts as good: the next back-off starts afresh.
constexpr TimeUs kGoodAfterUs = 2'000'000;
/// The clients of a broker that is gone come to another spread over so long, or over the pause that it asked for.
constexpr milliseconds kStep{50};
constexpr milliseconds kMaxStep{30'000};
constexpr milliseconds kMaxHoldOff{600'000};  ///< As of Retry-After: one message must not silence a client for weeks.
constexpr std::size_t kMaxAddresses = 16;     ///< Of one name.
/// Bytes that the kernel may hold unsent; what is more stays with us, where it is counted.
constexpr int kKernelUnsentBytes = 32 * 1024;

struct Outgoing {
  bool text = false;
  Bytes bytes;
};

/// Runs what it is given as Inner does, and holds a lock meanwhile: another thread that takes that lock may use what
/// belongs to the handlers. Meets Asio's requirements of an executor. The lock must outlive it, and is
/// recursive because a handler may be run within another.
template <typename Inner>
class LockingExecutor {
 public:
  LockingExecutor(Inner inner, std::recursive_mutex& lock) noexcept : inner_(std::move(inner)), lock_(&lock) {}

  template <typename Property>
  auto query(const Property& property) const -> decltype(boost::asio::query(std::declval<const Inner&>(), property)) {
    return boost::asio::query(inner_, property);
  }
  template <typename Property>
  auto require(const Property& property) const
      -> LockingExecutor<std::decay_t<decltype(boost::asio::require(std::declval<const Inner&>(), property))>> {
    return {boost::asio::require(inner_, property), *lock_};
  }
  template <typename Function>
  void execute(Function&& function) const {
    inner_.execute([lock = lock_, run = std::forward<Function>(function)]() mutable {
      const std::lock_guard held(*lock);
      run();
    });
  }
  friend bool operator==(const LockingExecutor& a, const LockingExecutor& b) noexcept {
    return a.inner_ == b.inner_ && a.lock_ == b.lock_;
  }

 private:
  Inner inner_;
  std::recursive_mutex* lock_;
};

/// One connection, from its first try to its end. Handlers of a past one find that it is not the current one and do
/// nothing.
struct Link {
  Link(const asio::any_io_executor& executor, ClientTls tls) : socket(executor, std::move(tls)) {}
  ws::stream<ClientStream, false> socket;  ///< No compression: poses have no redundancy left.
  beast::flat_buffer in;
  std::string target;
  ws::response_type response;
  std::deque<Outgoing> out;  ///< Bounded: send() drops what goes beyond max_unsent_bytes.
  bool writing = false;
  TimeUs opened_us = 0;  ///< 0: not yet.
  /// What it waits for until it is open.
  const char* doing = "looking up the host's name";
};

void set_option_int(int fd, int level, int name, int value) {
  // Best effort: a kernel without one of these options still carries the stream.
  (void)::setsockopt(fd, level, name, &value, sizeof(value));
}

void tune(tcp::socket& socket) {
  error_code ignored;
  socket.set_option(tcp::no_delay(true), ignored);
  socket.set_option(asio::socket_base::keep_alive(true), ignored);
  const int fd = socket.native_handle();
  set_option_int(fd, IPPROTO_TCP, TCP_KEEPIDLE, 10);
  set_option_int(fd, IPPROTO_TCP, TCP_KEEPINTVL, 5);
  set_option_int(fd, IPPROTO_TCP, TCP_KEEPCNT, 3);
  set_option_int(fd, IPPROTO_TCP, TCP_NOTSENT_LOWAT, kKernelUnsentBytes);
}

class BeastWebSocket final : public WebSocket {
 public:
  BeastWebSocket(WebSocketOptions options, WebSocketEvents events, LogSink log)
      : options_(std::move(options)),
        events_(std::move(events)),
        log_(std::move(log)),
        work_(asio::make_work_guard(io_)),
        random_(std::random_device{}()),
        order_(options_.url.brokers()) {
    asio::post(executor_, [this] { connect(); });
    thread_ = std::thread([this] {
      run_when_woken(kPassingOn);
      guarded_run([this] { io_.run(); }, [this](const std::string& what) { recover(what); });
    });
  }

  ~BeastWebSocket() override { stop(); }

  SendStatus send_text(std::string text) override { return send({true, Bytes(text.begin(), text.end())}); }
  SendStatus send_binary(Bytes message) override { return send({false, std::move(message)}); }

  std::size_t unsent_bytes() const override {
    const std::lock_guard lock(mutex_);
    return unsent_;
  }

  bool is_open() const override {
    const std::lock_guard lock(mutex_);
    return open_;
  }

  void hold_off(milliseconds pause) override {
    const std::lock_guard lock(mutex_);
    hold_off_ = std::min(pause, kMaxHoldOff);
  }

  void retry_now() override {
    asio::post(executor_, [this] {
      if (!link_) connect();
    });
  }

  void stop() override {
    assert(std::this_thread::get_id() != thread_.get_id());
    const std::lock_guard lock(stop_mutex_);
    if (!thread_.joinable()) return;
    asio::post(executor_, [this] { close_politely(); });
    thread_.join();
  }

 private:
  SendStatus send(Outgoing message) {
    // Where no handler runs, the caller's thread writes: waking the connection's thread takes longer than that.
    const std::unique_lock turn(turn_, std::try_to_lock);
    std::uint64_t generation = 0;
    {
      const std::lock_guard lock(mutex_);
      if (!open_) return SendStatus::kDisconnected;
      if (unsent_ > 0 && unsent_ + message.bytes.size() > options_.max_unsent_bytes) return SendStatus::kDropped;
      unsent_ += message.bytes.size();
      generation = generation_;
      if (!turn || posted_ > 0) {  // Not past those that wait for that thread.
        asio::post(executor_, [this, generation, m = std::move(message)]() mutable {
          {
            const std::lock_guard taken(mutex_);
            --posted_;
          }
          enqueue(generation, std::move(m));
        });
        ++posted_;
        return SendStatus::kSent;
      }
    }
    enqueue(generation, std::move(message));
    return SendStatus::kSent;
  }

  using LinkPtr = std::shared_ptr<Link>;
  bool is_current(const LinkPtr& link) const { return link == link_ && !stopping_; }

  void connect() {
    if (stopping_) return;
    retry_timer_.cancel();
    at_ = options_.url.at(order_.broker());
    where_ = at_.origin();
    if (options_.url.tls && !tls_) {
      auto made = make_client_tls(options_.url);
      if (!made) {
        connect_after(kHopelessRetry);
        return report_down(made.error(), kHopelessRetry);
      }
      tls_ = std::move(*made);
    }
    addresses_.clear();
    several_ = false;
    const LinkPtr link = new_link();
    error_code not_numeric;
    const auto address = asio::ip::make_address(at_.host, not_numeric);
    if (!not_numeric) {
      addresses_.emplace_back(address, at_.port);
      return reach(link);
    }
    const auto on_found = [this, link](error_code ec, const tcp::resolver::results_type& found) {
      if (!is_current(link)) return;
      const std::string why = "host \"" + at_.host + "\" is not known: " + ec.message();
      if (ec) return down(link, {fail(ErrorCode::kUnreachable, why)});
      addresses_.assign(found.begin(), found.end());
      if (addresses_.size() > kMaxAddresses) addresses_.resize(kMaxAddresses);
      // The one that was tried last comes last.
      const auto last = std::find(addresses_.begin(), addresses_.end(), reached_);
      if (last != addresses_.end()) std::rotate(addresses_.begin(), last + 1, addresses_.end());
      reach(link);
    };
    resolver_.async_resolve(at_.host, std::to_string(at_.port), on_found);
  }

  LinkPtr new_link() {
    link_ = std::make_shared<Link>(executor_, tls_);
    give_up_after(options_.connect_timeout, link_);
    return link_;
  }

  /// One timer over name lookup, connecting and upgrade.
  void give_up_after(milliseconds time, const LinkPtr& link) {
    connect_timer_.expires_after(time);
    connect_timer_.async_wait([this, link, time](error_code ec) {
      if (ec || !is_current(link) || link->opened_us > 0) return;
      down(link, {fail(ErrorCode::kTimeout,
                       where_ + " did not answer within " + std::to_string(time.count()) + " ms, " + link->doing)});
    });
  }

  /// REQUIRES: there are addresses.
  void reach(const LinkPtr& link) {
    link->doing = "connecting";
    several_ = several_ || addresses_.size() > 1;
    reached_ = addresses_.front();
    addresses_.pop_front();
    const auto on_connected = [this, link](error_code ec) {
      if (!is_current(link)) return;
      if (ec) return down(link, {fail(ErrorCode::kUnreachable, "no broker at " + where_ + ": " + ec.message())});
      secure(link);
    };
    beast::get_lowest_layer(link->socket).async_connect(reached_, on_connected);
  }

  void secure(const LinkPtr& link) {
    tune(beast::get_lowest_layer(link->socket).socket());
    link->doing = "securing the connection; does it speak TLS?";
    link->socket.next_layer().async_secure(at_, [this, link](error_code ec) {
      if (!is_current(link)) return;
      if (ec) return down(link, failure_of_handshake(ec, link->socket.next_layer(), at_));
      upgrade(link);
    });
  }

  void upgrade(const LinkPtr& link) {
    link->doing = "waiting for the upgrade; is it an Eigencast broker?";
    link->socket.set_option(ws::stream_base::timeout{ws::stream_base::none(), options_.silence_timeout, true});
    const std::string& token = options_.url.credentials.token;
    link->socket.set_option(ws::stream_base::decorator([token](ws::request_type& request) {
      if (!token.empty()) request.set(beast::http::field::authorization, "Bearer " + token);
      request.set(beast::http::field::sec_websocket_protocol, kProtocol);
    }));
    link->socket.read_message_max(limits::kMaxFrameBytes);
    link->socket.auto_fragment(false);
    link->target = options_.url.prefix + (events_.on_try ? events_.on_try() : options_.target);
    const auto on_upgraded = [this, link, has_token = !token.empty()](error_code ec) {
      if (!is_current(link)) return;
      if (ec) return down(link, failure_of_upgrade(ec, link->response, where_, has_token));
      if (link->response[beast::http::field::sec_websocket_protocol] != kProtocol) {
        const std::string what = where_ + " does not speak " + std::string(kProtocol);
        return down(link, {fail(ErrorCode::kIncompatibleVersion, what), true});
      }
      opened(link);
    };
    link->socket.async_handshake(link->response, at_.authority(), link->target, on_upgraded);
  }

  void opened(const LinkPtr& link) {
    connect_timer_.cancel();
    link->opened_us = steady_now_us();
    {
      const std::lock_guard lock(mutex_);
      hold_off_.reset();
      open_ = true;
      unsent_ = 0;
      ++generation_;
    }
    log(log_, LogLevel::kDebug, "connected to " + where_ + link->target);
    if (several_) at_.address = reached_.address().to_string();
    if (events_.on_open) events_.on_open(at_);
    tick(link);
    read(link);
  }

  void tick(const LinkPtr& link) {
    if (options_.tick == milliseconds(0)) return;
    tick_timer_.expires_after(options_.tick);
    tick_timer_.async_wait([this, link](error_code ec) {
      if (ec || !is_current(link)) return;
      events_.on_tick();
      tick(link);
    });
  }

  void read(const LinkPtr& link) {
    link->socket.async_read(link->in, [this, link](error_code ec, std::size_t) {
      if (!is_current(link)) return;
      if (ec) return down(link, failure_of_close(ec, link->socket.reason(), where_));
      const auto data = link->in.cdata();
      const auto* first = static_cast<const std::uint8_t*>(data.data());
      if (link->socket.got_binary()) {
        if (events_.on_binary) events_.on_binary(ByteView(first, data.size()));
      } else if (data.size() > limits::kMaxControlBytes) {
        // Others may have made it so long through a broker that lets them: it costs that message only.
        log(log_, LogLevel::kWarning,
            where_ + " sent a control message of " + std::to_string(data.size()) +
                " bytes, which is ignored: the limit is 65536");
      } else if (events_.on_text) {
        events_.on_text(std::string_view(static_cast<const char*>(data.data()), data.size()));
      }
      link->in.consume(link->in.size());
      if (is_current(link)) read(link);
    });
  }

  void enqueue(std::uint64_t generation, Outgoing message) {
    if (stopping_ || !link_ || generation != current_generation()) return;
    link_->out.push_back(std::move(message));
    if (!link_->writing) write(link_);
  }

  std::uint64_t current_generation() const {
    const std::lock_guard lock(mutex_);
    return generation_;
  }

  void write(const LinkPtr& link) {
    link->writing = true;
    link->socket.text(link->out.front().text);
    link->socket.async_write(asio::buffer(link->out.front().bytes), [this, link](error_code ec, std::size_t) {
      if (!is_current(link)) return;
      if (ec) return down(link, failure_of_close(ec, link->socket.reason(), where_));
      {
        const std::lock_guard lock(mutex_);
        unsent_ -= std::min(unsent_, link->out.front().bytes.size());
      }
      link->out.pop_front();
      link->writing = false;
      if (!link->out.empty()) write(link);
    });
  }

  void down(const LinkPtr& link, WebSocketFailure failure) {
    if (!is_current(link)) return;
    std::optional<milliseconds> hold_off;
    {
      const std::lock_guard lock(mutex_);
      open_ = false;
      unsent_ = 0;
      ++generation_;
      std::swap(hold_off, hold_off_);
    }
    connect_timer_.cancel();
    resolver_.cancel();
    beast::get_lowest_layer(link->socket).close();
    link_.reset();
    if (link->opened_us == 0 && !failure.refused && !addresses_.empty()) {
      log(log_, LogLevel::kDebug,
          failure.error.message + " (" + reached_.address().to_string() + "); the next address");
      return reach(new_link());
    }
    const TimeUs now = steady_now_us();
    const bool good = link->opened_us > 0 && now - link->opened_us >= kGoodAfterUs;
    if (good) order_.forgive();
    const int failures = order_.count_failure();
    const double unit = std::uniform_real_distribution<double>(0, 1)(random_);
    const milliseconds step(std::llround(1 + unit * std::clamp(hold_off.value_or(kStep), kStep, kMaxStep).count()));
    // A refusal will not change soon: the longest interval at once.
    const bool longest = failure.refused || hold_off == milliseconds(0);
    milliseconds wait = retry_delay(longest ? 64 : failures, options_.first_retry, options_.longest_retry, unit);
    if (good && several_ && !longest) wait = std::min(wait, step);
    // Clients that the broker sent away must not all come back at one moment either.
    if (failure.for_good) return report_down(failure.error, milliseconds(0));
    if (failure.min_wait > wait) wait = retry_delay(1, failure.min_wait, failure.min_wait, unit);
    if (hold_off && *hold_off > wait) wait = *hold_off + milliseconds(std::llround(0.25 * unit * hold_off->count()));
    wait = order_.go_on(now, wait, step);
    if (options_.url.brokers() > 1) {
      failure.error.message += "; next is " + options_.url.at(order_.broker()).origin();
    }
    connect_after(wait);  // First: the handler may throw.
    report_down(failure.error, wait);
  }

  void connect_after(milliseconds wait) {
    retry_timer_.expires_after(wait);
    retry_timer_.async_wait([this](error_code ec) {
      if (!ec) connect();
    });
  }

  /// A handler threw: the connection that it was of is in no known state.
  void recover(const std::string& what) {
    const std::lock_guard turn(turn_);
    if (stopping_) return;
    if (const LinkPtr link = link_) {
      down(link, {fail(ErrorCode::kInternal, "connection to " + where_ + " given up: " + what)});
    } else {
      connect_after(options_.longest_retry);
    }
  }

  void report_down(const Error& why, milliseconds wait) {
    if (!stopping_ && events_.on_down) events_.on_down(why, wait);
  }

  void close_politely() {
    stopping_ = true;
    bool was_open = false;
    {
      const std::lock_guard lock(mutex_);
      was_open = open_;
      open_ = false;
      ++generation_;
    }
    work_.reset();
    connect_timer_.cancel();
    retry_timer_.cancel();
    resolver_.cancel();
    tick_timer_.cancel();
    if (!link_) return;
    // Gone with its last handler: the timer of its pings would keep the thread for half of silence_timeout.
    const LinkPtr link = std::exchange(link_, nullptr);
    if (!was_open) return beast::get_lowest_layer(link->socket).close();
    stop_timer_.expires_after(kPoliteClose);
    stop_timer_.async_wait([link](error_code ec) {
      if (!ec) beast::get_lowest_layer(link->socket).close();
    });
    link->socket.async_close(ws::close_code::normal, [this, link](error_code) {
      stop_timer_.cancel();
      beast::get_lowest_layer(link->socket).close();
    });
  }

  const WebSocketOptions options_;
  const WebSocketEvents events_;
  const LogSink log_;

  /// Held by every handler, and by callers while they write; taken before mutex_.
  std::recursive_mutex turn_;
  asio::io_context io_;
  asio::executor_work_guard<asio::io_context::executor_type> work_;
  const asio::any_io_executor executor_{LockingExecutor(io_.get_executor(), turn_)};
  tcp::resolver resolver_{executor_};
  asio::steady_timer connect_timer_{executor_};
  asio::steady_timer retry_timer_{executor_};
  asio::steady_timer tick_timer_{executor_};
  asio::steady_timer stop_timer_{executor_};

  // GUARDED_BY(turn_), what follows up to mutex_.
  std::minstd_rand random_;
  ClientTls tls_;  ///< Made by the first try.
  LinkPtr link_;
  BrokerOrder order_;
  BrokerUrl at_;  ///< The broker that is tried or connected to.
  std::string where_;
  std::deque<tcp::endpoint> addresses_;  ///< Of its name, those that have not been tried yet.
  tcp::endpoint reached_;                ///< The one tried last.
  bool several_ = false;                 ///< The name has more than one.
  bool stopping_ = false;

  mutable std::mutex mutex_;
  bool open_ = false;                     ///< GUARDED_BY(mutex_)
  std::size_t unsent_ = 0;                ///< GUARDED_BY(mutex_)
  std::size_t posted_ = 0;                ///< GUARDED_BY(mutex_); messages on their way to the connection's thread.
  std::optional<milliseconds> hold_off_;  ///< GUARDED_BY(mutex_)
  std::uint64_t generation_ =
      0;  ///< GUARDED_BY(mutex_); grows at each open and each down, so that no message crosses them.

  std::mutex stop_mutex_;
  std::thread thread_;  ///< GUARDED_BY(stop_mutex_) after construction
};

}  // namespace

std::unique_ptr<WebSocket> WebSocket::start(WebSocketOptions options, WebSocketEvents events, LogSink log) {
  return std::make_unique<BeastWebSocket>(std::move(options), std::move(events), std::move(log));
}

}  // namespace eigencast
