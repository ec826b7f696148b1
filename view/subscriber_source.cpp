// SPDX-License-Identifier: MIT
#include "view/pose_source.h"

namespace eigencast {
namespace {

class SubscriberSource final : public PoseSource {
 public:
  explicit SubscriberSource(std::unique_ptr<Subscriber> subscriber) : subscriber_(std::move(subscriber)) {}
  std::vector<ReceivedPose> poll(std::chrono::milliseconds timeout) override { return subscriber_->poll(timeout); }
  const Asset* asset() const override { return subscriber_->asset(); }
  const ChangeOver* change() const override { return subscriber_->change(); }
  std::uint32_t epoch() const override { return subscriber_->epoch(); }
  const std::optional<control::StreamInfo>& info() const override { return subscriber_->info(); }
  Subscriber::Stats stats() const override { return subscriber_->stats(); }
  std::optional<SharedMoment> moment() const override { return subscriber_->moment(); }
  Rewind* rewind() override { return subscriber_.get(); }
  void report_late(TimeUs needed_lag_us) override { subscriber_->report_late(needed_lag_us); }

 private:
  std::unique_ptr<Subscriber> subscriber_;
};

}  // namespace

Result<std::unique_ptr<PoseSource>> subscribe_to(SubscriberOptions options, LogSink log) {
  Result<std::unique_ptr<Subscriber>> subscriber = Subscriber::create(std::move(options), std::move(log));
  if (!subscriber) return subscriber.error();
  return std::unique_ptr<PoseSource>(std::make_unique<SubscriberSource>(std::move(subscriber).value()));
}

}  // namespace eigencast
