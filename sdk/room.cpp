// SPDX-License-Identifier: MIT
#include "sdk/room.h"

#include <utility>
#include <vector>

#include "common/wire/limits.h"
#include "sdk/broker.h"
#include "sdk/broker_connection.h"

namespace eigencast {
namespace {

constexpr TimeUs kSayEveryUs = 100'000, kAskAgainUs = 5'000'000;

class BrokerRoom final : public RoomClient, private BrokerConnection::RoomListener {
 public:
  BrokerRoom(const BrokerUrl& url, control::Enter wish) : wish_(std::move(wish)) {
    connection_ = BrokerConnection::enter(url, wish_.room, *this);
  }
  ~BrokerRoom() override { connection_->leave(*this, wish_.room); }

  void read(RoomState& state) const override {
    const std::lock_guard lock(mutex_);
    if (state.version != state_.version) state = state_;
  }
  void say(const std::string& key, const std::string& json, bool keep) override {
    const std::lock_guard lock(mutex_);
    const Said said{json, keep, true};
    const auto [at, is_new] = said_.try_emplace(key, said);
    if (!is_new && (at->second.json != json || at->second.keep != keep)) at->second = said;
  }
  void remove(std::uint32_t member, const std::string& key) override {
    connection_->send_in_room(control::Say{wish_.room, {{key, "null"}}, false, member});
  }
  void take(const std::string& floor, bool take) override {
    connection_->send_in_room(control::Floor{wish_.room, floor, take});
  }

 private:
  struct Said {
    std::string json;
    bool keep = false;
    bool waits = false;  ///< To be sent.
  };

  ControlMessage on_room_open() override {
    const std::lock_guard lock(mutex_);
    for (auto& [key, said] : said_) said.waits = true;
    change().trouble.clear();
    asked_us_ = steady_now_us();
    return wish_;
  }
  void on_room_down(const Error& why) override {
    const std::lock_guard lock(mutex_);
    change().open = false;
    state_.trouble = why.message;
  }
  void on_room(const control::Room& news) override {
    const std::lock_guard lock(mutex_);
    if (news.self != 0) wish_.resume = news.resume;
    change().take(news);
  }
  void on_room_error(const control::ErrorMessage& error) override {
    const std::lock_guard lock(mutex_);
    change().trouble = error.message;
  }
  std::vector<ControlMessage> on_room_tick(TimeUs now) override {
    const std::lock_guard lock(mutex_);
    if (!state_.open && now - asked_us_ >= kAskAgainUs) {
      asked_us_ = now;
      return {wish_};
    }
    if (!state_.open || !state_.speaks || now - said_us_ < kSayEveryUs) return {};
    control::Say once{wish_.room, {}, false, 0}, kept{wish_.room, {}, true, 0};
    for (auto said = said_.begin(); said != said_.end();) {
      if (std::exchange(said->second.waits, false))
        (said->second.keep ? kept : once).values.push_back({said->first, said->second.json});
      said = said->second.json == "null" ? said_.erase(said) : std::next(said);
    }
    std::vector<ControlMessage> messages;
    if (!once.values.empty()) messages.emplace_back(std::move(once));
    if (!kept.values.empty()) messages.emplace_back(std::move(kept));
    if (!messages.empty()) said_us_ = now;
    return messages;
  }
  RoomState& change() {
    ++state_.version;
    return state_;
  }

  mutable std::mutex mutex_;
  control::Enter wish_;               ///< GUARDED_BY(mutex_) but for its room.
  RoomState state_;                   ///< GUARDED_BY(mutex_)
  std::map<std::string, Said> said_;  ///< GUARDED_BY(mutex_)
  TimeUs said_us_ = -kSayEveryUs;     ///< GUARDED_BY(mutex_)
  TimeUs asked_us_ = 0;               ///< GUARDED_BY(mutex_)
  std::shared_ptr<BrokerConnection> connection_;
};

}  // namespace

void RoomState::take(const control::Room& news) {
  if (news.self != 0) {
    self = news.self;
    speaks = news.speaks;
    open = true;
  }
  if (news.whole) {
    members.clear();
    floors.clear();
  }
  for (const std::uint32_t id : news.gone) members.erase(id);
  for (const control::Room::Member& change : news.members) {
    if (members.size() >= limits::kMaxRoomMembers && !members.contains(change.id)) continue;
    Member& member = members[change.id];
    if (!change.name.empty()) member.name = change.name;
    if (!change.colour.empty()) member.colour = change.colour;
    member.here = change.here;
    for (const control::RoomValue& value : change.values) {
      if (value.json == "null") {
        member.values.erase(value.key);
      } else if (member.values.size() < limits::kMaxRoomKeys || member.values.contains(value.key)) {
        member.values[value.key] = value.json;
      }
    }
  }
  for (const control::Room::Holder& held : news.floors) {
    if (held.member == 0) {
      floors.erase(held.floor);
    } else if (floors.size() < limits::kMaxRoomFloors || floors.contains(held.floor)) {
      floors[held.floor] = held.member;
    }
  }
}

const RoomState::Member* RoomState::holder_of(const std::string& floor) const {
  const auto held = floors.find(floor);
  const auto member = held == floors.end() ? members.end() : members.find(held->second);
  return member == members.end() ? nullptr : &member->second;
}

Result<std::unique_ptr<RoomClient>> RoomClient::enter(const std::string& url, const Credentials& credentials,
                                                      control::Enter wish, LogSink log) {
  const auto broker = stream_url(url, credentials, log);
  if (!broker) return broker.error();
  const auto checked = control_from_text(text_from_control(wish));
  if (!checked) return fail(ErrorCode::kInvalidArgument, checked.error().message);
  return std::unique_ptr<RoomClient>(std::make_unique<BrokerRoom>(*broker, std::move(wish)));
}

}  // namespace eigencast
