// SPDX-License-Identifier: MIT
#include "broker/connections/publisher.h"

#include <memory>
#include <span>
#include <utility>

#include "broker/access/resume_secret.h"
#include "broker/relay/fair_reads.h"
#include "broker/relay/hub.h"
#include "broker/relay/ownership.h"
#include "broker/storage/asset_store.h"
#include "broker/storage/segments.h"
#include "common/wire/limits.h"

namespace eigencast::broker {
namespace {

/// A sender asks whether its surface is here before it announces it.
constexpr TimeUs kContestUs = 3'000'000;
constexpr TimeUs kProgressUs = 900'000;

constexpr double kSegmentUs = 20;  ///< Of a memory: what its entries here take.

/// What the new segments of a memory took, if a byte and a pose take that much.
double loading_us(std::span<const Generation::Segment> segments, double byte_us, double pose_us) {
  double sum = kSegmentUs * static_cast<double>(segments.size());
  for (const auto& segment : segments) {
    if (segment.coded) sum += static_cast<double>(segment.coded->size()) * byte_us;
    if (segment.poses) sum += segment.poses->poses * pose_us;
  }
  return sum;
}

}  // namespace

Publisher::Publisher(Context& context, Transport transport, GrantPtr grant, std::string stream_name)
    : Connection(context, std::move(transport), std::move(grant),
                 {static_cast<std::size_t>(context.config.limits.max_control_bytes),
                  static_cast<std::size_t>(context.config.limits.max_frame_bytes)}),
      name_(std::move(stream_name)) {}

void Publisher::on_open() {
  greet();
  const auto stream = context().hub.open(name_);
  if (!stream) return refuse(stream.error(), name_, websocket::CloseCode::kTryAgainLater);
  if (claim(**stream, context().config.streams.second_sender == "replace")) return;
  contested_until_us_ = context().turn.now_us() + kContestUs;
}

Result<void> Publisher::claim(Stream& stream, bool replace) {
  if (auto claimed = stream.claim(*this, replace); !claimed) return claimed;
  contested_until_us_.reset();
  stream_ = &stream;
  claimed_us_ = context().turn.now_us();
  log(context().log, LogLevel::kInfo, name() + ": connected");
  watchers_ = stream_->watchers();
  return {};
}

bool Publisher::claim_contested(const std::string& shown) {
  contested_until_us_.reset();
  const auto stream = context().hub.open(name_);
  if (!stream) {
    refuse(stream.error(), name_, websocket::CloseCode::kTryAgainLater);
    return false;
  }
  const auto claimed = claim(**stream, is_same_proof(shown, (*stream)->resume()));
  if (claimed) return true;
  log(context().log, LogLevel::kWarning, name() + ": refused, the stream has a sender");
  refuse(claimed.error(), name_, websocket::CloseCode::kPolicy);
  return false;
}

/// It has had the time to upload what it wants to announce.
bool Publisher::yields() const {
  return !is_announced() && context().turn.now_us() - claimed_us_ > context().config.timeouts.upload_ms * 1000;
}

void Publisher::on_replaced() {
  stream_ = nullptr;
  ++context().counters.senders_replaced;
  log(context().log, LogLevel::kWarning, name() + ": another sender takes its place");
  send_bye("another sender has taken this stream over", 0, websocket::CloseCode::kReplaced);
}

void Publisher::describe(ClientInfo& info) const {
  Connection::describe(info);
  info.kind = ClientInfo::Kind::kSender;
  info.stream_count = 1;
  info.streams.push_back({name_, {}, 0});
}

void Publisher::on_message(const ControlMessage& message) {
  if (const auto* announce = std::get_if<control::Announce>(&message)) return on_announce(*announce);
  if (const auto* trace = std::get_if<control::Trace>(&message)) {
    if (stream_ == nullptr) return;
    stream_->relay_trace(*trace);
    return charge(stream_->take_unpaid_us());
  }
  if (const auto* memory = std::get_if<control::Remember>(&message)) return on_remember(*memory);
  if (const auto* progress = std::get_if<control::Progress>(&message)) return on_progress(*progress);
  send_error(fail(ErrorCode::kUnsupported, "a sender sends announce, remember, progress, trace, ping and pong"), name_);
}

void Publisher::on_announce(control::Announce announce) {
  if (stream_ == nullptr && !contested_until_us_) return;
  const Identity& identity = grant().identity();
  Resume resume;
  const std::string shown = std::exchange(announce.resume, {});
  if (!shown.empty()) resume.shown = resume_proof(shown, identity.key);
  if (stream_ == nullptr && !claim_contested(resume.shown)) return;
  const auto answer = [&](const Error& error) {
    log(context().log, LogLevel::kWarning, name() + ": announcement refused, " + error.message);
    send_error(error, name_);
  };
  if (auto ok = check_format(announce.format); !ok) return answer(ok.error());
  const auto asset = Sha256::from_hex(announce.asset);
  if (!asset)
    return answer(
        fail(ErrorCode::kInvalidArgument, "asset must be the 64 hexadecimal digits of its manifest's SHA-256"));
  if (!context().assets.contains(*asset)) {
    return answer(fail(ErrorCode::kNotFound,
                       "asset " + announce.asset + " is not here: PUT /v1/assets/" + announce.asset + " first"));
  }
  if (auto taken = grant().take_announcement(stream_->epoch() == 0, context().turn.now_us()); !taken) {
    return refuse(taken.error(), name_, websocket::CloseCode::kTryAgainLater);
  }
  preparing_.reset();
  if (announce.continues && is_announced()) return prepare(std::move(announce));
  announce.continues = false;
  const auto secret = new_resume_secret();
  if (!secret) return answer(secret.error());
  resume.issued = resume_proof(*secret, identity.key);
  const StreamHolder holder{grant().holder(), identity.is_stranger(), grant().is_spared()};
  const auto charge = [this] { return grant().hold(Resource::kSentStream); };
  if (auto admitted = context().hub.admit(*stream_, holder, announce.format, charge); !admitted) {
    log(context().log, LogLevel::kWarning, name() + ": refused, " + admitted.error().message);
    return refuse(admitted.error(), name_, websocket::CloseCode::kTryAgainLater);
  }
  // No answer once the connection has ended.
  const auto granted = [self = weak_from_this(), this, announce, resume, secret](const Result<std::uint32_t>& epoch) {
    if (const auto alive = self.lock()) begin(announce, *secret, resume.issued, epoch);
  };
  context().ownership.claim(name_, announce, resume, granted);
}

void Publisher::prepare(control::Announce announce) {
  charge(stream_->telling_us());
  stream_->prepare(std::make_shared<const control::StreamInfo::Next>(control::StreamInfo::Next{announce.asset, 1}));
  context().hub.mark_dirty(*stream_);
  log(context().log, LogLevel::kInfo, name() + ": viewers fetch asset " + announce.asset.substr(0, 12));
  preparing_since_us_ = context().turn.now_us();
  preparing_ = std::move(announce);
  if (stream_->watchers() == 0) announce_prepared();
}

/// Nine of ten viewers have it, or the time is over.
void Publisher::announce_prepared() {
  if (!preparing_ || stream_ == nullptr || !is_announced()) return;
  if (!stream_->is_prepared(context().turn.now_us() - preparing_since_us_)) return;
  const control::Announce announce = *std::exchange(preparing_, std::nullopt);
  const auto refuse_it = [&](const Error& error) {
    stream_->prepare(nullptr);
    context().hub.mark_dirty(*stream_);
    send_error(error, name_);
  };
  const StreamHolder holder{grant().holder(), grant().identity().is_stranger(), grant().is_spared()};
  if (!context().assets.contains(*Sha256::from_hex(announce.asset)))
    return refuse_it(fail(ErrorCode::kNotFound, "asset " + announce.asset + " is not here any more"));
  const auto epoch = context().ownership.next_epoch(name_);
  if (!epoch) return refuse_it(epoch.error());
  if (auto held = context().hub.hold_keys(*stream_, holder, announce.format); !held) return refuse_it(held.error());
  const auto secret = new_resume_secret();
  if (!secret) return refuse_it(secret.error());
  const auto tag = stream_->announce_next(announce, *epoch, resume_proof(*secret, grant().identity().key));
  if (!tag) return refuse_it(tag.error());
  log(context().log, LogLevel::kInfo,
      name() + ": epoch " + std::to_string(*epoch) + " follows without a gap, asset " + announce.asset.substr(0, 12));
  send(control::Announced{name_, stream_->id(), *epoch, *tag, *secret});
}

/// Told to viewers once a second at most.
void Publisher::on_progress(const control::Progress& progress) {
  const TimeUs now = context().turn.now_us();
  if (stream_ == nullptr || !is_announced() || preparing_ || now - progress_us_ < kProgressUs) return;
  progress_us_ = now;
  charge(stream_->telling_us());
  stream_->prepare(std::make_shared<const control::StreamInfo::Next>(control::StreamInfo::Next{{}, progress.fraction}));
  context().hub.mark_dirty(*stream_);
}

void Publisher::begin(const control::Announce& announce, const std::string& secret, const std::string& proof,
                      const Result<std::uint32_t>& epoch) {
  if (stream_ == nullptr) return;
  if (!epoch) {
    log(context().log, LogLevel::kWarning, name() + ": refused, " + epoch.error().message);
    release();  // Before it is closed: the stream is somebody else's.
    return refuse(epoch.error(), name_, websocket::CloseCode::kPolicy);
  }
  if (auto begun = stream_->announce(announce, *epoch, proof); !begun) return send_error(begun.error(), name_);
  charge(stream_->telling_us());
  log(context().log, LogLevel::kInfo,
      name() + ": epoch " + std::to_string(*epoch) + ", asset " + announce.asset.substr(0, 12) + ", " +
          std::to_string(announce.format.rows) + " coefficients, " + announce.format.codec);
  send(control::Announced{name_, stream_->id(), *epoch, stream_->tag(), secret});
  report_count();
  request_trace();
}

void Publisher::answer_memory(std::uint32_t generation, const Result<void>& held) {
  if (held) return send(control::Remembered{name_, generation});
  log(context().log, LogLevel::kWarning, name() + ": memory refused, " + held.error().message);
  ++context().counters.memories_refused;
  send(control::Remembered{name_, generation, std::string(name_of(held.error().code)), held.error().message});
}

void Publisher::on_remember(const control::Remember& memory) {
  if (stream_ == nullptr || !is_announced()) return;
  const auto refuse_memory = [&](ErrorCode code, std::string why) {
    answer_memory(memory.generation, fail(code, std::move(why)));
  };
  if (!context().config.memory.enabled)
    return refuse_memory(ErrorCode::kUnsupported, "this broker keeps no memory (memory.enabled)");
  const CoefficientLayout& layout = stream_->layout();
  if (layout.is_float()) return refuse_memory(ErrorCode::kUnsupported, "a float codec has no memory");
  if (loading_ == stream_->epoch()) return refuse_memory(ErrorCode::kRefused, "the one before is being read");
  const GenerationPtr held = stream_->memory();
  const std::size_t count = held ? held->segments.size() : 0;
  if (memory.kept > count || memory.kept + memory.segments.size() > limits::kMaxMemorySegments)
    return refuse_memory(ErrorCode::kInvalidArgument, "it keeps segments that are not here, or has too many");
  charge(stream_->telling_us());
  if (memory.kept < count) {
    stream_->set_memory(nullptr);
    context().hub.mark_dirty(*stream_);
  }
  std::vector<Generation::Segment> segments;
  if (held) segments.assign(held->segments.begin(), held->segments.begin() + memory.kept);
  for (const std::string& id : memory.segments) segments.push_back({id, nullptr, 0});
  if (segments.empty()) return answer_memory(memory.generation, {});
  struct Loading {
    std::vector<Generation::Segment> segments;
    Result<void> done{};
    std::shared_ptr<Connection> self{};  ///< Pays even if it ends meanwhile.
  };
  const auto loading = std::make_shared<Loading>(Loading{std::move(segments)});
  const std::uint32_t epoch = stream_->epoch();
  const auto wanted = [this, weak = weak_from_this(), loading, epoch] {
    loading->self = weak.lock();
    return loading->self && stream_ != nullptr && stream_->epoch() == epoch;
  };
  const auto load = [loading, &assets = context().assets, layout, asset = Sha256::from_hex(stream_->asset())->digest] {
    loading->done = load_segments(assets, layout, asset, loading->segments);
  };
  const auto then = [this, loading, epoch, generation = memory.generation, first_new = memory.kept,
                     byte_us = stream_->decoding_us(1, false), pose_us = stream_->decoding_us(0, true)] {
    const auto self = std::move(loading->self);
    guarded([&] {
      charge(loading_us(std::span(loading->segments).subspan(first_new), byte_us, pose_us));
      remember(generation, epoch, std::move(loading->segments), loading->done);
    });
  };
  loading_ = epoch;
  const std::string holder = grant().is_spared() ? std::string() : grant().holder();
  if (context().memory_reads.push(holder, {wanted, load, then})) return;
  loading_ = 0;
  refuse_memory(ErrorCode::kRefused, "too many memories wait to be read: try again later");
}

void Publisher::remember(std::uint32_t generation, std::uint32_t epoch, std::vector<Generation::Segment> segments,
                         const Result<void>& loaded) {
  if (loading_ == epoch) loading_ = 0;
  if (stream_ == nullptr || stream_->epoch() != epoch) return;
  if (!loaded) return answer_memory(generation, loaded);
  const auto held = context().hub.remember(*stream_, std::move(segments));
  if (held) ++context().counters.memories;
  answer_memory(generation, held);
  context().hub.mark_dirty(*stream_);
}

void Publisher::on_binary(ByteView message) {
  if (stream_ == nullptr) return;
  if (auto added = stream_->take_frame(message, context().turn.now_us()); !added) {
    ++context().counters.frames_refused;
    log(context().log, LogLevel::kWarning, name() + ": closed, " + added.error().message);
    return refuse(added.error(), name_, websocket::CloseCode::kPolicy);
  }
  Counters& counters = context().counters;
  ++counters.frames_received;
  counters.frame_bytes_received += message.size();
  if (stream_->snapshot().newest->generation != 0) {
    ++counters.keys_recalled;
    counters.recalled_bytes += message.size();
  }
  if (const double work_us = stream_->take_unpaid_us(); work_us > 0) charge(work_us);
  note_work(stream_->take_profiles_us());
  context().hub.mark_dirty(*stream_);
}

double Publisher::binary_work_us(std::uint64_t bytes, bool last) const {
  const double frame_us = Connection::binary_work_us(bytes, last);
  return stream_ != nullptr ? frame_us + stream_->decoding_us(bytes, last) : frame_us;
}

void Publisher::on_watcher_count(std::uint32_t count) {
  const bool changed_much = (watchers_ == 0) != (count == 0);
  watchers_ = count;
  if (changed_much) report_count();  // Other changes are sent once a second: a crowd must not fill the queue.
}

void Publisher::on_tick() {
  if (contested_until_us_ && context().turn.now_us() > *contested_until_us_) (void)claim_contested({});
  announce_prepared();
  if (!reported_) return;
  report_count();
  request_trace();  // At most once a second, so that changing viewers do not fill the queue.
}

void Publisher::report_count() {
  if (stream_ == nullptr || reported_ == watchers_) return;
  reported_ = watchers_;
  send(control::Subscribers{name_, watchers_});
}

void Publisher::request_trace() {
  if (stream_ == nullptr || requested_trace_ == stream_->trace_every()) return;
  requested_trace_ = stream_->trace_every();
  send(control::TraceRequest{name_, requested_trace_});
}

void Publisher::release() {
  Stream* stream = std::exchange(stream_, nullptr);
  stream->release(*this);
  context().hub.unwatched(*stream);
}

void Publisher::on_closed() {
  if (stream_ == nullptr) return;
  release();
  log(context().log, LogLevel::kInfo, name() + ": gone");
}

}  // namespace eigencast::broker
