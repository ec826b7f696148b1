// SPDX-License-Identifier: MIT
#include "broker/http/asset_transfer.h"

#include <strings.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <ctime>
#include <map>
#include <system_error>
#include <utility>
#include <vector>

#include "broker/http/http_target.h"
#include "broker/storage/asset_store.h"

namespace eigencast::broker {
namespace {

constexpr std::size_t kChunkBytes = HttpConnection::kPieceBytes;
constexpr int kRetryAfterS = 60;
constexpr double kChunksPerUs = 10;  ///< Parsed.
constexpr TimeUs kMaxChunksWaitUs = 2'000'000;

/// Opens the asset for this piece only: peers that do not read hold no descriptors. Errors: as AssetStore::read().
Result<std::size_t> read_at(const AssetStore& assets, const Sha256& id, std::uint64_t at, std::vector<char>& out) {
  const auto object = assets.read(id);
  if (!object) return object.error();
  for (;;) {
    const ssize_t count = ::pread(object->file.get(), out.data(), out.size(), static_cast<off_t>(at));
    if (count < 0 && errno == EINTR) continue;
    if (count > 0) return static_cast<std::size_t>(count);
    return fail(ErrorCode::kIo, "reading an asset failed: " +
                                    (count == 0 ? "the file ends early" : std::generic_category().message(errno)));
  }
}

/// The answer to one GET or HEAD. Counts in downloads_now while it lives.
class Download : public std::enable_shared_from_this<Download> {
 public:
  Download(HttpConnection& connection, Grant& grant, const Sha256& id)
      : connection_(connection.shared_from_this()), context_(connection.context()), grant_(grant), id_(id) {
    ++context_.counters.downloads_now;
  }
  ~Download() { --context_.counters.downloads_now; }

  void start() {
    connection_->arm(context_.config.timeouts.transfer_ms);  // Replaces the head's timeout.
    connection_->on(
        context_.disk, [this] { return context_.assets.read(id_); },
        [self = shared_from_this()](const Result<AssetStore::Object>& object) {
          if (object) return self->answer(object->size, object->is_segment);
          const bool missing = object.error().code == ErrorCode::kNotFound;
          if (!missing) {
            log(self->context_.log, LogLevel::kError, "download refused: " + object.error().message);
          }
          self->connection_->answer_error(missing ? HttpStatus::kNotFound : HttpStatus::kInternalServerError,
                                          object.error());
        });
  }

 private:
  void answer(std::uint64_t bytes, bool is_segment) {
    const std::string etag = "\"" + id_.hex() + "\"";
    // Shared caches must not serve restricted assets.
    const std::string scope = context_.gate.policy()->serves_everybody() ? "public" : "private";
    HttpHeaders headers = {{"ETag", etag},
                           {"Cache-Control", is_segment ? "no-store" : scope + ", max-age=31536000, immutable"},
                           {"Accept-Ranges", "bytes"}};
    if (etag_matches(connection_->header("If-None-Match"), etag)) {
      return connection_->answer(HttpStatus::kNotModified, {}, std::move(headers));
    }
    const std::string if_range = connection_->header("If-Range");
    const bool ranged = if_range.empty() || if_range == etag;
    const auto wanted = ranged ? range_from_header(connection_->header("Range"), bytes) : RangeRequest{};
    const std::string size = std::to_string(bytes);
    if (wanted.kind == RangeRequest::Kind::kUnsatisfiable) {
      return connection_->answer_error(HttpStatus::kRangeNotSatisfiable,
                                       fail(ErrorCode::kInvalidArgument, "the asset has " + size + " bytes"),
                                       {{"Accept-Ranges", "bytes"}, {"Content-Range", "bytes */" + size}});
    }
    const bool whole = wanted.kind == RangeRequest::Kind::kWhole;
    at_ = whole ? 0 : wanted.first;
    end_ = whole ? bytes : wanted.last + 1;
    const std::uint64_t to_send = connection_->method() == "HEAD" ? 0 : end_ - at_;
    const auto taken = grant_.take_download(to_send, steady_now_us());
    if (!taken) return connection_->answer_limit(taken.error().message, kRetryAfterS);
    if (!whole) {
      headers.emplace_back("Content-Range",
                           "bytes " + std::to_string(at_) + "-" + std::to_string(end_ - 1) + "/" + size);
    }
    ++context_.counters.downloads;
    headers.emplace_back("Content-Type", "application/octet-stream");
    connection_->answer_from(
        whole ? HttpStatus::kOk : HttpStatus::kPartialContent, end_ - at_,
        static_cast<std::size_t>(std::min<std::uint64_t>(end_ - at_, kChunkBytes)),
        [self = shared_from_this()](auto then) { self->read_chunk(std::move(then)); }, std::move(headers));
  }

  void read_chunk(std::function<void(std::string_view)> then) {
    if (grant_.has_expired(std::time(nullptr)) || grant_.is_void()) return connection_->close();
    chunk_.resize(std::min<std::uint64_t>(kChunkBytes, end_ - at_));
    connection_->on(
        context_.disk, [this] { return read_at(context_.assets, id_, at_, chunk_); },
        [self = shared_from_this(), then = std::move(then)](const Result<std::size_t>& count) {
          if (!count) {  // The head is sent: only closing the connection signals the error.
            log(self->context_.log, LogLevel::kError, count.error().message);
            return self->connection_->close();
          }
          self->at_ += *count;
          self->context_.counters.download_bytes += *count;
          then({self->chunk_.data(), *count});
        });
  }

  std::shared_ptr<HttpConnection> connection_;
  Context& context_;
  Grant& grant_;
  const Sha256 id_;
  std::uint64_t at_ = 0;
  std::uint64_t end_ = 0;
  std::vector<char> chunk_;
};

}  // namespace

/// The answer to one PUT. Counts in uploads_now and holds a slot of `grant` while it lives, until leave().
class Upload : public std::enable_shared_from_this<Upload> {
 public:
  Upload(HttpConnection& connection, Grant& grant)
      : connection_(connection.shared_from_this()),
        context_(connection.context()),
        grant_(grant),
        watch_(context_.loop.get_executor()) {
    ++context_.counters.uploads_now;
    context_.uploads.insert(this);
  }
  ~Upload() { end(); }

  const Grant& grant() const { return grant_; }
  TimeUs behind_us(TimeUs now_us) const { return pace_.behind_us(now_us); }
  /// For a newcomer, at once.
  void give_way() {
    leave();
    if (!denied_) denied_ = Denial{503, "too many uploads at a time: others have none yet, try again", 1};
    ErrorOf ignored;
    connection_->transport().socket().cancel(ignored);  // watch() does it again, if it waits for something else now.
  }

  void start(const Sha256& id) {
    watch();
    connection_->arm(context_.config.timeouts.transfer_ms);
    connection_->on(
        context_.disk,
        [&assets = context_.assets, id, holder = grant_.holder()] { return assets.begin_upload(id, holder); },
        [self = shared_from_this()](Result<std::unique_ptr<AssetStore::Upload>>& upload) {
          if (!upload) return self->fail_with(upload.error());
          self->upload_ = std::move(*upload);
          self->begin_body();
        });
  }

 private:
  /// Checks each second whether it may go on.
  void watch() {
    if (!denied_) denied_ = denial_at(steady_now_us(), std::time(nullptr));
    ErrorOf ignored;
    if (denied_) connection_->transport().socket().cancel(ignored);  // Ends reading, which answers.
    run_after(watch_, std::chrono::seconds(1), [self = weak_from_this()] {
      if (const auto upload = self.lock()) upload->watch();
    });
  }

  std::optional<Denial> denial_at(TimeUs now_us, std::int64_t now_unix_s) {
    const std::int64_t most_ms = context_.config.timeouts.upload_ms;
    if (now_us - began_us_ > most_ms * 1000) {
      return Denial{
          408, "the upload took longer than timeouts.upload_ms = " + std::to_string(most_ms) + ": try a faster link"};
    }
    if (pace_.behind_us(now_us) > context_.config.timeouts.transfer_ms * 1000) {
      return Denial{408, "the upload stays behind 4,000 bytes a second: try a faster link"};
    }
    if (grant_.has_expired(now_unix_s)) return Denial{401, "the token has expired: upload with a new one", 0, true};
    if (grant_.is_void()) return Denial{401, "the rights of this upload have changed: try again", 0, true};
    return std::nullopt;
  }

  void begin_body() {
    if (const auto held = store(held_, grant_.hold_bytes(2 * kChunkBytes)); !held) return fail_with(held.error());
    chunk_.resize(kChunkBytes);
    connection_->widen_receive_buffer();
    if (::strcasecmp(connection_->header("Expect").c_str(), "100-continue") != 0) return read_body();
    static constexpr std::string_view kContinue = "HTTP/1.1 100 Continue\r\n\r\n";
    connection_->send(kContinue, {}, [self = shared_from_this()] { self->read_body(); });
  }

  void read_body() {
    if (denied_) return refuse(*denied_);
    if (connection_->is_body_read()) return commit();
    connection_->arm(context_.config.timeouts.transfer_ms);
    pace_.begin_reading(steady_now_us());
    connection_->read_body(
        chunk_, [self = shared_from_this()](ErrorOf error, std::size_t count) { self->on_body_read(error, count); });
  }

  void on_body_read(ErrorOf error, std::size_t count) {
    pace_.end_reading(steady_now_us(), count);
    if (denied_) return refuse(*denied_);
    if (HttpConnection::is_body_limit(error)) {
      return fail_with(fail(ErrorCode::kTooLarge, "the body is over assets.max_object_bytes"));
    }
    if (error) {  // The peer is gone: no answer.
      ++context_.counters.uploads_failed;
      const bool timed_out = error == asio::error::operation_aborted;
      log(context_.log, LogLevel::kWarning,
          "an upload from " + connection_->peer().text() + " was cut off, nothing of it is kept: " +
              (timed_out ? "nothing came for timeouts.transfer_ms" : error.message()));
      return connection_->close();
    }
    if (!connection_->content_length()) {  // Bodies of known length were counted at once.
      if (auto taken = grant_.take_upload(count, steady_now_us()); !taken) return fail_with(taken.error());
    }
    context_.counters.upload_bytes += count;
    const std::uint64_t chunks = connection_->body_chunks() - std::exchange(chunks_, connection_->body_chunks());
    const double work_us = static_cast<double>(chunks) / kChunksPerUs;
    const auto wait_us = grant_.take_http_work(work_us, steady_now_us(), kMaxChunksWaitUs).value_or(kMaxChunksWaitUs);
    connection_->later(chunks > 0 ? wait_us : 0, [self = shared_from_this(), count] { self->write(count); });
  }

  void write(std::size_t count) {
    connection_->on(
        context_.disk, [this, count] { return upload_->write(ByteView(chunk_.data(), count)); },
        [self = shared_from_this()](const Result<void>& written) {
          written ? self->read_body() : self->fail_with(written.error());
        });
  }

  void commit() {
    connection_->disarm();
    connection_->on(
        context_.commits, [this] { return upload_->commit(); },
        [self = shared_from_this()](const Result<bool>& created) {
          if (!created) return self->fail_with(created.error());
          self->end();
          ++self->context_.counters.uploads;
          self->connection_->answer(*created ? HttpStatus::kCreated : HttpStatus::kOk, "{}\n");
        });
  }

  void refuse(const Denial& denial) {
    end();
    ++context_.counters.uploads_failed;
    connection_->answer_denial(denial);
  }

  void fail_with(const Error& error) {
    if (error.code == ErrorCode::kRefused) return refuse({429, error.message, kRetryAfterS});
    end();
    ++context_.counters.uploads_failed;
    log(context_.log, LogLevel::kWarning, "upload refused: " + error.message);
    switch (error.code) {
      case ErrorCode::kCorrupt:
        return connection_->answer_error(HttpStatus::kUnprocessableEntity, error);
      case ErrorCode::kTooLarge:
        return connection_->answer_error(HttpStatus::kPayloadTooLarge, error);
      default:
        return connection_->answer_error(HttpStatus::kInsufficientStorage, error);
    }
  }

  void end() {
    upload_.reset();
    watch_.cancel();
    leave();
  }

  void leave() {
    if (context_.uploads.erase(this) == 0) return;
    --context_.counters.uploads_now;
    grant_.give_back(Resource::kUpload);
  }

  std::shared_ptr<HttpConnection> connection_;
  Context& context_;
  Grant& grant_;
  Timer watch_;
  const TimeUs began_us_ = steady_now_us();
  std::optional<Denial> denied_;
  UploadPace pace_;
  std::unique_ptr<AssetStore::Upload> upload_;
  std::vector<std::uint8_t> chunk_;
  std::uint64_t chunks_ = 0;    ///< Of the body, paid for.
  std::shared_ptr<void> held_;  ///< Counts chunk_ and the buffer before it.
};

namespace {

/// That `newcomer` counts with.
std::vector<Upload*> uploads_beside(const Context& context, const Grant& newcomer) {
  std::vector<Upload*> beside;
  for (Upload* const upload : context.uploads) {
    if (!newcomer.identity().is_stranger() || upload->grant().identity().is_stranger()) beside.push_back(upload);
  }
  return beside;
}

/// Ends the slowest of the holder with the most, if that has several and `newcomer` has none.
bool make_room(const std::vector<Upload*>& beside, const Grant& newcomer) {
  std::map<const void*, int> counts;
  for (const Upload* const upload : beside) ++counts[upload->grant().purse()];
  const auto rank = [&, now_us = steady_now_us()](const Upload* upload) {
    return std::pair(counts.at(upload->grant().purse()), upload->behind_us(now_us));
  };
  const auto worst = std::max_element(beside.begin(), beside.end(),
                                      [&](const Upload* one, const Upload* other) { return rank(one) < rank(other); });
  if (worst == beside.end() || rank(*worst).first < 2 || counts.contains(newcomer.purse())) return false;
  (*worst)->give_way();
  return true;
}

}  // namespace

void send_asset(HttpConnection& connection, Grant& grant, const Sha256& id) {
  std::make_shared<Download>(connection, grant, id)->start();
}

void receive_asset(HttpConnection& connection, Grant& grant, const Sha256& id) {
  Context& context = connection.context();
  // A quarter is left to tokens.
  const std::int64_t all = context.config.limits.max_uploads;
  const std::int64_t max = grant.identity().is_stranger() ? all - all / 4 : all;
  const auto beside = uploads_beside(context, grant);
  auto now = static_cast<std::int64_t>(beside.size());
  const bool is_full = now >= max || static_cast<std::int64_t>(context.uploads.size()) >= all;
  if (is_full && make_room(beside, grant)) {
    --now;
  } else if (is_full) {
    return connection.answer_error(HttpStatus::kServiceUnavailable,
                                   fail(ErrorCode::kRefused, "too many uploads at a time: try again"),
                                   {{"Retry-After", "1"}});
  }
  const auto slot = grant.take_share(Resource::kUpload, max, now);
  if (!slot) return connection.answer_limit(slot.error().message);
  const auto taken = grant.take_upload(connection.content_length().value_or(0), steady_now_us());
  if (!taken) {
    grant.give_back(Resource::kUpload);
    return connection.answer_limit(taken.error().message, kRetryAfterS);
  }
  std::make_shared<Upload>(connection, grant)->start(id);
}

}  // namespace eigencast::broker
