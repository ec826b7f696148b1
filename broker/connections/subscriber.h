// SPDX-License-Identifier: MIT
#pragma once

#include <forward_list>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "broker/connections/connection.h"
#include "broker/connections/rewind.h"
#include "broker/relay/moments.h"
#include "broker/relay/rooms.h"
#include "broker/relay/stream.h"

namespace eigencast::broker {

/// The connection of a viewer: /v1/subscribe/{stream}, or /v1/subscribe and control messages. Belongs to its event
/// loop.
class Subscriber final : public Watcher, public Connection, private Rewind::Viewer {
 public:
  /// Of rooms, so that nobody who speaks fills the links of others: bytes a second, and at once.
  static constexpr std::int64_t kNewsBytesPerS = 131'072, kNewsBurst = 131'072;

  Subscriber(Context& context, Transport transport, GrantPtr grant, std::optional<control::Subscribe> first);
  ~Subscriber() override;

  std::string holder() const override { return grant().is_spared() ? std::string() : grant().holder(); }
  bool charge_poses(double work_us) override;
  bool take_key(double work_us) override;
  void charge_key(double work_us) override;
  const void* purse() const override { return grant().purse(); }
  void on_stream_changed(const Stream& stream, bool restart) override;
  void on_memory(const Stream& stream) override;
  void on_restart(const Stream& stream) override;
  void on_frames(const Stream& stream, std::span<const FramePtr> frames) override;
  void on_trace(const std::shared_ptr<const std::string>& text) override { send_droppable(text); }
  void describe(ClientInfo& info) const override;

 private:
  struct Watched {
    Stream* stream;
    Ladder ladder;
    std::uint32_t told = 0;  ///< The generation of its memory that the viewer was told of.
    std::optional<Moments::Seat> moment{};
    bool is_waited_for = false;      ///< In its group.
    std::optional<control::Moment> moment_told{};
    TimeUs noted_us = 0;             ///< When an arrival was noted last.
  };

  void on_open() override;
  void on_message(const ControlMessage& message) override;
  void on_binary(ByteView message) override;
  void on_closed() override;
  void on_tick() override;
  void on_paced(const std::string& limit) override;
  void on_beat() override;
  bool takes_turns() const override { return true; }
  /// Short requests have long answers.
  std::size_t read_bytes() const override { return 2048; }
  FramePtr join_of(std::uint32_t stream_id) override;
  std::string label() const override;
  void subscribe(const control::Subscribe& request);
  void unsubscribe(const control::Unsubscribe& request);
  /// group: empty: none.
  void synchronise(Watched& watched, const std::string& group);
  /// Microseconds that it took.
  double tell_moments();
  double tell_room(const std::string& room, const Rooms::Seat& seat);
  void note_late(const control::Late& late);
  void note_arrival(const Stream& stream, std::span<const FramePtr> frames);
  /// Apart from on_frames(), which so needs no registers of its own.
  [[gnu::noinline]] void deliver_noted(const Stream& stream, std::span<const FramePtr> frames);
  /// Whether it is told news.
  void follow_beat();
  void enter(const control::Enter& wish);
  Result<void> try_to_enter(const control::Enter& wish);
  void say(const control::Say& what);
  void take(const control::Floor& floor);
  void leave(const control::Leave& what);
  Rooms::Seat seat_in(const std::string& room) const;  ///< A void one: it is not there.
  Rooms::Limits room_limits();
  void refuse_in_room(const Error& why, const std::string& room);
  void acknowledge(const control::Ack& ack);
  void tell_history(const std::string& stream, const Error* why = nullptr);
  Result<void> may_see_past(const std::string& stream) const;
  void seek(const control::Seek& wanted);
  Result<void> try_to_seek(const control::Seek& wanted);
  /// Whether the past of the stream was shown, which is watched no more.
  bool end_rewind(const std::string& stream);
  void end_rewinds();
  std::shared_ptr<Rewind> rewind_of(const std::string& stream) const;  ///< Null: none.
  bool show_past(Rewind& rewind, Stream* former) override;
  void show_present(const Rewind& rewind) override;
  void refuse_seek(const Rewind& rewind, const Error& why) override;
  TimeUs pay(double work_us) override;
  std::shared_ptr<void> lifetime() override { return shared_from_this(); }
  void report_dropped();
  void step(Stream& stream, Ladder& ladder);

  std::optional<control::Subscribe> first_;
  std::map<std::uint32_t, Watched> streams_;  ///< For few streams a tree takes less memory than a hash table.
  bool synchronised_ = false;                 ///< Whether one of its streams has a moment; asked at each delivery.
  std::map<std::string, Rooms::Seat> rooms_;  ///< At most limits::kMaxRooms.
  std::size_t room_ = 0;                      ///< Of these the next one that is told.
  std::forward_list<std::shared_ptr<Rewind>> rewinds_;  ///< One of a stream; streams_ has what each watches.
  RateLimiter news_bytes_;
  TimeUs news_due_us_ = 0, rooms_due_us_ = 0, paced_told_us_ = 0;
  std::uint64_t joins_counted_ = 0, dropped_counted_ = 0;
};

}  // namespace eigencast::broker
