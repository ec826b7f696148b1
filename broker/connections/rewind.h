// SPDX-License-Identifier: MIT
#pragma once

#include <deque>
#include <memory>
#include <optional>
#include <string>

#include "broker/context/context.h"
#include "broker/sockets/net.h"
#include "broker/storage/past_reader.h"

namespace eigencast::broker {

/// When poses of the past are due: no clocks, no disk. Times on the steady clock, but for at_us.
class Replay {
 public:
  static constexpr TimeUs kAheadUs = 1'000'000;  ///< So much is read ahead, as long as it takes to be shown.
  static constexpr TimeUs kLateUs = 250'000;     ///< What is later than that is not caught up with.

  /// seeks: it replaces what was there.
  void add(Passage passage, bool seeks);
  /// The next pose that is due, with the epoch that begins with it; nothing: none is, yet.
  struct Due {
    std::optional<Passage::Beginning> begins;
    KeyRecordPtr key;
  };
  std::optional<Due> pop_due(TimeUs now_us);
  std::optional<TimeUs> next_due_us() const;
  /// Up to when to read on; nothing: there is enough.
  std::optional<TimeUs> wants(TimeUs now_us) const;
  /// The moment that is shown, in microseconds since 1970.
  TimeUs position_us(TimeUs now_us) const;
  double speed() const { return speed_; }
  /// How long one moment has been shown; 0: it plays.
  TimeUs paused_us(TimeUs now_us) const { return speed_ == 0 && !at_once_ ? now_us - start_us_ : 0; }
  /// Whether all has been shown that is kept.
  bool is_over() const { return ended_ && waiting_.empty() && speed_ > 0; }

 private:
  std::deque<Passage> waiting_;  ///< None is empty.
  bool at_once_ = false;         ///< Their first pose.
  bool ended_ = false;
  double speed_ = 1;
  TimeUs start_us_ = 0, start_at_us_ = 0;  ///< When which moment was shown.
  TimeUs shown_at_us_ = 0;                 ///< The moment of the last pose shown,
  TimeUs read_at_us_ = 0;                  ///< and of the last that was read.
};

/// One viewer's past of one stream: seeks and reads ahead off the loop, and gives the keys in time to a stream that
/// only this viewer watches. Belongs to the loop of its viewer. One read at a time: of seeks that wait the last counts.
class Rewind final : public std::enable_shared_from_this<Rewind> {
 public:
  /// Called on the loop, not within seek(), and no more after stop(); may call that.
  class Viewer {
   public:
    virtual ~Viewer() = default;
    /// Watch stream() in place of `former`, or of the present where that is null. False: it could not, and has ended
    /// this.
    virtual bool show_past(Rewind& rewind, Stream* former) = 0;
    /// Ends this.
    virtual void show_present(const Rewind& rewind) = 0;
    virtual void refuse_seek(const Rewind& rewind, const Error& why) = 0;
    /// Takes what reading took from its budget; how long the next has to wait.
    virtual TimeUs pay(double work_us) = 0;
    virtual std::shared_ptr<void> lifetime() = 0;  ///< Of it and of the loop.
  };

  /// place  among those that see the past
  Rewind(Context& context, Viewer& viewer, const control::Seek& first, std::string holder, const Profile& wanted,
         std::shared_ptr<void> place);
  ~Rewind();

  void seek(const control::Seek& wanted);
  void stop();

  const std::string& name() const { return name_; }
  Stream* stream() const { return stream_.get(); }         ///< Null before the first pose.
  bool is_seeking() const { return sought_.has_value(); }  ///< Besides what is being read.
  const Profile& wanted() const { return profile_; }
  /// At its speed.
  Profile profile() const;

 private:
  /// False: its holder has too many that wait.
  bool read(std::optional<TimeUs> until_us);
  void take(const Result<Passage>& read, bool sought, TimeUs pause_us);
  void run();
  bool begin(const Passage::Beginning& begins, const KeyRecordPtr& key, TimeUs now_us);
  void arm(TimeUs now_us);

  Context& context_;
  Viewer* viewer_;  ///< Null once stopped.
  const std::string name_, holder_;
  const Profile profile_;
  std::shared_ptr<void> place_;
  PastReader reader_;  ///< Belongs to the thread that reads while reading_.
  bool reading_ = false;
  TimeUs paid_us_ = 0;                   ///< Until then nothing more is read,
  TimeUs again_us_ = 0;                  ///< and until then nothing that follows.
  std::optional<control::Seek> sought_;  ///< Waits for its turn.
  Replay replay_;
  std::unique_ptr<Stream> stream_;
  Timer timer_;
};

}  // namespace eigencast::broker
