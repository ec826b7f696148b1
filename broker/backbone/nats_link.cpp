// SPDX-License-Identifier: MIT
#include "broker/backbone/nats_link.h"

#include <nats/nats.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <map>
#include <mutex>
#include <random>
#include <thread>
#include <utility>

namespace eigencast::broker {
namespace {

using namespace std::chrono_literals;

constexpr std::size_t kMaxWaitingBytes = 8u << 20;  ///< Of messages that are to leave.
constexpr std::size_t kMaxWaitingMessages = 16'384;
constexpr int kMaxComing = 16'384;  ///< Messages on their way to the loop.
constexpr std::int64_t kTableTimeoutMs = 2'000;
constexpr auto kReread = 60s;  ///< The table is read again so often, whatever was told meanwhile.
constexpr auto kLeave = 1s;    ///< What waits when stopping gets so long to leave.

template <auto destroy>
struct Destroyer {
  template <typename T>
  void operator()(T* object) const {
    destroy(object);
  }
};
using OptionsPtr = std::unique_ptr<natsOptions, Destroyer<natsOptions_Destroy>>;
using ConnectionPtr = std::unique_ptr<natsConnection, Destroyer<natsConnection_Destroy>>;
using MessagePtr = std::unique_ptr<natsMsg, Destroyer<natsMsg_Destroy>>;
using JetStreamPtr = std::unique_ptr<jsCtx, Destroyer<jsCtx_Destroy>>;
using StorePtr = std::unique_ptr<kvStore, Destroyer<kvStore_Destroy>>;
using WatcherPtr = std::unique_ptr<kvWatcher, Destroyer<kvWatcher_Destroy>>;
using EntryPtr = std::unique_ptr<kvEntry, Destroyer<kvEntry_Destroy>>;

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

std::string random_token() {
  std::random_device device;
  std::string token;
  for (int i = 0; i < 22; ++i) token += "abcdefghijklmnopqrstuvwxyz012345"[device() & 31];
  return token;
}

}  // namespace

class NatsLink::Impl : public std::enable_shared_from_this<Impl> {
 public:
  Impl(Settings settings, OptionsPtr options, std::function<void(std::function<void()>)> on_loop)
      : settings_(std::move(settings)),
        bucket_(bucket_of(settings_.prefix)),
        inbox_("_INBOX." + random_token()),
        options_(std::move(options)),
        on_loop_(std::move(on_loop)) {}
  ~Impl() { stop(); }

  void start(Listener& listener);
  void stop();
  void publish(const std::string& subject, Bytes message, const std::string& reply = {});
  std::shared_ptr<void> subscribe(const std::string& subject, std::function<void(Bytes, std::string reply)> handler);
  void ask(const std::string& subject, Bytes message, TimeUs timeout_us, Answer answer);
  void write_row(const std::string& key, std::optional<std::string> text, std::uint64_t expected,
                 std::function<void(const Result<std::uint64_t>&)> written);

 private:
  struct Outgoing {
    std::string subject, reply;
    Bytes message;
  };
  struct Question {
    Answer answer;
    std::chrono::steady_clock::time_point until;
  };
  /// What libnats holds of a subscription. `heard` runs on its thread.
  struct Subscribed {
    std::function<void(natsMsg*)> heard;
  };

  void hand_over(std::function<void()> work);
  void listen_to_connection();
  void came_up();
  void went_down(const std::string& why);
  std::shared_ptr<void> subscribe_raw(const std::string& subject, std::function<void(natsMsg*)> heard);
  void send_all();
  void expire_questions();
  void write_all();
  void read_table();
  void watch_once(std::uint64_t generation);
  JetStreamPtr jet_stream() const;
  Result<StorePtr> open_table(jsCtx& js) const;
  Result<std::uint64_t> write_now(const std::string& key, const std::optional<std::string>& text,
                                  std::uint64_t expected);
  void tell_row(const std::string& key, const std::optional<std::string>& text, std::uint64_t revision);
  void hear_row(ByteView message);

  const Settings settings_;
  const std::string bucket_, inbox_;
  OptionsPtr options_;
  ConnectionPtr connection_;
  std::function<void(std::function<void()>)> on_loop_;
  Listener* listener_ = nullptr;                               // Of the loop.
  std::map<std::uint64_t, Question> questions_;                // Of the loop.
  std::uint64_t last_question_ = 0;                            // Of the loop.
  std::shared_ptr<bool> open_ = std::make_shared<bool>(true);  // Of the loop: handlers may be called.
  std::atomic<int> coming_{0};
  std::atomic<bool> waiting_{false};  ///< There are questions.
  std::vector<std::shared_ptr<void>> subscriptions_;

  std::mutex mutex_;
  std::condition_variable news_;
  // GUARDED_BY(mutex_), all that follows.
  std::deque<Outgoing> outgoing_;
  std::size_t outgoing_bytes_ = 0;
  std::deque<std::function<void()>> rows_;
  bool connected_ = false, stopping_ = false;
  std::uint64_t generation_ = 0;  ///< Of the connection.
  std::chrono::steady_clock::time_point leave_until_{};

  std::thread sender_, writer_, reader_;
};

// ---- To and from the loop ----

void NatsLink::Impl::hand_over(std::function<void()> work) {
  on_loop_([self = shared_from_this(), work = std::move(work)] {
    if (*self->open_) work();
  });
}

void NatsLink::Impl::came_up() {
  {
    const std::lock_guard lock(mutex_);
    connected_ = true;
    ++generation_;
  }
  news_.notify_all();
  hand_over([this] { listener_->on_connected(); });
}

void NatsLink::Impl::went_down(const std::string& why) {
  {
    const std::lock_guard lock(mutex_);
    connected_ = false;
    outgoing_.clear();  // Frames of the past are of no use when the connection is back.
    outgoing_bytes_ = 0;
  }
  hand_over([this, why] { listener_->on_disconnected(why); });
}

void NatsLink::Impl::listen_to_connection() {
  // The connection ends before this object does, and with it these calls.
  natsOptions_SetReconnectedCB(
      options_.get(), [](natsConnection*, void* impl) { static_cast<Impl*>(impl)->came_up(); }, this);
  natsOptions_SetDisconnectedCB(
      options_.get(),
      [](natsConnection* connection, void* impl) {
        const char* text = nullptr;
        natsConnection_GetLastError(connection, &text);
        const std::string why = text != nullptr && *text != 0 ? text : "the connection to the NATS server is gone";
        static_cast<Impl*>(impl)->went_down(why);
      },
      this);
  // Silence: slow consumers lose messages, which is noticed as gaps; libnats would print.
  natsOptions_SetErrorHandler(
      options_.get(), [](natsConnection*, natsSubscription*, natsStatus, void*) {}, nullptr);
  natsOptions_SetRetryOnFailedConnect(
      options_.get(), true, [](natsConnection*, void* impl) { static_cast<Impl*>(impl)->came_up(); }, this);
}

void NatsLink::Impl::start(Listener& listener) {
  listener_ = &listener;
  listen_to_connection();
  natsConnection* connection = nullptr;
  const natsStatus status = natsConnection_Connect(&connection, options_.get());
  connection_.reset(connection);
  if (connection == nullptr) {
    return went_down(std::string("NATS: ") + natsStatus_GetText(status));
  }
  if (status == NATS_OK) {
    came_up();
  } else {
    const char* why = nats_GetLastError(nullptr);
    went_down(std::string("no NATS server takes this broker yet") +
              (why != nullptr && *why != 0 ? " (" + std::string(why) + ")" : std::string()));
  }
  subscriptions_.push_back(subscribe_raw(inbox_ + ".*", [this](natsMsg* message) {
    const std::string subject = natsMsg_GetSubject(message);
    const std::uint64_t number = std::strtoull(subject.c_str() + inbox_.size() + 1, nullptr, 10);
    const bool nobody = natsMsg_IsNoResponders(message);
    hand_over([this, number, nobody, data = data_of(message)]() mutable {
      const auto found = questions_.find(number);
      if (found == questions_.end()) return;
      const Answer answer = std::move(found->second.answer);
      questions_.erase(found);
      if (nobody) return answer(fail(ErrorCode::kUnreachable, "the broker that should answer is not there"));
      answer(std::move(data));
    });
  }));
  subscriptions_.push_back(
      subscribe_raw(settings_.prefix + ".rows", [this](natsMsg* message) { hear_row(data_of(message)); }));
  sender_ = std::thread([this] { send_all(); });
  writer_ = std::thread([this] { write_all(); });
  reader_ = std::thread([this] { read_table(); });
}

void NatsLink::Impl::stop() {
  {
    const std::lock_guard lock(mutex_);
    if (stopping_) return;
    stopping_ = true;
    leave_until_ = std::chrono::steady_clock::now() + kLeave;
  }
  *open_ = false;
  news_.notify_all();
  for (std::thread* thread : {&sender_, &writer_, &reader_}) {
    if (thread->joinable()) thread->join();
  }
  subscriptions_.clear();
  questions_.clear();
  if (connection_) {
    natsConnection_FlushTimeout(connection_.get(), 300);
    natsConnection_Close(connection_.get());
  }
}

// ---- Messages ----

void NatsLink::Impl::publish(const std::string& subject, Bytes message, const std::string& reply) {
  const std::lock_guard lock(mutex_);
  const bool full = outgoing_.size() >= kMaxWaitingMessages || outgoing_bytes_ + message.size() > kMaxWaitingBytes;
  if (!connected_ || full) return;
  outgoing_bytes_ += message.size();
  outgoing_.push_back({subject, reply, std::move(message)});
  news_.notify_all();
}

void NatsLink::Impl::send_all() {
  std::unique_lock lock(mutex_);
  for (;;) {
    news_.wait_for(lock, 50ms, [this] { return stopping_ || !outgoing_.empty(); });
    if (stopping_ && (outgoing_.empty() || std::chrono::steady_clock::now() >= leave_until_)) return;
    auto batch = std::exchange(outgoing_, {});
    outgoing_bytes_ = 0;
    lock.unlock();
    for (const Outgoing& out : batch) {
      const int size = static_cast<int>(out.message.size());
      // What cannot leave is lost, as it would be on the way: gaps and silence are answered for elsewhere.
      if (out.reply.empty()) {
        natsConnection_Publish(connection_.get(), out.subject.c_str(), out.message.data(), size);
      } else {
        natsConnection_PublishRequest(connection_.get(), out.subject.c_str(), out.reply.c_str(), out.message.data(),
                                      size);
      }
    }
    expire_questions();
    lock.lock();
  }
}

std::shared_ptr<void> NatsLink::Impl::subscribe_raw(const std::string& subject, std::function<void(natsMsg*)> heard) {
  if (!connection_) return nullptr;
  natsSubscription* subscription = nullptr;
  auto* subscribed = new Subscribed{std::move(heard)};
  const natsStatus status = natsConnection_Subscribe(
      &subscription, connection_.get(), subject.c_str(),
      [](natsConnection*, natsSubscription*, natsMsg* raw, void* closure) {
        const MessagePtr message(raw);
        static_cast<Subscribed*>(closure)->heard(raw);
      },
      subscribed);
  if (status != NATS_OK) {
    delete subscribed;
    return nullptr;
  }
  natsSubscription_SetOnCompleteCB(
      subscription, [](void* closure) { delete static_cast<Subscribed*>(closure); }, subscribed);
  return {subscription, [](natsSubscription* ended) {
            natsSubscription_Unsubscribe(ended);
            natsSubscription_Destroy(ended);
          }};
}

std::shared_ptr<void> NatsLink::Impl::subscribe(const std::string& subject,
                                                std::function<void(Bytes, std::string)> handler) {
  struct Handle {
    std::shared_ptr<bool> wanted = std::make_shared<bool>(true);
    std::shared_ptr<void> subscription;
    ~Handle() { *wanted = false; }
  };
  auto handle = std::make_shared<Handle>();
  auto shared = std::make_shared<std::function<void(Bytes, std::string)>>(std::move(handler));
  handle->subscription = subscribe_raw(subject, [this, wanted = handle->wanted, shared](natsMsg* message) {
    if (coming_.fetch_add(1) >= kMaxComing) {
      --coming_;
      return;
    }
    const char* reply = natsMsg_GetReply(message);
    on_loop_([self = shared_from_this(), wanted, shared, data = data_of(message),
              reply = std::string(reply == nullptr ? "" : reply)]() mutable {
      --self->coming_;
      if (*self->open_ && *wanted) (*shared)(std::move(data), std::move(reply));
    });
  });
  return handle;
}

void NatsLink::Impl::ask(const std::string& subject, Bytes message, TimeUs timeout_us, Answer answer) {
  const std::uint64_t number = ++last_question_;
  questions_[number] = {std::move(answer), std::chrono::steady_clock::now() + std::chrono::microseconds(timeout_us)};
  waiting_ = true;
  publish(subject, std::move(message), inbox_ + "." + std::to_string(number));
}

/// On the sender's thread, which wakes often enough.
void NatsLink::Impl::expire_questions() {
  if (!waiting_) return;
  hand_over([this] {
    const auto now = std::chrono::steady_clock::now();
    std::vector<Answer> late;
    std::erase_if(questions_, [&](auto& item) {
      if (item.second.until > now) return false;
      late.push_back(std::move(item.second.answer));
      return true;
    });
    waiting_ = !questions_.empty();
    for (const Answer& answer : late) answer(fail(ErrorCode::kTimeout, "another broker did not answer in time"));
  });
}

// ---- The table ----

void NatsLink::Impl::write_row(const std::string& key, std::optional<std::string> text, std::uint64_t expected,
                               std::function<void(const Result<std::uint64_t>&)> written) {
  const std::lock_guard lock(mutex_);
  rows_.push_back([this, key, text = std::move(text), expected, written = std::move(written)] {
    const auto result = write_now(key, text, expected);
    if (result) tell_row(key, text, *result);
    hand_over([written, result] { written(result); });
  });
  news_.notify_all();
}

void NatsLink::Impl::write_all() {
  std::unique_lock lock(mutex_);
  for (;;) {
    news_.wait(lock, [this] { return stopping_ || !rows_.empty(); });
    if (stopping_ && (rows_.empty() || std::chrono::steady_clock::now() >= leave_until_)) return;
    const auto job = std::move(rows_.front());
    rows_.pop_front();
    lock.unlock();
    job();
    lock.lock();
  }
}

JetStreamPtr NatsLink::Impl::jet_stream() const {
  jsOptions options;
  jsOptions_Init(&options);
  options.Wait = kTableTimeoutMs;
  jsCtx* js = nullptr;
  if (connection_) natsConnection_JetStream(&js, connection_.get(), &options);
  return JetStreamPtr(js);
}

Result<std::uint64_t> NatsLink::Impl::write_now(const std::string& key, const std::optional<std::string>& text,
                                                std::uint64_t expected) {
  const auto away = [](const char* why) {
    return fail(ErrorCode::kUnreachable, std::string("the directory of streams (JetStream) does not answer: ") + why);
  };
  const JetStreamPtr js = jet_stream();
  if (!js) return away("no connection");
  natsMsg* raw = nullptr;
  const std::string subject = "$KV." + bucket_ + "." + key;
  const std::string data = text.value_or("");
  if (const natsStatus made =
          natsMsg_Create(&raw, subject.c_str(), nullptr, data.data(), static_cast<int>(data.size()));
      made != NATS_OK) {
    return away(natsStatus_GetText(made));
  }
  const MessagePtr message(raw);
  if (!text) natsMsgHeader_Set(raw, "KV-Operation", "DEL");
  jsPubOptions options;
  jsPubOptions_Init(&options);
  options.MaxWait = kTableTimeoutMs;
  options.ExpectLastSubjectSeq = expected;
  options.ExpectNoMessage = expected == 0;
  jsPubAck* ack = nullptr;
  jsErrCode code{};
  const natsStatus status = js_PublishMsg(&ack, js.get(), raw, &options, &code);
  if (status == NATS_OK) {
    const std::uint64_t revision = ack->Sequence;
    jsPubAck_Destroy(ack);
    return revision;
  }
  if (code == JSStreamWrongLastSequenceErr) {
    return fail(ErrorCode::kRefused, "another broker has changed the stream's entry meanwhile");
  }
  return away(natsStatus_GetText(status));
}

void NatsLink::Impl::tell_row(const std::string& key, const std::optional<std::string>& text, std::uint64_t revision) {
  Bytes message;
  ByteWriter out(message);
  out.u64(revision);
  out.u8(text ? 1 : 0);
  out.u16(static_cast<std::uint16_t>(key.size()));
  out.text(key);
  if (text) out.text(*text);
  publish(settings_.prefix + ".rows", std::move(message));
}

void NatsLink::Impl::hear_row(ByteView message) {
  ByteReader in(message);
  const std::uint64_t revision = in.u64();
  const bool has_text = in.u8() == 1;
  const ByteView key = in.bytes(in.u16());
  const ByteView text = in.bytes(in.remaining());
  if (in.failed()) return;
  std::optional<std::string> row;
  if (has_text) row.emplace(text.begin(), text.end());
  hand_over([this, key = std::string(key.begin(), key.end()), row = std::move(row), revision] {
    listener_->on_row(key, row, revision);
  });
}

Result<StorePtr> NatsLink::Impl::open_table(jsCtx& js) const {
  kvStore* store = nullptr;
  natsStatus status = js_KeyValue(&store, &js, bucket_.c_str());
  if (status == NATS_NOT_FOUND) {
    kvConfig config;
    kvConfig_Init(&config);
    config.Bucket = bucket_.c_str();
    config.Description = "Eigencast: which broker has which stream";
    config.History = 1;
    config.MaxBytes = 64 << 20;
    config.StorageType = js_FileStorage;
    config.Replicas = settings_.replicas;
    status = js_CreateKeyValue(&store, &js, &config);
  }
  if (status != NATS_OK) return fail(ErrorCode::kUnreachable, natsStatus_GetText(status));
  return StorePtr(store);
}

void NatsLink::Impl::read_table() {
  std::unique_lock lock(mutex_);
  while (!stopping_) {
    news_.wait_for(lock, 500ms, [this] { return stopping_ || connected_; });
    if (stopping_ || !connected_) continue;
    const std::uint64_t generation = generation_;
    lock.unlock();
    watch_once(generation);
    lock.lock();
    news_.wait_for(lock, 500ms, [this] { return stopping_; });
  }
}

void NatsLink::Impl::watch_once(std::uint64_t generation) {
  const JetStreamPtr js = jet_stream();
  if (!js) return;
  auto store = open_table(*js);
  if (!store) return;
  kvWatchOptions options;
  kvWatchOptions_Init(&options);
  options.Timeout = kTableTimeoutMs;
  kvWatcher* raw = nullptr;
  if (kvStore_WatchAll(&raw, store->get(), &options) != NATS_OK) return;
  const WatcherPtr watcher(raw);
  const auto began = std::chrono::steady_clock::now();
  bool read = false;
  for (;;) {
    kvEntry* entry = nullptr;
    const natsStatus status = kvWatcher_Next(&entry, watcher.get(), 200);
    const EntryPtr owned(entry);
    {
      const std::lock_guard lock(mutex_);
      if (stopping_ || !connected_ || generation != generation_) return;
    }
    if (status == NATS_TIMEOUT) {
      const auto age = std::chrono::steady_clock::now() - began;
      if (age > kReread || (!read && age > 5s)) return;
      continue;
    }
    if (status != NATS_OK) return;
    if (entry == nullptr) {
      read = true;
      hand_over([this] { listener_->on_table_read(); });
      continue;
    }
    const std::string key = kvEntry_Key(entry);
    const std::uint64_t revision = kvEntry_Revision(entry);
    std::optional<std::string> text;
    if (kvEntry_Operation(entry) == kvOp_Put) {
      text.emplace(static_cast<const char*>(kvEntry_Value(entry)), static_cast<std::size_t>(kvEntry_ValueLen(entry)));
    }
    hand_over([this, key, text = std::move(text), revision] { listener_->on_row(key, text, revision); });
  }
}

// ---- The face ----

Result<std::unique_ptr<NatsLink>> NatsLink::create(const Settings& settings,
                                                   std::function<void(std::function<void()>)> on_loop) {
  nats_Open(-1);
  nats_SetMessageDeliveryPoolSize(1);  // One thread: messages of a subject stay in order, and streams cost no threads.
  natsOptions* raw = nullptr;
  if (natsOptions_Create(&raw) != NATS_OK) return fail(ErrorCode::kIo, "NATS: no memory");
  OptionsPtr options(raw);
  std::vector<const char*> servers;
  for (const std::string& server : settings.servers) servers.push_back(server.c_str());
  Result<void> result;
  const auto set = [&](natsStatus status, const std::string& what) {
    if (status == NATS_OK || !result) return;
    result = fail(ErrorCode::kInvalidArgument, "backbone." + what + ": " + natsStatus_GetText(status));
  };
  set(natsOptions_SetServers(raw, servers.data(), static_cast<int>(servers.size())), "servers");
  set(natsOptions_SetName(raw, settings.name.c_str()), "name");
  set(natsOptions_SetTimeout(raw, 1'000), "servers");
  set(natsOptions_SetMaxReconnect(raw, -1), "servers");
  set(natsOptions_SetReconnectWait(raw, 250), "servers");
  set(natsOptions_SetReconnectJitter(raw, 100, 200), "servers");
  set(natsOptions_SetPingInterval(raw, 1'000), "servers");
  set(natsOptions_SetMaxPingsOut(raw, 2), "servers");
  set(natsOptions_SetWriteDeadline(raw, 2'000), "servers");
  set(natsOptions_SetSendAsap(raw, true), "servers");
  set(natsOptions_UseGlobalMessageDelivery(raw, true), "servers");
  if (!settings.ca_file.empty()) {
    set(natsOptions_SetSecure(raw, true), "ca");
    set(natsOptions_LoadCATrustedCertificates(raw, settings.ca_file.c_str()), "ca");
  }
  if (!settings.certificate_file.empty()) {
    set(natsOptions_LoadCertificatesChain(raw, settings.certificate_file.c_str(), settings.key_file.c_str()),
        "certificate");
  }
  if (!settings.credentials_file.empty()) {
    set(natsOptions_SetUserCredentialsFromFiles(raw, settings.credentials_file.c_str(), nullptr), "credentials");
  }
  if (!settings.user.empty()) {
    set(natsOptions_SetUserInfo(raw, settings.user.c_str(), settings.password.c_str()), "user");
  }
  if (!settings.token.empty()) set(natsOptions_SetToken(raw, settings.token.c_str()), "token");
  if (!result) return result.error();
  return std::unique_ptr<NatsLink>(
      new NatsLink(std::make_shared<Impl>(settings, std::move(options), std::move(on_loop))));
}

NatsLink::NatsLink(std::shared_ptr<Impl> impl) : impl_(std::move(impl)) {}
NatsLink::~NatsLink() {
  impl_->stop();
}
void NatsLink::start(Listener& listener) {
  impl_->start(listener);
}
void NatsLink::stop() {
  impl_->stop();
}
void NatsLink::publish(const std::string& subject, Bytes message) {
  impl_->publish(subject, std::move(message));
}
std::shared_ptr<void> NatsLink::subscribe(const std::string& subject, Handler handler) {
  return impl_->subscribe(
      subject, [handler = std::move(handler)](Bytes message, const std::string&) { handler(std::move(message)); });
}
std::shared_ptr<void> NatsLink::serve(const std::string& subject, Questioned questioned) {
  return impl_->subscribe(
      subject, [weak = std::weak_ptr(impl_), questioned = std::move(questioned)](Bytes message, std::string reply) {
        questioned(std::move(message), [weak, reply = std::move(reply)](Bytes answer) {
          if (const auto impl = weak.lock()) impl->publish(reply, std::move(answer));
        });
      });
}
void NatsLink::ask(const std::string& subject, Bytes message, TimeUs timeout_us, Answer answer) {
  impl_->ask(subject, std::move(message), timeout_us, std::move(answer));
}
void NatsLink::write_row(const std::string& key, std::optional<std::string> text, std::uint64_t expected,
                         std::function<void(const Result<std::uint64_t>&)> written) {
  impl_->write_row(key, std::move(text), expected, std::move(written));
}

}  // namespace eigencast::broker
