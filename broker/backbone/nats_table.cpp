// SPDX-License-Identifier: MIT
// The table of a NatsLink: a JetStream key-value bucket, and row changes that brokers publish to each other.
#include <algorithm>
#include <utility>

#include "broker/backbone/nats_link_impl.h"

namespace eigencast::broker {
namespace {

using std::chrono_literals::operator""ms;
using std::chrono_literals::operator""s;

constexpr std::int64_t kTableTimeoutMs = 2'000;
constexpr auto kReread = 60s;     ///< Period of reading the whole table again, at least 50 times as long as that takes.
constexpr auto kMaxSilence = 5s;  ///< While it is read.

}  // namespace

void NatsLink::write_row(const std::string& key, std::optional<std::string> text, std::uint64_t expected,
                         std::function<void(const Result<std::uint64_t>&)> written) {
  const std::lock_guard lock(mutex_);
  auto& queue = text ? rows_ : removals_;
  queue.push_back([this, key, text = std::move(text), expected, written = std::move(written)] {
    const auto result = write_now(key, text, expected);
    if (result) publish_row(key, text, *result);
    post_to_listener([written, result] { written(result); });
  });
  wake_.notify_all();
}

void NatsLink::write_all() {
  std::unique_lock lock(mutex_);
  for (;;) {
    wake_.wait(lock, [this] { return stopping_ || !rows_.empty() || !removals_.empty(); });
    auto& queue = rows_.empty() ? removals_ : rows_;  // Senders wait for rows.
    if (stopping_ && (queue.empty() || std::chrono::steady_clock::now() >= drain_until_)) break;
    const auto job = std::move(queue.front());
    queue.pop_front();
    lock.unlock();
    job();
    lock.lock();
  }
  written_ = true;
  wake_.notify_all();
}

JetStreamPtr NatsLink::jet_stream() {
  std::unique_lock lock(mutex_);
  const auto connection = connection_;
  lock.unlock();
  jsOptions options;
  jsOptions_Init(&options);
  options.Wait = kTableTimeoutMs;
  jsCtx* js = nullptr;
  if (connection) natsConnection_JetStream(&js, connection.get(), &options);
  return JetStreamPtr(js);
}

Result<std::uint64_t> NatsLink::write_now(const std::string& key, const std::optional<std::string>& text,
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
    if (!text) {  // Else each name that ever was would keep a message.
      jsOptions purge;
      jsOptions_Init(&purge);
      purge.Stream.Purge.Subject = subject.c_str();
      purge.Stream.Purge.Sequence = revision + 1;
      js_PurgeStream(js.get(), ("KV_" + bucket_).c_str(), &purge, nullptr);
    }
    return revision;
  }
  if (code == JSStreamWrongLastSequenceErr) {
    return fail(ErrorCode::kRefused, "another broker has changed the stream's entry meanwhile");
  }
  return away(natsStatus_GetText(status));
}

void NatsLink::publish_row(const std::string& key, const std::optional<std::string>& text, std::uint64_t revision) {
  Bytes message;
  ByteWriter out(message);
  out.u64(revision);
  out.u8(text ? 1 : 0);
  out.u16(static_cast<std::uint16_t>(key.size()));
  out.text(key);
  if (text) out.text(*text);
  publish(settings_.prefix + ".rows." + settings_.id, std::move(message));
}

void NatsLink::take_row(const std::string& from, ByteView message) {
  ByteReader in(message);
  const std::uint64_t revision = in.u64();
  const std::uint8_t has_text = in.u8();
  const ByteView key = in.bytes(in.u16());
  const ByteView text = in.bytes(in.remaining());
  if (in.failed() || has_text > 1) return;
  std::optional<std::string> row;
  if (has_text == 1) row.emplace(text.begin(), text.end());
  listener_->on_row(std::string(key.begin(), key.end()), std::move(row), revision, from);
}

Result<StorePtr> NatsLink::open_table(jsCtx& js) const {
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

/// False: the table's state is unknown.
bool NatsLink::report_new_table(jsCtx& js) {
  jsStreamInfo* raw = nullptr;
  js_GetStreamInfo(&raw, &js, ("KV_" + bucket_).c_str(), nullptr, nullptr);
  const StreamInfoPtr info(raw);
  if (!info) return false;
  if (std::exchange(table_made_, info->Created) != info->Created)
    post_to_listener([this] { listener_->on_new_table(); });
  return true;
}

void NatsLink::read_table() {
  std::unique_lock lock(mutex_);
  while (!stopping_) {
    const std::uint64_t generation = generation_;
    const bool connected = connected_;
    lock.unlock();
    connected ? watch_once(generation) : connect();
    lock.lock();
    if (connected) wake_.wait_for(lock, 500ms, [this] { return stopping_ || !connected_; });
  }
}

void NatsLink::watch_once(std::uint64_t generation) {
  const JetStreamPtr js = jet_stream();
  if (!js) return;
  auto store = open_table(*js);
  if (!store || !report_new_table(*js)) return;
  kvWatchOptions options;
  kvWatchOptions_Init(&options);
  options.Timeout = kTableTimeoutMs;
  kvWatcher* raw = nullptr;
  if (kvStore_WatchAll(&raw, store->get(), &options) != NATS_OK) return;
  const WatcherPtr watcher(raw);
  const auto began = std::chrono::steady_clock::now();
  auto heard = began;
  std::chrono::nanoseconds took{};
  bool read = false;
  for (;;) {
    while (undelivered_ > kMaxUndeliveredBytes / 2) {
      std::unique_lock lock(mutex_);
      if (wake_.wait_for(lock, 5ms, [this] { return stopping_; })) return;
    }
    kvEntry* entry = nullptr;
    const natsStatus status = kvWatcher_Next(&entry, watcher.get(), 200);
    const EntryPtr owned(entry);
    {
      const std::lock_guard lock(mutex_);
      if (stopping_ || !connected_ || generation != generation_) return;
    }
    if (status == NATS_TIMEOUT) {
      const auto now = std::chrono::steady_clock::now();
      if (read ? now - began > std::max<std::chrono::nanoseconds>(kReread, 50 * took) : now - heard > kMaxSilence)
        return;
      continue;
    }
    if (status != NATS_OK) return;
    heard = std::chrono::steady_clock::now();
    if (entry == nullptr) {
      read = true;
      took = heard - began;
      post_to_listener([this] { listener_->on_table_read(); });
      continue;
    }
    const std::string key = kvEntry_Key(entry);
    const std::uint64_t revision = kvEntry_Revision(entry);
    std::optional<std::string> text;
    if (kvEntry_Operation(entry) == kvOp_Put) {
      text.emplace(static_cast<const char*>(kvEntry_Value(entry)), static_cast<std::size_t>(kvEntry_ValueLen(entry)));
    }
    const std::size_t cost = 2 * key.size() + (text ? text->size() : 0);
    undelivered_ += cost;
    post_to_listener([this, key, text = std::move(text), revision, cost] {
      undelivered_ -= cost;
      listener_->on_row(key, text, revision, {});
    });
  }
}

}  // namespace eigencast::broker
