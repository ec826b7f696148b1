// SPDX-License-Identifier: MIT
#include "broker/backbone/directory.h"

#include <nlohmann/json.hpp>
#include <tuple>

namespace eigencast::broker {
namespace {

constexpr std::size_t kMaxEntryBytes = 65'536;
constexpr std::size_t kMaxOwnerBytes = 64;
constexpr std::size_t kMaxProofBytes = 128;

Error corrupt(const std::string& why) {
  return fail(ErrorCode::kCorrupt, "an entry of the directory of streams cannot be read (" + why +
                                       "); do all brokers run the same version?");
}

}  // namespace

std::string text_from_entry(const DirectoryEntry& entry) {
  // The announcement is embedded as a control message, for its hardened parser.
  nlohmann::json json{{"owner", entry.owner},
                      {"epoch", entry.epoch},
                      {"live", entry.live},
                      {"announce", text_from_control(entry.announce)}};
  if (!entry.resume.empty()) json["resume"] = entry.resume;
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
  if (entry.owner.empty() || entry.owner.size() > kMaxOwnerBytes) return corrupt("owner");
  if (epoch->get<std::uint64_t>() == 0 || epoch->get<std::uint64_t>() > UINT32_MAX) return corrupt("epoch");
  entry.epoch = epoch->get<std::uint32_t>();
  entry.live = live->get<bool>();
  const auto message = control_from_text(announce->get<std::string>());
  if (!message) return corrupt(message.error().message);
  const auto* announced = std::get_if<control::Announce>(&*message);
  if (announced == nullptr) return corrupt("announce");
  if (const auto format = check_format(announced->format); !format) return corrupt(format.error().message);
  entry.announce = *announced;
  entry.announce.resume.clear();  // No broker writes one.
  if (const auto resume = json.find("resume"); resume != json.end()) {
    if (!resume->is_string()) return corrupt("resume");
    entry.resume = resume->get<std::string>();
    if (entry.resume.empty() || entry.resume.size() > kMaxProofBytes) return corrupt("resume");
  }
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

Result<void> Directory::take(std::string_view stream, std::optional<std::string_view> text, std::uint64_t revision) {
  Known& known = streams_[std::string(stream)];
  if (revision <= known.revision) return {};
  known.revision = revision;
  if (!text) {
    known.entry.reset();
    return {};
  }
  auto entry = entry_from_text(*text);
  if (!entry) return entry.error();
  known.entry = std::move(*entry);
  return {};
}

void Directory::note_heartbeat(std::string_view broker, TimeUs now_us) {
  if (broker.empty() || broker.size() > kMaxOwnerBytes) return;
  const auto found = last_heartbeat_us_.find(broker);
  if (found != last_heartbeat_us_.end()) {
    found->second = now_us;
  } else if (last_heartbeat_us_.size() < kMaxBrokers) {
    last_heartbeat_us_.emplace(broker, now_us);
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
    if (!known.entry || known.entry->owner == self_) continue;
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
