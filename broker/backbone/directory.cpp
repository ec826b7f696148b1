// SPDX-License-Identifier: MIT
#include "broker/backbone/directory.h"

#include <nlohmann/json.hpp>
#include <tuple>

#include "broker/config/config.h"
#include "broker/relay/ownership.h"
#include "common/core/hash/sha256.h"
#include "common/core/text.h"

namespace eigencast::broker {
namespace {

constexpr std::size_t kMaxEntryBytes = 8'192;
constexpr std::size_t kMaxIdBytes = 64;
constexpr std::size_t kMaxProofBytes = 128;
constexpr TimeUs kMakeRoomEveryUs = 1'000'000;

Error corrupt(const std::string& why) {
  return fail(ErrorCode::kCorrupt, "an entry of the directory of streams cannot be read (" + why +
                                       "); do all brokers run the same version?");
}

}  // namespace

std::string sender_of(const StreamHolder& holder, std::string_view salt) {
  if (holder.key.empty()) return {};
  const std::string text = std::string(salt) + holder.key;
  const ByteView bytes{reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
  return sha256(bytes).hex().substr(0, 16);
}

std::string payer_of(const DirectoryEntry& entry) {
  const std::string broker(name_of_broker(entry.owner));
  return entry.sender.empty() ? "broker " + broker
                              : "sender " + broker + " " + entry.sender;  // No other's word counts.
}

std::string text_from_entry(const DirectoryEntry& entry) {
  // The announcement is embedded as a control message, for its hardened parser.
  nlohmann::json json{{"owner", entry.owner},
                      {"epoch", entry.epoch},
                      {"live", entry.live},
                      {"announce", text_from_control(entry.announce)}};
  if (!entry.resume.empty()) json["resume"] = entry.resume;
  if (!entry.sender.empty()) json["sender"] = entry.sender;
  if (!entry.next.empty()) json["next"] = entry.next;
  return json.dump();
}

Result<DirectoryEntry> entry_from_text(std::string_view text) {
  if (text.size() > kMaxEntryBytes) return corrupt("it is too long");
  const auto json = nlohmann::json::parse(text, nullptr, false);
  if (!json.is_object()) return corrupt("not a JSON object");
  const auto owner = json.find("owner"), epoch = json.find("epoch"), live = json.find("live"),
             announce = json.find("announce");
  const bool whole = owner != json.end() && owner->is_string() && epoch != json.end() && epoch->is_number_unsigned() &&
                     live != json.end() && live->is_boolean() && announce != json.end() && announce->is_string();
  if (!whole) return corrupt("a field is missing");
  DirectoryEntry entry;
  entry.owner = owner->get<std::string>();
  if (!is_broker_id(entry.owner)) return corrupt("owner");
  if (epoch->get<std::uint64_t>() == 0 || epoch->get<std::uint64_t>() > kMaxForeignEpoch) return corrupt("epoch");
  entry.epoch = epoch->get<std::uint32_t>();
  entry.live = live->get<bool>();
  const auto message = control_from_text(announce->get<std::string>());
  if (!message) return corrupt(message.error().message);
  const auto* announced = std::get_if<control::Announce>(&*message);
  if (announced == nullptr) return corrupt("announce");
  if (const auto format = check_format(announced->format); !format) return corrupt(format.error().message);
  entry.announce = *announced;
  entry.announce.resume.clear();  // No broker writes one.
  for (const auto& [key, text_of] :
       {std::pair("resume", &entry.resume), std::pair("sender", &entry.sender), std::pair("next", &entry.next)}) {
    const auto found = json.find(key);
    if (found == json.end()) continue;
    if (!found->is_string()) return corrupt(key);
    *text_of = found->get<std::string>();
    if (text_of->empty() || text_of->size() > kMaxProofBytes) return corrupt(key);
  }
  if (!entry.next.empty() && !Sha256::from_hex(entry.next)) return corrupt("next");
  return entry;
}

std::string token_from_stream(std::string_view name) {
  std::string token(name);
  for (char& c : token) c = c == '.' ? '=' : c == '/' ? '.' : c;
  return token;
}

std::optional<std::string> stream_from_token(std::string_view token) {
  std::string name(token);
  for (char& c : name) {
    if (c == '/') return std::nullopt;
    c = c == '.' ? '/' : c == '=' ? '.' : c;
  }
  if (!check_stream_name(name)) return std::nullopt;
  return name;
}

bool is_broker_id(std::string_view id) {
  if (id.size() > kMaxIdBytes) return false;
  const auto parts = split(id, '.');
  return std::all_of(parts.begin(), parts.end(), is_broker_name);
}

Result<void> Directory::take(std::string_view stream, std::optional<std::string_view> text, std::uint64_t revision,
                             TimeUs now_us, std::string_view from) {
  const bool of_table = from.empty();
  const auto found = streams_.find(stream);
  const bool is_new = found == streams_.end();
  // What a broker said of the table is void if the table still says otherwise at its next reading.
  const bool due = of_table && !is_new && found->second.reading < reading_;
  if (!is_new && revision <= found->second.revision && !due) return {};
  const std::string before = is_new || !found->second.entry ? std::string() : found->second.entry->owner;
  std::optional<DirectoryEntry> entry;
  Result<void> read;
  if (text) {
    auto parsed = entry_from_text(*text);
    if (parsed) entry = std::move(*parsed);
    if (!parsed) read = parsed.error();
  }
  if (!of_table) {
    if (!read) return read;
    const bool may = entry ? entry->owner == from : before.empty() || before == from || !is_alive(before, now_us);
    if (!may) return fail(ErrorCode::kRefused, "broker " + std::string(from) + " claims it for another one");
  }
  if (!has_room(is_new, entry, before, now_us)) {
    return fail(ErrorCode::kTooLarge, "there are too many streams in the cluster, or at one broker");
  }
  Known& known = streams_[std::string(stream)];
  known.revision = revision;
  known.reading = reading_;
  if (!read) return read;
  known.since_us = now_us;
  set(known, std::move(entry));
  return {};
}

bool Directory::has_room(bool is_new, const std::optional<DirectoryEntry>& entry, std::string_view owner_before,
                         TimeUs now_us) {
  if (entry && entry->owner == self_) return true;  // limits.max_streams bounds these.
  const auto is_full = [&] {
    if (is_new && streams_.size() >= kMaxStreams) return true;
    if (!entry || name_of_broker(entry->owner) == name_of_broker(owner_before)) return false;
    const auto count = streams_of_.find(name_of_broker(entry->owner));
    return count != streams_of_.end() && count->second >= kMaxStreamsPerName;
  };
  if (!is_full()) return true;
  if (now_us < next_room_us_) return false;
  next_room_us_ = now_us + kMakeRoomEveryUs;
  // Streams that ended make room, too. Their revisions stay as long as possible: who claims one again needs it.
  const bool all = streams_.size() >= kMaxStreams;
  for (auto it = streams_.begin(); it != streams_.end();) {
    const std::optional<DirectoryEntry>& other = it->second.entry;
    const bool is_here = other && (other->owner == self_ || is_alive(other->owner, now_us));
    const bool is_needed = is_here && (other->live || other->owner == self_);
    if (is_here && !is_needed) set(it->second, std::nullopt);
    it = is_needed || (!all && (is_here || !other)) ? std::next(it) : erase(it);
  }
  return !is_full();
}

void Directory::set(Known& known, std::optional<DirectoryEntry> entry) {
  if (known.entry) {
    const auto count = streams_of_.find(name_of_broker(known.entry->owner));
    if (--count->second == 0) streams_of_.erase(count);
  }
  known.entry = std::move(entry);
  if (known.entry) ++streams_of_[std::string(name_of_broker(known.entry->owner))];
}

Directory::Streams::iterator Directory::erase(Streams::iterator found) {
  set(found->second, std::nullopt);
  return streams_.erase(found);
}

void Directory::end_reading() {
  for (auto it = streams_.begin(); it != streams_.end();)
    it = it->second.reading < reading_ ? erase(it) : std::next(it);
  ++reading_;
}

void Directory::drop_removed(std::string_view stream) {
  if (const auto found = streams_.find(stream); found != streams_.end() && !found->second.entry) streams_.erase(found);
}

void Directory::restart() {
  streams_.clear();
  streams_of_.clear();
}

void Directory::note_heartbeat(std::string_view broker, TimeUs now_us) {
  if (!is_broker_id(broker)) return;
  const auto found = last_heartbeat_us_.find(broker);
  if (found != last_heartbeat_us_.end()) {
    found->second = now_us;
    return;
  }
  const std::string name(name_of_broker(broker));
  auto oldest = last_heartbeat_us_.end();
  std::size_t runs = 0;
  for (auto it = last_heartbeat_us_.lower_bound(name + "."); it != last_heartbeat_us_.end(); ++it, ++runs) {
    if (name_of_broker(it->first) != name) break;
    if (oldest == last_heartbeat_us_.end() || it->second < oldest->second) oldest = it;
  }
  if (runs >= kMaxRuns) {
    if (now_us - oldest->second < kHeartbeatTimeoutUs) return;
    last_heartbeat_us_.erase(oldest);
  }
  if (last_heartbeat_us_.size() < kMaxBrokers) last_heartbeat_us_.emplace(broker, now_us);
}

void Directory::note_stopped(std::string_view broker) {
  if (const auto found = last_heartbeat_us_.find(broker); found != last_heartbeat_us_.end()) {
    last_heartbeat_us_.erase(found);
  }
}

void Directory::forget_silent(TimeUs now_us) {
  const TimeUs longest = std::max(2 * kForgetUs, heartbeat_periods() * kHeartbeatTimeoutUs);
  std::erase_if(last_heartbeat_us_, [&](const auto& item) { return now_us - item.second > longest; });
}

bool Directory::is_alive(std::string_view broker, TimeUs now_us) const {
  if (broker == self_ || now_us - began_us_ < kHeartbeatTimeoutUs) return true;
  const auto found = last_heartbeat_us_.find(broker);
  return found != last_heartbeat_us_.end() && now_us - found->second < kHeartbeatTimeoutUs;
}

const Directory::Known* Directory::find(std::string_view stream) const {
  const auto found = streams_.find(stream);
  return found == streams_.end() ? nullptr : &found->second;
}

const DirectoryEntry* Directory::live(std::string_view stream, TimeUs now_us) const {
  const Known* known = find(stream);
  if (known == nullptr || !known->entry || !known->entry->live || !is_alive(known->entry->owner, now_us)) {
    return nullptr;
  }
  return &*known->entry;
}

std::uint64_t Directory::revision(std::string_view stream) const {
  const Known* known = find(stream);
  return known == nullptr ? 0 : known->revision;
}

std::vector<std::string> Directory::forgotten(TimeUs now_us) const {
  std::vector<std::string> names;
  if (now_us - began_us_ < kForgetUs) return names;
  for (const auto& [name, known] : streams_) {
    if (names.size() == kMaxForgotten) break;
    if (!known.entry) continue;
    if (known.entry->owner == self_) {
      if (!known.entry->live && now_us - known.since_us > kForgetUs) names.push_back(name);
      continue;
    }
    const auto heard = last_heartbeat_us_.find(known.entry->owner);
    if (heard == last_heartbeat_us_.end() || now_us - heard->second > kForgetUs) names.push_back(name);
  }
  return names;
}

std::size_t Directory::brokers(TimeUs now_us) const {
  return 1 + static_cast<std::size_t>(
                 std::count_if(last_heartbeat_us_.begin(), last_heartbeat_us_.end(), [&](const auto& item) {
                   return item.first != self_ && now_us - item.second < heartbeat_periods() * kHeartbeatTimeoutUs;
                 }));
}

bool yields_to(const DirectoryEntry& mine, const DirectoryEntry& other) {
  return std::tie(mine.epoch, mine.owner) < std::tie(other.epoch, other.owner);
}

}  // namespace eigencast::broker
