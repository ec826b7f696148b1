// SPDX-License-Identifier: MIT
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "common/net/clock_offset.h"
#include "common/wire/control.h"
#include "common/wire/limits.h"
#include "sdk/asset_uploader.h"
#include "sdk/broker.h"
#include "sdk/publisher.h"
#include "sdk/send_policy.h"
#include "sdk/sending.h"
#include "sdk/stream_learner.h"

namespace eigencast {

/// Has a file for each: the connection, sending, changes of the asset, the memory of poses.
class BrokerPublisher final : public Publisher {
 public:
  BrokerPublisher(PublisherOptions options, BrokerUrl url, std::unique_ptr<Sending> sending, LogSink log);
  ~BrokerPublisher() override;
  void start();  ///< Once.

  SendStatus send_key(Key key, TimeUs capture_us, ByteView coded, std::optional<std::uint32_t> phase) override;
  SendStatus send_coefficients(std::span<const double> C, TimeUs capture_us, std::span<const double> V) override;
  Result<SendStatus> send_pose(const VertexPose& pose, TimeUs capture_us) override;
  Result<void> change_to(std::shared_ptr<const Asset> asset, std::shared_ptr<const EncodedAsset> encoded,
                         double coarser) override;
  bool take_change() override;
  void learn(LearnUse use) override;
  void show_progress(double fraction) override;
  std::shared_ptr<const Asset> asset() const override;
  Result<void> remember(std::vector<CodedSegment> segments) override;
  MemoryState memory() const override;
  std::vector<double> as_received() const override;
  State state() const override { return state_; }
  Stats stats() const override;

 private:
  using milliseconds = std::chrono::milliseconds;
  static constexpr milliseconds kUploadRetry{1000};
  static constexpr milliseconds kRefusedRetry{5000};  ///< Another sender may have left by then.

  enum class Phase { kDown, kUpload, kAnnounced, kLive };

  /// When the work on a pose began, and when its coefficients were there; 0: they were given.
  struct Work {
    TimeUs begun_us = 0;
    TimeUs transformed_us = 0;
  };

  /// To another asset of the surface.
  struct Change {
    std::unique_ptr<Sending> to;
    Ramp ramp;
    bool asked = false;  ///< The broker.
    std::optional<control::Announced> granted{};
  };

  // The connection, on its thread.
  void on_open(const BrokerUrl& broker);
  void on_down(const Error& why, milliseconds wait);
  void on_text(std::string_view text);
  template <typename Message>
  void on_message(const Message&) {}  // What concerns subscribers only.
  void on_message(const control::Announced& m);
  void on_message(const control::Remembered& m);
  void on_message(const control::Subscribers& m);
  void on_message(const control::Ping& m);
  void on_message(const control::Pong& m);
  void on_message(const control::TraceRequest& m);
  void on_message(const control::ErrorMessage& m);
  void on_message(const control::Notice& m) { log(log_, LogLevel::kInfo, m.message); }
  void on_message(const control::Bye& m);
  // On the uploader's thread, whenever a connection is new.
  void on_progress(std::uint64_t sent, std::uint64_t total);
  std::optional<milliseconds> on_uploaded(const Result<void>& done);
  void upload_failed(const std::string& what);
  control::Announce announcement(const Sending& of) const;

  // Sending. All that take Work, but for send(), REQUIRE: mutex_ is held.
  /// V: empty, or velocities per second; S: r x scalars.
  SendStatus send(std::span<const double> C, std::span<const double> V, std::span<const double> S, TimeUs capture_us,
                  const Work& work);
  /// The gate stays as it was where a frame is not sent. REQUIRES: as send_next; a key was sent, and there is a gate.
  SendStatus send_unless_still(Key key, std::span<const double> C, TimeUs capture_us, const Work& work);
  /// REQUIRES: nothing blocks sending.
  SendStatus send_next(Key key, TimeUs capture_us, const Work& work);
  /// pose  to remember; may be null.  REQUIRES: as send_next.
  SendStatus send_coded(Result<KeyWriter::Coded> coded, const Work& work, const Key* pose = nullptr);
  /// Where timing marks were asked for. Lost traces are not resent.
  void trace(const Work& work, TimeUs sent_us);
  // Likewise, and they are counted:
  std::optional<SendStatus> send_blocker(TimeUs capture_us);
  SendStatus dropped(DropReason why);
  SendStatus unusable(const Error& why);
  void restart_still();

  // To another asset of the surface. All but the first and the callback REQUIRE: mutex_ is held.
  /// On the caller's thread.
  void learn_from(const VertexPose& pose, std::span<const double> C, TimeUs capture_us);
  void upload_change();
  /// On the uploader's thread.
  std::optional<milliseconds> on_change_uploaded(const Result<void>& done);
  /// The stream goes on as it is.
  void drop_change(const std::string& why);

  // The memory of poses. All but the callback REQUIRE: mutex_ is held.
  /// REQUIRES: the key has left; a key before it.
  void keep(const Key& pose, const KeyWriter::Coded& coded, std::size_t bytes);
  Result<void> remember_now(std::vector<CodedSegment> segments);
  /// The broker has nothing of it (any more).
  void forget_memory();
  void upload_memory();
  /// On the uploader's thread.
  void on_memory_uploaded(const Result<void>& done);
  void refuse_memory(const Error& why);

  const PublisherOptions options_;
  const TimeUs utc_us_ = unix_at_steady_zero_us();  ///< One for all of its epochs.
  BrokerUrl url_;  ///< Changed by the connection's thread alone, with mutex_, before it is ever open.
  const LogSink log_;

  std::unique_ptr<Sending> now_;  ///< Replaced by the caller's thread alone, with mutex_.

  RetryLog retries_;  ///< For the connection's thread alone.

  // For the caller's thread alone.
  std::unique_ptr<StreamLearner> learner_;  ///< Null: nothing is learnt (yet).
  const Asset* learns_in_ = nullptr;        ///< What it began with.

  mutable std::mutex mutex_;
  // GUARDED_BY(mutex_):
  std::unique_ptr<WebSocket> socket_;              ///< Set once by start().
  std::unique_ptr<AssetUploader> asset_uploader_;  ///< Likewise.
  Phase phase_ = Phase::kDown;
  std::string resume_;  ///< Takes the stream over, at this broker and at others.
  BrokerUrl at_;        ///< The broker that it is or was connected to.
  bool ever_open_ = false;
  std::optional<StillGate> still_;  ///< Where still surfaces are not to be sent again and again.
  LearnUse learn_ = LearnUse::kOff;
  std::optional<Change> change_;                    ///< Under way.
  std::unique_ptr<AssetUploader> change_uploader_;  ///< Once there was one.
  std::optional<Ramp> ramp_;                        ///< While it lasts.
  TimeUs progress_us_ = 0;
  std::unique_ptr<AssetUploader> segment_uploader_;  ///< Once there was something to upload.
  Stats stats_;
  // In place of the one of stats_; written while mutex_ is held.
  std::atomic<State> state_ = State::kConnecting;
  std::uint64_t saved_before_ = 0, memory_before_ = 0;  ///< Of memories in assets before this one.
  std::uint32_t trace_every_ = 0;                       ///< Keys of which the broker wants traces; 0: none.
  ClockOffset clock_;                                   ///< The broker's; learnt while there are traces.
  TimeUs last_ping_us_ = 0;
  std::uint64_t ping_id_ = 0;
};

}  // namespace eigencast
