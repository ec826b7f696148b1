// SPDX-License-Identifier: MIT
#include "broker/backbone/nats_link.h"

#include <sys/socket.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <random>
#include <utility>

#include "broker/backbone/nats_link_impl.h"
#include "broker/config/config.h"
#include "common/core/clock.h"
#include "common/core/text.h"
#include "common/core/user_info.h"

namespace eigencast::broker {
namespace {

using std::chrono_literals::operator""ms;
using std::chrono_literals::operator""s;

constexpr std::int64_t kMaxWaitingBytes = 32 << 20;  ///< Bounds outgoing messages; one holder's are a fifth.
constexpr int kBatch = 256;                          ///< Messages that go between turns of holders.
constexpr std::size_t kMessageBytes = 256;           ///< What a message takes besides its data.
constexpr auto kDrainTime = 1s;                      ///< Time to send the queue when stopping, and to end all else.
constexpr auto kTryTime = 2s;                        ///< To connect to a server, its TLS handshake included.
constexpr auto kRetryTime = 250ms;                   ///< After all servers have been tried, or a connection was made.
constexpr std::size_t kMaxServers = 64;              ///< Those that servers name included.
constexpr std::string_view kInbox = "_INBOX.";
constexpr auto kClockStep = 1s;  ///< A wall clock that goes back by more was set.

/// No broker sends one. Status messages of JetStream, and what it publishes again, have one.
bool has_header(natsMsg* message) {
  const char** keys = nullptr;
  int count = 0;
  const natsStatus status = natsMsgHeader_Keys(message, &keys, &count);
  std::free(keys);
  return status != NATS_NOT_FOUND;
}

Bytes data_of(natsMsg* message) {
  const auto* data = reinterpret_cast<const std::uint8_t*>(natsMsg_GetData(message));
  return {data, data + natsMsg_GetDataLength(message)};
}

/// How far the wall clock is ahead of the steady one.
std::chrono::nanoseconds wall_ahead() {
  return std::chrono::microseconds(unix_at_steady_zero_us());
}

std::string bucket_of(std::string prefix) {
  std::replace(prefix.begin(), prefix.end(), '.', '_');
  return prefix + "_streams";
}

/// libnats shows its socket to nobody; it is the only one here that closes with a reset (SO_LINGER of 0 s).
void shut_down_sockets() {
  std::error_code error;
  for (std::filesystem::directory_iterator it("/proc/self/fd", error), end; !error && it != end; it.increment(error)) {
    const int fd = std::atoi(it->path().filename().c_str());
    linger closing = {};
    socklen_t size = sizeof closing;
    const bool is_its =
        ::getsockopt(fd, SOL_SOCKET, SO_LINGER, &closing, &size) == 0 && closing.l_onoff != 0 && closing.l_linger == 0;
    if (is_its) ::shutdown(fd, SHUT_RDWR);
  }
}

/// The closure of libnats' callbacks on a link's connections. They come on its threads, possibly after the link's end:
/// so it is kept, once for each link.
void* closure_of(std::weak_ptr<NatsLink> link) {
  static std::mutex mutex;
  static auto& kept = *new std::deque<std::weak_ptr<NatsLink>>;
  const std::lock_guard lock(mutex);
  return &kept.emplace_back(std::move(link));
}

}  // namespace

NatsLink::NatsLink(Settings settings, OptionsPtr options, std::function<void(std::function<void()>)> on_loop)
    : settings_(std::move(settings)),
      bucket_(bucket_of(settings_.prefix)),
      inbox_(std::string(kInbox) + settings_.id + "." + random_id(32)),
      options_(std::move(options)),
      servers_(settings_.servers),
      on_loop_(std::move(on_loop)) {
  std::shuffle(servers_.begin(), servers_.end(), std::minstd_rand(std::random_device{}()));
}

/// Does nothing after stop(): the loop may be destroyed.
void NatsLink::to_loop(std::function<void()> work) {
  const std::lock_guard lock(mutex_);
  if (!stopping_) on_loop_(std::move(work));
}

void NatsLink::post_to_listener(std::function<void()> work) {
  to_loop([self = shared_from_this(), work = std::move(work)] {
    if (*self->open_) work();
  });
}

/// Call after each change of news_.
void NatsLink::report_connection() {
  wake_.notify_all();
  post_to_listener([this] {
    std::unique_lock lock(mutex_);
    const ConnectionNews news = std::exchange(news_, {});
    lock.unlock();
    news.report(*listener_);
  });
}

/// Libnats has closed the connection.
void NatsLink::on_closed(natsConnection* connection) {
  const char* text = nullptr;
  natsConnection_GetLastError(connection, &text);
  const std::string why = text != nullptr && *text != 0 ? text : "the connection to the NATS server is gone";
  {
    const std::lock_guard lock(mutex_);
    if (connection_.get() != connection || !connected_) return;
    connected_ = false;
    outgoing_ = {};  // Old frames are useless after a reconnection.
    news_.note_lost(why);
  }
  report_connection();
}

/// Tries the next server.
void NatsLink::connect() {
  const std::string server = servers_[tries_ % servers_.size()];
  const char* name = server.c_str();
  natsOptions_SetServers(options_.get(), &name, 1);
  std::unique_lock lock(mutex_);
  if (wake_.wait_until(lock, made_ + kRetryTime, [this] { return stopping_; })) return;
  try_until_ = std::chrono::steady_clock::now() + kTryTime;
  lock.unlock();
  natsConnection* made = nullptr;
  const natsStatus status = natsConnection_Connect(&made, options_.get());
  lock.lock();
  try_until_.reset();
  lock.unlock();
  if (status != NATS_OK) {
    natsConnection_Destroy(made);
    if (++tries_ % servers_.size() != 0) return;  // The next one at once.
    const char* error = nats_GetLastError(nullptr);
    const std::string why = std::string("no NATS server takes this broker yet") +
                            (error != nullptr && *error != 0 ? " (" + std::string(error) + ")" : std::string());
    lock.lock();
    news_.note_lost(why);
    lock.unlock();
    report_connection();
    lock.lock();
    wake_.wait_for(lock, kRetryTime, [this] { return stopping_; });
    return;
  }
  made_ = std::chrono::steady_clock::now();
  tries_ = 1;  // The next one after it.
  servers_ = settings_.servers;
  std::rotate(servers_.begin(), std::find(servers_.begin(), servers_.end(), server), servers_.end());
  char** named = nullptr;
  int count = 0;
  natsConnection_GetDiscoveredServers(made, &named, &count);
  for (int i = 0; i < count; ++i) {
    if (servers_.size() < kMaxServers) servers_.emplace_back(named[i]);
    std::free(named[i]);
  }
  std::free(named);
  lock.lock();
  const auto last = std::exchange(connection_, {made, natsConnection_Destroy});
  subscribed_changed_ = connected_ = true;
  ++generation_;
  news_.note_connected();
  lock.unlock();
  report_connection();
  if (natsConnection_IsClosed(made)) on_closed(made);  // It was before it was known here.
}

/// Ends a try to connect that is late, or any when stopping. `lock`: of mutex_.
void NatsLink::end_try(std::unique_lock<std::mutex>& lock) {
  const auto now = std::chrono::steady_clock::now();
  if (!try_until_ || (!stopping_ && now < *try_until_)) return;
  try_until_ = now + kRetryTime;
  lock.unlock();
  shut_down_sockets();
  lock.lock();
}

void NatsLink::run(std::thread& thread, void (NatsLink::*work)()) {
  {
    const std::lock_guard lock(mutex_);
    ++running_;
  }
  thread = std::thread([self = shared_from_this(), work] {
    ((*self).*work)();
    const std::lock_guard lock(self->mutex_);
    --self->running_;
    self->wake_.notify_all();
  });
}

void NatsLink::start(Listener& listener) {
  listener_ = &listener;
  // Messages lost by slow consumers show up as gaps. Replaces libnats' handler, which prints.
  natsOptions_SetErrorHandler(
      options_.get(), [](natsConnection*, natsSubscription*, natsStatus, void*) {}, nullptr);
  natsOptions_SetClosedCB(
      options_.get(),
      [](natsConnection* connection, void* of) {
        if (const auto link = static_cast<std::weak_ptr<NatsLink>*>(of)->lock()) link->on_closed(connection);
      },
      closure_of(weak_from_this()));
  subscriptions_.push_back(listen(inbox_ + ".*", [this](Incoming incoming) {
    const auto found = requests_.find(incoming.subject.substr(inbox_.size() + 1));
    if (found == requests_.end()) return;
    const Answer answer = std::move(found->second.answer);
    requests_.erase(found);
    if (incoming.unheard) return answer(fail(ErrorCode::kUnreachable, "the broker that should answer is not there"));
    answer(std::move(incoming.message));
  }));
  const std::string rows = settings_.prefix + ".rows.";
  subscriptions_.push_back(subscribe(rows + ">", [this, rows](const std::string& subject, const Bytes& message) {
    take_row(subject.substr(rows.size()), message);
  }));
  run(sender_, &NatsLink::send_all);
  run(writer_, &NatsLink::write_all);
  run(reader_, &NatsLink::read_table);
}

void NatsLink::stop() {
  std::unique_lock lock(mutex_);
  if (stopping_) return;
  stopping_ = true;
  const auto until = std::chrono::steady_clock::now() + settings_.stop_within;
  drain_until_ = until - settings_.stop_within / 2;
  *open_ = false;
  wake_.notify_all();
  while (running_ > 0 && std::chrono::steady_clock::now() < until) {
    end_try(lock);
    wake_.wait_for(lock, 20ms);
  }
  const bool ended = running_ == 0;
  lock.unlock();
  // What libnats holds up (a name that no server resolves) owns the link, and ends it.
  for (std::thread* thread : {&sender_, &writer_, &reader_}) {
    if (thread->joinable()) ended ? thread->join() : thread->detach();
  }
  subscriptions_.clear();
  requests_.clear();
}

/// On the sender's thread: libnats may block.
void NatsLink::close() {
  std::unique_lock lock(mutex_);
  wake_.wait_until(lock, drain_until_, [this] { return written_; });
  const auto subscribed = std::exchange(subscribed_, {});
  const auto connection = connection_;
  lock.unlock();
  for (const auto& each : subscribed) renew(each, nullptr);
  if (!connection) return;
  natsConnection_FlushTimeout(connection.get(), 200);
  natsConnection_Close(connection.get());
}

void NatsLink::send(Outgoing message, const std::string& holder) {
  const std::lock_guard lock(mutex_);
  const auto cost = static_cast<std::int64_t>(kMessageBytes + message.message.size());
  if (connected_ && outgoing_.push(holder, cost, std::move(message), kMaxWaitingBytes)) wake_.notify_all();
}

void NatsLink::send_all() {
  auto ahead = wall_ahead();
  std::unique_lock lock(mutex_);
  for (;;) {
    wake_.wait_for(lock, 50ms, [this] { return stopping_ || subscribed_changed_ || !outgoing_.empty(); });
    if (stopping_ && (outgoing_.empty() || std::chrono::steady_clock::now() >= drain_until_)) break;
    end_try(lock);
    std::vector<Outgoing> batch;
    for (int i = 0; i < kBatch && !outgoing_.empty(); ++i) batch.push_back(outgoing_.pop().item);
    const auto connection = connection_;
    std::vector<std::shared_ptr<Subscribed>> changed;
    if (std::exchange(subscribed_changed_, false)) {
      changed = subscribed_;
      std::erase_if(subscribed_, [](const auto& subscribed) { return !subscribed->wanted; });
    }
    lock.unlock();
    // libnats waits, also for its next ping, until times of the wall clock; the end of a connection ends these waits.
    const auto before = std::exchange(ahead, wall_ahead());
    if (connection && ahead < before - kClockStep) natsConnection_Close(connection.get());
    for (const auto& subscribed : changed) renew(subscribed, connection);
    for (const Outgoing& out : batch) {
      const int size = static_cast<int>(out.message.size());
      // Errors are ignored: receivers handle gaps and missing heartbeats.
      if (out.reply.empty()) {
        natsConnection_Publish(connection.get(), out.subject.c_str(), out.message.data(), size);
      } else {
        natsConnection_PublishRequest(connection.get(), out.subject.c_str(), out.reply.c_str(), out.message.data(),
                                      size);
      }
    }
    expire_requests();
    lock.lock();
  }
  lock.unlock();
  close();
}

/// Subscribes at a new connection, unsubscribes what is not wanted.
void NatsLink::renew(const std::shared_ptr<Subscribed>& subscribed, const std::shared_ptr<natsConnection>& connection) {
  if (subscribed->wanted && subscribed->connection == connection) return;
  subscribed->subscription.reset();
  subscribed->connection = connection;
  if (!subscribed->wanted || !connection) return;
  natsSubscription* subscription = nullptr;
  auto* closure = new std::shared_ptr<Subscribed>(subscribed);
  const natsStatus status = natsConnection_Subscribe(
      &subscription, connection.get(), subscribed->subject.c_str(),
      [](natsConnection*, natsSubscription*, natsMsg* raw, void* heard_by) {
        const MessagePtr message(raw);
        const auto& listening = *static_cast<std::shared_ptr<Subscribed>*>(heard_by);
        if (const auto link = listening->link.lock()) listening->heard(raw);
      },
      closure);
  if (status != NATS_OK) {
    delete closure;
    return;
  }
  natsSubscription_SetOnCompleteCB(
      subscription, [](void* ended) { delete static_cast<std::shared_ptr<Subscribed>*>(ended); }, closure);
  subscribed->subscription = {subscription, [](natsSubscription* ended) {
                                natsSubscription_Unsubscribe(ended);
                                natsSubscription_Destroy(ended);
                              }};
}

std::shared_ptr<void> NatsLink::subscribe_raw(const std::string& subject, std::function<void(natsMsg*)> heard) {
  const std::shared_ptr<Subscribed> subscribed(new Subscribed{weak_from_this(), subject, std::move(heard)});
  const std::lock_guard lock(mutex_);
  if (stopping_) return nullptr;
  subscribed_.push_back(subscribed);
  subscribed_changed_ = true;
  wake_.notify_all();
  return {subscribed.get(), [subscribed](Subscribed* ended) {
            ended->wanted = false;
            const auto link = ended->link.lock();
            if (!link) return;
            const std::lock_guard changing(link->mutex_);
            link->subscribed_changed_ = true;
          }};
}

std::shared_ptr<void> NatsLink::subscribe(const std::string& subject, Handler handler) {
  return listen(subject, [handler = std::move(handler)](Incoming incoming) {
    if (incoming.unheard || !incoming.reply.empty()) return;  // What JetStream delivers names where to confirm it.
    handler(incoming.subject, std::move(incoming.message));
  });
}

std::shared_ptr<void> NatsLink::serve(const std::string& subject, OnRequest on_request) {
  return listen(subject, [weak = weak_from_this(), on_request = std::move(on_request)](Incoming incoming) {
    if (!incoming.reply.starts_with(kInbox)) return;  // Who asks must not choose what this broker says elsewhere.
    on_request(std::move(incoming.message), [weak, reply = std::move(incoming.reply)](Bytes answer) {
      if (const auto link = weak.lock()) link->publish(reply, std::move(answer), std::string(kInbox));
    });
  });
}

std::shared_ptr<void> NatsLink::listen(const std::string& subject, std::function<void(Incoming)> handler) {
  // The subscription alone owns the handler.
  const auto owned = std::make_shared<std::function<void(Incoming)>>(std::move(handler));
  const auto waiting = std::make_shared<std::atomic<std::size_t>>(0);
  const bool below = subject.ends_with('>') || subject.ends_with('*');
  const std::string wanted = subject.substr(0, subject.size() - (below ? 1 : 0));
  const auto hear = [this, weak = std::weak_ptr(owned), waiting, below, wanted](natsMsg* message) {
    // JetStream delivers rows to whatever subject a consumer names: they keep their own. Its answers do not, which are
    // JSON: each handler refuses that.
    const std::string_view own = natsMsg_GetSubject(message);
    if (below ? !own.starts_with(wanted) : own != wanted) return;
    const bool unheard = natsMsg_IsNoResponders(message);
    if (!unheard && has_header(message)) return;
    const std::size_t cost = kMessageBytes + static_cast<std::size_t>(natsMsg_GetDataLength(message));
    const std::size_t free = kMaxUndeliveredBytes - std::min<std::size_t>(undelivered_, kMaxUndeliveredBytes);
    if (*waiting + cost > free / 4) return;  // A flood of one subject leaves room for others.
    *waiting += cost;
    undelivered_ += cost;
    const char* reply = natsMsg_GetReply(message);
    to_loop([self = shared_from_this(), weak, waiting, cost,
             incoming = Incoming{natsMsg_GetSubject(message), reply == nullptr ? "" : reply, unheard,
                                 data_of(message)}]() mutable {
      *waiting -= cost;
      self->undelivered_ -= cost;
      const auto hears = weak.lock();
      if (*self->open_ && hears) (*hears)(std::move(incoming));
    });
  };
  return std::shared_ptr<void>(owned.get(), [owned, subscription = subscribe_raw(subject, hear)](void*) {});
}

void NatsLink::ask(const std::string& subject, Bytes message, TimeUs timeout_us, Answer answer) {
  const std::string token = random_id(32);  // Those that have seen one reply subject know no other.
  requests_[token] = {std::move(answer), std::chrono::steady_clock::now() + std::chrono::microseconds(timeout_us)};
  waiting_ = true;
  send({subject, inbox_ + "." + token, std::move(message)}, {});
}

/// Called on the sender's thread, which wakes every 50 ms.
void NatsLink::expire_requests() {
  if (!waiting_) return;
  post_to_listener([this] {
    const auto now = std::chrono::steady_clock::now();
    std::vector<Answer> late;
    std::erase_if(requests_, [&](auto& item) {
      if (item.second.until > now) return false;
      late.push_back(std::move(item.second.answer));
      return true;
    });
    waiting_ = !requests_.empty();
    for (const Answer& answer : late) answer(fail(ErrorCode::kTimeout, "another broker did not answer in time"));
  });
}

Result<std::shared_ptr<Link>> make_nats_link(const Config& config, const std::string& id,
                                             std::function<void(std::function<void()>)> on_loop) {
  const auto& settings = config.backbone;
  nats_Open(-1);
  nats_SetMessageDeliveryPoolSize(1);  // One thread keeps messages in order.
  natsOptions* raw = nullptr;
  if (natsOptions_Create(&raw) != NATS_OK) return fail(ErrorCode::kIo, "NATS: no memory");
  OptionsPtr options(raw);
  std::vector<const char*> servers;
  Result<void> result;
  for (const std::string& server : settings.servers) {
    servers.push_back(server.c_str());
    if (server.starts_with("nats://") || server.starts_with("tls://") || !result) continue;
    result = fail(ErrorCode::kInvalidArgument,
                  "backbone.servers: '" + without_user_info(server) + "' is not nats://HOST:PORT or tls://HOST:PORT");
  }
  const auto set = [&](natsStatus status, const std::string& what) {
    if (status == NATS_OK || !result) return;
    result = fail(ErrorCode::kInvalidArgument, "backbone." + what + ": " + natsStatus_GetText(status));
  };
  set(natsOptions_SetServers(raw, servers.data(), static_cast<int>(servers.size())), "servers");
  set(natsOptions_SetName(raw, ("eigencast-broker " + id).c_str()), "name");
  set(natsOptions_SetCustomInboxPrefix(raw, (std::string(kInbox) + id).c_str()), "name");
  set(natsOptions_SetTimeout(raw, 1'000), "servers");
  set(natsOptions_SetAllowReconnect(raw, false), "servers");
  // An unreachable server is abandoned after two pings without an answer, 1.2 s at most, so that frames continue over
  // another one within two seconds.
  set(natsOptions_SetPingInterval(raw, 400), "servers");
  set(natsOptions_SetMaxPingsOut(raw, 2), "servers");
  set(natsOptions_SetWriteDeadline(raw, 2'000), "servers");
  set(natsOptions_SetSendAsap(raw, true), "servers");
  set(natsOptions_UseGlobalMessageDelivery(raw, true), "servers");
  const auto file = [](const std::string& name) { return resolved_path(name); };
  // libnats does not read tls:// as a demand: by default it follows a server that offers plain text.
  const bool secure = !settings.ca.empty() || !settings.certificate.empty() ||
                      std::any_of(settings.servers.begin(), settings.servers.end(),
                                  [](const std::string& server) { return server.starts_with("tls://"); });
  if (secure) set(natsOptions_SetSecure(raw, true), "servers");
  if (!settings.ca.empty()) set(natsOptions_LoadCATrustedCertificates(raw, file(settings.ca).c_str()), "ca");
  if (!settings.certificate.empty()) {
    set(natsOptions_LoadCertificatesChain(raw, file(settings.certificate).c_str(), file(settings.key).c_str()),
        "certificate");
  }
  if (!settings.credentials.empty()) {
    set(natsOptions_SetUserCredentialsFromFiles(raw, file(settings.credentials).c_str(), nullptr), "credentials");
  }
  if (!settings.user.empty()) {
    set(natsOptions_SetUserInfo(raw, settings.user.c_str(), settings.password.c_str()), "user");
  }
  if (!settings.token.empty()) set(natsOptions_SetToken(raw, settings.token.c_str()), "token");
  if (!result) return result.error();
  const auto stop_within =
      std::min<std::chrono::steady_clock::duration>(kDrainTime, std::chrono::milliseconds(config.timeouts.shutdown_ms));
  auto link = std::make_shared<NatsLink>(
      NatsLink::Settings{settings.prefix, id, static_cast<int>(settings.replicas), settings.servers, stop_within},
      std::move(options), std::move(on_loop));
  Link* raw_link = link.get();
  // Callbacks of libnats and work on the loop may outlive the owner: its end stops the link.
  return std::shared_ptr<Link>(raw_link, [link = std::move(link)](Link*) { link->stop(); });
}

}  // namespace eigencast::broker
