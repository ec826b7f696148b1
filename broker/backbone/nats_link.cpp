// SPDX-License-Identifier: MIT
#include "broker/backbone/nats_link.h"

#include <algorithm>
#include <utility>

#include "broker/backbone/nats_link_impl.h"
#include "broker/config/config.h"
#include "common/core/text.h"

namespace eigencast::broker {
namespace {

using std::chrono_literals::operator""ms;
using std::chrono_literals::operator""s;

constexpr std::size_t kMaxWaitingBytes = 8u << 20;  ///< Bounds outgoing messages.
constexpr std::size_t kMaxWaitingMessages = 16'384;
constexpr int kMaxUndelivered = 16'384;  ///< Messages on their way to the loop.
constexpr auto kDrainTime = 1s;          ///< Time to send the queue when stopping.

Bytes data_of(natsMsg* message) {
  const auto* data = reinterpret_cast<const std::uint8_t*>(natsMsg_GetData(message));
  return {data, data + natsMsg_GetDataLength(message)};
}

std::string bucket_of(std::string prefix) {
  for (char& c : prefix) {
    if (c == '.') c = '_';
  }
  return prefix + "_streams";
}

/// The closure of libnats' callbacks on a link's connections. They come on its threads, possibly after the link's end,
/// and a connection that could not be made may report its end or not: so it is kept, once for each link.
void* closure_of(std::weak_ptr<NatsLink> link) {
  static std::mutex mutex;
  static auto& kept = *new std::deque<std::weak_ptr<NatsLink>>;
  const std::lock_guard lock(mutex);
  return &kept.emplace_back(std::move(link));
}

std::shared_ptr<NatsLink> link_of(void* closure) {
  return static_cast<std::weak_ptr<NatsLink>*>(closure)->lock();
}

}  // namespace

NatsLink::NatsLink(std::string prefix, int replicas, OptionsPtr options,
                   std::function<void(std::function<void()>)> on_loop)
    : prefix_(std::move(prefix)),
      replicas_(replicas),
      bucket_(bucket_of(prefix_)),
      inbox_("_INBOX." + random_id(32)),
      options_(std::move(options)),
      on_loop_(std::move(on_loop)) {}

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

void NatsLink::on_up() {
  {
    const std::lock_guard lock(mutex_);
    connected_ = true;
    ++generation_;
  }
  wake_.notify_all();
  post_to_listener([this] { listener_->on_connected(); });
}

void NatsLink::on_down(const std::string& why, std::optional<std::uint64_t> generation) {
  {
    const std::lock_guard lock(mutex_);
    if (generation && *generation != generation_) return;  // Connected meanwhile.
    connected_ = false;
    outgoing_.clear();  // Old frames are useless after a reconnection.
    outgoing_bytes_ = 0;
  }
  post_to_listener([this, why] { listener_->on_disconnected(why); });
}

void NatsLink::on_closed() {
  const std::lock_guard lock(mutex_);
  closed_ = true;
}

void NatsLink::listen_to_connection() {
  void* closure = closure_of(weak_from_this());
  const natsConnectionHandler up = [](natsConnection*, void* of) {
    if (const auto link = link_of(of)) link->on_up();
  };
  natsOptions_SetReconnectedCB(options_.get(), up, closure);
  natsOptions_SetRetryOnFailedConnect(options_.get(), true, up, closure);
  natsOptions_SetDisconnectedCB(
      options_.get(),
      [](natsConnection* connection, void* of) {
        const char* text = nullptr;
        natsConnection_GetLastError(connection, &text);
        const std::string why = text != nullptr && *text != 0 ? text : "the connection to the NATS server is gone";
        if (const auto link = link_of(of)) link->on_down(why);
      },
      closure);
  natsOptions_SetClosedCB(
      options_.get(),
      [](natsConnection*, void* of) {
        if (const auto link = link_of(of)) link->on_closed();
      },
      closure);
  // Replaces libnats' handler, which prints. Messages lost by slow consumers show up as gaps.
  natsOptions_SetErrorHandler(
      options_.get(), [](natsConnection*, natsSubscription*, natsStatus, void*) {}, nullptr);
}

/// Makes the connection, and a new one after libnats has closed it: whatever its options say, libnats gives up after a
/// second refusal of the credentials, most other errors, and any failure of the first handshake.
void NatsLink::connect() {
  std::unique_lock lock(mutex_);
  closed_ = false;
  const std::uint64_t generation = generation_;
  lock.unlock();
  natsConnection* connection = nullptr;
  const natsStatus status = natsConnection_Connect(&connection, options_.get());
  lock.lock();
  connection_.reset(connection, natsConnection_Destroy);
  subscribed_changed_ = true;
  if (connection == nullptr) closed_ = true;
  lock.unlock();
  if (status == NATS_OK) return on_up();
  const char* why = nats_GetLastError(nullptr);
  on_down(std::string("no NATS server takes this broker yet") +
              (why != nullptr && *why != 0 ? " (" + std::string(why) + ")" : std::string()),
          generation);
}

void NatsLink::start(Listener& listener) {
  listener_ = &listener;
  listen_to_connection();
  connect();
  subscriptions_.push_back(subscribe_raw(inbox_ + ".*", [this](natsMsg* message) {
    const std::string subject = natsMsg_GetSubject(message);
    const std::uint64_t number = std::strtoull(subject.c_str() + inbox_.size() + 1, nullptr, 10);
    const bool nobody = natsMsg_IsNoResponders(message);
    post_to_listener([this, number, nobody, data = data_of(message)]() mutable {
      const auto found = requests_.find(number);
      if (found == requests_.end()) return;
      const Answer answer = std::move(found->second.answer);
      requests_.erase(found);
      if (nobody) return answer(fail(ErrorCode::kUnreachable, "the broker that should answer is not there"));
      answer(std::move(data));
    });
  }));
  subscriptions_.push_back(subscribe(prefix_ + ".rows", [this](const Bytes& message) { take_row(message); }));
  sender_ = std::thread([this] { send_all(); });
  writer_ = std::thread([this] { write_all(); });
  reader_ = std::thread([this] { read_table(); });
}

void NatsLink::stop() {
  {
    const std::lock_guard lock(mutex_);
    if (stopping_) return;
    stopping_ = true;
    drain_until_ = std::chrono::steady_clock::now() + kDrainTime;
  }
  *open_ = false;
  wake_.notify_all();
  for (std::thread* thread : {&sender_, &writer_, &reader_}) {
    if (thread->joinable()) thread->join();
  }
  subscriptions_.clear();
  requests_.clear();
  for (const auto& subscribed : std::exchange(subscribed_, {})) renew(subscribed, nullptr);
  if (connection_) {
    natsConnection_FlushTimeout(connection_.get(), 300);
    natsConnection_Close(connection_.get());
  }
}

void NatsLink::send(const std::string& subject, Bytes message, const std::string& reply) {
  const std::lock_guard lock(mutex_);
  const bool full = outgoing_.size() >= kMaxWaitingMessages || outgoing_bytes_ + message.size() > kMaxWaitingBytes;
  if (!connected_ || full) return;
  outgoing_bytes_ += message.size();
  outgoing_.push_back({subject, reply, std::move(message)});
  wake_.notify_all();
}

void NatsLink::send_all() {
  std::unique_lock lock(mutex_);
  for (;;) {
    wake_.wait_for(lock, 50ms, [this] { return stopping_ || subscribed_changed_ || !outgoing_.empty(); });
    if (stopping_ && (outgoing_.empty() || std::chrono::steady_clock::now() >= drain_until_)) return;
    auto batch = std::exchange(outgoing_, {});
    outgoing_bytes_ = 0;
    const auto connection = connection_;
    std::vector<std::shared_ptr<Subscribed>> changed;
    if (std::exchange(subscribed_changed_, false)) {
      changed = subscribed_;
      std::erase_if(subscribed_, [](const auto& subscribed) { return !subscribed->wanted; });
    }
    lock.unlock();
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
}

/// Subscribes at a new connection, unsubscribes what is not wanted. Blocks while libnats connects.
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
  return subscribe_with_reply(
      subject, [handler = std::move(handler)](Bytes message, const std::string&) { handler(std::move(message)); });
}

std::shared_ptr<void> NatsLink::serve(const std::string& subject, OnRequest on_request) {
  return subscribe_with_reply(
      subject, [weak = weak_from_this(), on_request = std::move(on_request)](Bytes message, std::string reply) {
        on_request(std::move(message), [weak, reply = std::move(reply)](Bytes answer) {
          if (const auto link = weak.lock()) link->publish(reply, std::move(answer));
        });
      });
}

std::shared_ptr<void> NatsLink::subscribe_with_reply(const std::string& subject,
                                                     std::function<void(Bytes, std::string)> handler) {
  // The subscription alone owns the handler.
  const auto owned = std::make_shared<std::function<void(Bytes, std::string)>>(std::move(handler));
  const auto subscription = subscribe_raw(subject, [this, weak = std::weak_ptr(owned)](natsMsg* message) {
    if (undelivered_.fetch_add(1) >= kMaxUndelivered) {
      --undelivered_;
      return;
    }
    const char* reply = natsMsg_GetReply(message);
    to_loop([self = shared_from_this(), weak, data = data_of(message),
             reply = std::string(reply == nullptr ? "" : reply)]() mutable {
      --self->undelivered_;
      const auto wanted = weak.lock();
      if (*self->open_ && wanted) (*wanted)(std::move(data), std::move(reply));
    });
  });
  return std::shared_ptr<void>(owned.get(), [owned, subscription](void*) {});
}

void NatsLink::ask(const std::string& subject, Bytes message, TimeUs timeout_us, Answer answer) {
  const std::uint64_t number = ++last_request_;
  requests_[number] = {std::move(answer), std::chrono::steady_clock::now() + std::chrono::microseconds(timeout_us)};
  waiting_ = true;
  send(subject, std::move(message), inbox_ + "." + std::to_string(number));
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
                  "backbone.servers: '" + server + "' is not nats://HOST:PORT or tls://HOST:PORT");
  }
  const auto set = [&](natsStatus status, const std::string& what) {
    if (status == NATS_OK || !result) return;
    result = fail(ErrorCode::kInvalidArgument, "backbone." + what + ": " + natsStatus_GetText(status));
  };
  set(natsOptions_SetServers(raw, servers.data(), static_cast<int>(servers.size())), "servers");
  set(natsOptions_SetName(raw, ("eigencast-broker " + id).c_str()), "name");
  set(natsOptions_SetTimeout(raw, 1'000), "servers");
  set(natsOptions_SetMaxReconnect(raw, -1), "servers");
  set(natsOptions_SetReconnectWait(raw, 250), "servers");
  set(natsOptions_SetReconnectJitter(raw, 100, 200), "servers");
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
  auto link = std::make_shared<NatsLink>(settings.prefix, static_cast<int>(settings.replicas), std::move(options),
                                         std::move(on_loop));
  Link* raw_link = link.get();
  // Callbacks of libnats and work on the loop may outlive the owner: its end stops the link.
  return std::shared_ptr<Link>(raw_link, [link = std::move(link)](Link*) { link->stop(); });
}

}  // namespace eigencast::broker
