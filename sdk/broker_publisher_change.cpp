// SPDX-License-Identifier: MIT
#include "sdk/broker_publisher.h"

#include <algorithm>
#include <mutex>

namespace eigencast {

namespace {

constexpr TimeUs kProgressEveryUs = 1'000'000;

}  // namespace

Result<void> BrokerPublisher::change_to(std::shared_ptr<const Asset> asset, std::shared_ptr<const EncodedAsset> encoded,
                                        double coarser) {
  const std::shared_ptr<const Asset> before = this->asset();
  if (!before || !asset || !encoded || !asset->complete())
    return fail(ErrorCode::kInvalidArgument, "a publisher of poses changes to a complete asset");
  StreamFormat format = format_of(options_, *asset);
  if (auto usable = check_format(format); !usable) return usable;
  Change change{nullptr, Ramp(*before, *asset)};
  if (change.ramp.is_over())
    return fail(ErrorCode::kInvalidArgument,
                "a stream changes to an asset of the same surface, whose vertices are in the same order");
  change.to = std::make_unique<Sending>(options_, options_.codec, std::move(format), std::move(asset),
                                        std::move(encoded), coarser);
  if (auto ready = change.to->projection.prepare(); !ready) return ready;
  const std::lock_guard lock(mutex_);
  change_ = std::move(change);
  if (phase_ == Phase::kLive) upload_change();
  return {};
}

bool BrokerPublisher::take_change() {
  const std::lock_guard lock(mutex_);
  const bool begins_anew = phase_ == Phase::kDown;
  if (!change_ || (!begins_anew && !change_->granted)) return false;
  if (segment_uploader_) segment_uploader_->cancel();
  Sending& to = *change_->to;
  const bool alike = to.format.scalars == now_->format.scalars && to.format.velocity_us == now_->format.velocity_us;
  ramp_.reset();
  if (!begins_anew) {
    std::optional<Key> held;
    if (alike && now_->writer.held() != nullptr) {
      const auto C = coefficients_from_key(now_->writer.layout(), *now_->writer.held());
      if (auto key = key_from_coefficients(to.writer.layout(), change_->ramp.carried_over(C, to.format.channels),
                                           to.quantiser.step))
        held = std::move(*key);
      ramp_ = std::move(change_->ramp);
    }
    to.writer.continue_as(*change_->granted, now_->writer.newest(), std::move(held));
    resume_ = change_->granted->resume;
  }
  stats_.learnt_columns = stats_.learnt_bytes = 0;
  for (const AssetObject& section : to.encoded->sections) {
    stats_.learnt_columns = to.asset->rank - now_->asset->rank;
    stats_.learnt_bytes += section.bytes.size() + to.encoded->manifest.bytes.size();
    learn_ = LearnUse::kOff;
  }
  saved_before_ = stats_.saved_bytes;
  memory_before_ = stats_.memory_bytes;
  now_ = std::move(change_->to);
  change_.reset();
  asset_uploader_->use(now_->encoded);
  restart_still();
  ++stats_.changes;
  return true;
}

void BrokerPublisher::learn(LearnUse use) {
  const std::lock_guard lock(mutex_);
  learn_ = now_->writer.layout().is_float() ? LearnUse::kOff : use;
}

void BrokerPublisher::show_progress(double fraction) {
  const std::lock_guard lock(mutex_);
  if (phase_ != Phase::kLive || change_ || steady_now_us() - progress_us_ < kProgressEveryUs) return;
  progress_us_ = steady_now_us();
  (void)socket_->send_text(text_from_control(control::Progress{url_.stream, std::clamp(fraction, 0.0, 1.0)}));
}

void BrokerPublisher::learn_from(const VertexPose& pose, std::span<const double> C, TimeUs capture_us) {
  std::unique_lock lock(mutex_);
  const LearnUse use = learn_;
  const bool is_changing = change_.has_value();
  lock.unlock();
  if (use == LearnUse::kOff) return learner_.reset();
  if (is_changing) return;
  if (!learner_) {
    const auto take = [this](const std::shared_ptr<const Asset>& from, const LearntAsset& learnt) {
      if (asset() != from) return;
      if (const auto changes = change_to(learnt.asset, learnt.encoded, learnt.coarser); !changes)
        log(log_, LogLevel::kError, "what was learnt is not used: " + changes.error().message);
    };
    learner_ = std::make_unique<StreamLearner>(use, take, log_);
  }
  if (learns_in_ != now_->asset.get()) {
    learner_->begin(now_->asset, now_->encoded, error_bound(options_, *now_->asset));
    learns_in_ = now_->asset.get();
  }
  if (learner_->wants(capture_us)) learner_->add(pose.positions, C, capture_us);
}

void BrokerPublisher::upload_change() {
  change_->asked = false;
  change_->granted.reset();
  if (!change_uploader_) {
    AssetUploader::Events upload;
    upload.on_progress = [](std::uint64_t, std::uint64_t) {};
    upload.on_done = [this](const Result<void>& done) { return on_change_uploaded(done); };
    upload.on_exception = [this](const std::string& what) {
      const std::lock_guard lock(mutex_);
      drop_change(what);
    };
    change_uploader_ = std::make_unique<AssetUploader>(change_->to->encoded, std::move(upload));
  }
  change_uploader_->use(change_->to->encoded);
  change_uploader_->begin(at_, milliseconds(0));
}

auto BrokerPublisher::on_change_uploaded(const Result<void>& done) -> std::optional<milliseconds> {
  const std::lock_guard lock(mutex_);
  if (phase_ != Phase::kLive || !change_) return std::nullopt;
  if (!done) {
    log(log_, LogLevel::kWarning, "the next asset: " + done.error().message);
    return done.error().code == ErrorCode::kRefused ? kRefusedRetry : kUploadRetry;
  }
  control::Announce m = announcement(*change_->to);
  m.continues = true;
  change_->asked = true;
  (void)socket_->send_text(text_from_control(m));
  return std::nullopt;
}

void BrokerPublisher::drop_change(const std::string& why) {
  if (!change_) return;
  change_.reset();
  log(log_, LogLevel::kError, "the next asset is not used: " + why);
}

}  // namespace eigencast
