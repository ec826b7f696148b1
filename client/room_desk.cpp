// SPDX-License-Identifier: MIT
#include "client/room_desk.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <glm/geometric.hpp>
#include <nlohmann/json.hpp>
#include <utility>

#include "common/wire/limits.h"

namespace eigencast {
namespace {

using nlohmann::json;

constexpr const char* kSeek = "seek";
constexpr const char* kPinPrefix = "pin.";
constexpr TimeUs kFollowUs = 150'000;  ///< In which most of a camera's way is gone.

json parsed(const std::string& text) {
  return json::parse(text, nullptr, /*allow_exceptions=*/false);
}

json list(const glm::vec3& v) {
  return json::array({v.x, v.y, v.z});
}

std::optional<glm::vec3> vector_in(const json& object, const char* name) {
  constexpr double kFarthest = 1e12;
  const json value = object.is_object() ? object.value(name, json()) : json();
  if (!value.is_array() || value.size() != 3) return std::nullopt;
  glm::vec3 vector{0};
  for (int i = 0; i < 3; ++i) {
    const json& number = value[static_cast<std::size_t>(i)];
    if (!number.is_number() || !(std::abs(number.get<double>()) < kFarthest)) return std::nullopt;
    vector[i] = number.get<float>();
  }
  return vector;
}

/// To whole characters of at most kMaxNoteBytes.
std::string shortened(std::string note) {
  std::size_t end = std::min(note.size(), RoomDesk::kMaxNoteBytes);
  while (end < note.size() && end > 0 && (note[end] & 0xC0) == 0x80) --end;
  note.resize(end);
  return note;
}

/// The mean over the corners that have arrived.
std::optional<std::array<std::uint32_t, 3>> rows_at(const std::vector<std::uint32_t>& row_of,
                                                    const SurfacePoint& point) {
  std::array<std::uint32_t, 3> rows{};
  for (std::size_t i = 0; i < 3; ++i) {
    if (point.corners[i] >= row_of.size() || row_of[point.corners[i]] == ~0U) return std::nullopt;
    rows[i] = row_of[point.corners[i]];
  }
  return rows;
}

}  // namespace

std::string text_from_point(const SurfacePoint& point, const std::string& note) {
  json text{{"stream", point.stream}, {"corners", point.corners}, {"weights", list(point.weights)}};
  if (!note.empty()) text["note"] = note;
  return text.dump(-1, ' ', false, json::error_handler_t::replace);
}

std::optional<SurfacePoint> point_from_text(const std::string& text, std::string* note) {
  const json value = parsed(text);
  if (!value.is_object()) return std::nullopt;
  const json stream = value.value("stream", json()), corners = value.value("corners", json()),
             said = value.value("note", json());
  const auto weights = vector_in(value, "weights");
  if (!stream.is_string() || !corners.is_array() || corners.size() != 3 || !weights) return std::nullopt;
  SurfacePoint point{stream.get<std::string>(), {}, *weights};
  for (std::size_t i = 0; i < 3; ++i) {
    const auto* corner = corners[i].get_ptr<const std::uint64_t*>();
    if (corner == nullptr || *corner > 0xFFFF'FFFEU) return std::nullopt;
    point.corners[i] = static_cast<std::uint32_t>(*corner);
  }
  constexpr float kRounding = 0.01F;
  const float least = std::min({weights->x, weights->y, weights->z});
  if (least < -kRounding || std::abs(weights->x + weights->y + weights->z - 1) > kRounding) return std::nullopt;
  if (note != nullptr && said.is_string()) *note = shortened(said.get<std::string>());
  return point;
}

std::array<std::uint8_t, 3> colour_from_text(const std::string& colour) {
  unsigned r = 128, g = 128, b = 128;
  (void)std::sscanf(colour.c_str(), "#%2x%2x%2x", &r, &g, &b);
  return {static_cast<std::uint8_t>(r), static_cast<std::uint8_t>(g), static_cast<std::uint8_t>(b)};
}

std::string colour_of_name(const std::string& name) {
  // Okabe, Ito 2008, "Color Universal Design", and a rose instead of black.
  constexpr std::array kColours{"#e69f00", "#56b4e9", "#009e73", "#f0e442", "#0072b2", "#d55e00", "#cc79a7", "#ff6b8b"};
  std::uint32_t hash = 2166136261U;  // FNV-1a
  for (const char c : name) hash = (hash ^ static_cast<unsigned char>(c)) * 16777619U;
  return kColours[hash % kColours.size()];
}

bool RoomDesk::leads() const {
  const auto lead = state_.floors.find(kLead);
  return lead != state_.floors.end() && lead->second == state_.self && state_.self != 0;
}

void RoomDesk::lead(bool take) {
  if (take) said_camera_.clear();
  client_->take(kLead, take);
}

bool RoomDesk::advance(Camera& camera, TimeUs now_us) {
  const std::uint64_t before = state_.version;
  client_->read(state_);
  const bool news = state_.version != before;
  if (news) find_points();
  const TimeUs passed_us = now_us - std::exchange(moved_us_, now_us);
  if (leads()) {
    goal_.reset();
    std::string at = json{{"eye", list(camera.position())}, {"target", list(camera.target())}}.dump();
    if (at != said_camera_) client_->say("camera", at);
    said_camera_ = std::move(at);
    return news;
  }
  if (!std::exchange(said_camera_, {}).empty()) client_->say("camera", "null");
  const RoomState::Member* leading = state_.holder_of(kLead);
  const auto wanted = leading == nullptr ? decltype(leading->values.end()){} : leading->values.find("camera");
  if (leading == nullptr || wanted == leading->values.end() || !follows_) {
    goal_.reset();
    return news;
  }
  if (!goal_ || goal_->text != wanted->second) {
    const json place = parsed(wanted->second);
    const auto eye = vector_in(place, "eye"), target = vector_in(place, "target");
    if (!eye || !target || glm::length(*eye - *target) < 1e-6F) return news;
    goal_ = Goal{wanted->second, *eye, *target};
  }
  const glm::vec3 eye = camera.position(), target = camera.target();
  const float left = glm::length(goal_->eye - eye) + glm::length(goal_->target - target);
  if (left < 1e-4F * camera.distance()) return news;
  const float part = 1 - std::exp(-3 * static_cast<float>(std::clamp<TimeUs>(passed_us, 0, kFollowUs)) / kFollowUs);
  const glm::vec3 to_eye = eye + part * (goal_->eye - eye), to_target = target + part * (goal_->target - target);
  if (glm::length(to_eye - to_target) > 1e-6F) camera.look_from(to_eye, to_target);
  return true;
}

void RoomDesk::share(RewindDesk& rewind, std::span<PoseSource* const> sources) {
  const auto named = std::find_if(sources.begin(), sources.end(), [](const auto* one) { return one->info(); });
  const RewindDesk::Led led = leads() && named != sources.end() ? rewind.led() : RewindDesk::Led{};
  std::string said = "null";
  if (led.at_us) said = json{{"stream", (*named)->info()->stream}, {"at_us", *led.at_us}, {"speed", led.speed}}.dump();
  if (said != said_seek_) client_->say(kSeek, said);
  said_seek_ = std::move(said);
  const RoomState::Member* leading = leads() ? nullptr : state_.holder_of(kLead);
  if (leading == nullptr) heard_seek_.clear();
  if (leading == nullptr || !follows_ || !rewind.bar()) return;  // What is kept may come after what the leader says.
  const auto wanted = leading->values.find(kSeek);
  const std::string text = wanted == leading->values.end() ? std::string() : wanted->second;
  if (text == std::exchange(heard_seek_, text)) return;
  const json value = parsed(text);
  const bool is_one = value.is_object() && value.value("at_us", json()).is_number_unsigned() &&
                      value.value("speed", json()).is_number();
  if (!is_one) return rewind.follow({});
  const double speed = value["speed"].get<double>();
  const auto at_us = value["at_us"].get<std::uint64_t>();
  const bool is_good =
      at_us <= static_cast<std::uint64_t>(limits::kMaxTimeUs) &&
      (speed == 0 || (speed >= 1 / limits::kMaxSpeed && speed <= limits::kMaxSpeed));
  if (is_good) rewind.follow({static_cast<TimeUs>(at_us), speed});
}

void RoomDesk::point_at(const std::optional<SurfacePoint>& point) {
  client_->say("pointer", point ? text_from_point(*point) : "null");
}

void RoomDesk::pin(const SurfacePoint& point, std::string note) {
  note = shortened(std::move(note));
  const auto self = state_.members.find(state_.self);
  int number = 1;
  while (self != state_.members.end() && self->second.values.contains(kPinPrefix + std::to_string(number))) ++number;
  client_->say(kPinPrefix + std::to_string(number), text_from_point(point, note), true);
}

void RoomDesk::find_points() {
  points_.clear();
  for (const auto& [id, member] : state_.members) {
    for (const auto& [key, text] : member.values) {
      const bool is_pin = key.starts_with(kPinPrefix);
      if (!is_pin && (key != "pointer" || id == state_.self)) continue;
      std::string note;
      auto point = point_from_text(text, &note);
      if (point) points_.push_back({id, key, std::move(note), std::move(*point), is_pin});
    }
  }
}

std::vector<RoomDesk::Pin> RoomDesk::pins(std::span<PoseSource* const> sources) const {
  std::vector<Pin> all;
  for (const Said& said : points_) {
    const bool removable = state_.speaks && (said.member == state_.self || !state_.members.at(said.member).here);
    const bool is_shown = std::any_of(sources.begin(), sources.end(), [&](const PoseSource* source) {
      return source->info() && source->info()->stream == said.point.stream;
    });
    if (said.is_pin && is_shown) all.push_back({said.member, said.key, said.note, removable});
  }
  return all;
}

void RoomDesk::remove(const Pin& pin) {
  if (pin.member == state_.self) return client_->say(pin.key, "null", true);
  client_->remove(pin.member, pin.key);
}

const RoomDesk::Rows& RoomDesk::rows_of(std::size_t source, const PoseSource& from) {
  const Asset& asset = *from.asset();
  Rows& rows = rows_[source];
  if (rows.epoch == from.epoch() && rows.ready == asset.rows_ready) return rows;
  rows.epoch = from.epoch();
  rows.ready = asset.rows_ready;
  rows.row_of.assign(asset.vertex_count, ~0U);
  const std::size_t known = std::min<std::size_t>(asset.rows_ready, asset.source_vertex.size());
  for (std::uint32_t row = 0; row < known; ++row) rows.row_of[asset.source_vertex[row]] = row;
  return rows;
}

std::vector<RoomDesk::Mark> RoomDesk::marks(const Scene& scene, std::span<PoseSource* const> sources) {
  std::vector<Mark> all;
  for (const Said& said : points_) {
    const RoomState::Member& member = state_.members.at(said.member);
    for (std::size_t i = 0; i < scene.instances().size(); ++i) {
      const Scene::Instance& instance = scene.instances()[i];
      const PoseSource& source = *sources[instance.placement.source];
      const Asset* asset = source.asset();
      if (!instance.visible || asset == nullptr || !source.info() || source.info()->stream != said.point.stream)
        continue;
      const auto rows = rows_at(rows_of(instance.placement.source, source).row_of, said.point);
      const std::uint32_t drawn = instance.view.reconstructor().tiles().rows();
      if (!rows || *std::max_element(rows->begin(), rows->end()) >= drawn) continue;
      const glm::vec3 at = instance.view.point(*rows, said.point.weights, room_);
      all.push_back({glm::vec3(instance.scene_from_surface * glm::vec4(at, 1)), colour_from_text(member.colour),
                     said.is_pin ? said.note : member.name, said.is_pin});
    }
  }
  return all;
}

std::optional<SurfacePoint> RoomDesk::point_of(const Hit& hit, const Scene& scene,
                                               std::span<PoseSource* const> sources) {
  const PoseSource& source = *sources[scene.instances()[hit.surface].placement.source];
  const Asset* asset = source.asset();
  if (asset == nullptr || !source.info()) return std::nullopt;
  SurfacePoint point{source.info()->stream, {}, hit.weights};
  for (std::size_t i = 0; i < 3; ++i) {
    if (hit.rows[i] >= asset->source_vertex.size()) return std::nullopt;
    point.corners[i] = asset->source_vertex[hit.rows[i]];
  }
  return point;
}

}  // namespace eigencast
